"""A recorded bag as a capture: cameras, calibrations and poses however they were recorded."""
from collections.abc import Callable
from dataclasses import replace
import math
from pathlib import Path
from typing import Any

from camera_bags import as_sqlite, CameraBag
from camera_on_base import (
    add_camera, add_mount, add_odometry, add_poses, add_tf, base_pose, CAMERA, camera_poses, COUNT,
    IMAGES, no_way_from_tf, RAW, START, STEP, T_BASE_OPTICAL, two_parents_beside_odometry)
from neo_ros.bags.tf_tree import PoseTrack
from neo_ros.captures.bag import BagOptions, read_bag_capture
from neo_ros.captures.capture import origin_of
from neo_ros.captures.scene_writing import write_capture
from neo_ros.errors import BagError
from neo_ros.geometry import CameraPose, Intrinsics
from neo_ros.geometry.camera_pose import T_BODY_OPTICAL
from neo_ros.scenes.scene import read_scene
import numpy as np
import pytest


@pytest.mark.parametrize('add_motion', [add_tf, add_odometry, add_poses],
                         ids=['tf', 'odometry', 'pose'])
@pytest.mark.parametrize('compressed', [False, True], ids=['raw', 'compressed'])
@pytest.mark.parametrize('sqlite', [False, True], ids=['mcap', 'sqlite'])
def test_poses_are_interpolated_at_the_stamps_of_the_images(
        tmp_path: Path, add_motion: Callable[[CameraBag], None], compressed: bool,
        sqlite: bool) -> None:
    with CameraBag(tmp_path / 'bag') as bag:
        add_mount(bag)
        add_motion(bag)
        add_camera(bag, '/cam/image_raw/compressed' if compressed else RAW,
                   compressed=compressed)
    path = as_sqlite(tmp_path / 'bag', tmp_path / 'db') if sqlite else tmp_path / 'bag'
    capture = read_bag_capture(path)
    write_capture(capture, tmp_path / 'scene')
    found = read_scene(tmp_path / 'scene').train
    # Driving on an arc, the chord between two poses misses the arc by a millimetre or two.
    np.testing.assert_allclose(found.T_world_cam, camera_poses(), atol=3e-3)
    np.testing.assert_array_equal(found.read_images(), IMAGES)
    assert (found.intrinsics.fx, found.intrinsics.cx) == pytest.approx((30.0, 16.5))


def test_a_camera_with_poses_of_its_own_needs_no_transforms(tmp_path: Path) -> None:
    with CameraBag(tmp_path / 'bag') as bag:
        add_camera(bag)
        for i, T in enumerate(camera_poses()):
            bag.pose('/vio', START + i * STEP, T)
    capture = read_bag_capture(tmp_path / 'bag')
    found = [frame.pose.T_world_cam for frame in capture.frames if frame.pose is not None]
    np.testing.assert_allclose(found, camera_poses(), atol=1e-9)


def test_images_out_of_order_are_sorted_and_twins_dropped(tmp_path: Path) -> None:
    with CameraBag(tmp_path / 'bag') as bag:
        add_mount(bag)
        add_tf(bag)
        add_camera(bag, order=[1, 0, 3, 2, 2])
    capture = read_bag_capture(tmp_path / 'bag')
    write_capture(capture, tmp_path / 'scene')
    np.testing.assert_array_equal(
        read_scene(tmp_path / 'scene').train.read_images(), IMAGES)
    notes = ' '.join(capture.notes)
    assert 'stamps go back 2 times' in notes and '1 images repeat the stamp' in notes


def test_images_without_a_pose_near_their_stamp_are_counted(tmp_path: Path) -> None:
    with CameraBag(tmp_path / 'bag') as bag:
        add_mount(bag)
        add_camera(bag)
        for time in (0.9, 1.1, 2.1, 9):  # nothing before 0.9, and a gap after 2.1
            bag.tf('/tf', START + int(time * STEP), 'map', 'base_link', base_pose(time))
    capture = read_bag_capture(tmp_path / 'bag')
    assert [frame.stamp_ns for frame in capture.frames] == [START + STEP, START + 2 * STEP]
    assert '2 of 4 images have no pose' in ' '.join(capture.notes)


@pytest.mark.parametrize('with_odometry, advice', [
    (False, ''), (True, '; other poses: --pose-topic /odom')], ids=['alone', 'odometry'])
def test_a_link_that_comes_too_rarely_is_named(
        tmp_path: Path, with_odometry: bool, advice: str) -> None:
    with CameraBag(tmp_path / 'bag') as bag:
        add_mount(bag)
        add_tf(bag)
        add_camera(bag)
        if with_odometry:
            add_odometry(bag)
        for time in (0, 6, 12):  # The map is corrected by 5 cm.
            bag.tf('/tf', START + time * STEP, 'map', 'odom', CameraPose.from_planar(
                0.05 * time / 6, 0, 0, 0).T_world_cam)
    capture = read_bag_capture(tmp_path / 'bag')
    assert ('3 of 4 images have no pose near their stamp and are left out; 3 lie between poses of '
            'odom in map that are up to 0.60 s apart; at most 0.5 s are interpolated' + advice
            ) in capture.notes


def test_a_pose_topic_that_comes_too_rarely_is_named(tmp_path: Path) -> None:
    with CameraBag(tmp_path / 'bag') as bag:
        add_camera(bag)
        for time in (-5, 5):
            bag.pose('/vio', START + time * STEP, base_pose(time))
    with pytest.raises(BagError, match='has a pose near its stamp; 4 lie between poses of /vio '
                       'that are up to 1.00 s apart; at most 0.5 s are interpolated$'):
        read_bag_capture(tmp_path / 'bag')


def test_lost_poses_are_counted(tmp_path: Path) -> None:
    with CameraBag(tmp_path / 'bag') as bag:
        add_camera(bag)
        for i, T in enumerate(camera_poses()):
            if i == 0:
                T[0, 3] = np.nan
            bag.pose('/vio', START + i * STEP, T)
    capture = read_bag_capture(tmp_path / 'bag')
    assert len(capture) == 3
    assert '1 poses are not finite' in ' '.join(capture.notes)


@pytest.mark.parametrize('image_topic', ['/left/image_raw', '/right/image_raw'])
def test_one_of_two_cameras_is_chosen_by_name(tmp_path: Path, image_topic: str) -> None:
    with CameraBag(tmp_path / 'bag') as bag:
        add_mount(bag)
        add_tf(bag)
        add_camera(bag, '/left/image_raw', '/left/camera_info')
        add_camera(bag, '/right/image_raw', '/right/camera_info', order=range(2))
    with pytest.raises(BagError, match='2 cameras.*--image-topic: /left/image_raw.*/right'):
        read_bag_capture(tmp_path / 'bag')
    assert len(read_bag_capture(tmp_path / 'bag', BagOptions(image_topic))) == (
        4 if 'left' in image_topic else 2)


def test_the_other_camera_does_not_keep_the_images_of_the_first(tmp_path: Path) -> None:
    # A rectified pair has one frame, one lens and the same stamps.
    left, right = '/left/image_rect', '/right/image_rect'
    with CameraBag(tmp_path / 'bag') as bag:
        add_mount(bag)
        add_tf(bag)
        add_camera(bag, left, '/left/camera_info')
        for i in range(COUNT):
            bag.image(right, START + i * STEP, 255 - IMAGES[i])
            bag.info('/right/camera_info', START + i * STEP, CAMERA)
    scene, shown = tmp_path / 'scene', {left: IMAGES, right: 255 - IMAGES}
    for topic in (left, right):
        capture = read_bag_capture(tmp_path / 'bag', BagOptions(topic))
        write_capture(capture, scene)
        np.testing.assert_array_equal(read_scene(scene).train.read_images(), shown[topic])
    # An import of before noted no topics: nobody knows which images lie there.
    write_capture(replace(capture, origin=origin_of(tmp_path / 'bag')), scene)
    write_capture(read_bag_capture(tmp_path / 'bag', BagOptions(left)), scene)
    np.testing.assert_array_equal(read_scene(scene).train.read_images(), IMAGES)


def test_raw_images_are_preferred_to_their_compressed_copies(tmp_path: Path) -> None:
    with CameraBag(tmp_path / 'bag') as bag:
        add_mount(bag)
        add_tf(bag)
        add_camera(bag)
        add_camera(bag, RAW + '/compressed', None, compressed=True)
    capture = read_bag_capture(tmp_path / 'bag')
    assert len(capture) == 4 and not any('camera_info' in note for note in capture.notes)


@pytest.mark.parametrize('topic, model, d, expected', [
    (RAW, 'plumb_bob', [-0.1, 0.01, 0.001, 0.0, 0.0], (False, (-0.1, 0.01, 0.001, 0.0, 0.0))),
    (RAW, 'equidistant', [0.1, 0.0, 0.0, 0.0], (True, (0.1, 0.0, 0.0, 0.0))),
    ('/cam/image_rect', 'plumb_bob', [-0.1, 0.01, 0.001, 0.0, 0.0], (False, ())),
    (RAW, 'plumb_bob', [0.0] * 5, (False, ())),
    # As the node takes it: image_proc leaves the model's name where it has taken out the rest.
    (RAW, 'equidistant', [0.0] * 4, (False, ())),
], ids=['plumb_bob', 'equidistant', 'rectified', 'none', 'no fisheye left'])
def test_distortion_comes_from_camera_info(
        tmp_path: Path, topic: str, model: str, d: list[float],
        expected: tuple[bool, tuple[float, ...]]) -> None:
    with CameraBag(tmp_path / 'bag') as bag:
        add_mount(bag)
        add_tf(bag)
        add_camera(bag, topic, distortion_model=model, d=np.array(d))
    capture = read_bag_capture(tmp_path / 'bag')
    lens = capture.frames[0].lens
    assert lens is not None and (lens.fisheye, lens.distortion) == expected
    write_capture(capture, tmp_path / 'scene')
    found = read_scene(tmp_path / 'scene').train
    assert (found.intrinsics == lens.intrinsics) == (not any(expected[1]))


def test_a_rectified_camera_is_the_one_of_p(tmp_path: Path) -> None:
    p = np.array([25.0, 0, 15, 0, 0, 25, 11, 0, 0, 0, 1, 0])
    with CameraBag(tmp_path / 'bag') as bag:
        add_mount(bag)
        add_tf(bag)
        add_camera(bag, '/cam/image_rect', p=p, d=np.full(5, 0.1))
    lens = read_bag_capture(tmp_path / 'bag').frames[0].lens
    assert lens is not None and lens.intrinsics == Intrinsics(32, 24, 25, 25, 15.5, 11.5)


def test_a_bag_without_poses_is_unposed(tmp_path: Path) -> None:
    with CameraBag(tmp_path / 'bag') as bag:
        add_mount(bag)
        add_camera(bag)
    capture = read_bag_capture(tmp_path / 'bag')
    assert not capture.posed and len(capture) == 4
    assert 'the bag has no poses: structure from motion' in capture.notes


@pytest.mark.parametrize('zeros', [
    {'k': np.zeros(9), 'p': np.zeros(12)}, {'width': 0, 'height': 0}], ids=['matrix', 'size'])
def test_a_camera_that_is_not_calibrated_is_estimated_where_there_are_no_poses(
        tmp_path: Path, zeros: dict[str, Any]) -> None:
    with CameraBag(tmp_path / 'bag') as bag:
        add_camera(bag, **zeros)
    capture = read_bag_capture(tmp_path / 'bag')
    assert not capture.posed and {frame.lens for frame in capture.frames} == {None}
    assert '/cam/camera_info is not calibrated: the camera is estimated' in capture.notes


def test_poses_are_left_aside_where_none_are_wanted(tmp_path: Path) -> None:
    with CameraBag(tmp_path / 'bag') as bag:
        no_way_from_tf(bag)
        add_odometry(bag)
    capture = read_bag_capture(tmp_path / 'bag', options=BagOptions(pose_topic='none'))
    assert not capture.posed
    assert 'no poses are taken from the bag: structure from motion' in capture.notes


def test_what_moves_below_the_camera_does_not_move_it(tmp_path: Path) -> None:
    with CameraBag(tmp_path / 'bag') as bag:
        add_mount(bag)
        add_camera(bag)
        for time in range(COUNT):
            bag.tf('/tf', START + time * STEP, 'base_link', 'wheel', base_pose(time))
    assert not read_bag_capture(tmp_path / 'bag').posed


@pytest.mark.parametrize('add_motion', [add_odometry, add_poses], ids=['odometry', 'pose'])
@pytest.mark.parametrize('pan', [0.0, 0.3], ids=['a mount', 'a pan joint'])
def test_transforms_below_the_body_do_not_hide_its_poses(
        tmp_path: Path, add_motion: Callable[[CameraBag], None], pan: float) -> None:
    turns = [CameraPose.from_planar(0, 0, 0, pan * i).T_world_cam @ np.linalg.inv(T_BODY_OPTICAL)
             @ T_BASE_OPTICAL for i in range(COUNT)]
    with CameraBag(tmp_path / 'bag') as bag:
        add_motion(bag)
        add_camera(bag)
        for i, T in enumerate(turns):
            bag.tf('/tf', START + i * STEP, 'base_link', 'optical', T)
    capture = read_bag_capture(tmp_path / 'bag')
    found = [frame.pose.T_world_cam for frame in capture.frames if frame.pose is not None]
    np.testing.assert_allclose(found, [base_pose(i) @ T for i, T in enumerate(turns)], atol=3e-3)


def test_a_camera_that_never_moves_in_tf_has_no_poses_unless_they_are_asked_for(
        tmp_path: Path, caplog: pytest.LogCaptureFixture) -> None:
    with CameraBag(tmp_path / 'bag') as bag:
        add_camera(bag)
        for time in (-1, COUNT):
            bag.tf('/tf', START + time * STEP, 'base_link', 'optical', T_BASE_OPTICAL)
    assert not read_bag_capture(tmp_path / 'bag').posed
    assert 'optical never moves in /tf' in caplog.text and '--pose-topic /tf' in caplog.text
    capture = read_bag_capture(tmp_path / 'bag', options=BagOptions(pose_topic='/tf'))
    found = [frame.pose.T_world_cam for frame in capture.frames if frame.pose is not None]
    np.testing.assert_allclose(found, [T_BASE_OPTICAL] * COUNT, atol=1e-9)
    assert 'poses from /tf: optical in base_link, where it never moves' in capture.notes


def test_a_frame_with_two_parents_matters_only_on_the_way_to_the_poses(tmp_path: Path) -> None:
    with CameraBag(tmp_path / 'bag') as bag:
        add_mount(bag)
        add_tf(bag)
        add_odometry(bag)
        add_camera(bag)
        for parent in ('hand', 'table'):
            bag.tf('/tf', START, parent, 'cup', np.eye(4))
    assert 'poses from /tf: optical in map' in read_bag_capture(tmp_path / 'bag').notes
    with CameraBag(tmp_path / 'odometry') as bag:
        two_parents_beside_odometry(bag)
    capture = read_bag_capture(tmp_path / 'odometry', options=BagOptions(pose_topic='/odom'))
    found = [frame.pose.T_world_cam for frame in capture.frames if frame.pose is not None]
    np.testing.assert_allclose(found, camera_poses(), atol=3e-3)


@pytest.mark.parametrize('stamp, expected', [
    (0, 0.0), (50, 0.5), (100, 1.0), (-10, 0.0), (-30, None), (115, None), (700, None),
    (3000, 5.0),
], ids=lambda value: str(value))
def test_tracks_are_interpolated_where_they_are_known(stamp: int,
                                                      expected: float | None) -> None:
    track = PoseTrack()
    # Metres along x at milliseconds; it stands still from 2 s to 4 s.
    for milliseconds, x in ((100, 1.0), (0, 0.0), (2000, 5.0), (4000, 5.0)):
        track.add(milliseconds * 1_000_000, (x, 0, 0, 0, 0, 0, 1))
    found = track.at(stamp * 1_000_000)
    assert (found is None) == (expected is None)
    if found is not None and expected is not None:
        assert math.isclose(found[0, 3], expected, abs_tol=1e-9)
