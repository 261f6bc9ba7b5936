"""What the memory knows, on a real graph: pose, depth, points, status, panorama; priors."""
from array import array
from unittest.mock import Mock

from box_room import (
    apart, box_walk, EXPANSION, planar, view, write_box_model, write_model_without_floor)
from diagnostic_msgs.msg import DiagnosticArray
from geometry_msgs.msg import PoseWithCovarianceStamped
from live_node import Camera, NODE, node_beside, set_parameter
from nav_msgs.msg import OccupancyGrid, Odometry
from neo_ros.geometry import CameraPose
from neo_ros.geometry.camera_pose import quaternion_from_rotation, T_BODY_OPTICAL
from neo_ros.messages import image_fields
from neo_ros.messages.hints import read_pose
from neo_ros.node.extrapolator_node import ExtrapolatorNode
from neo_ros.node.map_publisher import MapPublisher
from neo_ros.node.robot_frames import moved_covariance
from neo_ros.runtime import read_model_card
import numpy as np
from rclpy.lifecycle import TransitionCallbackReturn
from rclpy.parameter import Parameter
from rclpy.qos import DurabilityPolicy, QoSProfile
from sensor_msgs.msg import Image, PointCloud2
from std_srvs.srv import Trigger

KINDS = {'pose': PoseWithCovarianceStamped, 'depth': Image, 'points': PointCloud2,
         'status': DiagnosticArray, 'panorama': Image, 'panorama_mask': Image}


def fill(message, pose):
    position, turn = pose.position.tolist(), quaternion_from_rotation(pose.T_world_cam[:3, :3])
    for name, value in zip('xyz', position):
        setattr(message.position, name, value)
    for name, value in zip('xyzw', turn.tolist()):
        setattr(message.orientation, name, value)


def test_everything_that_is_known_comes_with_the_images_stamp(tmp_path, graph):
    camera = Camera(graph)
    known = {name: graph.collect(kind, f'/robot/wide/{name}') for name, kind in KINDS.items()}
    camera.start_node(write_box_model(tmp_path), 'scene_frame:=flat', 'panorama_width:=128')
    camera.wait_for_node()
    for number, pose in enumerate(box_walk(4)):
        camera.widen(view(pose, EXPANSION.source)[0], number)
        graph.spin_until(lambda: all(
            known[name] and known[name][-1].header.stamp.nanosec == number
            for name in ('pose', 'depth', 'points', 'status')))
        message = known['pose'][-1]
        assert message.header.frame_id == 'flat'
        assert apart(read_pose(message.pose.pose), pose)[0] < 0.02
        assert np.linalg.eigvalsh(message.pose.covariance.reshape(6, 6)).min() > 0
    depth = np.frombuffer(known['depth'][-1].data, np.float32).reshape(128, 128)
    assert np.nanmedian(np.abs(depth - view(pose, EXPANSION.target)[1])) < 0.05
    assert (known['points'][-1].width, known['points'][-1].height) == (64, 64)
    lines = {entry.key: entry.value for entry in known['status'][-1].status[0].values}
    assert lines['guided'] == 'true' and float(lines['agreement']) > 0.9
    # Stamps of the test's images are a billionth of a second apart: one panorama.
    graph.spin_until(lambda: known['panorama'] and known['panorama_mask'])
    assert (known['panorama'][0].width, known['panorama'][0].height) == (128, 64)
    assert set(np.unique(known['panorama_mask'][0].data)) == {0, 128, 255}


def test_prior_odometry_and_relocalize_reach_the_memory(tmp_path, graph):
    camera = Camera(graph)
    poses = graph.collect(PoseWithCovarianceStamped, '/robot/wide/pose')
    status = graph.collect(DiagnosticArray, '/robot/wide/status')
    camera.start_node(write_box_model(tmp_path))
    camera.wait_for_node()
    priors = graph.node.create_publisher(
        PoseWithCovarianceStamped, f'{NODE}/prior', 1)
    odometry = graph.node.create_publisher(Odometry, '/robot/odom', 10)
    graph.spin_until(lambda: priors.get_subscription_count()
                     and odometry.get_subscription_count())
    graph.spin_for(0.3)
    pose = planar(2.1, 1.6, 40)
    camera.widen(view(planar(3.0, 2.4, 200), EXPANSION.source)[0], 1)
    click = PoseWithCovarianceStamped()
    click.header.frame_id = 'map'
    fill(click.pose.pose, CameraPose(CameraPose.from_planar(
        2.4, 1.4, 0.0, np.radians(60)).T_world_cam @ np.linalg.inv(T_BODY_OPTICAL)))
    priors.publish(click)
    broken = Odometry()
    broken.child_frame_id = 'camera_1'
    broken.pose.pose.orientation.w = 0.0
    odometry.publish(broken)
    graph.spin_for(0.3)
    camera.widen(view(pose, EXPANSION.source)[0], 2)
    graph.spin_until(lambda: all(
        kept and kept[-1].header.stamp.nanosec == 2 for kept in (status, poses)))
    assert 'prior' in status[-1].status[0].message
    assert apart(read_pose(poses[-1].pose.pose), pose)[0] < 0.02
    assert graph.call(Trigger, f'{NODE}/relocalize', Trigger.Request()).success
    camera.widen(view(pose, EXPANSION.source)[0], 3)
    graph.spin_until(lambda: status[-1].header.stamp.nanosec == 3)
    assert 'searched' in status[-1].status[0].message


def test_a_prior_is_of_the_scene_frame_that_holds_now(tmp_path, graph, model):
    priors = graph.node.create_publisher(PoseWithCovarianceStamped, f'{NODE}/prior', 1)
    prior = PoseWithCovarianceStamped()
    prior.pose.pose.orientation.w = 1.0
    other = write_box_model(tmp_path, arbitrary_scale=True)  # Its frame is called scene.
    with node_beside(graph, model) as node:
        graph.spin_until(priors.get_subscription_count)
        graph.spin_for(0.3)
        for name, value, frame in (('scene_frame', 'flat', 'flat'), ('scene_frame', '', 'map'),
                                   ('model', str(other), 'scene')):
            assert node.set_parameters([Parameter(name, value=value)])[0].successful
            prior.header.frame_id = frame
            priors.publish(prior)
            graph.spin_until(node._scene.inputs.hints.take_prior)


def test_a_prior_for_one_model_is_not_given_to_the_next(tmp_path, graph, model):
    other = write_box_model(tmp_path)
    with node_beside(graph, model) as node:
        node._scene.inputs.hints.set_prior(planar(2.1, 1.6, 40))
        assert node.set_parameters([Parameter('model', value=str(other))])[0].successful
        assert node._scene.inputs.hints.take_prior() is None


def test_a_camera_that_was_carried_while_nobody_listened_is_searched_for(tmp_path, graph):
    images = graph.node.create_publisher(Image, '/robot/image', 10)
    with node_beside(graph, write_box_model(tmp_path)):
        for number, pose in enumerate([planar(3.0, 2.4, 200), planar(2.1, 1.6, 40)]):
            kept: dict[str, list] = {'pose': [], 'status': []}
            listeners = [graph.node.create_subscription(
                KINDS[name], f'/robot/wide/{name}', kept[name].append, 10) for name in kept]
            graph.spin_until(images.get_subscription_count)
            graph.spin_for(0.3)
            message = Image(**image_fields(view(pose, EXPANSION.source)[0]))
            message.data = array('B', bytes(message.data))
            message.header.stamp.nanosec = number
            images.publish(message)
            graph.spin_until(lambda: all(kept.values()))
            assert 'searched' in kept['status'][0].status[0].message
            assert apart(read_pose(kept['pose'][0].pose.pose), pose)[0] < 0.02
            for listener in listeners:
                graph.node.destroy_subscription(listener)
            graph.spin_until(lambda: not images.get_subscription_count())


def test_a_base_frame_without_tf_says_what_is_missing(tmp_path, graph):
    model = write_box_model(tmp_path)
    for name, value, words in (('base_frame', 'base_link', 'tf2_ros'),
                               ('publish_tf', True, 'base_frame')):
        node = ExtrapolatorNode(context=graph.context, parameter_overrides=[
            Parameter('model', value=str(model)), Parameter(name, value=value)])
        assert node.trigger_configure() == TransitionCallbackReturn.FAILURE
        assert words in node.fault
        node.destroy_node()


def test_a_scene_of_arbitrary_scale_is_not_called_map(tmp_path, graph):
    node = ExtrapolatorNode(context=graph.context, parameter_overrides=[
        Parameter('model', value=str(write_box_model(tmp_path, arbitrary_scale=True)))])
    assert node.trigger_configure() == TransitionCallbackReturn.SUCCESS
    assert node._scene is not None and node._scene.outputs.scene_frame == 'scene'
    node.destroy_node()


def test_a_base_far_from_the_camera_is_known_less_exactly():
    camera = np.diag([1e-4] * 3 + [1e-4] * 3)
    offset = np.array([0.5, 0.0, -1.2])
    base = moved_covariance(camera, offset)
    samples = np.random.default_rng(0).normal(0, 1e-2, (200_000, 6))
    moved = samples[:, :3] + np.cross(samples[:, 3:], offset)
    assert np.allclose(base[:3, :3], np.cov(moved.T), atol=4e-6)
    assert np.allclose(base[:3, 3:], np.cov(np.hstack([moved, samples[:, 3:]]).T)[:3, 3:],
                       atol=4e-6)
    assert np.array_equal(base[3:, 3:], camera[3:, 3:])


def test_the_map_is_latched_and_comes_once_somebody_listens(tmp_path, graph):
    camera = Camera(graph)
    latched = QoSProfile(depth=1, durability=DurabilityPolicy.TRANSIENT_LOCAL)
    camera.start_node(write_box_model(tmp_path), 'scene_frame:=flat')
    camera.wait_for_node()
    for _ in range(2):  # The second one comes late.
        maps = graph.collect(OccupancyGrid, '/robot/wide/map', latched)
        graph.spin_until(lambda maps=maps: maps)
        grid, = maps
        assert grid.header.frame_id == 'flat' and grid.info.resolution > 0
        cells = np.array(grid.data, np.int8).reshape(grid.info.height, grid.info.width)
        # Where the camera walks there is floor.
        for pose in box_walk(4):
            x, y = pose.position[:2]
            column = int((x - grid.info.origin.position.x) / grid.info.resolution)
            row = int((y - grid.info.origin.position.y) / grid.info.resolution)
            assert cells[row, column] == 0
        assert set(np.unique(cells)) <= {-1, 0, 100}
        stamp = grid.header.stamp
    assert maps[0].header.stamp == stamp, 'it is drawn once'
    # A new frame is a new map.
    assert set_parameter(graph, 'scene_frame', 'map').successful
    graph.spin_until(lambda: maps[-1].header.frame_id == 'map')


def test_a_memory_that_shows_no_floor_is_told(tmp_path):
    path, told = write_model_without_floor(tmp_path), Mock()
    model = Mock(description={'path': str(path)}, card=read_model_card(path))
    MapPublisher(Mock(), told)._draw(model, 'map')
    message, = told.call_args.args
    assert message.startswith('no map: the memory shows no floor')


def test_a_node_that_learns_takes_images_though_nobody_subscribes(tmp_path, graph):
    with node_beside(graph, write_box_model(tmp_path), '-p', 'learn:=true') as node:
        assert node._inputs.subscribed
        assert set_parameter(graph, 'learn', False).successful
        graph.spin_until(lambda: not node._inputs.subscribed)
        # What was learnt is kept when it ends, not only when the model is freed.
        assert set_parameter(graph, 'learn', True).successful
        graph.spin_until(lambda: node._inputs.subscribed)
        learner = node._model.processor._extrapolator._guided_view._guide
        assert learner.learner is not None
        assert node.end() and learner.learner is None
