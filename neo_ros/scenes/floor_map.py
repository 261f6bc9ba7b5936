"""
Floor maps from elsewhere as walkable maps: ROS map_server's YAML with its image, and masks.

Free floor is what the map says is free. What is occupied, unknown or off the map is not.
"""
import logging
import math
from pathlib import Path
import re
from typing import Any

import cv2
from neo_ros.errors import SceneError
from neo_ros.scenes.walkable import read_number, WalkableMap
import numpy as np
import yaml

logger = logging.getLogger(__name__)
# Occupancy of the grey that map savers write for unknown floor.
UNKNOWN = 50 / 255
MODES = ('trinary', 'scale', 'raw')
# Of a PGM or PPM with binary pixels: width, height and the value of white, which OpenCV overlooks.
BINARY_HEADER = re.compile(rb'P[56]' + 3 * rb'(?:\s|#[^\n]*\n)+([1-9]\d*)')


def read_map_server(path: Path, camera_height: float) -> WalkableMap:
    """
    Read the YAML file of a map_server map: image (PGM, PNG), resolution, origin, thresholds.

    Image row 0 lies at the largest y; `origin` is (x, y, yaw) of the lower left corner, and the
    map is turned about that corner. Occupancy is (255 - value) / 255, with `negate` value / 255;
    cells below `free_thresh` are free. In mode raw, values up to 100 are percent of occupancy.
    """
    try:
        document: Any = yaml.safe_load(path.read_text())
    except (OSError, UnicodeDecodeError, yaml.YAMLError) as error:
        raise SceneError(f'{path}: expected the YAML file of a map: {error}') from error
    if not isinstance(document, dict):
        raise SceneError(f'{path}: expected the YAML file of a map (image, resolution, origin, '
                         f'negate, occupied_thresh, free_thresh), got {document!r:.60}')
    try:
        free = read_number(document, 'free_thresh')
        occupied = read_number(document, 'occupied_thresh')
        resolution = read_number(document, 'resolution')
        negate = read_number(document, 'negate') != 0
        origin = _read_origin(document['origin'])
        image_path = path.parent / str(document['image'])
    except KeyError as error:
        raise SceneError(f'{path}: expected the key {error}') from error
    except SceneError as error:
        raise SceneError(f'{path}: {error}') from error
    mode = str(document.get('mode', 'trinary')).lower()
    if mode not in MODES:
        raise SceneError(f'{path}: mode: expected {", ".join(MODES)}, got {mode!r}')
    if not 0 <= free <= occupied <= 1:
        raise SceneError(f'{path}: expected 0 <= free_thresh <= occupied_thresh <= 1, got '
                         f'{free} and {occupied}')
    image = _read_image(image_path)
    occupancy, known = _occupancy(image, mode, negate)
    if mode != 'raw' and not negate and free > UNKNOWN and (image[..., 0] == 205 / 255).any():
        logger.warning('%s: grey 205, which map savers write for unknown floor, counts as free '
                       'with free_thresh %s; 0.196 excludes it', path, free)
    return _placed(path, (occupancy < free) & known, resolution, origin, camera_height)


def read_floor_mask(path: Path, resolution: float, origin: tuple[float, float, float],
                    camera_height: float) -> WalkableMap:
    """Read an image whose bright pixels (from 128 of 255) are free floor; seen from above."""
    bright = _read_image(path)[..., :3].mean(axis=-1) >= 0.5
    return _placed(path, bright, resolution, origin, camera_height)


def place_floor(free: np.ndarray, resolution: float, origin: tuple[float, float, float],
                camera_height: float) -> WalkableMap:
    """
    Lay a picture of free floor, bool (rows, columns) with y up, into the world.

    `origin` is (x, y, yaw) of its lower left corner, metres and radians. A turned picture is
    looked up at the cells of a grid along the world's axes. No clearance is taken off.
    """
    x, y, yaw = origin
    if not (math.isfinite(yaw) and math.isfinite(x) and math.isfinite(y)):
        raise SceneError(f'origin: expected finite x, y and yaw, got {origin}')
    if not (math.isfinite(resolution) and resolution > 0):
        raise SceneError(f'resolution: expected metres per pixel > 0, got {resolution}')
    cells = free[::-1]
    if abs(math.remainder(yaw, 2 * math.pi)) > 1e-9:
        rows, columns = cells.shape
        R = np.array([[math.cos(yaw), -math.sin(yaw)], [math.sin(yaw), math.cos(yaw)]])
        corners = resolution * np.array(
            [[0, 0], [columns, 0], [0, rows], [columns, rows]]) @ R.T + (x, y)
        low = corners.min(0)
        width, height = np.ceil(np.ptp(corners, axis=0) / resolution - 1e-9).astype(int)
        i, j = np.meshgrid(np.arange(width), np.arange(height))
        centres = low + resolution * (np.stack([i, j], axis=-1) + 0.5)
        index = np.floor((centres - (x, y)) @ R / resolution).astype(int)
        inside = ((index >= 0) & (index < (columns, rows))).all(-1)
        turned = np.zeros((height, width), bool)
        turned[inside] = cells[index[inside][:, 1], index[inside][:, 0]]
        cells, (x, y) = turned, low
    return WalkableMap(resolution, (float(x), float(y)), cells, camera_height, clearance=0.0)


def _placed(path: Path, free: np.ndarray, resolution: float,
            origin: tuple[float, float, float], camera_height: float) -> WalkableMap:
    try:
        return place_floor(free, resolution, origin, camera_height)
    except SceneError as error:
        raise SceneError(f'{path}: {error}') from error


def _read_origin(origin: Any) -> tuple[float, float, float]:
    """Return x, y and yaw; a map may leave out the yaw."""
    try:
        x, y, yaw = (float(value) for value in (*origin, 0.0)[:max(len(origin), 3)])
    except (TypeError, ValueError, OverflowError) as error:
        raise SceneError(f'origin: expected [x, y, yaw], got {origin!r:.60}') from error
    return x, y, yaw


def _read_image(path: Path) -> np.ndarray:
    """Read an image as float64 (H, W, 3 or 4) in [0, 1], BGR and perhaps opacity."""
    try:
        data = path.read_bytes()
    except OSError as error:
        raise SceneError(f'{path}: expected an image of a floor: {error.strerror}; is the path '
                         'right, relative to the YAML file?') from error
    try:
        image = cv2.imdecode(np.frombuffer(data, np.uint8), cv2.IMREAD_UNCHANGED)
    except cv2.error:  # An empty file.
        image = None
    if image is None:
        raise SceneError(f'{path}: expected a readable image of a floor (PGM, PNG), got one that '
                         'is cut off or of another kind; save it again')
    header = BINARY_HEADER.match(data)
    white = int(header[3]) if header else 65535 if image.dtype == np.uint16 else 255
    image = image.astype(np.float64) / white
    return np.repeat(image[..., None], 3, axis=-1) if image.ndim == 2 else image


def _occupancy(image: np.ndarray, mode: str, negate: bool) -> tuple[np.ndarray, np.ndarray]:
    """Return occupancy in [0, 1] and where it is known; as map_server does with opacity."""
    known = np.ones(image.shape[:2], bool)
    if mode == 'trinary':
        shade = image.mean(axis=-1)
    else:
        shade = image[..., :3].mean(axis=-1)
        if mode == 'scale' and image.shape[-1] == 4:
            known = image[..., 3] == 1
    if mode == 'raw':
        percent = np.round(255 * shade)
        return percent / 100, percent <= 100
    return (shade if negate else 1 - shade), known
