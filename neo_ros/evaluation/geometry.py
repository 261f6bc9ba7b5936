"""
How true is what the memory says of space: the camera's pose, its covariance, the ring's depth.

The measure that a planner cares about is occupancy: points between LOW and HIGH above the floor
mark cells of a grid, as an obstacle layer does. Of the cells that the ring truly shows within
reach, the share that is marked; of those that it truly shows to be free, the share that is marked,
too.
"""
from collections.abc import Callable, Iterator
from dataclasses import dataclass, field
import time
from types import SimpleNamespace
from typing import Any

from neo_ros.evaluation.evaluate import protocol_of, TruthFrames
from neo_ros.evaluation.stability import DepthOf
from neo_ros.geometry import CameraPose, ViewExpansion
from neo_ros.geometry.camera_pose import rotation_vector
from neo_ros.machine.host import commit, host
from neo_ros.memory.sight import Guide
from neo_ros.messages.points import PointMaker
from neo_ros.messages.scene_outputs import depth_fields, pose_message
from neo_ros.runtime import FovExtrapolator, WideView
import numpy as np

# The contract of results/geometry.json; null where not measured.
GEOMETRY_KEYS = (
    'scene', 'protocol', 'camera', 'n_frames', 'pose_share',
    'position_cm_median', 'position_cm_p95', 'rotation_deg_median', 'rotation_deg_p95',
    'position_covered_95', 'rotation_covered_95',
    'depth_error_median', 'depth_within_5_percent', 'depth_too_far_10_percent',
    'occupied_marked', 'free_marked_occupied', 'pose_ms', 'depth_ms', 'points_ms',
    'commit', 'host')
CHI_SQUARED_95 = 7.815  # of three degrees of freedom


@dataclass(frozen=True)
class OccupancyGrid:
    """Cells of a costmap: their side, heights above the floor, and reach; metres."""

    side: float = 0.05
    low: float = 0.1
    high: float = 1.5
    reach: float = 4.0
    # Rays are walked in steps of half a cell; every so many pixels and rows one.
    every: int = 4

    def occupied(self, depth: np.ndarray, rays: np.ndarray, pose: CameraPose,
                 around: np.ndarray) -> np.ndarray:
        """
        Return the cells that points mark, int64 (N, 2), without doubles.

        depth (M,) along the optical axis, NaN = none; rays (M, 3) with z = 1, camera axes; around
        (3,): where the reach is measured from.
        """
        points = (rays * depth[:, None]) @ pose.T_world_cam[:3, :3].T + pose.position
        return self._cells(points, around)

    def free(self, depth: np.ndarray, rays: np.ndarray, pose: CameraPose) -> np.ndarray:
        """Return the cells that rays cross between the heights before they end, int64 (N, 2)."""
        world = rays @ pose.T_world_cam[:3, :3].T
        across = np.linalg.norm(world[:, :2], axis=1)
        steps = np.arange(self.side, self.reach, self.side / 2) / np.maximum(across, 1e-6)[:, None]
        # Not the cell in which the ray ends.
        steps[steps > (depth - self.side / np.maximum(across, 1e-6))[:, None]] = np.nan
        points = world[:, None] * steps[..., None] + pose.position
        return self._cells(points.reshape(-1, 3), pose.position)

    def _cells(self, points: np.ndarray, around: np.ndarray) -> np.ndarray:
        with np.errstate(invalid='ignore'):
            kept = ((points[:, 2] > self.low) & (points[:, 2] < self.high) & (
                np.linalg.norm(points[:, :2] - around[:2], axis=1) < self.reach))
        return np.unique(np.floor(points[kept, :2] / self.side).astype(np.int64), axis=0)


@dataclass
class DepthScores:
    """
    How true the ring's depth was in the frames so far.

    errors: relative, signed; cells: truly occupied that are marked, truly occupied, truly free
    that are marked, truly free.
    """

    errors: list[np.ndarray] = field(default_factory=list)
    cells: list[tuple[int, int, int, int]] = field(default_factory=list)

    def add(self, depth: np.ndarray, true: np.ndarray, pose: CameraPose, found: CameraPose,
            expansion: ViewExpansion, grid: OccupancyGrid | None) -> None:
        """
        Score depth (H, W) of a frame against the true one, both along the optical axis.

        pose: the true one; found: from where the depth is told; grid: where the floor is at z = 0.
        """
        ring = expansion.extrapolated_mask
        known = ring & np.isfinite(depth) & np.isfinite(true)
        self.errors.append(((depth - true) / true)[known].astype(np.float32))
        if grid is None:
            return
        rays = expansion.target.pixel_rays()
        occupied = grid.occupied(true[ring], rays[ring], pose, pose.position)
        marked = grid.occupied(depth[ring], rays[ring], found, pose.position)
        some = np.zeros_like(ring)
        some[::grid.every, ::grid.every] = ring[::grid.every, ::grid.every]
        free = _without(grid.free(true[some], rays[some], pose), occupied)
        self.cells.append((len(occupied) - len(_without(occupied, marked)), len(occupied),
                           len(free) - len(_without(free, marked)), len(free)))

    def figures(self) -> dict[str, float]:
        """Return what was measured under its keys of GEOMETRY_KEYS."""
        found = {}
        if self.errors:
            errors = np.concatenate(self.errors)
            found['depth_error_median'] = float(np.median(np.abs(errors)))
            found['depth_within_5_percent'] = float(np.mean(np.abs(errors) <= 0.05))
            found['depth_too_far_10_percent'] = float(np.mean(errors > 0.1))
        if self.cells:
            marked, occupied, wrong, free = np.sum(self.cells, axis=0)
            found['occupied_marked'] = float(marked / max(occupied, 1))
            found['free_marked_occupied'] = float(wrong / max(free, 1))
        return found


@dataclass
class _Scores:
    """Figures of the frames so far."""

    position: list[float] = field(default_factory=list)
    rotation: list[float] = field(default_factory=list)
    covered: list[tuple[bool, bool]] = field(default_factory=list)
    depth: DepthScores = field(default_factory=DepthScores)
    milliseconds: list[tuple[float, float, float]] = field(default_factory=list)

    def row(self) -> dict[str, float]:
        """Return what was measured under its keys."""
        if not self.position:
            return {}
        found = {f'{name}_{stated}': float(np.percentile(values, share))
                 for name, values in (('position_cm', self.position),
                                      ('rotation_deg', self.rotation))
                 for stated, share in (('median', 50), ('p95', 95))}
        found['position_covered_95'], found['rotation_covered_95'] = map(
            float, np.mean(self.covered, axis=0))
        for name, value in zip(('pose_ms', 'depth_ms', 'points_ms'),
                               np.median(self.milliseconds, axis=0)):
            found[name] = float(value)
        return found | self.depth.figures()


def score_geometry(scene: str, frames: TruthFrames, extrapolator: FovExtrapolator,
                   true_depth: DepthOf | None = None, grid: OccupancyGrid | None = None,
                   progress: Callable[[int], None] = lambda done: None) -> dict[str, Any]:
    """
    Follow the walks of the test frames with a guided model; return a row of GEOMETRY_KEYS.

    true_depth: of frame i, (H, W) metres along the optical axis; grid: where the floor is at
    z = 0. What depends on what is not given is None.
    """
    expansion, scores = frames.expansion, _Scores()
    points = PointMaker(expansion.target, 2)
    for index, view in _follow(frames, extrapolator):
        if view.guide is not None:
            pose = frames.images.poses[index]
            _score_pose(scores, pose, view.guide)
            depth = _timed_depth(scores, view, points)
            if true_depth is not None:
                scores.depth.add(depth, true_depth(index), pose, view.guide.pose, expansion, grid)
        progress(index + 1)
    row: dict[str, Any] = dict.fromkeys(GEOMETRY_KEYS)
    return row | {
        'scene': scene, 'protocol': protocol_of(expansion),
        'camera': f'{expansion.source.width}x{expansion.source.height}', 'n_frames': len(frames),
        'pose_share': len(scores.position) / len(frames), **scores.row(),
        'commit': commit(), 'host': host()}


def _follow(frames: TruthFrames, extrapolator: FovExtrapolator
            ) -> Iterator[tuple[int, WideView]]:
    """Yield (index, wide view) of all frames in their order; anew where another walk begins."""
    path_id = None
    for index, (image, _) in enumerate(frames):
        if frames.images.path_ids[index] != path_id:
            extrapolator.reset()
        path_id = frames.images.path_ids[index]
        yield index, extrapolator.expand(image)


def _score_pose(scores: _Scores, pose: CameraPose, guide: Guide) -> None:
    moved = pose.position - guide.pose.position
    turned = rotation_vector(pose.T_world_cam[:3, :3] @ guide.pose.T_world_cam[:3, :3].T)
    scores.position.append(100 * float(np.linalg.norm(moved)))
    scores.rotation.append(float(np.degrees(np.linalg.norm(turned))))
    started = time.perf_counter()
    covariance = guide.covariance
    pose_message(_plain, _HEADER, guide.pose, covariance, 'map')
    scores.milliseconds.append((1e3 * (time.perf_counter() - started), 0.0, 0.0))
    inside = [bool(error @ np.linalg.solve(part, error) < CHI_SQUARED_95) for error, part in (
        (moved, covariance[:3, :3]), (turned, covariance[3:, 3:]))]
    scores.covered.append((inside[0], inside[1]))


def _timed_depth(scores: _Scores, view: WideView, points: PointMaker) -> np.ndarray:
    assert view.guide is not None
    started = time.perf_counter()
    depth = view.guide.trusted_depth(view.wide_image, view.confidence)
    depth_fields(depth)
    made = time.perf_counter()
    points.fields(_plain, depth, view.wide_image, view.confidence)
    done = time.perf_counter()
    scores.milliseconds[-1] = (scores.milliseconds[-1][0], 1e3 * (made - started),
                               1e3 * (done - started))
    return depth


def _without(cells: np.ndarray, others: np.ndarray) -> np.ndarray:
    """Return the cells (N, 2) that are not among others (M, 2)."""
    key, other = (one[:, 0] * (1 << 32) + one[:, 1] for one in (cells, others))
    rest: np.ndarray = cells[~np.isin(key, other)]
    return rest


def _plain(msgtype: str, **fields: Any) -> Any:
    return SimpleNamespace(**fields)


_HEADER = SimpleNamespace(stamp=None)
