"""
`sensor_msgs/CameraInfo` to `Intrinsics` and back.

CameraInfo counts pixel centres from 0, `Intrinsics` has them at +0.5: cx_ros = cx - 0.5, here
and nowhere else.
"""
import math
import re
from types import SimpleNamespace
from typing import Any

from neo_ros.errors import GeometryError, ImageRejected
from neo_ros.geometry import Intrinsics, ViewExpansion
from neo_ros.geometry.lens import CENTRE, COUNTS, FISHEYE_COUNTS, Lens
import numpy as np

# Indices into the row-major 3x3 K and 3x4 P: fx, skew, cx (and Tx); fy, cy (and Ty).
K_COLUMNS = 3
P_COLUMNS = 4
FISHEYE = 'equidistant'
# Distortion models of ROS and how many coefficients they may have.
DISTORTION_MODELS = {
    'plumb_bob': COUNTS, 'rational_polynomial': COUNTS, FISHEYE: FISHEYE_COUNTS}
# A word of its own: image_rect_color and /rectified/image are meant, /direct/image is not.
RECTIFIED_TOPIC = re.compile(r'(^|[/_])rect(ified)?([/_]|$)')
# What is read of a CameraInfo besides its matrices.
INFO_FIELDS = ('width', 'height', 'binning_x', 'binning_y', 'roi')


def camera_info_of(message: Any, image_topic: str) -> Any:
    """
    Return what a `sensor_msgs/CameraInfo` says of the images on a topic, by its full name.

    image_proc's image_rect has the camera_info of the raw images beside it. Images of a topic
    with the word rect or rectified in its name are straight and turned already: their K is in P,
    where P is not all zero, and D and R are done with. Of other topics the message stays as it
    is. Checks nothing, so that it may be called where nothing may be raised.
    """
    if not RECTIFIED_TOPIC.search(image_topic):
        return message
    p = np.asarray(message.p)
    k = [*p[0:3], *p[4:7], *p[8:11]] if p.any() else message.k
    return SimpleNamespace(
        **{name: getattr(message, name) for name in INFO_FIELDS}, distortion_model='plumb_bob',
        d=np.zeros(5), k=k, r=np.eye(3).reshape(-1), p=p)


def read_camera_info(message: Any, distorted: bool = False) -> Intrinsics:
    """
    Return the camera of a `sensor_msgs/CameraInfo`, of the image as it is sent.

    With `distorted` a camera with distortion passes, too: the result is its pinhole part.

    `message` is anything with the fields of the ROS message. ROI and binning are folded in:
    K describes the full sensor, the result the cut and binned image. Binned pixels are taken
    as the mean of their neighbourhood, so corners keep their place (REP 104).

    Raises ImageRejected('camera_info') for an uncalibrated camera (K[0] = 0), values that are
    not finite, distortion, and windows outside the sensor.
    """
    if not distorted:
        _refuse_distortion(message)
    return _fold_window(message, read_matrix(message.k, 'k', 9), K_COLUMNS)[0]


def read_lens(message: Any) -> Lens:
    """
    Return the camera of a `sensor_msgs/CameraInfo` with its distortion, ROI and binning folded in.

    Zeros behind the coefficients of a model are no fault; without distortion it is a pinhole
    camera, whatever its model.
    Raises ImageRejected('camera_info') as `read_camera_info` does for a distorted camera, and for
    models other than plumb_bob, rational_polynomial and equidistant, and a wrong number of
    coefficients.
    """
    intrinsics = read_camera_info(message, distorted=True)
    values = np.array(message.d, np.float64).reshape(-1)
    name = message.distortion_model
    if not values.any():  # NaN counts as any
        return Lens(intrinsics)
    count = max((n for n in DISTORTION_MODELS.get(name, ()) if n <= values.size), default=None)
    if count is None or values[count:].any() or not np.isfinite(values).all():
        expected = '; '.join(f'{" or ".join(map(str, counts))} of {model}'
                             for model, counts in DISTORTION_MODELS.items())
        raise _rejected(f'd: expected finite coefficients, and zeros behind them: {expected}; '
                        f'got {values.tolist()!s:.200} ({name!r:.40}); take image_rect of '
                        'image_proc')
    return Lens(intrinsics, tuple(values[:count].tolist()), name == FISHEYE)


def expand_camera_info(message: Any, expansion: ViewExpansion) -> dict[str, Any]:
    """
    Return the `CameraInfo` fields below the header of the wide view of this camera.

    cx and cy grow by `left` and `top` in K and P; fx, fy, R, P[3] and P[7] stay those of the
    image as it is sent (ROI and binning of the input folded in, and zero in the output). The
    size is the wide one and D is zero. A P that is all zero is filled from K.

    Raises ImageRejected('camera_info') as `read_camera_info` does, and where the image's size
    is not the one of `expansion.source`.
    """
    _refuse_distortion(message)
    camera, k = _fold_window(message, read_matrix(message.k, 'k', 9), K_COLUMNS)
    source = expansion.source
    if (camera.width, camera.height) != (source.width, source.height):
        raise _rejected(f'size: expected {source.width}x{source.height}, '
                        f'got {camera.width}x{camera.height}')
    p = read_matrix(message.p, 'p', 12)
    if p.any():
        p = _fold_window(message, p, P_COLUMNS, 'p')[1]
    else:
        p = np.hstack([k.reshape(3, 3), np.zeros((3, 1))]).reshape(-1)
    for matrix, columns in ((k, K_COLUMNS), (p, P_COLUMNS)):
        matrix[2] += expansion.left
        matrix[columns + 2] += expansion.top
    target = expansion.target
    fields = _fields(target.width, target.height, k, p)
    return fields | {'r': read_matrix(message.r, 'r', 9)}


def camera_info_fields(intrinsics: Intrinsics) -> dict[str, Any]:
    """
    Return the `CameraInfo` fields below the header of a camera without distortion.

    `k`, `r` (identity) are float64 (9,), `p` is float64 (12,), `d` is float64 (5,) of zeros.
    """
    k = intrinsics.matrix
    k[:2, 2] -= CENTRE
    p = np.hstack([k, np.zeros((3, 1))])
    return _fields(intrinsics.width, intrinsics.height, k.reshape(-1), p.reshape(-1))


def is_same_camera(found: Intrinsics, expected: Intrinsics, tolerance: float = 0.01) -> bool:
    """
    Say whether `found` is the camera that the model was trained for.

    Sizes must agree exactly, focal lengths within `tolerance` of their value, the optical
    centre within `tolerance` of the image's size.
    """
    return (
        (found.width, found.height) == (expected.width, expected.height)
        and abs(found.fx - expected.fx) <= tolerance * expected.fx
        and abs(found.fy - expected.fy) <= tolerance * expected.fy
        and abs(found.cx - expected.cx) <= tolerance * expected.width
        and abs(found.cy - expected.cy) <= tolerance * expected.height)


def read_matrix(values: Any, name: str, count: int) -> np.ndarray:
    """Return a float64 copy of a matrix field, (count,); raises ImageRejected('camera_info')."""
    matrix = np.array(values, np.float64).reshape(-1)
    if matrix.size != count or not np.isfinite(matrix).all():
        raise _rejected(f'{name}: expected {count} finite numbers, got {matrix.tolist()}')
    return matrix


def describe_camera(camera: Intrinsics) -> str:
    """Put a camera into words, as CameraInfo counts pixels."""
    return (f'{camera.width}x{camera.height} with hfov {math.degrees(camera.hfov):.2f} deg '
            f'(fx {camera.fx:.2f}, fy {camera.fy:.2f}, '
            f'cx {camera.cx - CENTRE:.2f}, cy {camera.cy - CENTRE:.2f})')


def _fields(width: int, height: int, k: np.ndarray, p: np.ndarray) -> dict[str, Any]:
    return {'height': height, 'width': width, 'distortion_model': 'plumb_bob',
            'd': np.zeros(5), 'k': k, 'r': np.eye(3).reshape(-1), 'p': p}


def _rejected(message: str) -> ImageRejected:
    return ImageRejected('camera_info', f'camera_info {message}')


def _refuse_distortion(message: Any) -> None:
    distortion = np.array(message.d, np.float64).reshape(-1)
    if distortion.any():  # NaN counts as any
        raise _rejected(
            f'd: rectified input required, got distortion {distortion.tolist()!s:.200} '
            f'({message.distortion_model!r:.40}); take image_rect of image_proc, or set the '
            'parameter rectify, as an option --rectify')


def _fold_window(message: Any, matrix: np.ndarray, columns: int,
                 name: str = 'k') -> tuple[Intrinsics, np.ndarray]:
    """
    Fold ROI and binning into K (columns = 3) or P (columns = 4).

    Returns the camera of the image as it is sent and the changed copy of the matrix.
    """
    row = columns  # index of the first element of the second row
    fx, fy = matrix[0], matrix[row + 1]
    if fx == 0:
        raise _rejected(f'{name}: the camera is uncalibrated ({name}[0] = 0); calibrate it, or '
                        'give no camera_info')
    roi = message.roi
    bin_x, bin_y = max(message.binning_x, 1), max(message.binning_y, 1)
    width, height = roi.width or message.width, roi.height or message.height
    if roi.x_offset + width > message.width or roi.y_offset + height > message.height:
        raise _rejected(
            f'roi: {width}x{height} at ({roi.x_offset}, {roi.y_offset}) is not inside '
            f'{message.width}x{message.height}')
    folded = matrix.copy()
    folded[:columns] /= bin_x
    folded[row:row + columns] /= bin_y
    cx = (matrix[2] + CENTRE - roi.x_offset) / bin_x
    cy = (matrix[row + 2] + CENTRE - roi.y_offset) / bin_y
    folded[2], folded[row + 2] = cx - CENTRE, cy - CENTRE
    try:
        camera = Intrinsics(width // bin_x, height // bin_y, fx / bin_x, fy / bin_y, cx, cy)
    except GeometryError as error:
        raise _rejected(f'{name}: {error}') from error
    return camera, folded
