"""Occupancy on walls whose place is known."""
from neo_ros.evaluation.geometry import _without, OccupancyGrid
from neo_ros.geometry import CameraPose, Intrinsics
import numpy as np

GRID = OccupancyGrid()
RAYS = Intrinsics(64, 64, 32.0, 32.0, 32.0, 32.0).pixel_rays().reshape(-1, 3).astype(np.float64)
POSE = CameraPose.from_planar(0.01, 0.01, 1.0, 0.0)


def test_a_wall_marks_its_cells_and_frees_those_before_it() -> None:
    wall = np.full(len(RAYS), 2.0)
    occupied = GRID.occupied(wall, RAYS, POSE, POSE.position)
    assert set(occupied[:, 0]) == {40}  # x = 2.01
    free = _without(GRID.free(wall, RAYS, POSE), occupied)
    assert free[:, 0].max() in (38, 39) and len(free) > 500


def test_floor_ceiling_and_what_is_far_mark_nothing() -> None:
    with np.errstate(divide='ignore'):
        floor = np.where(RAYS[:, 1] > 0, 1.0 / RAYS[:, 1], np.nan)
    assert not len(GRID.occupied(floor, RAYS, POSE, POSE.position))
    assert not len(GRID.occupied(np.full(len(RAYS), 5.0), RAYS, POSE, POSE.position))
    assert not len(GRID.occupied(np.full(len(RAYS), np.nan), RAYS, POSE, POSE.position))


def test_cells_are_told_apart() -> None:
    cells = np.array([[1, 2], [-1, 2], [2, 1]])
    assert _without(cells, np.array([[-1, 2]])).tolist() == [[1, 2], [2, 1]]
