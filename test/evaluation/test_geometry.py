"""Occupancy on walls whose place is known, and how true a depth is."""
from neo_ros.evaluation.geometry import _without, DepthScores, OccupancyGrid
from neo_ros.geometry import CameraPose, Intrinsics, ViewExpansion
import numpy as np
import pytest

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


def test_depth_is_scored_in_the_ring_where_it_is_told() -> None:
    expansion = ViewExpansion.to_size(Intrinsics(32, 32, 16.0, 16.0, 16.0, 16.0), 64, 64)
    true = np.full((64, 64), 2.0, np.float32)
    depth = true * 1.2
    depth[:, :32] = 2.02
    depth[:16] = np.nan
    depth[expansion.observed] = 9  # The camera's own view is not scored.
    scores = DepthScores()
    scores.add(depth, true, POSE, POSE, expansion, GRID)
    figures = scores.figures()
    told = expansion.extrapolated_mask & np.isfinite(depth)
    assert figures['depth_within_5_percent'] == pytest.approx(told[:, :32].sum() / told.sum())
    assert figures['depth_too_far_10_percent'] == pytest.approx(told[:, 32:].sum() / told.sum())
    assert 0.1 < figures['occupied_marked'] < 0.6  # A part is told, and half of that is right.
    exact = DepthScores()
    exact.add(true, true, POSE, POSE, expansion, GRID)
    assert exact.figures()['occupied_marked'] == 1
    assert exact.figures()['free_marked_occupied'] == 0
