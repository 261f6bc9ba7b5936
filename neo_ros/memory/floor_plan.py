"""The scene from above, drawn from the keyframes of its memory."""
from collections.abc import Sequence
from dataclasses import dataclass
import math
from typing import NamedTuple

import cv2
from neo_ros.errors import ModelError
from neo_ros.memory.floor_kernels import stack_points
from neo_ros.memory.scene_memory import SceneMemory
import numpy as np

# One of so many rows and columns of the keyframes tells how far the scene reaches.
SAMPLED = 4
EVERY = (slice(None, None, SAMPLED), slice(None, None, SAMPLED))
# The focal length of a view for which textures are made as small as they can be.
COARSEST = 0.0


@dataclass(frozen=True)
class PlanThresholds:
    """What of the scene is drawn, and how finely."""

    # All that is higher above the floor is left out: ceiling, lamps, lintels of doors. Of low
    # rooms, or of scenes whose scale nobody knows, this share of their height.
    most_height: float = 1.8
    height_share: float = 0.7
    # The longer side has at most so many cells, and a cell so many points on average; its edge is
    # 1, 2 or 5 times a power of ten.
    most_cells: int = 640
    points_a_cell: float = 6.0
    # Layers above the floor; the highest one is drawn that has this share of a cell's points.
    layers: int = 14
    least_share: float = 0.03
    # Cells with fewer points than this share of the median are noise, or seen through a window,
    # except where others surround them.
    least_points: float = 0.4
    # Gaps are closed where so many cells of the square of 5 around them are known, twice.
    around: int = 13
    # Rows of the keyframes, from below and from above, that show floor and ceiling, and the
    # quantile of their heights.
    edge_rows: float = 0.25
    edge_quantile: float = 0.2
    # Share of the points that may lie outside of the plan at each side: what windows show.
    outside: float = 0.005


@dataclass(frozen=True, eq=False)
class FloorPlan:
    """
    A picture of the scene from above, in the scene's axes.

    image uint8 RGBA (H, W, 4), transparent where nothing is known; the first row lies at the
    largest y. height float32 (H, W), z of what is drawn, metres, NaN = unknown. resolution:
    metres a pixel; origin: x and y of the image's lower left corner, as of map_server's maps.
    """

    image: np.ndarray
    height: np.ndarray
    resolution: float
    origin: tuple[float, float]

    def pixel(self, x: float, y: float) -> tuple[float, float]:
        """Return column and row of a place, pixel centres at whole numbers and a half."""
        return ((x - self.origin[0]) / self.resolution,
                self.image.shape[0] - (y - self.origin[1]) / self.resolution)


class FirstLook(NamedTuple):
    """
    What tells how far a scene reaches: z of points below and above of some keyframes, metres.

    keyframes: of each its position (3,) and depth float32 (h / SAMPLED, w / SAMPLED).
    """

    lowest: list[np.ndarray]
    highest: list[np.ndarray]
    keyframes: list[tuple[np.ndarray, np.ndarray]]


def draw_floor_plan(memory: SceneMemory, arbitrary_scale: bool = False,
                    thresholds: PlanThresholds = PlanThresholds()) -> FloorPlan:
    """
    Look at the scene from above, without its ceiling: of each place the highest colour.

    With an arbitrary scale the height is a share of the room's. Needs a second for a flat, longer
    the more was learnt. Raises ModelError where the memory shows no floor: the camera saw only
    what is above it.
    """
    limits = thresholds
    rays = memory.band.rays(*next(memory.each(COARSEST, changed=False)).depth.shape)
    # All are decoded twice, one after the other: those of a building take a GB.
    seen = _look_first(memory, rays[..., 2], limits)
    floor, top = _floor_and_top(seen, arbitrary_scale, limits)
    low, high, points = _extent(seen.keyframes, rays, floor, top, limits)
    resolution = _round_up(max(
        float((high - low).max()) / limits.most_cells,
        math.sqrt(float(np.prod(high - low)) * limits.points_a_cell / points)))
    # On whole cells of the scene's axes.
    first = np.floor(low / resolution).astype(int)
    width, height = np.ceil(high / resolution).astype(int) - first
    step = (top - floor) / limits.layers
    corner = np.array([*(first * resolution), floor - step / 2])
    sums = np.zeros((limits.layers, height, width, 4), np.float32)
    for keyframe in memory.each(COARSEST):
        depth = keyframe.depth
        colours = cv2.resize(keyframe.texture, depth.shape[::-1], interpolation=cv2.INTER_AREA)
        stack_points(rays, depth, colours, keyframe.position, corner, 1 / resolution, 1 / step,
                     sums)
    image, z = _closed(*_seen_from_above(sums, floor, step, limits), limits.around)
    rows, columns = (np.flatnonzero(image[..., 3].any(axis)) for axis in (1, 0))
    if not len(rows):
        raise _no_floor()
    bottom, left = int(rows[0]), int(columns[0])
    shown = (slice(bottom, rows[-1] + 1), slice(left, columns[-1] + 1))
    return FloorPlan(image[shown][::-1].copy(), z[shown][::-1].copy(), resolution,
                     (float(corner[0] + left * resolution),
                      float(corner[1] + bottom * resolution)))


def encode_plan(plan: FloorPlan, quality: int = 80) -> bytes:
    """Return the picture as WebP."""
    done, coded = cv2.imencode('.webp', cv2.cvtColor(plan.image, cv2.COLOR_RGBA2BGRA),
                               [cv2.IMWRITE_WEBP_QUALITY, quality])
    assert done
    return coded.tobytes()


def _look_first(memory: SceneMemory, rise: np.ndarray, limits: PlanThresholds) -> FirstLook:
    """
    Keep what `_floor_and_top` and `_extent` need; rise (h, w): z of unit rays.

    As the memory was made: how far a scene reaches is not learnt.
    """
    seen = FirstLook([], [], [])
    some = max(len(memory.positions) // 32, 1)
    rows = max(int(limits.edge_rows * len(rise)), 1)
    for index, keyframe in enumerate(memory.each(COARSEST, changed=False)):
        depth, position = keyframe.depth, keyframe.position
        seen.keyframes.append((position, depth[EVERY].copy()))
        if index % some == 0:
            z, known = position[2] + rise * depth, depth > 0
            seen.lowest.append(z[-rows:][known[-rows:]])
            seen.highest.append(z[:rows][known[:rows]])
    return seen


def _floor_and_top(seen: FirstLook, arbitrary_scale: bool, limits: PlanThresholds
                   ) -> tuple[float, float]:
    """Return z of the floor, and up to where things are drawn."""
    edges = np.concatenate(seen.lowest), np.concatenate(seen.highest)
    if not min(map(len, edges)):
        raise _no_floor()
    floor, ceiling = (float(np.quantile(heights, quantile)) for heights, quantile in zip(
        edges, (limits.edge_quantile, 1 - limits.edge_quantile)))
    # Above the camera it is a ceiling.
    if floor >= min(ceiling, max(float(position[2]) for position, _ in seen.keyframes)):
        raise _no_floor()
    share = limits.height_share * (ceiling - floor)
    return floor, floor + (share if arbitrary_scale else min(share, limits.most_height))


def _extent(keyframes: Sequence[tuple[np.ndarray, np.ndarray]], rays: np.ndarray, floor: float,
            top: float, limits: PlanThresholds) -> tuple[np.ndarray, np.ndarray, int]:
    """Return smallest and largest x, y of what is drawn, (2,) metres, and how many points are."""
    places = []
    for position, depth in keyframes:
        points = (rays[EVERY] * depth[..., None] + position)[depth > 0]
        drawn = (points[:, 2] > floor - 0.1 * (top - floor)) & (points[:, 2] < top)
        places.append(points[drawn, :2])
    found = np.concatenate(places)
    if not len(found):
        raise _no_floor()
    low, high = np.quantile(found, (limits.outside, 1 - limits.outside), axis=0,
                            overwrite_input=True)
    if not (low < high).all():
        raise _no_floor()
    return low, high, len(found) * SAMPLED ** 2


def _no_floor() -> ModelError:
    return ModelError('the memory shows no floor: the camera saw only what is above it; train '
                      'with photos that show the floor')


def _seen_from_above(sums: np.ndarray, floor: float, step: float, limits: PlanThresholds
                     ) -> tuple[np.ndarray, np.ndarray]:
    """Return image RGBA and height of the highest layer that has enough points."""
    counts = sums[..., 3]
    total = counts.sum(0)
    seen = _inside(total >= limits.least_points * np.median(total[total > 0])) & (total > 0)
    enough = seen & (counts >= np.maximum(limits.least_share * total, 1))
    highest = len(sums) - 1 - np.argmax(enough[::-1], axis=0)
    chosen = np.take_along_axis(sums, highest[None, ..., None], axis=0)[0]
    known = enough.any(0)
    image = np.zeros((*known.shape, 4), np.uint8)
    image[..., :3] = chosen[..., :3] / np.maximum(chosen[..., 3:], 1) + 0.5
    image[..., 3] = np.where(known, 255, 0)
    height = np.where(known, floor + step * highest, np.nan).astype(np.float32)
    return image, height


def _inside(known: np.ndarray) -> np.ndarray:
    """Return what is known, bool (H, W), without small pieces, and what that surrounds."""
    _, labels, found, _ = cv2.connectedComponentsWithStats(known.astype(np.uint8))
    found[0, cv2.CC_STAT_AREA] = 0  # What is not known.
    known = known & (found[:, cv2.CC_STAT_AREA] > 0.01 * known.sum())[labels]
    _, labels = cv2.connectedComponents(np.pad(~known, 1, constant_values=True).astype(np.uint8),
                                        connectivity=4)
    return np.asarray(labels[1:-1, 1:-1] != labels[0, 0])


def _closed(image: np.ndarray, height: np.ndarray, around: int
            ) -> tuple[np.ndarray, np.ndarray]:
    """Close small gaps with the mean of what is around them."""
    known = image[..., 3] > 0
    layers = np.dstack([image[..., :3], np.nan_to_num(height), known]).astype(np.float32)
    for _ in range(2):
        total = cv2.boxFilter(layers, -1, (5, 5), normalize=False, borderType=cv2.BORDER_CONSTANT)
        gap = (layers[..., 4] == 0) & (total[..., 4] > around - 0.5)
        layers[gap] = total[gap] / total[gap][:, 4:]
    known = layers[..., 4] > 0
    closed = np.dstack([layers[..., :3] + 0.5, np.where(known, 255, 0)]).astype(np.uint8)
    closed[~known] = 0
    return closed, np.where(known, layers[..., 3], np.float32(np.nan))


def _round_up(edge: float) -> float:
    """Return the next length of 1, 2 or 5 times a power of ten."""
    power = 10.0 ** math.floor(math.log10(edge))
    return next(power * times for times in (1, 2, 5, 10) if power * times >= edge)
