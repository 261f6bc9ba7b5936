"""Bags of which something is missing, ambiguous or damaged: it is named."""
from collections import Counter
from collections.abc import Callable
from pathlib import Path
from typing import Any

from camera_bags import CameraBag
from camera_on_base import (
    add_camera, add_mount, add_odometry, add_poses, add_tf, base_pose, CAMERA, camera_poses, COUNT,
    IMAGES, no_way_from_tf, RAW, RAW_INFO, START, STEP, two_parents, two_parents_beside_odometry)
from capture_files import demo_photos, write_bag
import cv2
from neo_ros.bags import BagReader, BagWriter
from neo_ros.captures.bag import BagOptions, read_bag_capture
from neo_ros.captures.scene_writing import write_capture
from neo_ros.errors import BagError, SceneError
from neo_ros.geometry import Intrinsics
from neo_ros.scenes.scene import read_scene
import numpy as np
import pytest


def two_pose_topics(bag: CameraBag) -> None:
    add_camera(bag)
    add_poses(bag)
    add_odometry(bag)


def no_mount(bag: CameraBag) -> None:
    add_camera(bag)
    add_odometry(bag)


def foreign_transforms(bag: CameraBag) -> None:
    add_camera(bag)
    add_mount(bag)
    for time in range(COUNT):
        for name in ('/robot1/tf', '/robot2/tf'):
            bag.tf(name, START + time * STEP, 'odom', 'base_link', base_pose(time))


def only_fixed(bag: CameraBag) -> None:
    add_camera(bag)
    add_mount(bag)


def two_calibrations(bag: CameraBag) -> None:
    add_camera(bag)
    bag.info(RAW_INFO, START, Intrinsics(32, 24, 40.0, 40.0, 16, 12))


def two_frames(bag: CameraBag) -> None:
    add_camera(bag)
    bag.image(RAW, START + COUNT * STEP, IMAGES[0], '')  # None said is no other one.
    bag.image(RAW, START + (COUNT + 1) * STEP, IMAGES[0], 'optical_right')


def two_parents_below_the_body(bag: CameraBag) -> None:
    two_parents_beside_odometry(bag)
    bag.tf('/tf', START, 'arm', 'link', np.eye(4))


def loop(bag: CameraBag) -> None:
    add_camera(bag)
    bag.tf('/tf', START, 'optical', 'base_link', np.eye(4))
    bag.tf('/tf', START, 'base_link', 'optical', np.eye(4))


def other_clock(bag: CameraBag) -> None:
    add_camera(bag)
    for i, T in enumerate(camera_poses()):
        bag.pose('/vio', i * STEP, T)


def no_info(bag: CameraBag) -> None:
    add_camera(bag, info=None)
    bag.info('/other/camera_info', START, CAMERA)
    add_mount(bag)
    add_tf(bag)


def no_info_at_all(bag: CameraBag) -> None:
    add_camera(bag, info=None)
    add_mount(bag)
    add_tf(bag)


def not_calibrated(bag: CameraBag) -> None:
    add_camera(bag, k=np.zeros(9), p=np.zeros(12))
    add_mount(bag)
    add_tf(bag)


def no_size(bag: CameraBag) -> None:
    add_camera(bag, width=0, height=0)
    bag.info('/other/camera_info', START, CAMERA)
    add_mount(bag)
    add_tf(bag)


def strange_lens(bag: CameraBag) -> None:
    add_camera(bag, distortion_model='mystery', d=np.full(3, 0.1))


def only_depth(bag: CameraBag) -> None:
    bag.send(RAW, 'sensor_msgs/msg/Image', START, header=bag.header(START, 'optical'),
             height=24, width=32, encoding='32FC1', is_bigendian=0, step=64,
             data=np.zeros(24 * 64, np.uint8))


def no_image(bag: CameraBag) -> None:
    add_tf(bag)


@pytest.mark.parametrize('fill, topics, message', [
    (two_pose_topics, {}, r'--pose-topic: /odom .*/pose'),
    (two_pose_topics, {'pose_topic': '/nowhere'}, 'expected poses on /nowhere.*/odom'),
    (two_pose_topics, {'pose_topic': '/tf'}, '/tf: expected transforms that move the frame of the '
     r"images, 'optical', got none; .*--pose-topic: /odom .*/pose .* or none"),
    (only_fixed, {'pose_topic': '/tf'}, 'got optical -> link -> base_link; .*--pose-topic: none'),
    (no_way_from_tf, {}, '/tf moves base_link; expected /tf_static from there to the frame of the '
     r"images, 'optical', got optical -> cam; .*--pose-topic: none \(structure"),
    (no_way_from_tf, {'pose_topic': '/tf'}, '/tf moves base_link; expected /tf_static'),
    (foreign_transforms, {}, 'expected transforms on /tf and /tf_static, got /robot1/tf .*'
     '--pose-topic /robot1/tf.*none'),
    (foreign_transforms, {'pose_topic': '/odom'}, 'expected poses on /odom; .*--pose-topic: none'),
    (two_pose_topics, {'image_topic': '/nowhere'}, 'expected images on /nowhere.*image_raw'),
    (no_mount, {}, "/odom gives poses of 'base_link'; expected /tf_static"),
    (two_calibrations, {}, '/cam/camera_info: expected one calibration, but k changes'),
    (two_frames, {}, "image_raw: expected one frame_id.* from 'optical' to 'optical_right'"),
    (two_parents, {}, "bag: /tf: expected one parent of the frame 'base_link', got 'odom' and "
     "'world'"),
    (two_parents_beside_odometry, {}, "'odom' and 'world'; choose the poses with --pose-topic: "
     '/odom'),
    (two_parents_below_the_body, {'pose_topic': '/odom'}, "of the frame 'link'.*topic: none"),
    (loop, {}, 'bag: /tf: the frames optical -> base_link -> optical form a loop'),
    (other_clock, {}, 'no image of /cam/image_raw has a pose.*same clock'),
    (no_info, {}, 'expected a camera_info beside /cam/image_raw.*/other/camera_info'),
    (no_info_at_all, {}, 'the bag has no CameraInfo topic.* with --pose-topic none'),
    (not_calibrated, {}, '/cam/camera_info is not calibrated.* the bag has no CameraInfo topic '
     'that is calibrated; give a file with --camera-info FILE, or .*--pose-topic none'),
    (no_size, {}, '/cam/camera_info is not calibrated.* the bag has /other/camera_info [^,]*; '
     'choose one with --info-topic, or give a file with --camera-info FILE'),
    (strange_lens, {}, "/cam/camera_info: .*coefficients.* of plumb_bob.*'mystery'.*image_rect"),
    (only_depth, {}, 'expected a topic of type .*the bag has only depth: /cam/image_raw'),
    (only_depth, {'image_topic': RAW}, '/cam/image_raw: .*32FC1.*record another topic'),
    (no_image, {}, 'expected a topic of type sensor_msgs/msg/Image.*/tf'),
], ids=lambda value: value.__name__ if callable(value) else '')
def test_what_is_missing_or_ambiguous_is_named(
        tmp_path: Path, fill: Callable[[CameraBag], None], topics: dict[str, Any],
        message: str) -> None:
    with CameraBag(tmp_path / 'bag') as bag:
        fill(bag)
    with pytest.raises(BagError, match=message):
        read_bag_capture(tmp_path / 'bag', BagOptions(**topics))


def test_an_image_of_another_size_is_named_by_its_stamp(tmp_path: Path) -> None:
    with CameraBag(tmp_path / 'bag') as bag:
        add_mount(bag)
        add_tf(bag)
        add_camera(bag)
        bag.image(RAW, START + STEP // 2, IMAGES[0][:12])
    with pytest.raises(SceneError, match='image of 1700000000.050 s: expected 32x24 .* got 32x12'):
        write_capture(read_bag_capture(tmp_path / 'bag'), tmp_path / 'scene')


def test_an_image_that_cannot_be_decoded_is_named_by_its_stamp(tmp_path: Path) -> None:
    with CameraBag(tmp_path / 'bag') as bag:
        add_mount(bag)
        add_tf(bag)
        add_camera(bag, RAW + '/compressed', compressed=True)
        bag.send(RAW + '/compressed', 'sensor_msgs/msg/CompressedImage', START + STEP // 2,
                 header=bag.header(START + STEP // 2, 'optical'), format='png',
                 data=cv2.imencode('.png', IMAGES[0])[1].reshape(-1)[:60])
    notes = write_capture(read_bag_capture(tmp_path / 'bag'), tmp_path / 'scene')
    assert notes[-1] == (
        '1 images cannot be read and are left out: the image of 1700000000.050 s')
    assert len(read_scene(tmp_path / 'scene').train) == COUNT


def test_a_cut_off_bag_gives_what_is_left_of_it(tmp_path: Path) -> None:
    path = write_bag(tmp_path / 'bag', demo_photos())
    file, = path.glob('*.mcap')
    data = file.read_bytes()
    (tmp_path / 'cut.mcap').write_bytes(data[:int(len(data) * 0.7)])
    capture = read_bag_capture(tmp_path / 'cut.mcap')
    assert 0 < len(capture) < len(demo_photos().poses)
    assert 'recovered' in capture.notes[0]


def test_messages_that_cannot_be_decoded_are_counted_and_keep_their_place(tmp_path: Path) -> None:
    with CameraBag(tmp_path / 'whole') as bag:
        add_mount(bag)
        add_tf(bag)
        add_camera(bag)
    with BagReader(tmp_path / 'whole') as reader, BagWriter(tmp_path / 'bag') as writer:
        topics = {topic: writer.add_topic(topic.name, topic.msgtype) for topic in reader.topics}
        seen: Counter[str] = Counter()
        for message in reader.messages():
            name = message.topic.name
            seen[name] += 1
            damaged = (name, seen[name]) in ((RAW, 2), ('/tf', 1))
            writer.write_cdr(topics[message.topic], message.stamp_ns,
                             message.cdr[:7] if damaged else message.cdr)
    capture = read_bag_capture(tmp_path / 'bag')
    assert {f'1 messages of {name} are damaged and are left out' for name in (RAW, '/tf')} <= set(
        capture.notes)
    images = dict(capture.images(range(len(capture))))
    assert len(images) == COUNT - 1
    for index, kept in enumerate((0, 2, 3)):
        np.testing.assert_array_equal(images[index], IMAGES[kept])
