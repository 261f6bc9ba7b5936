"""What is plain and flat comes onto planes through its edges; all else stays where it is."""
import math

import cv2
from neo_ros.baking.plain_surfaces import (
    dominant_directions, hand_held, move_to_planes, with_planes)
from neo_ros.geometry import Band
import numpy as np
import pytest

HEIGHT, WIDTH = 120, 360
BAND = Band(top=1.0, bottom=-1.0)
RAYS = BAND.rays(HEIGHT, WIDTH)
HALF = np.array([2.0, 1.5, 1.2])
# How far the camera stands from the middle of the room.
STANDS = np.array([0.3, -0.2, 0.1])
SOME_TURN = cv2.Rodrigues(np.array([0.05, -0.08, 0.5]))[0].astype(np.float32)


def room(turn: np.ndarray = np.eye(3, dtype=np.float32)) -> tuple[np.ndarray, np.ndarray]:
    """Return depth (h, w) and wall, 0 to 5, of a room with plain walls that is turned."""
    own = RAYS @ turn
    with np.errstate(divide='ignore'):
        along = (np.copysign(HALF, own) - STANDS) / own
    axis = along.argmin(-1)
    side = np.take_along_axis(own, axis[..., None], -1)[..., 0] > 0
    return along.min(-1).astype(np.float32), 2 * axis + side


def drawn(wall: np.ndarray) -> np.ndarray:
    """Return a texture in which each wall has a grey of its own."""
    greys = np.array([60, 90, 120, 150, 180, 210], np.uint8)[wall]
    return np.repeat(greys[..., None], 3, 2)


def inner(wall: np.ndarray, pixels: int) -> np.ndarray:
    """Tell what is so many pixels away from the next wall."""
    grey = drawn(wall)[..., 0]
    kernel = np.ones((2 * pixels + 1, 2 * pixels + 1), np.uint8)
    return cv2.dilate(grey, kernel) == cv2.erode(grey, kernel)


def receded(depth: np.ndarray, wall: np.ndarray, by: float = 1.08) -> np.ndarray:
    """Return what a field has: right at corners, too far in between."""
    return np.where(inner(wall, 4), by * depth, depth).astype(np.float32)


@pytest.mark.parametrize('turn', [np.eye(3, dtype=np.float32), SOME_TURN], ids=['level', 'turned'])
def test_the_directions_of_walls_are_found(turn: np.ndarray) -> None:
    depth, wall = room(turn)
    directions = dominant_directions([receded(depth, wall)], [RAYS])
    assert directions.shape == (3, 3)
    np.testing.assert_allclose(np.sort(np.abs(directions @ turn).max(1)), 1, atol=2e-4)


@pytest.mark.parametrize('turn', [np.eye(3, dtype=np.float32), SOME_TURN], ids=['level', 'turned'])
def test_plain_walls_come_back_to_where_their_corners_are(turn: np.ndarray) -> None:
    depth, wall = room(turn)
    wrong = receded(depth, wall)
    directions = dominant_directions([wrong], [RAYS])
    off = np.abs(with_planes(wrong, drawn(wall), RAYS, directions) / depth - 1)
    assert np.median(np.abs(wrong / depth - 1)) > 0.07
    assert np.median(off) < 0.01 and np.quantile(off, 0.95) < 0.03


def test_what_is_right_stays_right() -> None:
    depth, wall = room()
    found = with_planes(depth, drawn(wall), RAYS, np.eye(3, dtype=np.float32))
    assert np.abs(found / depth - 1).max() < 0.02


def test_walls_without_edges_stay() -> None:
    wrong = receded(*room())
    grey = np.full((HEIGHT, WIDTH, 3), 128, np.uint8)
    np.testing.assert_array_equal(with_planes(wrong, grey, RAYS, np.eye(3, dtype=np.float32)),
                                  wrong)


def test_a_scene_without_flat_surfaces_stays() -> None:
    _, wall = room()
    random = np.random.default_rng(0)
    leaves = random.uniform(1, 3, (HEIGHT, WIDTH)).astype(np.float32)
    directions = dominant_directions([leaves], [RAYS])
    assert directions.shape == (0, 3)
    np.testing.assert_array_equal(with_planes(leaves, drawn(wall), RAYS, directions), leaves)


def test_what_is_unknown_stays_unknown() -> None:
    depth, wall = room()
    wrong = receded(depth, wall)
    wrong[50:70, 100:140] = 0
    found = with_planes(wrong, drawn(wall), RAYS, np.eye(3, dtype=np.float32))
    np.testing.assert_array_equal(found == 0, wrong == 0)


def test_the_edges_of_what_stands_before_a_wall_do_not_draw_it_nearer() -> None:
    depth, wall = room()
    # A bright board hangs in the air before a wall whose own corners are out of the picture.
    board = np.zeros((HEIGHT, WIDTH), bool)
    middle = round(WIDTH * (1 - (0.0 + math.pi) / (2 * math.pi)))
    board[45:75, middle - 12:middle + 12] = True
    texture = np.full((HEIGHT, WIDTH, 3), 100, np.uint8)
    texture[board] = 220
    wrong = receded(depth, wall)
    wrong[board] = 0.85 * depth[board]
    found = with_planes(wrong, texture, RAYS, np.eye(3, dtype=np.float32))
    side = np.s_[50:70, middle + 18:middle + 30]
    assert (found[side] > 0.97 * depth[side]).all()


def test_finer_pixels_follow_their_block_but_not_onto_another_surface() -> None:
    depth, wall = room()
    wrong, directions, block = receded(depth, wall), np.eye(3, dtype=np.float32), 3
    fine = wrong.repeat(block, 0).repeat(block, 1)
    far = np.s_[180, 500]  # One pixel of nine that looks through a hole in the wall.
    fine[far] = 9
    rays = RAYS.repeat(block, 0).repeat(block, 1)
    texture = drawn(wall).repeat(block, 0).repeat(block, 1)
    moved = fine.copy()
    move_to_planes(moved, texture, rays, block, directions, 0.1)
    assert moved[far] == 9
    moved[far] = moved[180, 499]
    wanted = with_planes(wrong, texture, RAYS, directions)
    np.testing.assert_allclose(moved, wanted.repeat(block, 0).repeat(block, 1), rtol=1e-5)
    assert (moved != fine).mean() > 0.5


@pytest.mark.parametrize('heights, expected', [([1.2], False), ([1.2, 1.2, 1.2], False),
                                               ([1.2, 1.25], True),
                                               ([1.2, 1.21, 4.2, 4.21], False),
                                               ([1.2, 1.2, 4.2, 4.3], True)])
def test_keyframes_at_several_heights_are_of_a_hand_held_camera(
        heights: list[float], expected: bool) -> None:
    positions = np.column_stack([np.arange(len(heights)), np.zeros(len(heights)), heights])
    assert hand_held(positions) == expected
