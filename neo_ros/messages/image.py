"""`sensor_msgs/Image` to RGB arrays and back."""
from collections.abc import Callable
from typing import Any, NamedTuple

import cv2
from neo_ros.errors import ImageRejected
from neo_ros.pictures.header import MAX_PIXELS
import numpy as np

RGB8 = 'rgb8'
MONO8 = 'mono8'
# OpenCV's demosaicing leaves images of fewer than 3 rows or columns black.
MIN_BAYER_SIDE = 3


class Encoding(NamedTuple):
    """How one encoding lies in memory and becomes RGB."""

    channels: int
    to_rgb: Callable[[np.ndarray], np.ndarray]


def _convert(code: int) -> Callable[[np.ndarray], np.ndarray]:
    return lambda image: cv2.cvtColor(image, code)


# ROS names a Bayer pattern by its first row pair from the top-left pixel. OpenCV's classic names
# (BayerBG = rggb) start at the second row and column; its newer aliases spell the pattern as ROS.
ENCODINGS = {
    RGB8: Encoding(3, lambda image: image),
    'bgr8': Encoding(3, _convert(cv2.COLOR_BGR2RGB)),
    'rgba8': Encoding(4, _convert(cv2.COLOR_RGBA2RGB)),
    'bgra8': Encoding(4, _convert(cv2.COLOR_BGRA2RGB)),
    MONO8: Encoding(1, _convert(cv2.COLOR_GRAY2RGB)),
    'bayer_rggb8': Encoding(1, _convert(cv2.COLOR_BayerRGGB2RGB)),
    'bayer_bggr8': Encoding(1, _convert(cv2.COLOR_BayerBGGR2RGB)),
    'bayer_gbrg8': Encoding(1, _convert(cv2.COLOR_BayerGBRG2RGB)),
    'bayer_grbg8': Encoding(1, _convert(cv2.COLOR_BayerGRBG2RGB)),
}


def read_image(message: Any) -> np.ndarray:
    """
    Return the picture of a `sensor_msgs/Image` as RGB uint8 (H, W, 3), C-contiguous.

    `message` is anything with the fields of the ROS message. An unpadded rgb8 image is returned
    as a view of the message's data, without a copy: do not write to it. Padding at the row
    ends (`step`) is dropped. `is_bigendian` says nothing about 8-bit samples and is ignored;
    encodings of 16 bits are rejected by name.

    Raises ImageRejected with the reason 'encoding', 'size' (zero, above 64 megapixels, or a
    Bayer image below 3x3), 'step' (rows shorter than the width), 'empty' (no data) or 'data'
    (fewer bytes than step * height).
    """
    name = message.encoding
    encoding = ENCODINGS.get(name) if isinstance(name, str) else None
    if encoding is None:
        raise ImageRejected(
            'encoding', f'encoding: expected one of {", ".join(ENCODINGS)}, got {name!r:.80}')
    height, width, step = message.height, message.width, message.step
    smallest = MIN_BAYER_SIDE if name.startswith('bayer') else 1
    if min(height, width) < smallest or height * width > MAX_PIXELS:
        raise ImageRejected(
            'size', f'size: expected {smallest}x{smallest} to {MAX_PIXELS} pixels for {name}, '
            f'got {width}x{height}')
    row_bytes = width * encoding.channels
    if step < row_bytes:
        raise ImageRejected(
            'step', f'step: expected at least {row_bytes} bytes for {width} pixels of {name}, '
            f'got {step}')
    data = _as_bytes(message.data)
    if data.size == 0:
        raise ImageRejected('empty', f'data: expected {step * height} bytes, got none')
    if data.size < step * height:
        raise ImageRejected(
            'data', f'data: expected step * height = {step * height} bytes, got {data.size}')
    rows = data[:step * height].reshape(height, step)[:, :row_bytes]
    # OpenCV and the extrapolator want rows without gaps; without padding this copies nothing.
    rows = np.ascontiguousarray(rows)
    shape = (height, width) if encoding.channels == 1 else (height, width, encoding.channels)
    return encoding.to_rgb(rows.reshape(shape))


def image_fields(image: np.ndarray) -> dict[str, Any]:
    """
    Return the `sensor_msgs/Image` fields below the header of an RGB or mono picture.

    `image` is uint8, (H, W, 3) for rgb8 or (H, W) for mono8. `data` is a flat uint8 array: a
    view of `image` where its memory allows. rosbags takes it as it is; for rclpy copy it into
    an existing `array.array`, because assigning it to `msg.data` converts element by element.
    """
    if image.dtype != np.uint8 or image.ndim not in (2, 3) or image.shape[2:] not in ((), (3,)):
        raise ImageRejected(
            'encoding', 'image: expected uint8 (H, W, 3) or (H, W), '
            f'got {image.dtype} {image.shape}')
    channels = 3 if image.ndim == 3 else 1
    return {
        'height': image.shape[0],
        'width': image.shape[1],
        'encoding': RGB8 if channels == 3 else MONO8,
        'is_bigendian': 0,
        'step': image.shape[1] * channels,
        'data': np.ascontiguousarray(image).reshape(-1),
    }


def _as_bytes(data: Any) -> np.ndarray:
    """Return the data of a message as flat uint8 without copying array.array, bytes, ndarray."""
    if len(data) == 0:
        return np.empty(0, np.uint8)  # np.frombuffer refuses empty buffers
    return np.frombuffer(data, np.uint8)
