"""
Depth images of ROS to arrays: REP-118's Image, and image_transport's compressedDepth.

16UC1 counts millimetres, 32FC1 is in metres; both along the optical axis.
"""
from typing import Any

import cv2
from neo_ros.errors import ImageRejected
from neo_ros.pictures.header import MAX_PIXELS, read_header
import numpy as np

# Metres that one step of an encoding means.
UNITS = {'16UC1': 0.001, '32FC1': 1.0}
COMPRESSED_DEPTH = 'compressedDepth'
_PNG_START = b'\x89PNG'
# Before the picture: an int of no meaning, and the two floats of `_from_inverse`.
_CONFIG_BYTES = 12


def depth_encoding(message: Any) -> str | None:
    """Return '16UC1' or '32FC1' of an Image or CompressedImage of depth; None of any other."""
    form = getattr(message, 'encoding', getattr(message, 'format', ''))
    word = form.partition(';')[0].strip()
    return word if word in UNITS else None


def read_depth_image(message: Any) -> np.ndarray:
    """
    Return the numbers of a depth image: uint16 or float32 (H, W), to be multiplied by its unit.

    Raises ImageRejected: 'encoding' for what is no depth, 'size', 'step', 'empty', 'data'.
    """
    encoding = depth_encoding(message)
    if encoding is None:
        raise ImageRejected('encoding', f'encoding: expected one of {", ".join(UNITS)}, got '
                            f'{getattr(message, "encoding", getattr(message, "format", ""))!r}')
    if hasattr(message, 'step'):
        return _read_raw(message, encoding)
    return _read_compressed(bytes(message.data), encoding, message.format)


def _read_raw(message: Any, encoding: str) -> np.ndarray:
    kind = np.dtype('u2' if encoding == '16UC1' else 'f4').newbyteorder(
        '>' if message.is_bigendian else '<')
    height, width, step = message.height, message.width, message.step
    if not 0 < height * width <= MAX_PIXELS:
        raise ImageRejected('size', f'size: expected 1 to {MAX_PIXELS} pixels, got '
                            f'{width}x{height}')
    if step < width * kind.itemsize:
        raise ImageRejected('step', f'step: expected at least {width * kind.itemsize} bytes for '
                            f'{width} pixels of {encoding}, got {step}')
    data = np.frombuffer(message.data, np.uint8) if len(message.data) else np.empty(0, np.uint8)
    if data.size < step * height:
        raise ImageRejected('data', f'data: expected {step * height} bytes for {height} rows of '
                            f'{step}, got {data.size}')
    rows = data[:step * height].reshape(height, step)[:, :width * kind.itemsize]
    return np.ascontiguousarray(rows).view(kind).astype(kind.newbyteorder('='), copy=False)


def _read_compressed(data: bytes, encoding: str, form: str) -> np.ndarray:
    config = b'' if data.startswith(_PNG_START) else data[:_CONFIG_BYTES]
    picture = data[len(config):]
    if 'rvl' in form.lower():
        numbers = _decode_rvl(picture)
    else:
        numbers = _decode_picture(picture, form)
    if encoding == '16UC1' or numbers.dtype == np.float32:
        return numbers
    return _from_inverse(numbers, config)


def _decode_picture(picture: bytes, form: str) -> np.ndarray:
    read_header(picture)  # Small data may unpack to gigabytes.
    try:
        numbers = cv2.imdecode(np.frombuffer(picture, np.uint8), cv2.IMREAD_UNCHANGED) if (
            picture) else None
    except cv2.error:
        numbers = None
    if numbers is None or numbers.ndim != 2 or numbers.dtype not in (np.uint16, np.float32):
        raise ImageRejected('data', f'data: expected a picture of one channel of 16 bits, as '
                            f'{form!r:.80} says, got {len(picture)} bytes of something else')
    return numbers


def _from_inverse(numbers: np.ndarray, config: bytes) -> np.ndarray:
    """Return the metres that were stored as steps of their inverse."""
    if len(config) < _CONFIG_BYTES:
        raise ImageRejected('data', 'data: expected the two parameters of 32FC1 before its '
                            'picture, got none')
    a, b = np.frombuffer(config, '<f4', 2, offset=4)
    with np.errstate(divide='ignore', invalid='ignore'):
        metres = a / (numbers.astype(np.float32) - b)
    return np.where(numbers > 0, metres, 0).astype(np.float32)


def _decode_rvl(data: bytes) -> np.ndarray:
    """
    Decode run lengths and differences (Wilson, Fast Lossless Depth Image Compression, 2017).

    Numbers are written in nibbles of three bits, the lowest first, of 32-bit words from their top;
    each run is a count of zeros, a count of others, and these as differences in zigzag.
    """
    fault = ImageRejected('data', 'data: expected depth in RVL, got something else or less of it')
    if len(data) < 8:
        raise fault
    width, height = map(int, np.frombuffer(data, '<i4', 2))
    if not (width > 0 and height > 0 and width * height <= MAX_PIXELS):
        raise ImageRejected('size', f'size: expected 1 to {MAX_PIXELS} pixels, got '
                            f'{width}x{height}')
    words = np.frombuffer(data, '<u4', (len(data) - 8) // 4, offset=8)
    values = _nibble_values(words)
    out = np.zeros(width * height, np.int64)
    place = at = last = 0
    while place < out.size:
        if at + 2 > len(values):
            raise fault
        place += int(values[at])
        count = int(values[at + 1])
        coded = values[at + 2:at + 2 + count]
        if place + count > out.size or len(coded) < count:
            raise fault
        if count:
            run = last + np.cumsum((coded >> 1) ^ -(coded & 1))
            out[place:place + count], last = run, int(run[-1])
        place, at = place + count, at + 2 + count
    return out.astype(np.uint16).reshape(height, width)


def _nibble_values(words: np.ndarray) -> np.ndarray:
    """Return the numbers, int64, that lie in 32-bit words as nibbles whose top bit says 'more'."""
    shifts = np.arange(28, -4, -4).astype(np.uint32)
    nibbles = (words[:, None] >> shifts & 15).ravel().astype(np.int64)
    ends = np.flatnonzero(nibbles < 8)
    starts = np.concatenate([[0], ends[:-1] + 1]) if len(ends) else ends
    nibbles = nibbles[:ends[-1] + 1] if len(ends) else nibbles[:0]
    # A number of more than 10 nibbles is none; its bits must not run over.
    order = np.minimum(np.arange(len(nibbles)) - np.repeat(starts, ends - starts + 1), 10)
    parts = (nibbles & 7) << 3 * order
    return np.add.reduceat(parts, starts) if len(starts) else parts
