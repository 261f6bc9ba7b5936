"""Where landmarks look like an image: places first, then a pose at each of them."""
import math

from box_room import apart
from neo_ros.geometry import CameraPose, Intrinsics
from neo_ros.memory.landmark_places import coded, PlaceFinder, PlaceThresholds
from neo_ros.memory.landmarks import Landmarks, Locator
from neo_ros.memory.local_features import Features
import numpy as np

CAMERA = Intrinsics.from_hfov(128, 128, math.pi / 2)
POSE = CameraPose.from_planar(1.0, 2.0, 1.2, 0.3)
AWAY, ABOVE = np.array([[20, 0, 0], [0, 0, 3]], np.float32)
A_ROOM = 500  # landmarks


def room(seed: int, x: float = 0.0, y: float = 0.0, z: float = 0.0
         ) -> tuple[np.ndarray, np.ndarray]:
    """Landmarks of a room of 4 by 4 metres, and how they look, of length 1."""
    random = np.random.default_rng(seed)
    points = random.uniform((x, y, z), (x + 4, y + 4, z + 2.5), (A_ROOM, 3))
    looks = np.abs(random.normal(0, 1, (A_ROOM, 128)))
    return points.astype(np.float32), looks / np.linalg.norm(looks, axis=1, keepdims=True)


def building(*rooms: tuple[np.ndarray, np.ndarray]) -> Landmarks:
    points, looks = map(np.concatenate, zip(*rooms))
    return Landmarks(points, coded(looks))


def seen(points: np.ndarray, looks: np.ndarray, pose: CameraPose = POSE) -> Features:
    """Take the features of what a camera sees of a room, its descriptors a little off."""
    x, y, z = ((points - pose.position) @ pose.T_world_cam[:3, :3]).T
    pixels = np.stack([CAMERA.fx * x / z + CAMERA.cx, CAMERA.fy * y / z + CAMERA.cy], 1)
    inside = (z > 0.3) & ((pixels > 0) & (pixels < 128)).all(1)
    off = looks[inside] + np.random.default_rng(9).normal(0, 0.01, looks[inside].shape)
    off = np.maximum(off, 0).astype(np.float32)
    return Features(pixels[inside].astype(np.float32),
                    off / np.linalg.norm(off, axis=1, keepdims=True))


def row(count: int) -> Landmarks:
    return building(*(room(number, x=5.0 * number) for number in range(count)))


def test_a_room_among_many_is_found() -> None:
    there = room(17, x=85)
    pose = CameraPose.from_planar(86, 2, 1.2, 0.3)
    found = Locator(row(40), CAMERA).search(seen(*there, pose))
    assert len(found) == 1
    metres, degrees = apart(found[0].pose, pose)
    assert metres < 0.01 and degrees < 0.1


def test_equal_rooms_are_all_found_also_on_another_floor() -> None:
    points, looks = room(0)
    twins = building((points, looks), room(1, x=5), (points + AWAY, looks),
                     (points + ABOVE, looks))
    found = Locator(twins, CAMERA).search(seen(points, looks))
    places = sorted(tuple((one.pose.position - POSE.position).round(1) + 0) for one in found)
    assert places == [(0, 0, 0), (0, 0, 3), (20, 0, 0)]


def test_a_search_says_the_same_each_time() -> None:
    features = seen(*room(3, x=15), CameraPose.from_planar(16, 2, 1.2, 0.3))
    one, other = (Locator(row(6), CAMERA).search(features)[0].pose for _ in range(2))
    np.testing.assert_array_equal(one.T_world_cam, other.T_world_cam)


def test_what_is_nowhere_is_not_found() -> None:
    locator = Locator(row(6), CAMERA)
    assert locator.search(seen(*room(99))) == []
    assert locator.search(Features(np.zeros((0, 2), np.float32),
                                   np.zeros((0, 128), np.float32))) == []


def test_around_a_pose_no_more_are_tried_in_a_larger_building() -> None:
    for count in (4, 40):
        landmarks = row(count)
        finder = PlaceFinder(landmarks.points, landmarks.descriptors,
                             PlaceThresholds(tried=3 * A_ROOM))
        near = finder.near(np.array([2.0, 2.0, 1.2]))
        assert A_ROOM < len(near) <= 3 * A_ROOM
        assert (np.diff(near) > 0).all() and np.isin(np.arange(A_ROOM), near).all()


def test_points_far_out_cost_nothing() -> None:
    points, looks = room(0)
    points[:3] = [[1e9, 0, 0], [0, -1e30, 0], [0, 0, 1e7]]
    assert Locator(building((points, looks)), CAMERA).search(seen(points, looks))
