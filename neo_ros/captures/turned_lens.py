"""The calibration of photos that are shown upright, of one of the pixels as they are stored."""
from pathlib import Path

from neo_ros.errors import SceneError
from neo_ros.geometry import Intrinsics
from neo_ros.geometry.lens import Lens
import numpy as np

UPRIGHT = 1
# What EXIF says of a stored photo, and where x (right) and y (down) go when it is shown.
TURNS = {orientation: np.array(rows) for orientation, rows in (
    (UPRIGHT, ((1, 0), (0, 1))), (2, ((-1, 0), (0, 1))), (3, ((-1, 0), (0, -1))),
    (4, ((1, 0), (0, -1))), (5, ((0, 1), (1, 0))), (6, ((0, -1), (1, 0))),
    (7, ((0, -1), (-1, 0))), (8, ((0, 1), (-1, 0))))}
# OpenCV's coefficients: k1 k2 p1 p2 k3 ... k6, then those of thin prisms and of a tilted sensor.
_TANGENTIAL, _PRISM = slice(2, 4), 8
REMEDY = ('calibrate with photos as they are stored, or remove the tag from copies of the '
          'photos: exiftool -Orientation= FOLDER')


def shown_size(size: tuple[int, int], orientation: int) -> tuple[int, int]:
    """Return (width, height) of a stored image as a viewer shows it."""
    return size if TURNS[orientation][0, 0] else size[::-1]


def shown_pixels(image: np.ndarray, orientation: int) -> np.ndarray:
    """Return a stored image (H, W, 3) as a viewer shows it."""
    turn = TURNS[orientation]
    rows, columns = turn[1], turn[0]
    shown = image if rows[1] else image.transpose(1, 0, 2)
    return shown[::rows.sum(), ::columns.sum()]


def shown_lens(lens: Lens, orientation: int, camera_info: Path) -> Lens:
    """
    Return the lens of photos that are shown upright, of one of the pixels as they are stored.

    Raises SceneError for a distortion that cannot be turned.
    """
    if orientation == UPRIGHT:
        return lens
    turn, camera = TURNS[orientation], lens.intrinsics
    size = np.array([camera.width, camera.height])
    width, height = shown_size((camera.width, camera.height), orientation)
    cx, cy = turn @ (np.array([camera.cx, camera.cy]) - size / 2) + (width / 2, height / 2)
    fx, fy = abs(turn) @ (camera.fx, camera.fy)
    return Lens(Intrinsics(width, height, fx, fy, cx, cy),
                _shown_distortion(lens, turn, camera_info), lens.fisheye, lens.fisheye_view,
                lens.rim)


def _shown_distortion(lens: Lens, turn: np.ndarray, camera_info: Path) -> tuple[float, ...]:
    """Radial coefficients stay; (p2, p1) turns as a direction in the image does."""
    values = list(lens.distortion)
    if lens.fisheye or not any(values[_TANGENTIAL.start:]):
        return lens.distortion
    if any(values[_PRISM:]):
        raise SceneError(f'--camera-info {camera_info}: expected at most k1 to k6, p1 and p2 of '
                         'photos that are stored turned (EXIF), got the distortion '
                         f'{lens.distortion}; {REMEDY}')
    p1, p2 = (*values[_TANGENTIAL], 0.0)[:2]
    p2, p1 = turn @ (p2, p1)
    values[_TANGENTIAL] = [float(p1), float(p2)]
    return tuple(values)
