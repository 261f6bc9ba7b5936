"""A replayed bag holds what the node would have known."""
from collections import Counter
from types import SimpleNamespace
from typing import Any

from bag_files import write_walk_bag
from box_room import box_walk, EXPANSION, view, write_box_model
from neo_ros.bags import BagReader, BagWriter, replay
from neo_ros.bags.replay_outputs import ReplayOutputs
from neo_ros.errors import BagError
from neo_ros.messages import image_fields, WideFrame
from neo_ros.messages.memory_messages import MEMORY_OUTPUTS, MemorySettings
from neo_ros.runtime import FovExtrapolator
from neo_ros.viewer.wide_topics import NodeDiagnosis
import numpy as np
import pytest
from tiny_model import TINY_EXPANSION, write_tiny_model

WALK = box_walk(5)
STEP_NS = 400_000_000


@pytest.fixture(scope='module')
def bag(tmp_path_factory):
    path = tmp_path_factory.mktemp('bag') / 'walk'
    with BagWriter(path) as writer:
        types = writer.typestore.types
        topic = writer.add_topic('/eye/image_raw', 'sensor_msgs/msg/Image')
        old = writer.add_topic('/diagnostics', 'diagnostic_msgs/msg/DiagnosticArray')
        for number, pose in enumerate(WALK):
            stamp_ns = 10**9 + number * STEP_NS
            header = types['std_msgs/msg/Header'](
                stamp=types['builtin_interfaces/msg/Time'](*divmod(stamp_ns, 10**9)),
                frame_id='eye_optical')
            writer.write(topic, stamp_ns, types['sensor_msgs/msg/Image'](
                header=header, **image_fields(view(pose, EXPANSION.source)[0])))
            name = '/eye/fov_extrapolator: widening' if number % 2 else '/motors'
            writer.write(old, stamp_ns, types['diagnostic_msgs/msg/DiagnosticArray'](
                header=header, status=[types['diagnostic_msgs/msg/DiagnosticStatus'](
                    level=2, name=name, message='old', hardware_id='', values=[])]))
    return path


@pytest.fixture(scope='module')
def extrapolator(tmp_path_factory):
    return FovExtrapolator.load(write_box_model(tmp_path_factory.mktemp('model')), threads=2)


def contents(path):
    found: dict = {}
    with BagReader(path) as reader:
        for message in reader.messages():
            found.setdefault(message.topic.name, []).append(message.read())
    return found


@pytest.mark.slow
def test_pose_and_status_are_written_and_depth_when_asked(tmp_path, bag, extrapolator):
    replay(bag, extrapolator, tmp_path / 'usual')
    usual = contents(tmp_path / 'usual')
    made = {name.removeprefix('/eye/wide/') for name in usual if '/wide/' in name}
    assert made & set(MEMORY_OUTPUTS) == {'pose', 'status'}
    for pose, message in zip(WALK, usual['/eye/wide/pose'], strict=True):
        at = message.pose.pose.position
        assert message.header.frame_id == 'map'
        assert np.linalg.norm(pose.position - [at.x, at.y, at.z]) < 0.02
    extrapolator.reset()
    replay(bag, extrapolator, tmp_path / 'all', outputs=tuple(MEMORY_OUTPUTS))
    full = contents(tmp_path / 'all')
    for pose, message, cloud in zip(WALK, full['/eye/wide/depth'], full['/eye/wide/points'],
                                    strict=True):
        depth = np.frombuffer(message.data.tobytes(), '<f4').reshape(message.height, -1)
        known = np.isfinite(depth)
        true = view(pose, EXPANSION.target)[1]
        assert known.mean() > 0.8 and np.median(np.abs(depth - true)[known]) < 0.05
        points = np.frombuffer(cloud.data.tobytes(), '<f4').reshape(cloud.height, cloud.width, 5)
        assert np.array_equal(points[..., 2], depth[1::2, 1::2], equal_nan=True)
    # Two seconds at one a second.
    assert len(full['/eye/wide/panorama']) == len(full['/eye/wide/panorama_mask']) == 2


def test_the_viewer_reads_the_diagnosis_of_the_replay(tmp_path, bag, extrapolator):
    extrapolator.reset()
    replay(bag, extrapolator, tmp_path / 'out')
    arrays = contents(tmp_path / 'out')['/diagnostics']
    names = [status.name for array in arrays for status in array.status]
    # What the recorded node said of other images than these is gone, the motors are not.
    assert names.count('/motors') == 3 and names.count('/eye/fov_extrapolator: widening') == 2
    reader = NodeDiagnosis('/eye')
    verdicts = [found for array in arrays if (found := reader.read(array.status))]
    # A warning: the bag says nothing of its camera.
    assert [verdict['level'] for verdict in verdicts] == [1, 1]
    assert all('; no camera_info: the camera' in verdict['message'] for verdict in verdicts)
    assert not any(verdict['out_of_scene'] for verdict in verdicts)
    assert all(verdict['node_ms'] is None for verdict in verdicts)


def test_a_network_alone_has_a_status_and_no_pose(tmp_path):
    model = FovExtrapolator.load(write_tiny_model(tmp_path / 'tiny.onnx'), threads=1)
    bag = write_walk_bag(tmp_path / 'bag', TINY_EXPANSION, 3)
    replay(bag, model, tmp_path / 'out', outputs=tuple(MEMORY_OUTPUTS))
    found = contents(tmp_path / 'out')
    assert len(found['/camera/wide/status']) == 3
    assert not {f'/camera/wide/{name}' for name in MEMORY_OUTPUTS if name != 'status'} & set(found)


def test_the_diagnosis_begins_anew_where_the_clock_was_set_back():
    said = []

    def write(topic: str, stamp_ns: int, message: Any) -> None:
        values = {entry.key: entry.value for entry in message.status[0].values}
        said.append((stamp_ns // 10**9, values['guided by the scene memory']))

    outputs = ReplayOutputs(lambda kind, **fields: SimpleNamespace(**fields), (),
                            MemorySettings('map', 'test'), write, True)
    mask = np.zeros((2, 2), np.uint8)
    for second, guided in ((100, True), (101, True), (1, False), (2, False), (8, True)):
        outputs.add(second * 10**9, None, WideFrame(
            None, None, mask, {}, None, guided, '', {}, TINY_EXPANSION.target), Counter())
    assert said == [(100, '100%'), (101, '100%'), (1, '0%'), (2, '0%'), (8, '100%')]


def test_an_unknown_output_is_refused_by_name(tmp_path, bag, extrapolator):
    with pytest.raises(BagError, match="output: expected some of pose.*got 'poses'"):
        replay(bag, extrapolator, tmp_path / 'out', outputs=['poses'])
