"""Depth maps as files: 16-bit PNG, millimetres along the optical axis, 0 = unknown (REP-118)."""
from pathlib import Path

import cv2
from neo_ros.errors import SceneError
from neo_ros.machine.files import write_bytes
import numpy as np

MM_PER_M = 1000.0
# 65.535 m: what the 16 bits of a file hold.
MOST_MM = 65535


def to_millimetres(depth: np.ndarray) -> np.ndarray:
    """Return uint16 (H, W) millimetres, 0 = unknown, of metres; NaN, inf, <= 0 are unknown."""
    known = np.isfinite(depth) & (depth > 0) & (depth * MM_PER_M < MOST_MM + 0.5)
    return np.where(known, np.rint(np.where(known, depth, 0) * MM_PER_M), 0).astype(np.uint16)


def encode_depth(millimetres: np.ndarray) -> bytes:
    """Return the PNG of uint16 (H, W) millimetres."""
    return cv2.imencode('.png', millimetres)[1].tobytes()


def write_depth(path: Path, millimetres: np.ndarray) -> None:
    """Write uint16 (H, W) millimetres; raises NeoError where the file cannot be written."""
    write_bytes(path, encode_depth(millimetres))


def read_depth(path: Path, width: int, height: int) -> np.ndarray:
    """
    Read uint16 (height, width) millimetres; a map of another size takes the nearest pixels.

    Depth of two surfaces must not be averaged. Raises SceneError for what is no 16-bit picture
    of one channel.
    """
    found = read_numbers(path)
    if found is None:
        raise SceneError(f'{path}: expected a depth map, there is no picture that can be read')
    if found.dtype != np.uint16 or found.ndim != 2:
        raise SceneError(f'{path}: expected a depth map, 16-bit PNG of one channel, '
                         f'millimetres; got {found.dtype} {found.shape}')
    return nearest(found, width, height)


def read_numbers(path: Path) -> np.ndarray | None:
    """
    Return the numbers of a picture's file as they are stored; None if it cannot be read.

    EXR needs the extra `record3d`; its one channel, or the first of Z, R and Y, is float32.
    """
    if path.suffix.lower() == '.exr':
        return _read_exr(path)
    try:
        data = np.fromfile(path, np.uint8)
        return cv2.imdecode(data, cv2.IMREAD_UNCHANGED) if len(data) else None
    except (OSError, cv2.error):
        return None


def _read_exr(path: Path) -> np.ndarray | None:
    # Built without it is the OpenCV that is on PyPI.
    try:
        import OpenEXR
        channels = OpenEXR.File(str(path), separate_channels=True).channels()
    except (ImportError, RuntimeError, ValueError):
        return None
    name = next((name for name in ('Z', 'R', 'Y', *channels) if name in channels), None)
    return None if name is None else channels[name].pixels.astype(np.float32)


def nearest(numbers: np.ndarray, width: int, height: int) -> np.ndarray:
    """Return the nearest of the pixels (h, w) at (height, width): no number is a new one."""
    if numbers.shape == (height, width):
        return numbers
    # INTER_NEAREST takes the upper left one of those that a pixel covers.
    return cv2.resize(numbers, (width, height), interpolation=cv2.INTER_NEAREST_EXACT)
