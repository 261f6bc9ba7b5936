"""Sharp frames per step of the camera, and worlds with z up."""
from dataclasses import replace
import math
from pathlib import Path

from capture_files import demo_photos
import cv2
from hypothesis import given, strategies as st
from neo_ros.captures.capture import Capture, CapturedFrame
from neo_ros.captures.frame_selection import select_frames, split_steps
from neo_ros.captures.levelling import level_world, scaled
from neo_ros.errors import ConfigError, SceneError
from neo_ros.geometry import CameraPose, Intrinsics
from neo_ros.geometry.camera_pose import rotation_from_vector
from neo_ros.pictures.sharpness import sharpness
from neo_ros.scenes.posed_images import PosedImages
from neo_ros.scenes.scene import Scene
from neo_ros.scenes.upright import estimate_up, rotation_between, stood_up, tilt
from neo_ros.scenes.walkable import WalkableMap
import numpy as np
import pytest


def walk(count: int, step: float = 0.1, turn: float = 0.0) -> list[CameraPose]:
    return [CameraPose.from_planar(step * i, 0, 1.5, turn * i) for i in range(count)]


@pytest.mark.parametrize('poses, paths, distance, angle, expected', [
    (walk(6), [0] * 6, 0.25, math.inf, [(0, 3), (3, 6)]),
    (walk(6, 0, 0.1), [0] * 6, math.inf, 0.25, [(0, 3), (3, 6)]),
    (walk(4), [0, 0, 1, 1], math.inf, math.inf, [(0, 2), (2, 4)]),
    (walk(3), [0] * 3, 0.05, math.inf, [(0, 1), (1, 2), (2, 3)]),
], ids=['distance', 'angle', 'new path', 'every frame'])
def test_steps_end_where_the_camera_has_moved(
        poses: list[CameraPose], paths: list[int], distance: float, angle: float,
        expected: list[tuple[int, int]]) -> None:
    steps = split_steps(poses, paths, distance, angle)
    assert [(step.start, step.stop) for step in steps] == expected


def test_the_sharpest_readable_frame_of_a_step_is_kept() -> None:
    sharp = demo_photos().images[0]
    images = {0: cv2.GaussianBlur(sharp, (0, 0), 2), 1: sharp, 2: None, 3: None,
              4: cv2.GaussianBlur(sharp, (0, 0), 2), 5: cv2.GaussianBlur(sharp, (0, 0), 1)}
    capture = Capture(
        tuple(CapturedFrame(f'{i}.png', pose, None) for i, pose in enumerate(walk(6))),
        stream=lambda indices: ((index, images[index]) for index in indices))
    kept = select_frames(capture, 0.25, None)
    assert [frame.name for frame in kept.frames] == ['1.png', '5.png']
    np.testing.assert_array_equal(dict(kept.images([1]))[1], images[5])
    assert '2 keyframes chosen of 6' in kept.notes[-1]


def test_frames_of_which_none_can_be_read_are_refused() -> None:
    capture = Capture(
        tuple(CapturedFrame(f'{i}.png', pose, None) for i, pose in enumerate(walk(3))),
        stream=lambda indices: ((index, None) for index in indices))
    with pytest.raises(SceneError, match='none of the 3 images can be read'):
        select_frames(capture, 0.25, None)


def test_blur_lowers_sharpness() -> None:
    image = demo_photos().images[0]
    assert sharpness(image) > 2 * sharpness(cv2.GaussianBlur(image, (0, 0), 1))


@pytest.mark.parametrize('distance, angle', [(0.0, None), (None, -1.0), (math.nan, None)])
def test_steps_have_a_size(distance: float | None, angle: float | None) -> None:
    with pytest.raises(ConfigError, match='expected a number > 0'):
        select_frames(Capture(()), distance, angle)


units = st.tuples(*[st.floats(-1, 1)] * 3).filter(lambda v: np.linalg.norm(v) > 0.1).map(
    lambda v: np.array(v) / np.linalg.norm(v))


@given(units, units)
def test_a_rotation_between_directions_turns_one_to_the_other(a: np.ndarray,
                                                              b: np.ndarray) -> None:
    R = rotation_between(a, b)
    np.testing.assert_allclose(R @ a, b, atol=1e-6)
    np.testing.assert_allclose(R @ R.T, np.eye(3), atol=1e-9)


@pytest.mark.parametrize('vector', [(0, 0, 0), (1.2, 0.3, 0), (math.pi, 0, 0), (0, -1.5, 0.4)],
                         ids=['level', 'tilted', 'upside down', 'sideways'])
@pytest.mark.parametrize('pitch', [0.0, 0.6], ids=['ahead', 'looking down'])
def test_levelling_finds_up_whatever_the_world_was(vector: tuple[float, ...],
                                                   pitch: float) -> None:
    down = rotation_from_vector(np.array([-pitch, 0, 0]))
    T = np.eye(4)
    T[:3, :3] = rotation_from_vector(np.array(vector))
    poses = []
    for pose in walk(12, 0.2, 0.5):
        T_world_cam = pose.T_world_cam.copy()
        T_world_cam[:3, :3] = T_world_cam[:3, :3] @ down
        poses.append(CameraPose(T @ T_world_cam))
    np.testing.assert_allclose(estimate_up(poses), T[:3, 2], atol=1e-6)
    capture = scaled(level_world(Capture(tuple(CapturedFrame(f'{i}', pose, None)
                                         for i, pose in enumerate(poses)))), 2.0)
    levelled = [frame.pose for frame in capture.frames if frame.pose is not None]
    assert tilt(levelled) < 1e-4
    steps = np.diff([pose.position for pose in levelled], axis=0)
    np.testing.assert_allclose(np.linalg.norm(steps, axis=1), 0.4, atol=1e-9)
    np.testing.assert_allclose(steps[:, 2], 0, atol=1e-6)


def test_cameras_that_hardly_turn_give_their_own_up() -> None:
    up = estimate_up(walk(5, 0.1, 0.001))
    np.testing.assert_allclose(up, [0, 0, 1], atol=1e-9)


def hand_held(R_world: np.ndarray, count: int = 40) -> PosedImages:
    """Return photos held upright, in a world that is turned by R_world."""
    T = np.eye(4)
    T[:3, :3] = R_world
    poses = tuple(CameraPose(T @ CameraPose.from_planar(i % 5, i % 3, 1.5, 0.7 * i).T_world_cam)
                  for i in range(count))
    return PosedImages(Intrinsics(4, 4, 4, 4, 2, 2), (Path('none.png'),) * count, poses,
                       (0,) * count)


@pytest.mark.parametrize('up', [
    (0, 0, 1), (0, 1, 0), (1, 0, 0), (0, 0, -1), (0, -1, 0), (-1, 0, 0)], ids=str)
def test_any_axis_may_point_up(
        up: tuple[int, int, int], caplog: pytest.LogCaptureFixture) -> None:
    R = rotation_between(np.array([0.0, 0.0, 1.0]), np.array(up, float))
    photos = hand_held(R)
    scene = stood_up(Scene('room', photos, photos.subset([3, 4]), None, None))
    name = ('-' if sum(up) < 0 else '+') + 'xyz'[int(np.abs(up).argmax())]
    said = f'room: the photos were held with {name} up: the world is turned'
    assert (said in caplog.text) == (up != (0, 0, 1))
    np.testing.assert_allclose(scene.train.T_world_cam[:, 2, 3], 1.5, atol=1e-9)
    assert tilt(list(scene.train.poses)) < 1e-6
    assert scene.test is not None
    np.testing.assert_allclose(scene.test.T_world_cam, scene.train.T_world_cam[3:5])
    # Only turned: cameras see one another as before.
    np.testing.assert_allclose(
        np.linalg.inv(photos.T_world_cam[0]) @ photos.T_world_cam[7],
        np.linalg.inv(scene.train.T_world_cam[0]) @ scene.train.T_world_cam[7], atol=1e-9)


@pytest.mark.parametrize('degrees, warned', [(10, None), (20, 20), (29, 29), (44, 44), (50, 40)])
def test_a_world_that_no_quarter_turn_stands_up_is_told(
        degrees: float, warned: int | None, caplog: pytest.LogCaptureFixture) -> None:
    photos = hand_held(rotation_from_vector(np.array([math.radians(degrees), 0, 0])))
    stood_up(Scene('room', photos, None, None, None))
    assert ('--level' in caplog.text) == (warned is not None)
    assert warned is None or f'room: the photos were held {warned} degrees from ' in caplog.text
    caplog.clear()
    stood_up(Scene('room', replace(photos, z_up=True), None, None, None))
    assert not caplog.text


@pytest.mark.parametrize('turn', [0.001, 0.5], ids=['hardly turning', 'turning'])
def test_looking_down_is_no_lean(turn: float, caplog: pytest.LogCaptureFixture) -> None:
    T = np.eye(4)
    T[:3, :3] = rotation_from_vector(np.array([math.radians(-30), 0, 0]))
    poses = tuple(CameraPose(pose.T_world_cam @ T) for pose in walk(12, 0.1, turn))
    photos = replace(hand_held(np.eye(3), 12), poses=poses)
    assert stood_up(Scene('room', photos, None, None, None)).train is photos
    assert not caplog.text


def test_a_floor_map_says_which_way_is_up() -> None:
    photos = hand_held(rotation_between(np.array([0.0, 0.0, 1.0]), np.array([0.0, 1.0, 0.0])))
    floor = WalkableMap(0.5, (0.0, 0.0), np.ones((2, 2), bool), 1.0)
    scene = Scene('room', photos, None, None, floor)
    assert stood_up(scene) is scene


def test_a_camera_on_its_side_does_not_turn_a_world_with_z_up(
        caplog: pytest.LogCaptureFixture) -> None:
    photos = hand_held(np.eye(3))
    roll = np.eye(4)
    roll[:3, :3] = rotation_from_vector(np.array([0.0, 0.0, math.pi / 2]))
    rolled = replace(photos, z_up=True, poses=tuple(
        CameraPose(pose.T_world_cam @ roll) for pose in photos.poses))
    scene = Scene('room', rolled, None, None, None)
    assert tilt(list(rolled.poses)) > 1
    assert stood_up(scene) is scene and not caplog.text
