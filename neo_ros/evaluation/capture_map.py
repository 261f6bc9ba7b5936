"""A capture from above: where the cameras stood, where they looked, where the robot can be."""
import cv2
from neo_ros.evaluation.capture_measures import CaptureMeasures
from neo_ros.scenes.walkable import WalkableMap
import numpy as np

_PAPER, _FLOOR, _GRID, _INK = (255, 255, 255), (226, 236, 228), (214, 218, 224), (70, 74, 82)
_SIDE, _MARGIN, _LOOK = 800, 48, 14


def draw_map(measures: CaptureMeasures, walkable: WalkableMap | None) -> np.ndarray:
    """
    Draw the capture from above (world x to the right, y up), RGB uint8.

    A dot and a tick in the viewing direction for every photo, coloured by how much of the wide
    view was seen there, red (little) to green (all); walkable floor is shaded; lines are 1, 2, 5,
    ... metres apart.
    """
    positions = measures.photos.T_world_cam[:, :2, 3]
    corners = [positions.min(0), positions.max(0)]
    if walkable is not None:
        centres = walkable.centres()
        corners = [np.minimum(corners[0], centres.min(0)), np.maximum(corners[1], centres.max(0))]
    low, high = corners[0] - 0.3, corners[1] + 0.3
    scale = (_SIDE - 2 * _MARGIN) / float((high - low).max())
    width, height = ((high - low) * scale).round().astype(int) + 2 * _MARGIN
    image = np.full((height, width, 3), _PAPER, np.uint8)

    def place(xy: np.ndarray) -> tuple[int, int]:
        across, up = (np.asarray(xy) - low) * scale + _MARGIN
        return round(float(across)), round(float(height - up))

    if walkable is not None:
        half = walkable.resolution / 2
        for centre in centres:
            left, bottom = place(centre - half)
            right, top = place(centre + half)
            cv2.rectangle(image, (left, top), (right, bottom), _FLOOR, -1)
    _draw_grid(image, low, high, place)
    seen = measures.wide_seen.mean(axis=(1, 2))
    nearest = np.searchsorted(measures.viewed, np.arange(len(positions))).clip(0, len(seen) - 1)
    for index, pose in enumerate(measures.photos.poses):
        share = float(seen[nearest[index]])
        colour = (round(215 * (1 - share) + 15), round(150 * share + 30), 60)
        start = place(pose.position[:2])
        ahead = pose.forward[:2] * (_LOOK, -_LOOK)
        end = (start[0] + round(float(ahead[0])), start[1] + round(float(ahead[1])))
        cv2.line(image, start, end, colour, 1, cv2.LINE_AA)
        cv2.circle(image, start, 3, colour, -1, cv2.LINE_AA)
    return image


def _draw_grid(image: np.ndarray, low: np.ndarray, high: np.ndarray, place: object) -> None:
    assert callable(place)
    extent = float((high - low).max())
    step = next(factor for power in range(-3, 6) for factor in (
        10.0 ** power, 2 * 10.0 ** power, 5 * 10.0 ** power) if extent / factor <= 12)
    height, width = image.shape[:2]
    for axis in (0, 1):
        for value in np.arange(np.ceil(low[axis] / step), high[axis] / step) * step:
            point = low.copy()
            point[axis] = value
            x, y = place(point)
            ends = ((x, 0), (x, height)) if axis == 0 else ((0, y), (width, y))
            cv2.line(image, ends[0], ends[1], _GRID, 1)
            at = (x + 3, height - 8) if axis == 0 else (4, y - 4)
            cv2.putText(image, f'{value:g}', at, cv2.FONT_HERSHEY_SIMPLEX, 0.42, _INK, 1,
                        cv2.LINE_AA)
