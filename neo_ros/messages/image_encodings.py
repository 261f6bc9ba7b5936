"""The one table of how pixels lie in a `sensor_msgs/Image`, and how they become RGB."""
from collections.abc import Callable
from typing import NamedTuple

import cv2
import numpy as np

RGB8 = 'rgb8'
MONO8 = 'mono8'
# Nothing but depth is published under this name on purpose; it is grey only where that is asked.
DEPTH = '16UC1'
# OpenCV's demosaicing leaves images of fewer than 3 rows or columns black.
MIN_BAYER_SIDE = 3


class Encoding(NamedTuple):
    """
    How one encoding lies in memory and becomes RGB.

    sample           bytes of a sample, 1 or 2
    channels         samples of a pixel in a row
    planes           rows in memory = planes * height / 2: colour below the luminance, where > 2
    even             pixels that share a colour (across, down): sizes are multiples of these
    smallest         least width and height
    to_rgb           from (rows, width[, channels]) uint8 or uint16 to (H, W, 3) of that type
    """

    sample: int
    channels: int
    to_rgb: Callable[[np.ndarray], np.ndarray]
    planes: int = 2
    even: tuple[int, int] = (1, 1)
    smallest: int = 1


def to_8_bit(image: np.ndarray) -> np.ndarray:
    """
    Return uint8 of uint8 or uint16: full scale stays full scale, 65535 becomes 255.

    The rule for every 16-bit image, whatever bits its sensor fills; values are rounded.
    """
    return image if image.dtype == np.uint8 else cv2.convertScaleAbs(image, alpha=1 / 257)


def _convert(code: int) -> Callable[[np.ndarray], np.ndarray]:
    return lambda image: cv2.cvtColor(image, code)


def _nv24_to_rgb(image: np.ndarray) -> np.ndarray:
    """Make each pixel a pair of YUY2 of one colour: OpenCV knows no nv24."""
    height, width = image.shape[0] // 3, image.shape[1]
    colour = image[height:].reshape(height, width, 2)
    pairs = np.empty((height, 2 * width, 2), np.uint8)
    pairs[..., 0] = np.repeat(image[:height], 2, axis=1)
    pairs[..., 1] = colour.reshape(height, 2 * width)
    return np.ascontiguousarray(cv2.cvtColor(pairs, cv2.COLOR_YUV2RGB_YUY2)[:, ::2])


def _colours(order: str, code: int | None) -> dict[str, Encoding]:
    to_rgb = (lambda image: image) if code is None else _convert(code)
    return {f'{order}{8 * size}': Encoding(size, len(order), to_rgb) for size in (1, 2)}


def _bayer(pattern: str, code: int) -> dict[str, Encoding]:
    return {f'bayer_{pattern}{8 * size}': Encoding(
        size, 1, _convert(code), smallest=MIN_BAYER_SIDE) for size in (1, 2)}


_GREY = _convert(cv2.COLOR_GRAY2RGB)
_UYVY = Encoding(1, 2, _convert(cv2.COLOR_YUV2RGB_UYVY), even=(2, 1))
_YUYV = Encoding(1, 2, _convert(cv2.COLOR_YUV2RGB_YUY2), even=(2, 1))
# ROS names a Bayer pattern by its first row pair from the top-left pixel. OpenCV's classic names
# (BayerBG = rggb) start at the second row and column; its newer aliases spell the pattern as ROS.
ENCODINGS = {
    **_colours('rgb', None),
    **_colours('bgr', cv2.COLOR_BGR2RGB),
    **_colours('rgba', cv2.COLOR_RGBA2RGB),
    **_colours('bgra', cv2.COLOR_BGRA2RGB),
    MONO8: Encoding(1, 1, _GREY),
    'mono16': Encoding(2, 1, _GREY),
    # The channels of the OpenCV types have the order that OpenCV gives them.
    '8UC1': Encoding(1, 1, _GREY),
    '8UC3': Encoding(1, 3, _convert(cv2.COLOR_BGR2RGB)),
    '8UC4': Encoding(1, 4, _convert(cv2.COLOR_BGRA2RGB)),
    DEPTH: Encoding(2, 1, _GREY),
    **_bayer('rggb', cv2.COLOR_BayerRGGB2RGB),
    **_bayer('bggr', cv2.COLOR_BayerBGGR2RGB),
    **_bayer('gbrg', cv2.COLOR_BayerGBRG2RGB),
    **_bayer('grbg', cv2.COLOR_BayerGRBG2RGB),
    'yuv422': _UYVY,
    'uyvy': _UYVY,
    'yuv422_yuy2': _YUYV,
    'yuyv': _YUYV,
    'nv12': Encoding(1, 1, _convert(cv2.COLOR_YUV2RGB_NV12), planes=3, even=(2, 2)),
    'nv21': Encoding(1, 1, _convert(cv2.COLOR_YUV2RGB_NV21), planes=3, even=(2, 2)),
    'nv24': Encoding(1, 1, _nv24_to_rgb, planes=6),
}
