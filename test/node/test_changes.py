"""What may change under a running node: model, transport, camera, files, clock, neighbours."""
from array import array
import logging
import math
import os
import signal
import time

from camera_messages import noise_image
import cv2
from diagnostic_msgs.msg import DiagnosticStatus
from geometry_msgs.msg import PoseWithCovarianceStamped
from live_node import Camera, end, NODE, node_beside, set_parameter, started
from neo_ros.geometry import Intrinsics, ViewExpansion
from neo_ros.messages import camera_info_fields, CameraFit
from neo_ros.messages.compressed_image import read_compressed_image
from neo_ros.runtime import FovExtrapolator
import numpy as np
import pytest
from rclpy.parameter import Parameter
from rclpy.qos import qos_profile_sensor_data, ReliabilityPolicy
from rclpy.time import Time
from rosgraph_msgs.msg import Clock
from sensor_msgs.msg import CompressedImage, Image
from std_srvs.srv import SetBool, Trigger
from tiny_model import TINY_EXPANSION, write_tiny_model

SOURCE = TINY_EXPANSION.source
LARGER = ViewExpansion.to_size(SOURCE, 80, 60)


def pixels(message):
    return np.frombuffer(message.data, np.uint8).reshape(message.height, message.width, -1)


def test_another_model_takes_over_without_losing_the_subscription(graph, model, tmp_path):
    camera, _ = started(graph, model)
    camera.publish_info()
    image = noise_image(SOURCE, 0)
    assert camera.widen(image, 1)['image'].width == 64
    larger = write_tiny_model(tmp_path / 'larger.onnx', LARGER, scene_id='kitchen')
    broken = tmp_path / 'broken.onnx'
    broken.write_bytes(model.read_bytes()[:400])
    lost = []
    graph.node.create_timer(0.01, lambda: lost.append(not camera.images.get_subscription_count()))
    refusal = set_parameter(graph, 'model', str(broken))
    assert not refusal.successful and 'truncated' in refusal.reason
    assert camera.widen(image, 2)['image'].width == 64
    assert set_parameter(graph, 'model', str(larger)).successful
    wide = camera.widen(image, 3)
    assert (wide['image'].width, wide['mask'].width, wide['camera_info'].width) == (80,) * 3
    np.testing.assert_array_equal(
        pixels(wide['image']), FovExtrapolator.load(larger).expand(image).wide_image)
    camera.diagnostics.clear()
    lines = camera.wait_for_diagnosis(DiagnosticStatus.OK, 'widening')
    assert lines['model scene'] == 'kitchen'
    assert lost and not any(lost)


def test_images_are_widened_while_another_model_loads(graph, model, tmp_path):
    larger = write_tiny_model(tmp_path / 'larger.onnx', LARGER)
    image, widths = noise_image(SOURCE, 0), []

    def load_slowly(path, *arguments):
        for number in range(2, 6) if str(path) == str(larger) else ():
            # In the loader's thread: the node's waits for it.
            widths.append(camera.widen(image, number)['image'].width)
        return FovExtrapolator.load(path, *arguments)

    camera = Camera(graph)
    with node_beside(graph, model, load=load_slowly) as node:
        camera.wait_for_node()
        camera.widen(image, 1)
        graph.executor.remove_node(node)  # No executor runs it, as while its callback loads.
        result, = node.set_parameters([Parameter('model', value=str(larger))])
        graph.executor.add_node(node)
        assert result.successful and widths == [64] * 4
        assert camera.widen(image, 6)['image'].width == 80


def test_priors_and_the_clock_are_heard_while_another_model_loads(graph, model, tmp_path):
    larger = write_tiny_model(tmp_path / 'larger.onnx', LARGER)
    priors = graph.node.create_publisher(
        PoseWithCovarianceStamped, '/robot/fov_extrapolator/prior', 10)
    clock = graph.node.create_publisher(Clock, '/clock', 10)
    heard: list[object] = []

    def load_slowly(path, *arguments):
        if str(path) == str(larger):
            prior = PoseWithCovarianceStamped()
            prior.pose.pose.orientation.w = 1.0
            clock.publish(Clock(clock=Time(seconds=100).to_msg()))
            priors.publish(prior)
            deadline = time.monotonic() + 10
            while heard[-1:] != [(True, True)] and time.monotonic() < deadline:
                time.sleep(0.02)
                heard.append((node._scene.inputs.hints._prior is not None,
                              node.get_clock().now().nanoseconds == 100 * 10**9))
        return FovExtrapolator.load(path, *arguments)

    with node_beside(graph, model, '-p', 'use_sim_time:=true', load=load_slowly) as node:
        graph.spin_until(lambda: priors.get_subscription_count()
                         and clock.get_subscription_count())
        graph.spin_for(0.3)
        graph.executor.remove_node(node)  # No executor runs it, as while its callback loads.
        result, = node.set_parameters([Parameter('model', value=str(larger))])
        graph.executor.add_node(node)
    assert result.successful and heard[-1] == (True, True)


def test_a_replaced_file_is_loaded_on_request_only_and_a_deleted_one_does_no_harm(graph, model):
    camera, _ = started(graph, model)
    image = noise_image(SOURCE, 0)
    other = model.with_name('other.onnx')
    write_tiny_model(other, LARGER)
    os.replace(other, model)
    assert camera.widen(image, 1)['image'].width == 64
    answer = graph.call(Trigger, f'{NODE}/reload_model', Trigger.Request())
    assert answer.success and str(model) in answer.message
    assert camera.widen(image, 2)['image'].width == 80
    model.unlink()
    assert camera.widen(image, 3)['image'].width == 80
    answer = graph.call(Trigger, f'{NODE}/reload_model', Trigger.Request())
    assert not answer.success and 'no such model file' in answer.message
    assert camera.widen(image, 4)['image'].width == 80


def jpeg(image, number, quality=95):
    data = cv2.imencode('.jpg', image[..., ::-1], [cv2.IMWRITE_JPEG_QUALITY, quality])[1]
    message = CompressedImage(format='jpeg', data=array('B', data.tobytes()))
    message.header.stamp.sec, message.header.frame_id = number, 'eye'
    return message


def test_compressed_in_and_out_and_back_to_raw_while_it_runs(graph, model):
    camera = Camera(graph)
    camera.start_node(model, 'image_transport:=compressed', 'jpeg_quality:=90')
    sender = graph.node.create_publisher(CompressedImage, '/robot/image/compressed', 10)
    smaller = graph.collect(CompressedImage, '/robot/wide/image/compressed')
    graph.spin_until(lambda: sender.get_subscription_count() and graph.node.count_publishers(
        '/robot/wide/image/compressed'))
    graph.spin_for(0.5)
    image = cv2.GaussianBlur(noise_image(SOURCE, 3), (0, 0), 3)
    sent = jpeg(image, 7)
    sender.publish(sent)
    graph.spin_until(lambda: smaller and camera.wide['image'])
    expected = FovExtrapolator.load(model).expand(read_compressed_image(sent)).wide_image
    np.testing.assert_array_equal(pixels(camera.wide['image'][-1]), expected)
    assert smaller[-1].header == sent.header == camera.wide['image'][-1].header
    assert smaller[-1].format == 'rgb8; jpeg compressed bgr8'
    found = read_compressed_image(smaller[-1])
    assert np.abs(found.astype(int) - expected).mean() < 4
    before = len(smaller[-1].data)
    assert set_parameter(graph, 'jpeg_quality', 10).successful
    assert not set_parameter(graph, 'jpeg_quality', 0).successful
    assert 'raw or compressed' in set_parameter(graph, 'image_transport', 'theora').reason
    assert set_parameter(graph, 'image_transport', 'raw').successful
    camera.wait_for_node()
    camera.widen(image, 9)
    graph.spin_until(lambda: smaller[-1].header.frame_id == 'camera_9')
    assert len(smaller[-1].data) < before
    graph.spin_until(lambda: not sender.get_subscription_count())


def test_a_wider_distorted_camera_is_rectified_on_request(graph, model):
    camera, _ = started(graph, model)
    lens = Intrinsics.from_hfov(96, 80, math.radians(115))
    changes = {'d': [-0.1, 0.01, 0.0, 0.0, 0.0]}
    camera.publish_info(lens, **changes)
    image = noise_image(lens, 1)
    camera.publish(image, 1)
    camera.wait_for_diagnosis(DiagnosticStatus.ERROR, 'camera_info d: rectified input required')
    assert set_parameter(graph, 'rectify', True).successful
    wide = camera.widen(image, 2)
    fit = CameraFit(camera_message(lens, changes), TINY_EXPANSION, rectify=True)
    expected = FovExtrapolator.load(model).expand(fit.apply(image)).wide_image
    np.testing.assert_array_equal(pixels(wide['image']), expected)
    for name, value in camera_info_fields(TINY_EXPANSION.target).items():
        assert np.array_equal(getattr(wide['camera_info'], name), value), name
    lines = camera.wait_for_diagnosis(DiagnosticStatus.WARN, 'some images are rejected')
    assert lines['camera'].startswith('rectified and resampled from 96x80')


def test_the_first_image_waits_for_its_camera_info(graph, model):
    camera, _ = started(graph, model)
    wider = Intrinsics.from_hfov(64, 48, math.radians(100))
    camera.publish_info()  # So that node and publisher have found each other.
    assert graph.call(SetBool, f'{NODE}/enable', SetBool.Request(data=False)).success
    assert graph.call(SetBool, f'{NODE}/enable', SetBool.Request(data=True)).success
    graph.spin_until(lambda: camera.images.get_subscription_count()
                     and camera.infos.get_subscription_count())
    graph.spin_for(0.3)
    camera.diagnostics.clear()

    def send():
        camera.publish(noise_image(wider, 1), 1)
        graph.spin_for(0.2)
        camera.publish_info(wider)

    lines = camera.send_until(
        send, lambda: camera.diagnosis(DiagnosticStatus.OK, 'widening'))
    assert lines['rejected'] == '0' and lines['camera'].startswith('resampled from 64x48')


def test_the_rectified_topic_of_image_proc_is_taken_as_it_is(graph, model):
    camera = Camera(graph)
    camera.images = graph.node.create_publisher(Image, '/robot/image_rect', 10)
    graph.start('-m', 'neo_ros.node.main', '--ros-args', '-r', '__ns:=/robot', '-r',
                'image:=image_rect', '-p', f'model:={model}', '-p', 'rectify:=true')
    camera.wait_for_node()
    raw = Intrinsics(SOURCE.width, SOURCE.height, 20.0, 20.0, 15.0, 13.0)
    camera.publish_info(raw, d=[-0.1, 0.01, 0.0, 0.0, 0.0], p=camera_info_fields(SOURCE)['p'],
                        r=np.diag([1.0, -1, -1]).reshape(-1))
    image = noise_image(SOURCE, 1)
    wide = camera.widen(image, 1)
    np.testing.assert_array_equal(TINY_EXPANSION.crop(pixels(wide['image'])), image)
    for name, value in camera_info_fields(TINY_EXPANSION.target).items():
        assert np.array_equal(getattr(wide['camera_info'], name), value), name


def camera_message(lens, changes):
    from camera_messages import camera_info_message
    return camera_info_message(lens, **changes)


def test_a_stream_may_change_its_size_and_encoding_and_its_clock(graph, model):
    camera, _ = started(graph, model, 'use_sim_time:=true')
    clock = graph.node.create_publisher(Clock, '/clock', 10)
    image = noise_image(SOURCE, 0)
    for number, seconds in enumerate((100, 5, 10**6, 0)):
        clock.publish(Clock(clock=Time(seconds=seconds).to_msg()))
        expected = camera.widen(image, 10 - number)['image'].data
        camera.publish(noise_image(SOURCE.scaled(2), 1), 50 + number)
        graph.spin_for(0.1)
        sent = camera.publish(image[..., ::-1], 20 - number, encoding='bgr8')
        graph.spin_until(lambda: camera.wide['image'][-1].header == sent.header)
        assert camera.wide['image'][-1].data == expected
    beats = len(camera.diagnostics)
    graph.spin_until(lambda: len(camera.diagnostics) >= beats + 2)
    assert len(camera.wide['image']) == 8


def test_outputs_follow_the_qos_overrides(graph, model):
    override = 'qos_overrides./robot/wide/image.publisher.reliability:=best_effort'
    started(graph, model, override)
    reliabilities = {name: graph.node.get_publishers_info_by_topic(
        f'/robot/wide/{name}')[0].qos_profile.reliability for name in ('image', 'mask')}
    assert reliabilities == {'image': ReliabilityPolicy.BEST_EFFORT,
                             'mask': ReliabilityPolicy.RELIABLE}


def test_reliable_may_be_asked_for_while_it_runs(graph, model):
    camera, _ = started(graph, model)
    graph.node.destroy_publisher(camera.images)
    camera.images = graph.node.create_publisher(Image, '/robot/image', qos_profile_sensor_data)
    assert set_parameter(graph, 'reliable', True).successful
    camera.wait_for_diagnosis(
        DiagnosticStatus.WARN, '/robot/image is best effort.*reliable to false')
    assert set_parameter(graph, 'reliable', False).successful
    camera.diagnostics.clear()
    camera.wait_for_diagnosis(DiagnosticStatus.WARN, 'publishers: 1$')
    camera.wait_for_node()
    camera.widen(noise_image(SOURCE, 0), 1)


def test_killed_node_and_killed_camera_find_each_other_again(graph, model):
    image = noise_image(SOURCE, 0)
    camera, process = started(graph, model)
    camera.widen(image, 1)
    assert end(process, signal.SIGKILL) == -signal.SIGKILL
    camera.start_node(model)

    def came_back():
        # The graph shows the dead node for a while: send until the new one answers.
        camera.publish(image, 2)
        graph.spin_for(0.2)
        return camera.wide['image'][-1].header.frame_id == 'camera_2'
    graph.spin_until(came_back)
    script = ('import time, rclpy; from sensor_msgs.msg import Image; rclpy.init(); '
              'node = rclpy.create_node("driver"); '
              'publisher = node.create_publisher(Image, "/robot/image", 10)\n'
              'while True: publisher.publish(Image()); time.sleep(0.02)')
    for _ in range(2):
        driver = graph.start('-c', script)
        camera.diagnostics.clear()
        camera.wait_for_diagnosis(DiagnosticStatus.ERROR, 'the image is 0x0')
        end(driver, signal.SIGKILL)
    camera.widen(image, 3)


def test_a_disk_that_cannot_be_written_does_not_keep_it_from_working(graph, model, monkeypatch):
    monkeypatch.setenv('ROS_LOG_DIR', '/dev/null/logs')
    monkeypatch.setenv('HOME', '/dev/null')
    camera, process = started(graph, model)
    camera.widen(noise_image(SOURCE, 0), 1)
    assert end(process) == 0


@pytest.mark.parametrize('parameter, words', [
    ('threads:=1000', 'threads'), ('max_fps:=fast', 'max_fps'), ('jpeg_quality:=0', 'quality'),
], ids=['range', 'type', 'below'])
def test_a_parameter_of_no_use_ends_the_start_with_one_line(graph, model, parameter, words):
    process = Camera(graph).start_node(model, parameter)
    assert process.wait(30) == 1
    text = process.stdout.read()
    assert words in text and 'Traceback' not in text


@pytest.mark.parametrize('parameter, words', [
    ('image_transport:=theora', 'image_transport: expected raw or compressed'),
    ('providers:=[abacus]', 'providers: expected some of tensorrt, cuda, cpu, got abacus'),
], ids=['transport', 'providers'])
def test_a_wrong_word_leaves_it_unconfigured_with_the_reason(graph, model, parameter, words):
    camera = Camera(graph)
    camera.start_node(model, parameter)
    camera.wait_for_diagnosis(DiagnosticStatus.ERROR, words)


def test_no_provider_at_all_is_the_cpu(graph, model, tmp_path):
    file = tmp_path / 'params.yaml'
    file.write_text('/**:\n  ros__parameters:\n    providers: []\n')
    with node_beside(graph, model, '--params-file', str(file)) as node:
        assert node.state_label == 'active'
        assert node._model.description['runs on'] == 'CPUExecutionProvider'
        assert set_parameter(graph, 'max_fps', 5.0).successful
        assert set_parameter(graph, 'providers', ['cpu']).successful


def test_what_needs_a_memory_does_nothing_without_one(graph, model):
    with node_beside(graph, model, '-p', 'learn:=true') as node:
        assert node.state_label == 'active' and not node._inputs.subscribed
        answer = graph.call(Trigger, f'{NODE}/relocalize', Trigger.Request())
        assert not answer.success and 'no scene memory' in answer.message


def test_what_the_memory_warns_of_is_in_the_diagnosis(graph, model):
    with node_beside(graph, model) as node:
        camera = Camera(graph)
        logging.getLogger('neo_ros.memory.learning').warning('learning: %s', 'no space left')
        lines = camera.wait_for_diagnosis(DiagnosticStatus.WARN, '; learning: no space left')
        assert lines['last warning of the memory'] == 'learning: no space left'
        assert set_parameter(graph, 'model', str(model)).successful  # It is loaded anew.
        assert node._warnings.last == ''


def test_integers_do_for_doubles_and_nothing_else_does(graph, model):
    with node_beside(graph, model, '-p', 'max_fps:=20') as node:
        assert node.get_parameter('max_fps').value == 20.0
        assert set_parameter(graph, 'max_fps', 25).successful
        assert node.get_parameter('max_fps').type_ == Parameter.Type.DOUBLE
        for value in ('fast', True, 2000):
            assert not set_parameter(graph, 'max_fps', value).successful
        assert not set_parameter(graph, 'threads', 1.0).successful
        assert node.get_parameter('max_fps').value == 25.0


def test_frames_are_set_before_it_is_configured(graph, model):
    with node_beside(graph, model, '-p', 'scene_frame:=/flat') as node:
        assert node._scene.outputs.scene_frame == 'flat'  # As in messages.
        refused = set_parameter(graph, 'odom_frame', 'world')
        assert not refused.successful and 'clean it up, set it and configure' in refused.reason
        assert set_parameter(graph, 'odom_frame', 'odom').successful  # As it is.
        node.trigger_deactivate()
        node.trigger_cleanup()
        assert set_parameter(graph, 'odom_frame', 'world').successful


def test_a_package_that_is_not_there_is_named(graph, model):
    camera = Camera(graph)
    camera.start_node('package://nowhere/models/tiny.onnx')
    camera.wait_for_diagnosis(DiagnosticStatus.ERROR, "there is no package 'nowhere' here")
    assert set_parameter(graph, 'model', f'file://{model}').successful
