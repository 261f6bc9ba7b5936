"""Pose, depth, points and status as messages of both kinds: rclpy's and rosbags'."""
from types import SimpleNamespace
from typing import Any

from diagnostic_msgs.msg import DiagnosticStatus
from neo_ros.bags.replay_outputs import bag_maker
from neo_ros.geometry import CameraPose, Intrinsics
from neo_ros.messages.frame_processor import WideFrame
from neo_ros.messages.memory_messages import MEMORY_OUTPUTS, MemoryMessages, MemorySettings
from neo_ros.messages.scene_outputs import default_scene_frame
from neo_ros.node.message_types import make_message
import numpy as np
import pytest
from rosbags.typesys import get_typestore, Stores

VIEW = Intrinsics(6, 4, 3.0, 3.0, 3.0, 2.0)
TYPES = get_typestore(Stores.ROS2_JAZZY)
MAKERS = {'rclpy': make_message, 'bag': bag_maker(TYPES.types)}
POSE = CameraPose.from_planar(1.0, 2.0, 1.5, np.pi / 2)
DEPTH = np.arange(24, dtype=np.float32).reshape(4, 6) + 1
DEPTH[0, 0] = np.nan
IMAGE = np.arange(72, dtype=np.uint8).reshape(4, 6, 3)
SURE = np.arange(24, dtype=np.uint8).reshape(4, 6) + 200
EVERY = set(MEMORY_OUTPUTS)


class KnownGuide:
    """Knows what the test says; counts what it is asked for."""

    pose, covariance = POSE, np.arange(36.0).reshape(6, 6)
    agreement, found, landmarks = 0.97, 'tracked', 41

    def __init__(self):
        self.asked = []

    def trusted_depth(self, wide_image, confidence):
        self.asked.append('depth')
        assert wide_image is IMAGE and confidence is SURE
        return DEPTH

    def panorama(self, wide_image, width):
        self.asked.append('panorama')
        return SimpleNamespace(image=np.zeros((width // 2, width, 3), np.uint8),
                               kinds=np.zeros((width // 2, width), np.uint8))


def wide_frame(guide, **changes):
    return WideFrame(**{
        'image': IMAGE, 'confidence': SURE, 'extrapolated_mask': SURE, 'camera_info': {},
        'out_of_scene': 0.0, 'guided': guide is not None, 'camera_note': 'as the model takes it',
        'stages_ms': {'infer': 3.0}, 'view': VIEW, 'guide': guide, **changes})


def header_at(make, seconds, nanoseconds=7):
    return make('std_msgs/msg/Header', frame_id='eye', stamp=make(
        'builtin_interfaces/msg/Time', sec=seconds, nanosec=nanoseconds))


@pytest.fixture(params=list(MAKERS))
def make(request):
    return MAKERS[request.param]


def messages(make, guide, wanted=EVERY, seconds=3, maker=None, **changes):
    maker = maker or MemoryMessages(make, MemorySettings('map', '/eye/node', 2, 16))
    return dict(maker.of(header_at(make, seconds), wide_frame(guide, **changes), wanted, 12.5))


def test_all_messages_have_the_stamp_and_can_be_sent(make):
    found = messages(make, KnownGuide())
    assert set(found) == EVERY
    for name, message in found.items():
        assert (message.header.stamp.sec, message.header.stamp.nanosec) == (3, 7)
        there = name == 'pose' or name.startswith('panorama')
        assert message.header.frame_id == ('map' if there else 'eye')
        if make is not make_message:
            sent = TYPES.serialize_cdr(message, MEMORY_OUTPUTS[name])
            received: Any = TYPES.deserialize_cdr(sent, MEMORY_OUTPUTS[name])
            assert received.header == message.header


def test_the_pose_is_of_the_optical_frame(make):
    pose = messages(make, KnownGuide(), {'pose'})['pose'].pose
    at, turn = pose.pose.position, pose.pose.orientation
    read = CameraPose.from_quaternion(np.array([at.x, at.y, at.z]),
                                      np.array([turn.x, turn.y, turn.z, turn.w]))
    assert np.allclose(read.T_world_cam, POSE.T_world_cam)
    # Yaw 90 degrees: the camera's z looks along the map's y, its y points down (REP-103).
    assert np.allclose(read.T_world_cam[:3, 2], [0, 1, 0])
    assert np.allclose(read.T_world_cam[:3, 1], [0, 0, -1])
    assert np.array_equal(pose.covariance, np.arange(36.0))


def test_depth_is_float_metres_with_nan_for_unknown(make):
    depth = messages(make, KnownGuide(), {'depth'})['depth']
    assert (depth.encoding, depth.width, depth.height, depth.step) == ('32FC1', 6, 4, 24)
    values = np.frombuffer(bytes(depth.data), '<f4').reshape(4, 6)
    assert np.array_equal(values, DEPTH, equal_nan=True) and np.isnan(values[0, 0])


def test_points_are_the_pixels_of_the_depth(make):
    cloud = messages(make, KnownGuide(), {'points'})['points']
    assert (cloud.width, cloud.height, cloud.point_step, cloud.row_step) == (3, 2, 20, 60)
    assert not cloud.is_dense
    assert [(field.name, field.offset, field.datatype) for field in cloud.fields] == [
        (name, 4 * i, 7) for i, name in enumerate(('x', 'y', 'z', 'rgb', 'confidence'))]
    points = np.frombuffer(bytes(cloud.data), '<f4').reshape(2, 3, 5)
    for row, column in np.ndindex(2, 3):
        v, u = 2 * row + 1, 2 * column + 1
        z = DEPTH[v, u]
        assert points[row, column, :3] == pytest.approx(
            [(u + 0.5 - 3) / 3 * z, (v + 0.5 - 2) / 3 * z, z])
        packed = points[row, column, 3:4].view(np.uint32)[0]
        assert [packed >> 16 & 255, packed >> 8 & 255, packed & 255] == IMAGE[v, u].tolist()
        assert points[row, column, 4] == SURE[v, u]


def test_the_status_says_what_is_true_of_the_frame(make):
    status = messages(make, KnownGuide(), {'status'})['status'].status[0]
    lines = {entry.key: entry.value for entry in status.values}
    assert status.name == '/eye/node: frame' and 'tracked' in status.message
    assert status.level in (0, DiagnosticStatus.OK)
    assert lines == {
        'guided': 'true', 'found': 'tracked', 'agreement': '0.970', 'landmarks matched': '41',
        'out of the scene': '0.00', 'camera': 'as the model takes it', 'infer [ms]': '3.00',
        'age [ms]': '12.5'}
    alone = messages(make, None, out_of_scene=0.9)
    assert set(alone) == {'status'}
    assert 'unlike' in alone['status'].status[0].message
    assert alone['status'].status[0].level in (1, DiagnosticStatus.WARN)


def test_what_nobody_wants_is_not_computed(make):
    guide = KnownGuide()
    messages(make, guide, {'pose', 'status'})
    assert guide.asked == []
    messages(make, guide, {'depth', 'points'})
    assert guide.asked == ['depth']


def test_panoramas_come_at_their_rate(make):
    guide = KnownGuide()
    maker = MemoryMessages(make, MemorySettings('map', 'n', panorama_width=16, panorama_fps=0.5))
    sent = [bool(messages(make, guide, {'panorama'}, seconds, maker))
            for seconds in (10, 11, 12, 13, 14, 2)]
    # Time that runs back is another bag.
    assert sent == [True, False, True, False, True, True]


def test_a_scene_of_arbitrary_scale_is_no_map():
    assert (default_scene_frame(False), default_scene_frame(True)) == ('map', 'scene')


def test_where_stamps_stand_still_panoramas_go_by_the_clock_of_a_live_camera(make):
    now = 50.0
    settings = MemorySettings('map', 'n', panorama_width=16, panorama_fps=0.5)
    for maker, drawn in ((MemoryMessages(make, settings, lambda: now), [True, False, True]),
                         (MemoryMessages(make, settings), [True, False, False])):
        found = []
        for now in (50.0, 51.0, 52.5):
            found.append('panorama' in messages(make, KnownGuide(), {'panorama'}, 0, maker))
        assert found == drawn
