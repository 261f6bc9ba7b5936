"""`sensor_msgs/Image` to RGB arrays and back."""
from typing import Any

from neo_ros.errors import ImageRejected
from neo_ros.messages.image_encodings import DEPTH, Encoding, ENCODINGS, MONO8, RGB8, to_8_bit
from neo_ros.pictures.header import MAX_PIXELS
import numpy as np


def read_image(message: Any, depth_as_grey: bool = False) -> np.ndarray:
    """
    Return the picture of a `sensor_msgs/Image` as RGB uint8 (H, W, 3), C-contiguous.

    `message` is anything with the fields of the ROS message, in one of ENCODINGS. An unpadded
    rgb8 image is returned as a view of the message's data, without a copy: do not write to it.
    Padding at the row ends (`step`) is dropped. Samples of 16 bits have the order of
    `is_bigendian` and are scaled to 8 bits as `to_8_bit` does. 16UC1 is depth, and refused
    unless `depth_as_grey`.

    Raises ImageRejected with the reason 'encoding', 'size' (zero, above 64 megapixels, a Bayer
    image below 3x3, or odd where two pixels share a colour), 'step' (rows shorter than the
    width), 'empty' (no data) or 'data' (fewer bytes than step and height ask for).
    """
    name = message.encoding
    encoding = ENCODINGS.get(name) if isinstance(name, str) else None
    if name == DEPTH and not depth_as_grey:
        raise ImageRejected(
            'encoding', f'encoding: expected a colour or grey image, got {DEPTH}, which is depth; '
            'name another topic, or publish grey images as mono16')
    if encoding is None:
        raise ImageRejected(
            'encoding', f'encoding: expected one of {", ".join(ENCODINGS)}, got {name!r:.80}')
    rows = _rows(message, encoding)
    samples = rows if encoding.sample == 1 else rows.view(
        '>u2' if message.is_bigendian else '<u2').astype(np.uint16, copy=False)
    shape = (len(rows), message.width) + ((encoding.channels,) if encoding.channels > 1 else ())
    return to_8_bit(encoding.to_rgb(samples.reshape(shape)))


def _rows(message: Any, encoding: Encoding) -> np.ndarray:
    """Return the bytes of the rows without padding, (rows, bytes), C-contiguous."""
    height, width, step, name = message.height, message.width, message.step, message.encoding
    across, down = encoding.even
    if min(height, width) < encoding.smallest or height * width > MAX_PIXELS:
        raise ImageRejected(
            'size', f'size: expected {encoding.smallest}x{encoding.smallest} to {MAX_PIXELS} '
            f'pixels for {name}, got {width}x{height}')
    if width % across or height % down:
        raise ImageRejected(
            'size', f'size: expected multiples of {across}x{down} for {name}, '
            f'got {width}x{height}')
    row_bytes, row_count = width * encoding.channels * encoding.sample, (
        height * encoding.planes // 2)
    data = _as_bytes(message.data)
    # Drivers disagree on the step of images in planes; nothing is padded where all just fits.
    if encoding.planes > 2 and data.size == row_bytes * row_count:
        step = row_bytes
    if step < row_bytes:
        raise ImageRejected(
            'step', f'step: expected at least {row_bytes} bytes for {width} pixels of {name}, '
            f'got {step}')
    needed = step * row_count
    if data.size == 0:
        raise ImageRejected('empty', f'data: expected {needed} bytes, got none')
    if data.size < needed:
        raise ImageRejected(
            'data', f'data: expected {needed} bytes for {row_count} rows of {step}, '
            f'got {data.size}')
    rows = data[:needed].reshape(row_count, step)
    if encoding.planes == 6:  # A row of colours is two steps long.
        below = rows[height:].reshape(height, 2 * step)[:, :2 * row_bytes]
        return np.concatenate([rows[:height, :row_bytes], below.reshape(2 * height, row_bytes)])
    # OpenCV and the extrapolator want rows without gaps; without padding this copies nothing.
    return np.ascontiguousarray(rows[:, :row_bytes])


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
