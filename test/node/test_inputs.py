"""Which topics the node listens to, and what it says when they are not what it needs."""
import math

from camera_messages import noise_image
from diagnostic_msgs.msg import DiagnosticArray, DiagnosticStatus
from geometry_msgs.msg import PoseWithCovarianceStamped
from live_node import Camera, node_beside, set_parameter, SOURCE
from neo_ros.geometry import Intrinsics
from neo_ros.messages import camera_info_fields
from neo_ros.node.parameters import override_of
import pytest
import rclpy
from rclpy.parameter import Parameter
from rclpy.qos import DurabilityPolicy, QoSProfile, ReliabilityPolicy
from sensor_msgs.msg import CameraInfo, CompressedImage, Image

LATCHED = QoSProfile(depth=1, durability=DurabilityPolicy.TRANSIENT_LOCAL)
IMAGE_QOS = 'qos_overrides./robot/image.subscription'
WIDER = Intrinsics.from_hfov(64, 48, math.radians(100))
WARN, OK = DiagnosticStatus.WARN, DiagnosticStatus.OK


def calibration(camera, frame=''):
    message = CameraInfo(**camera_info_fields(camera))
    message.header.frame_id = frame
    return message


def test_a_latched_camera_info_is_heard_by_a_node_that_comes_later(graph, model):
    camera = Camera(graph)
    infos = graph.node.create_publisher(CameraInfo, '/robot/camera_info', LATCHED)
    infos.publish(calibration(WIDER))
    with node_beside(graph, model):
        camera.wait_for_node()
        camera.widen(noise_image(WIDER, 0), 1)
        lines = camera.wait_for_diagnosis(OK, 'widening')
        assert lines['camera'].startswith('resampled from 64x48')
        graph.node.destroy_publisher(infos)
        camera.widen(noise_image(SOURCE, 0), 2)
        camera.wait_for_diagnosis(WARN, 'no camera_info: the camera is assumed to be 32x24')


@pytest.mark.parametrize('rules, image, info', [
    (['image:=left/image_raw'], 'left/image_raw', 'left/camera_info'),
    (['image:=left/image_raw', 'camera_info:=right/camera_info'],
     'left/image_raw', 'right/camera_info'),
    (['image:=/eye/image'], '/eye/image', '/eye/camera_info'),
], ids=['follows', 'remapped', 'absolute'])
def test_camera_info_lies_beside_the_image(graph, model, rules, image, info):
    graph.collect(Image, '/robot/wide/image')
    with node_beside(graph, model, *[word for rule in rules for word in ('-r', rule)]):
        for topic in (image, info):
            full = topic if topic[0] == '/' else f'/robot/{topic}'
            graph.spin_until(lambda: graph.node.count_subscribers(full))
        assert not graph.node.count_subscribers('/robot/camera_info')


def test_it_takes_images_only_while_somebody_listens(graph, model):
    images = graph.node.create_publisher(Image, '/robot/image', 10)
    camera_infos = graph.node.create_publisher(CameraInfo, '/robot/camera_info', 10)
    diagnoses = graph.collect(DiagnosticArray, '/diagnostics')
    with node_beside(graph, model) as node:
        status = graph.spin_until(lambda: diagnoses and diagnoses[-1].status[0])
        assert (status.level, status.message) == (
            OK, 'nobody subscribes to wide/*: no image is taken from /robot/image, publishers: 1')
        for kind, topic in ((Image, 'mask'), (PoseWithCovarianceStamped, 'pose')) * 2:
            assert not images.get_subscription_count()
            assert not camera_infos.get_subscription_count()
            listener = graph.node.create_subscription(
                kind, f'/robot/wide/{topic}', lambda message: None, 10)
            graph.spin_until(lambda: images.get_subscription_count() == 1
                             and camera_infos.get_subscription_count() == 1)
            # One more listener changes nothing.
            other = graph.node.create_subscription(
                Image, '/robot/wide/image', lambda message: None, 10)
            graph.spin_until(lambda: node._scene.outputs.wanted().image)
            graph.node.destroy_subscription(other)
            graph.spin_until(lambda: not node._scene.outputs.wanted().image)
            graph.spin_for(0.2)
            assert images.get_subscription_count() == 1
            graph.node.destroy_subscription(listener)
            graph.spin_until(lambda: not images.get_subscription_count()
                             and not camera_infos.get_subscription_count())


def test_compressed_images_follow_a_remapped_image(graph, model):
    graph.collect(Image, '/robot/wide/image')
    with node_beside(graph, model, '-r', 'image:=image_raw', '-p', 'image_transport:=compressed'):
        graph.spin_until(lambda: graph.node.count_subscribers('/robot/image_raw/compressed'))
        assert not graph.node.count_subscribers('/robot/image/compressed')


@pytest.mark.parametrize('kind, topic, parameters, rules, words', [
    (CompressedImage, 'image/compressed', [], [],
     'publishers: 0; there is /robot/image/compressed: set the parameter image_transport to '
     'compressed'),
    (Image, 'image', ['image_transport:=compressed'], [],
     'there is /robot/image: set the parameter image_transport to raw'),
    (CameraInfo, 'image', [], [],
     '/robot/image is sensor_msgs/msg/CameraInfo, expected sensor_msgs/msg/Image'),
    (CompressedImage, 'eye/compressed', [], ['image:=eye/compressed'],
     'remap image to /robot/eye and set the parameter image_transport to compressed'),
    (Image, 'eye/image', [], [], 'there is /robot/eye/image: remap image to the right one'),
], ids=['compressed', 'raw', 'another type', 'compressed by name', 'another name'])
def test_what_the_graph_has_instead_is_named(
        graph, model, kind, topic, parameters, rules, words):
    camera = Camera(graph)
    graph.node.destroy_publisher(camera.images)
    graph.node.create_publisher(kind, f'/robot/{topic}', 10)
    # In a process of its own: no participant may hold one topic with two types.
    camera.start_node(model, *parameters, rules=rules)
    camera.wait_for_diagnosis(WARN, words)


def test_two_publishers_of_one_topic_are_named(graph, model):
    camera = Camera(graph)
    other = rclpy.create_node('other', namespace='eyes', context=graph.context)
    other.create_publisher(Image, '/robot/image', 10)
    with node_beside(graph, model):
        camera.wait_for_diagnosis(
            WARN, '/eyes/other and /test publish /robot/image: remap one of them')
    other.destroy_node()


def test_the_wait_says_what_it_waits_for_and_a_frame_that_does_not_fit_is_told(graph, model):
    camera = Camera(graph)
    with node_beside(graph, model) as node:
        camera.wait_for_node()
        infos = graph.node.create_publisher(CameraInfo, '/robot/camera_info', 10)
        graph.spin_until(infos.get_subscription_count)
        graph.spin_for(0.3)
        camera.publish(noise_image(SOURCE, 0), 1)
        graph.spin_until(lambda: node._inputs.missing == (
            'an image came on /robot/image; it waits up to 2 s for the camera_info on '
            '/robot/camera_info'))
        infos.publish(calibration(WIDER, 'right'))
        graph.spin_for(2.0)
        camera.widen(noise_image(SOURCE, 0), 2)
        camera.wait_for_diagnosis(
            WARN, 'camera_info is of the frame right, the images are of camera_2; no camera_info')


def test_each_image_of_a_camera_that_zooms_meets_its_own_camera_info(graph, model):
    camera = Camera(graph)
    with node_beside(graph, model):
        camera.wait_for_node()
        infos = graph.node.create_publisher(CameraInfo, '/robot/camera_info', 10)

        def send(degrees, number):
            lens = Intrinsics.from_hfov(64, 48, math.radians(degrees))
            sent = camera.publish(noise_image(lens, 0), number)
            message = calibration(lens)
            message.header = sent.header
            infos.publish(message)
            return sent

        # Until both topics have found the node.
        camera.send_until(lambda: send(90, 0), lambda: camera.diagnosis(OK, 'widening'))
        for number, degrees in enumerate((100, 110, 95), start=1):
            sent = send(degrees, number)
            graph.spin_until(lambda: camera.wide['image'] and
                             camera.wide['image'][-1].header == sent.header)
            camera.diagnostics.clear()
            lines = camera.wait_for_diagnosis(OK, 'widening')
            assert f'hfov {degrees:.2f}' in lines['camera']


@pytest.mark.parametrize(('override', 'remedy'), [
    ([], 'set the parameter reliable to true'),
    (['reliable:=true'], 'this computer or the network is too slow for them'),
    ([f'{IMAGE_QOS}.reliability:=reliable'], 'this computer or the network is too slow for them'),
    ([f'{IMAGE_QOS}.reliability:=best_effort', 'reliable:=true'],
     f'set the parameter {IMAGE_QOS}.reliability to reliable'),
], ids=['as it is', 'reliable', 'override', 'override against reliable'])
def test_the_remedy_for_lost_images_is_one_that_helps(graph, model, override, remedy):
    graph.collect(Image, '/robot/wide/image')
    arguments = [part for one in override for part in ('-p', one)]
    with node_beside(graph, model, *arguments) as node:
        graph.spin_until(lambda: graph.node.count_subscribers('/robot/image'))
        assert node._inputs.remedy == remedy


def test_inputs_follow_the_qos_overrides(graph, model):
    graph.collect(Image, '/robot/wide/image')
    with node_beside(graph, model, '-p', f'{IMAGE_QOS}.reliability:=reliable',
                     '-p', f'{IMAGE_QOS}.durability:=transient_local'):
        def profiles(topic):
            return {(found.qos_profile.reliability, found.qos_profile.durability)
                    for found in graph.node.get_subscriptions_info_by_topic(topic)}
        graph.spin_until(lambda: profiles('/robot/camera_info'))
        assert profiles('/robot/image') == {
            (ReliabilityPolicy.RELIABLE, DurabilityPolicy.TRANSIENT_LOCAL)}
        assert profiles('/robot/camera_info') == {
            (ReliabilityPolicy.BEST_EFFORT, DurabilityPolicy.VOLATILE),
            (ReliabilityPolicy.RELIABLE, DurabilityPolicy.TRANSIENT_LOCAL)}


def test_a_publisher_that_keeps_nothing_for_a_node_that_asks_for_it_is_told(graph, model):
    graph.collect(Image, '/robot/wide/image')
    with node_beside(graph, model, '-p', f'{IMAGE_QOS}.durability:=transient_local'):
        camera = Camera(graph)
        camera.wait_for_diagnosis(WARN, '/robot/image is volatile, this node asks for transient '
                                        f'local; take back {IMAGE_QOS}.durability')


def test_a_typo_in_a_qos_override_is_told_and_ends_nothing(graph, model):
    with node_beside(graph, model, '-p', f'{IMAGE_QOS}.reliability:=besteffort') as node:
        camera = Camera(graph)  # Nobody has subscribed to the node before.
        camera.wait_for_diagnosis(WARN, 'cannot subscribe to /robot/image and .*besteffort')
        assert node.state_label == 'active' and not node._inputs.subscribed
        graph.node.create_publisher(CompressedImage, '/robot/image/compressed', 10)
        assert set_parameter(graph, 'image_transport', 'compressed').successful
        camera.diagnostics.clear()
        camera.wait_for_diagnosis(WARN, 'waiting for image on /robot/image/compressed')


def test_an_override_is_found_without_being_declared(graph):
    node = rclpy.create_node('holder', context=graph.context, parameter_overrides=[
        Parameter('given', value=3)])
    assert override_of(node, 'given') == 3 and override_of(node, 'other') is None
    assert not node.has_parameter('given') and not node.has_parameter('other')
    node.declare_parameter('given', 1)
    assert override_of(node, 'given') == 3
    node.destroy_node()


# A driver of VGA images with the defaults of Fast DDS: rclpy's publisher is reliable.
DRIVER = """
import time
from array import array
import rclpy
from sensor_msgs.msg import CameraInfo, Image
rclpy.init()
node = rclpy.create_node('driver')
images = node.create_publisher(Image, '/robot/image', 10)
infos = node.create_publisher(CameraInfo, '/robot/camera_info', 10)
image = Image(width=640, height=480, encoding='rgb8', step=1920, data=array('B', bytes(921600)))
while True:
    image.header.stamp = node.get_clock().now().to_msg()
    images.publish(image)
    infos.publish(CameraInfo(header=image.header))
    time.sleep(0.1)
"""


def test_a_driver_that_loses_large_images_is_recognised_and_the_remedy_helps(
        graph, model, monkeypatch):
    monkeypatch.delenv('FASTRTPS_DEFAULT_PROFILES_FILE', raising=False)
    camera = Camera(graph)
    graph.node.destroy_publisher(camera.images)
    graph.start('-c', DRIVER)
    camera.start_node(model)
    lines = camera.wait_for_diagnosis(
        WARN, '(got lost before this node|the images do not).*: set the parameter reliable to '
        'true(, unless somebody throttles .*)?$', 'camera')
    assert int(lines['images']) < int(lines['camera_infos'])
    assert set_parameter(graph, 'reliable', True).successful
    camera.diagnostics.clear()
    lines = camera.wait_for_diagnosis(OK, r'^[2-9]\d images in five seconds', 'camera')
    assert int(lines['images lost before the node']) < int(lines['images'])


def test_stamps_that_stand_still_are_told(graph, model):
    camera = Camera(graph)
    with node_beside(graph, model):
        camera.wait_for_node()
        graph.node.create_timer(0.1, lambda: camera.publish(noise_image(SOURCE, 0), 7))
        camera.wait_for_diagnosis(WARN, 'images have one stamp: the driver repeats it', 'camera')


def test_images_of_another_time_are_told(graph, model):
    camera = Camera(graph)
    with node_beside(graph, model):
        camera.wait_for_node()
        camera.publish(noise_image(SOURCE, 0), 1)
        camera.wait_for_diagnosis(
            WARN, r'the images are \d+\.\d s old when they come', 'camera')


def test_simulated_time_that_nobody_tells_is_told(graph, model):
    camera = Camera(graph)
    with node_beside(graph, model, '-p', 'use_sim_time:=true'):
        camera.wait_for_node()
        camera.publish(noise_image(SOURCE, 0), 1)
        camera.wait_for_diagnosis(WARN, 'use_sim_time is true, and nobody publishes /clock')
        assert not camera.diagnosis(WARN, 'ahead of the clock', 'camera')
