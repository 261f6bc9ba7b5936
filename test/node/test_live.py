"""The node as a process of its own on a real ROS graph."""
import re
import signal
from typing import Any

from bag_files import START_NS
from box_room import box_walk, EXPANSION, view, write_box_model
from camera_messages import noise_image
from diagnostic_msgs.msg import DiagnosticStatus
from lifecycle_msgs.msg import Transition
from live_node import Camera, change_state, end, NODE, set_parameter, started, state_of
from neo_ros.bags import BagReader, replay, write_demo_bag
from neo_ros.messages import camera_info_fields, image_fields
from neo_ros.node.extrapolator_node import ExtrapolatorNode
from neo_ros.runtime import FovExtrapolator
import numba
import numpy as np
import onnxruntime
import pytest
from rclpy.lifecycle import TransitionCallbackReturn
import rclpy.parameter
from rclpy.qos import qos_profile_sensor_data
from sensor_msgs.msg import CameraInfo, Image
from std_srvs.srv import SetBool, Trigger
from tiny_model import TINY_EXPANSION

SOURCE, TARGET = TINY_EXPANSION.source, TINY_EXPANSION.target


def test_frames_come_back_wide_with_their_header(graph, model):
    camera = Camera(graph)
    process = camera.start_node(model)
    camera.wait_for_node()
    extrapolator = FovExtrapolator.load(model)
    for number, with_info in enumerate([False, True, True]):
        if with_info:
            camera.publish_info()
        image = noise_image(SOURCE, number)
        wide = camera.widen(image, number)
        expected = extrapolator.expand(image)
        mask = np.where(extrapolator.extrapolated_mask, 255, 0).astype(np.uint8)
        for name, pixels in (('image', expected.wide_image), ('mask', mask),
                             ('confidence', expected.confidence)):
            fields = image_fields(pixels)
            assert wide[name].data.tobytes() == fields.pop('data').tobytes()
            assert {key: getattr(wide[name], key) for key in fields} == fields
        for name, value in camera_info_fields(TARGET).items():
            assert np.array_equal(getattr(wide['camera_info'], name), value), name
    status = camera.wait_for_diagnosis(DiagnosticStatus.OK, 'widening')
    assert status['model scene'] == 'tiny' and status['image topic'] == '/robot/image'
    assert end(process) == 0, process.stdout.read()


def test_a_guided_walk_gives_the_bytes_of_its_replay(graph, tmp_path):
    model = write_box_model(tmp_path)
    frames = [(START_NS + number, view(pose, EXPANSION.target)[0], pose)
              for number, pose in enumerate(box_walk(6))]
    write_demo_bag(tmp_path / 'walk', frames, EXPANSION)
    result = replay(tmp_path / 'walk', FovExtrapolator.load(model), tmp_path / 'wide')
    assert result.frames == len(frames)
    camera, _ = started(graph, model)
    camera.publish_info(EXPANSION.source)
    ours = [camera.widen(EXPANSION.crop(wide), number)
            for number, (_, wide, _) in enumerate(frames)]
    with BagReader(tmp_path / 'wide') as bag:
        for name in ('image', 'mask', 'confidence'):
            replayed = [message.read() for message in bag.messages([f'/camera/wide/{name}'])]
            assert [message.data.tobytes() for message in replayed] == [
                frame[name].data.tobytes() for frame in ours]
    status = camera.wait_for_diagnosis(DiagnosticStatus.OK, 'widening')
    assert status['guided by the scene memory'] == '100%'
    assert status['model has a scene memory'] == 'yes'


def test_threads_wait_for_one_another_asleep(graph, tmp_path, monkeypatch):
    model = write_box_model(tmp_path)
    FovExtrapolator.load(model)
    if numba.threading_layer() != 'omp':
        pytest.skip(f"numba's threads are those of {numba.threading_layer()} here, not OpenMP's")
    for name in ('OMP_WAIT_POLICY', 'GOMP_SPINCOUNT'):
        monkeypatch.delenv(name, raising=False)
    monkeypatch.setenv('OMP_DISPLAY_ENV', 'VERBOSE')
    _, process = started(graph, model)
    end(process)
    assert "GOMP_SPINCOUNT = '0'" in process.stdout.read()


def test_bad_messages_are_counted_and_good_ones_pass(graph, model):
    camera = Camera(graph)

    def rejected():
        return next(int(pair.value) for pair in camera.diagnostics[-1].status[0].values
                    if pair.key == 'rejected')

    camera.start_node(model)
    camera.wait_for_node()
    camera.wait_for_diagnosis(
        DiagnosticStatus.WARN, 'waiting for image on /robot/image, publishers: 1')
    good = noise_image(SOURCE, 0)
    bad: list[dict[str, Any]] = [
        {'encoding': 'nonsense'}, {'data': b''}, {'data': b'short'}, {'step': 3},
        {'width': 0}, {'height': 2**32 - 1}]
    for number, changes in enumerate(bad):
        camera.publish(good, 100 + number, **changes)
        graph.spin_until(lambda: rejected() == number + 1)  # Else the next one would replace it.
        camera.widen(good, number)
    camera.publish_info(k=np.diag([8.0, 8, 1]).reshape(-1))
    camera.publish(good, 200)
    status = camera.wait_for_diagnosis(DiagnosticStatus.WARN, 'rejected: camera: .*90.00 deg')
    assert {key: value for key, value in status.items() if key.startswith('rejected')} == {
        'rejected': '7', 'rejected: camera': '1', 'rejected: data': '1', 'rejected: empty': '1',
        'rejected: encoding': '1', 'rejected: size': '2', 'rejected: step': '1'}
    assert [message.header.stamp.nanosec for message in camera.wide['image']] == list(range(6))


def test_lifecycle_and_enable(graph, model):
    camera = Camera(graph)
    process = camera.start_node(model, 'autostart:=false')
    assert state_of(graph) == 'unconfigured'
    image = noise_image(SOURCE, 0)
    for number in range(2):
        assert change_state(graph, Transition.TRANSITION_CONFIGURE)
        assert graph.node.count_subscribers('/robot/image') == 0
        assert change_state(graph, Transition.TRANSITION_ACTIVATE)
        camera.wait_for_node()
        camera.widen(image, number)
        assert change_state(graph, Transition.TRANSITION_DEACTIVATE)
        assert state_of(graph) == 'inactive'
        graph.spin_until(lambda: not graph.node.count_subscribers('/robot/image'))
        assert change_state(graph, Transition.TRANSITION_CLEANUP)
        assert state_of(graph) == 'unconfigured'
        graph.spin_until(lambda: not graph.node.count_publishers('/robot/wide/image'))
    assert change_state(graph, Transition.TRANSITION_CONFIGURE)
    assert change_state(graph, Transition.TRANSITION_ACTIVATE)
    camera.wait_for_node()
    assert 'disabled' in graph.call(
        SetBool, f'{NODE}/enable', SetBool.Request(data=False)).message
    graph.spin_until(lambda: not graph.node.count_subscribers('/robot/image'))
    assert graph.call(SetBool, f'{NODE}/enable', SetBool.Request(data=True)).success
    camera.wait_for_node()
    camera.widen(image, 9)
    assert change_state(graph, Transition.TRANSITION_ACTIVE_SHUTDOWN)
    assert state_of(graph) == 'finalized'
    assert end(process, signal.SIGINT) == 0


def test_impossible_transition_does_not_end_the_node(graph, model):
    camera, process = started(graph, model)
    for transition in (Transition.TRANSITION_CONFIGURE, Transition.TRANSITION_CLEANUP,
                       Transition.TRANSITION_CALLBACK_ERROR, 200):
        assert not change_state(graph, transition)
    assert not change_state(graph, 0, 'wish')
    assert state_of(graph) == 'active'
    camera.widen(noise_image(SOURCE, 0), 1)
    end(process)
    assert re.search('transition 1 refused: the node is active, possible: deactivate, shutdown; '
                     '.*autostart to false', process.stdout.read())


def test_wrong_model_leaves_it_unconfigured_with_the_reason(graph, model, tmp_path):
    broken = tmp_path / 'broken.onnx'
    broken.write_bytes(model.read_bytes()[:500])
    camera = Camera(graph)
    camera.start_node(broken)
    camera.wait_for_diagnosis(DiagnosticStatus.ERROR, 'cannot configure: .*broken.onnx')
    assert state_of(graph) == 'unconfigured'
    assert set_parameter(graph, 'model', str(model)).successful
    assert change_state(graph, Transition.TRANSITION_CONFIGURE)
    refusal = set_parameter(graph, 'model', str(broken))
    assert not refusal.successful and 'truncated' in refusal.reason
    assert change_state(graph, Transition.TRANSITION_ACTIVATE)
    camera.wait_for_node()
    camera.widen(noise_image(SOURCE, 0), 1)


def test_unforeseen_error_ends_unconfigured_and_is_told(graph, model):
    def load(path, threads, providers):
        if path != str(model):
            raise RuntimeError('the disk is on fire')
        return FovExtrapolator.load(path, threads, providers)

    node = ExtrapolatorNode(load, context=graph.context, parameter_overrides=[
        rclpy.parameter.Parameter('model', value='other.onnx')])
    node.autostart()
    assert node.state_label == 'unconfigured'
    assert node.fault == 'on_configure failed: RuntimeError: the disk is on fire'
    node.set_parameters([rclpy.parameter.Parameter('model', value=str(model))])
    node.autostart()
    assert (node.state_label, node.fault) == ('active', '')
    assert node.stop() is True
    node.destroy_node()


def test_unforeseen_error_of_a_new_model_is_a_refusal_and_the_old_one_stays(graph, model):
    broken = False

    def load(path, threads, providers):
        if broken:
            raise RuntimeError('the disk is on fire')
        return FovExtrapolator.load(path, threads, providers)

    node = ExtrapolatorNode(load, context=graph.context, namespace='robot', parameter_overrides=[
        rclpy.parameter.Parameter('model', value=str(model))])
    graph.executor.add_node(node)
    node.autostart()
    before, broken = node._model, True
    answer = graph.call(Trigger, f'{NODE}/reload_model', Trigger.Request())
    assert not answer.success
    assert answer.message == 'the model stays as it is: RuntimeError: the disk is on fire'
    refusal = set_parameter(graph, 'threads', 1)
    assert not refusal.successful and refusal.reason == 'RuntimeError: the disk is on fire'
    assert node._model is before and node.state_label == 'active'
    broken = False
    assert set_parameter(graph, 'threads', 1).successful and node._model is not before
    assert node.stop() is True
    node.destroy_node()


@pytest.mark.parametrize('claimed', [[], ['CUDAExecutionProvider', 'TensorrtExecutionProvider']],
                         ids=['not built in', 'does not start'])
@pytest.mark.filterwarnings('ignore:Specified provider')
def test_without_its_gpu_it_runs_on_the_cpu_and_says_so(
        graph, model, monkeypatch, capfd, claimed):
    monkeypatch.setattr(
        onnxruntime, 'get_available_providers', lambda: [*claimed, 'CPUExecutionProvider'])
    node = ExtrapolatorNode(context=graph.context, parameter_overrides=[
        rclpy.parameter.Parameter('model', value=str(model)),
        rclpy.parameter.Parameter('providers', value=['tensorrt', 'cuda'])])
    assert node.trigger_configure() == TransitionCallbackReturn.SUCCESS
    node.destroy_node()
    assert 'runs on CPUExecutionProvider, not here tensorrt, cuda' in capfd.readouterr().err


SLOW_NODE = """
import time
from neo_ros.node.extrapolator_node import ExtrapolatorNode
from neo_ros.runtime import FovExtrapolator
fast = FovExtrapolator.expand
def slow(self, image, **hints):
    if image.max() == 0:
        print('in the middle', flush=True)
        time.sleep(600)  # Longer than a test waits.
    return fast(self, image, **hints)
FovExtrapolator.expand = slow
from neo_ros.node.main import main
main()
"""


@pytest.mark.parametrize('number', [signal.SIGTERM, signal.SIGINT], ids=['SIGTERM', 'SIGINT'])
def test_signal_in_the_middle_of_inference_ends_it(graph, model, number):
    camera = Camera(graph)
    process = graph.start('-c', SLOW_NODE, '--ros-args', '-r', '__ns:=/robot',
                          '-p', f'model:={model}')
    camera.wait_for_node()
    camera.widen(noise_image(SOURCE, 0), 1)
    camera.publish(np.zeros((SOURCE.height, SOURCE.width, 3), np.uint8), 2)
    assert 'in the middle\n' in iter(process.stdout.readline, ''), 'the node ended before'
    assert end(process, number) == 0, process.stdout.read()


SLOW_LOAD = """
import time
from neo_ros.runtime import FovExtrapolator
FovExtrapolator.load = lambda *arguments: print('loading', flush=True) or time.sleep(600)
from neo_ros.node.main import main
main()
"""


@pytest.mark.parametrize('number', [signal.SIGTERM, signal.SIGINT], ids=['SIGTERM', 'SIGINT'])
def test_signal_while_a_model_loads_ends_it(graph, model, number):
    process = graph.start('-c', SLOW_LOAD, '--ros-args', '-p', f'model:={model}')
    assert process.stdout.readline() == 'loading\n'
    assert end(process, number) == 0, process.stdout.read()


def test_qos_conflict_is_told(graph, model):
    camera = Camera(graph)
    graph.node.destroy_publisher(camera.images)
    other = graph.node.create_publisher(Image, '/robot/image', qos_profile_sensor_data)
    process = camera.start_node(model, 'reliable:=true')
    camera.wait_for_diagnosis(
        DiagnosticStatus.WARN, 'publishers: 1; the publisher of /robot/image is best effort, this '
        'node asks for reliable; set the parameter reliable to false')
    graph.node.destroy_publisher(other)
    camera.images = graph.node.create_publisher(Image, '/robot/image', 10)
    camera.diagnostics.clear()
    camera.wait_for_diagnosis(DiagnosticStatus.WARN, 'publishers: [01]$')
    camera.wait_for_node()
    infos = graph.node.create_publisher(CameraInfo, '/robot/camera_info', qos_profile_sensor_data)
    camera.widen(noise_image(SOURCE, 0), 1)
    camera.wait_for_diagnosis(
        DiagnosticStatus.WARN, 'widening .*; the publisher of /robot/camera_info is best effort')
    graph.node.destroy_publisher(infos)
    camera.diagnostics.clear()
    camera.wait_for_diagnosis(DiagnosticStatus.WARN, 'per second; no camera_info: .* assumed to '
                              'be 32x24 with hfov')
    end(process)
    assert 'another RELIABILITY than this node asks for (reliable)' in process.stdout.read()


def test_a_twin_is_noticed(graph, model):
    camera, first = started(graph, model)
    second = camera.start_node(model)
    camera.wait_for_diagnosis(
        DiagnosticStatus.WARN, 'another node is called /robot/fov_extrapolator, too: give each')
    end(second)
    third = camera.start_node(model, rules=['__node:=other'])
    camera.wait_for_diagnosis(
        DiagnosticStatus.WARN, '/robot/wide/image is published by /robot/other, too: give each')
    end(third)
    camera.diagnostics.clear()
    camera.wait_for_diagnosis(DiagnosticStatus.WARN, r'publishers: 1$')
    status = camera.diagnostics[-1].status[0]  # What the third said last may come late.
    assert status.name == '/robot/fov_extrapolator: widening'
    assert status.hardware_id == '/robot/image'
    camera.widen(noise_image(SOURCE, 0), 1)
    graph.spin_until(lambda: camera.diagnostics[-1].status[0].hardware_id == 'camera_1')
    end(first)
