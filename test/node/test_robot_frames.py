"""The base's pose, the transform for tf, odometry of the base: with a stand-in for tf2_ros."""
from array import array
from time import monotonic
from types import SimpleNamespace
from typing import Any

from box_room import apart, EXPANSION, planar, view, write_box_model
from diagnostic_msgs.msg import DiagnosticArray, DiagnosticStatus
from geometry_msgs.msg import PoseWithCovarianceStamped
from live_node import Camera, node_beside
from nav_msgs.msg import Odometry
from neo_ros.geometry import CameraPose
from neo_ros.geometry.camera_pose import T_BODY_OPTICAL
from neo_ros.messages import image_fields
from neo_ros.messages.hints import read_pose
from neo_ros.node.pose_inputs import PoseInputs
from neo_ros.node.robot_frames import RobotFrames
import numpy as np
import pytest
from rclpy.lifecycle import TransitionCallbackReturn
from rclpy.time import Time
from rosgraph_msgs.msg import Clock
from sensor_msgs.msg import Image
import tf2_stand_in
from tf2_stand_in import Buffer, TransformBroadcaster, TransformListener

# The camera 0.2 m before the base and 1.1 m above it, looking ahead.
T_BASE_CAMERA = T_BODY_OPTICAL.copy()
T_BASE_CAMERA[:3, 3] = [0.2, 0.0, 1.1]
STAMP_S = 1_700_000_000


@pytest.fixture
def tf2(monkeypatch):
    tf2_stand_in.install(monkeypatch)


def send(publisher, pose, stamp_s=STAMP_S, frame='camera_optical'):
    fields = image_fields(view(pose, EXPANSION.source)[0])
    message = Image(**(fields | {'data': array('B', bytes(fields['data']))}))
    message.header.frame_id, message.header.stamp.sec = frame, stamp_s
    publisher.publish(message)


def test_the_base_is_where_the_camera_says(tmp_path, graph, tf2):
    images = graph.node.create_publisher(Image, '/robot/image', 10)
    poses = graph.collect(PoseWithCovarianceStamped, '/robot/wide/base_pose')
    with node_beside(graph, write_box_model(tmp_path), '-p', 'base_frame:=base_link'):
        graph.spin_until(images.get_subscription_count)
        graph.spin_for(0.3)
        send(images, planar(2.1, 1.6, 40))
        graph.spin_for(1.0)
        assert not poses  # Nobody has said where the camera is.
        Buffer.known['base_link', 'camera_optical'] = T_BASE_CAMERA
        send(images, planar(2.1, 1.6, 40))
        graph.spin_until(lambda: poses)
        base = CameraPose.nearest(
            planar(2.1, 1.6, 40).T_world_cam @ np.linalg.inv(T_BASE_CAMERA))
        assert apart(read_pose(poses[0].pose.pose), base)[0] < 0.03
        assert poses[0].header.frame_id == 'map' and poses[0].header.stamp.sec == STAMP_S
        assert not TransformBroadcaster.sent


def test_tf_hears_where_odom_is_in_the_map_though_nobody_subscribes(tmp_path, graph, tf2):
    T_odom_base = CameraPose.from_planar(0.7, -0.3, 0.0, 0.4).T_world_cam @ np.linalg.inv(
        T_BODY_OPTICAL)
    Buffer.known['base_link', 'camera_optical'] = T_BASE_CAMERA
    images = graph.node.create_publisher(Image, '/robot/image', 10)
    with node_beside(graph, write_box_model(tmp_path), '-p', 'base_frame:=base_link',
                     '-p', 'publish_tf:=true') as node:
        graph.spin_until(images.get_subscription_count)
        graph.spin_for(0.3)
        send(images, planar(2.1, 1.6, 40))
        graph.spin_for(1.0)
        assert not TransformBroadcaster.sent  # The odometry is silent.
        Buffer.known['odom', 'base_link'] = T_odom_base
        send(images, planar(2.1, 1.6, 40))
        sent = graph.spin_until(lambda: TransformBroadcaster.sent and TransformBroadcaster.sent[0])
        assert (sent.header.frame_id, sent.child_frame_id) == ('map', 'odom')
        # Dated ahead: who asks for now finds it.
        assert (sent.header.stamp.sec, sent.header.stamp.nanosec) == (STAMP_S, 500_000_000)
        at, turn = sent.transform.translation, sent.transform.rotation
        T_map_odom = CameraPose.from_quaternion(
            np.array([at.x, at.y, at.z]),
            np.array([turn.x, turn.y, turn.z, turn.w])).T_world_cam
        camera = CameraPose.nearest(T_map_odom @ T_odom_base @ T_BASE_CAMERA)
        assert apart(camera, planar(2.1, 1.6, 40))[0] < 0.02
        asked = node._scene.frames._buffer.asked
        # At the image's time.
        assert {('odom', 'base_link', STAMP_S * 10**9),
                ('base_link', 'camera_optical', STAMP_S * 10**9)} <= set(asked)
        assert TransformListener.listening == 1 and graph.node.count_publishers('/tf') == 1
        for transition in (node.trigger_deactivate, node.trigger_cleanup):
            assert transition() == TransitionCallbackReturn.SUCCESS
        assert TransformListener.listening == 0
        graph.spin_until(lambda: not graph.node.count_publishers('/tf'))


def test_a_stamp_before_time_began_costs_the_base_alone(tmp_path, graph, tf2):
    Buffer.known['base_link', 'camera_optical'] = T_BASE_CAMERA
    images = graph.node.create_publisher(Image, '/robot/image', 10)
    bases = graph.collect(PoseWithCovarianceStamped, '/robot/wide/base_pose')
    poses = graph.collect(PoseWithCovarianceStamped, '/robot/wide/pose')
    states = graph.collect(DiagnosticArray, '/robot/wide/status')
    with node_beside(graph, write_box_model(tmp_path), '-p', 'base_frame:=base_link'):
        graph.spin_until(images.get_subscription_count)
        graph.spin_for(0.3)
        send(images, planar(2.1, 1.6, 40), -1)
        graph.spin_until(lambda: poses and states)
        send(images, planar(2.1, 1.6, 40))
        graph.spin_until(lambda: bases)
        assert bases[0].header.stamp.sec == STAMP_S


def test_where_nobody_knows_the_scale_nothing_is_said_in_metres(tmp_path, graph, tf2):
    for pair in (('base_link', 'camera_optical'), ('odom', 'base_link')):
        Buffer.known[pair] = T_BASE_CAMERA
    images = graph.node.create_publisher(Image, '/robot/image', 10)
    odometry = graph.node.create_publisher(Odometry, '/robot/odom', 10)
    bases = graph.collect(PoseWithCovarianceStamped, '/robot/wide/base_pose')
    poses = graph.collect(PoseWithCovarianceStamped, '/robot/wide/pose')
    with node_beside(graph, write_box_model(tmp_path, arbitrary_scale=True),
                     '-p', 'base_frame:=base_link', '-p', 'publish_tf:=true') as node:
        graph.spin_until(images.get_subscription_count)
        graph.spin_until(odometry.get_subscription_count)
        graph.spin_for(0.3)
        send(images, planar(2.1, 1.6, 40))
        graph.spin_until(lambda: poses)
        for stamp_s in (STAMP_S - 1, STAMP_S + 1):
            message = Odometry(child_frame_id='base_link')
            message.header.stamp.sec = stamp_s
            odometry.publish(message)
        graph.spin_for(0.5)
        assert poses[0].header.frame_id == 'scene' and not bases
        assert not TransformBroadcaster.sent and not node._scene.inputs.hints._odometry


def test_a_transform_that_is_missing_is_told(tmp_path, graph, tf2, monkeypatch):
    monkeypatch.setattr('neo_ros.node.robot_frames.MISSED_S', 0.5)
    camera = Camera(graph)
    with node_beside(graph, write_box_model(tmp_path), '-p', 'base_frame:=base_link',
                     '-p', 'publish_tf:=true'):
        camera.wait_for_node()
        graph.node.create_timer(0.2, lambda: send(
            camera.images, planar(2.1, 1.6, 40), frame='/camera_optical'))
        camera.wait_for_diagnosis(
            DiagnosticStatus.WARN, '; no transform from base_link to camera_optical: ')
        Buffer.known['base_link', 'camera_optical'] = T_BASE_CAMERA
        camera.wait_for_diagnosis(DiagnosticStatus.WARN, 'second; no transform from odom to base')
        Buffer.known['odom', 'base_link'] = np.eye(4)
        camera.diagnostics.clear()
        camera.wait_for_diagnosis(DiagnosticStatus.WARN, 'second; no camera_info')
        assert TransformBroadcaster.sent


def test_a_camera_that_turns_on_the_robot_is_where_it_was_at_the_images_time(
        tmp_path, graph, tf2):
    turned = T_BASE_CAMERA.copy()
    turned[:3, :3] = CameraPose.from_planar(0, 0, 0, 0.5).T_world_cam[:3, :3]
    Buffer.moving['base_link', 'camera_optical'] = {
        STAMP_S * 10**9: T_BASE_CAMERA, (STAMP_S + 1) * 10**9: turned}
    images = graph.node.create_publisher(Image, '/robot/image', 10)
    poses = graph.collect(PoseWithCovarianceStamped, '/robot/wide/base_pose')
    with node_beside(graph, write_box_model(tmp_path), '-p', 'base_frame:=base_link'):
        graph.spin_until(images.get_subscription_count)
        graph.spin_for(0.3)
        # At the last time tf has nothing yet: the newest has to do.
        for ahead, mount in enumerate((T_BASE_CAMERA, turned, turned)):
            send(images, planar(2.1, 1.6, 40), STAMP_S + ahead)
            graph.spin_until(lambda: poses and poses[-1].header.stamp.sec == STAMP_S + ahead)
            base = CameraPose.nearest(planar(2.1, 1.6, 40).T_world_cam @ np.linalg.inv(mount))
            assert apart(read_pose(poses[-1].pose.pose), base)[1] < 1


def test_what_tf_said_later_is_forgotten_when_the_images_begin_anew(tmp_path, graph, tf2):
    Buffer.known['base_link', 'camera_optical'] = T_BASE_CAMERA
    Buffer.moving['odom', 'base_link'] = {}
    images = graph.node.create_publisher(Image, '/robot/image', 10)
    poses = graph.collect(PoseWithCovarianceStamped, '/robot/wide/base_pose')
    with node_beside(graph, write_box_model(tmp_path), '-p', 'base_frame:=base_link'):
        graph.spin_until(images.get_subscription_count)
        graph.spin_for(0.3)
        for stamp_s, kept in ((STAMP_S, True), (STAMP_S - 60, False), (STAMP_S, False)):
            send(images, planar(2.1, 1.6, 40), stamp_s)
            graph.spin_until(lambda: poses and poses[-1].header.stamp.sec == stamp_s)
            assert bool(Buffer.moving) == kept


def test_what_tf_said_later_is_forgotten_when_simulated_time_runs_back(tmp_path, graph, tf2):
    clock = graph.node.create_publisher(Clock, '/clock', 10)
    with node_beside(graph, write_box_model(tmp_path), '-p', 'base_frame:=base_link',
                     '-p', 'use_sim_time:=true') as node:
        def wait_until(seconds):
            clock.publish(Clock(clock=Time(seconds=seconds).to_msg()))
            graph.spin_for(0.05)
            return node.get_clock().now().nanoseconds == seconds * 10**9

        for seconds, kept in ((100, True), (101, True), (5, False)):
            Buffer.moving['odom', 'base_link'] = {}
            graph.spin_until(lambda: wait_until(seconds))
            assert bool(Buffer.moving) == kept
        Buffer.moving['odom', 'base_link'] = {}
        for transition in (node.trigger_deactivate, node.trigger_cleanup):
            assert transition() == TransitionCallbackReturn.SUCCESS
        graph.spin_until(lambda: wait_until(1))
        assert Buffer.moving


@pytest.fixture
def frames(graph, tf2):
    values: Any = SimpleNamespace(base_frame='base_link', odom_frame='odom', publish_tf=False)
    frames = RobotFrames(graph.node, values)
    yield frames
    frames.destroy()


def test_a_transform_that_was_missed_once_is_not_missing_for_good(frames, monkeypatch):
    now = 100.0
    monkeypatch.setattr('neo_ros.node.robot_frames.monotonic', lambda: now)
    told = []
    for now, asked in ((100.0, True), (106.0, True), (150.0, False), (160.0, True),
                       (166.0, True)):
        if asked:
            frames.camera_in_base('eye')
        told.append('from base_link to eye' in frames.missing)
    assert told == [False, True, False, False, True]


@pytest.mark.parametrize('number', [np.inf, 1e308])
def test_a_transform_of_no_use_is_dropped_and_told(graph, frames, number, monkeypatch):
    monkeypatch.setattr('neo_ros.node.robot_frames.MISSED_S', -1.0)
    endless = T_BASE_CAMERA.copy()
    endless[:3, 3] = number
    Buffer.known['base_link', 'camera_optical'] = endless
    inputs = PoseInputs(graph.node, 'map', 'base_link', frames)
    inputs.camera_frame = 'camera_optical'
    message = PoseWithCovarianceStamped()
    message.pose.pose.orientation.w = 1.0
    at = message.pose.pose.position
    at.x = at.y = at.z = 1e308
    inputs._on_prior(message)
    odometry = Odometry(child_frame_id='base_link', pose=message.pose)
    inputs._on_odometry(odometry)
    assert inputs.hints.take_prior() is None and not inputs.hints._odometry
    assert bool(frames.missing) != np.isfinite(number)
    inputs.destroy()


@pytest.fixture
def inputs(graph, frames):
    inputs = PoseInputs(graph.node, 'map', 'base_link', frames)
    yield inputs
    inputs.destroy()


def prior_ahead():
    """Return a prior at the origin of the map, along x."""
    message = PoseWithCovarianceStamped()
    message.pose.pose.orientation.w = 1.0
    return message


def test_a_prior_waits_for_the_first_image_and_for_the_transform(inputs):
    inputs._on_prior(prior_ahead())
    assert inputs.hints.take_prior() is None
    inputs.see_camera('camera_optical')
    assert inputs.hints.take_prior() is None
    Buffer.known['base_link', 'camera_optical'] = T_BASE_CAMERA
    inputs.see_camera('camera_optical')
    found = inputs.hints.take_prior()
    assert found is not None
    assert apart(found, CameraPose(T_BASE_CAMERA)) == pytest.approx((0, 0), abs=1e-9)
    inputs.see_camera('camera_optical')
    assert inputs.hints.take_prior() is None  # It is used once.


@pytest.mark.parametrize('late', [False, True], ids=['another model', 'too late'])
def test_a_prior_that_waits_may_be_of_no_use(inputs, late):
    inputs._on_prior(prior_ahead())
    if late:
        inputs._waiting = prior_ahead(), monotonic() - 11
        inputs.see_camera('camera_optical')
        assert inputs._waiting is None  # Though no transform is known yet.
    else:
        inputs.forget_prior()
    Buffer.known['base_link', 'camera_optical'] = T_BASE_CAMERA
    inputs.see_camera('camera_optical')
    assert inputs.hints.take_prior() is None
