"""The demo bag: a camera, its truth and its poses fit together."""
import math
from pathlib import Path

from bag_files import START_NS, walk_frames, write_walk_bag
from neo_ros.bags import BagReader, write_demo_bag
from neo_ros.errors import BagError
from neo_ros.geometry import CameraPose, Intrinsics, ViewExpansion
from neo_ros.geometry.camera_pose import transform_from_quaternion
from neo_ros.messages import read_camera_info, read_image
import numpy as np
import pytest

EXPANSION = ViewExpansion.to_size(Intrinsics.from_hfov(16, 12, math.pi / 2), 32, 24)
CHAIN = ['map', 'odom', 'base_link', 'camera_link', 'camera_optical_frame']
TYPES = {
    '/camera/camera_info': 'sensor_msgs/msg/CameraInfo',
    '/camera/image_raw': 'sensor_msgs/msg/Image',
    '/camera/wide/image_raw': 'sensor_msgs/msg/Image',
    '/odom': 'nav_msgs/msg/Odometry',
    '/tf': 'tf2_msgs/msg/TFMessage',
    '/tf_static': 'tf2_msgs/msg/TFMessage'}


def _matrix(transform) -> np.ndarray:
    t, q = transform.translation, transform.rotation
    return transform_from_quaternion(np.array([t.x, t.y, t.z]), np.array([q.x, q.y, q.z, q.w]))


def _stamp_ns(header) -> int:
    return header.stamp.sec * 10**9 + header.stamp.nanosec


@pytest.fixture(scope='module')
def walk(tmp_path_factory):
    """Return the frames and all messages by topic of one bag."""
    path = write_walk_bag(tmp_path_factory.mktemp('demo') / 'bag', EXPANSION)
    with BagReader(path) as bag:
        assert {topic.name: topic.msgtype for topic in bag.topics} == TYPES
        messages: dict = {name: [] for name in TYPES}
        for message in bag.messages():
            messages[message.topic.name].append((message.stamp_ns, message.read()))
    return walk_frames(EXPANSION, 5), messages


def test_images_are_the_truth_and_its_window(walk) -> None:
    frames, messages = walk
    for i, (stamp_ns, wide_image, _) in enumerate(frames):
        for topic, expected in (('/camera/wide/image_raw', wide_image),
                                ('/camera/image_raw', EXPANSION.crop(wide_image))):
            log_ns, message = messages[topic][i]
            assert log_ns == _stamp_ns(message.header) == stamp_ns
            assert message.header.frame_id == 'camera_optical_frame'
            assert message.encoding == 'rgb8'
            np.testing.assert_array_equal(read_image(message), expected)


def test_camera_info_is_the_source_camera(walk) -> None:
    frames, messages = walk
    assert len(messages['/camera/camera_info']) == len(frames)
    for (log_ns, message), (stamp_ns, _, _) in zip(messages['/camera/camera_info'], frames):
        assert log_ns == _stamp_ns(message.header) == stamp_ns
        assert read_camera_info(message) == EXPANSION.source


def test_transforms_lead_from_the_map_to_the_camera(walk) -> None:
    frames, messages = walk
    (_, static), = messages['/tf_static']
    for (_, moving), (stamp_ns, _, pose) in zip(messages['/tf'], frames):
        edges = {(t.header.frame_id, t.child_frame_id): t
                 for t in [*moving.transforms, *static.transforms]}
        assert list(edges) == list(zip(CHAIN, CHAIN[1:]))
        T_map_optical = np.eye(4)
        for edge in zip(CHAIN, CHAIN[1:]):
            T_map_optical = T_map_optical @ _matrix(edges[edge].transform)
        np.testing.assert_allclose(T_map_optical, pose.T_world_cam, atol=1e-9)
        assert {_stamp_ns(t.header) for t in moving.transforms} == {stamp_ns}
        base = edges['odom', 'base_link'].transform.translation
        assert base.z == pytest.approx(0)  # The camera is 1.5 m above the floor.


def test_odometry_agrees_with_the_transforms_and_the_walk(walk) -> None:
    frames, messages = walk
    for i, (_, odom) in enumerate(messages['/odom']):
        assert (odom.header.frame_id, odom.child_frame_id) == ('odom', 'base_link')
        transform = messages['/tf'][i][1].transforms[1].transform
        assert odom.pose.pose.position.x == transform.translation.x == frames[i][2].position[0]
        assert odom.pose.pose.orientation.w == transform.rotation.w
    first, second = (messages['/odom'][i][1].twist.twist for i in (0, 1))
    assert (first.linear.x, first.angular.z) == (0, 0)
    # 0.1 m along the map's x and 0.05 rad a frame of 0.1 s; the first frame looks along x.
    assert second.linear.x == pytest.approx(1.0)
    assert second.angular.z == pytest.approx(0.5)


def test_static_transforms_are_for_late_subscribers_too(tmp_path: Path) -> None:
    with BagReader(write_walk_bag(tmp_path / 'bag', EXPANSION, 1)) as bag:
        latched, = (topic for topic in bag.topics if topic.latched)
        assert latched.name == '/tf_static'
        assert [qos.durability.name for qos in latched.qos] == ['TRANSIENT_LOCAL']


def test_stamps_must_rise_and_there_must_be_frames(tmp_path: Path) -> None:
    with pytest.raises(BagError, match='expected frames'):
        write_demo_bag(tmp_path / 'none', [], EXPANSION)
    assert not (tmp_path / 'none').exists()
    image = np.zeros((24, 32, 3), np.uint8)
    pose = CameraPose.from_planar(0, 0, 1.5, 0)
    frames = [(START_NS, image, pose), (START_NS, image, pose)]
    with pytest.raises(BagError, match='rising stamps'):
        write_demo_bag(tmp_path / 'same', frames, EXPANSION)
