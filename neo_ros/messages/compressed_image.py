"""`sensor_msgs/CompressedImage` (JPEG, PNG) to RGB arrays and back."""
from typing import Any

import cv2
from neo_ros.errors import ImageRejected
from neo_ros.messages.image import MAX_PIXELS
import numpy as np

# The form that image_transport's plugins understand: what it was, and what the JPEG holds.
JPEG_FORMAT = 'rgb8; jpeg compressed bgr8'
JPEG_START, JPEG_END = b'\xff\xd8', b'\xff\xd9'
PNG_START, PNG_END = b'\x89PNG\r\n\x1a\n', b'IEND\xaeB`\x82'
# Each scan of a progressive JPEG costs a pass over the whole picture; cameras send one, ten are
# usual, a few kilobytes could hold thousands.
MAX_SCANS = 64
# Start-of-frame markers; the other codes of their range are tables.
JPEG_FRAMES = frozenset(range(0xc0, 0xd0)) - {0xc4, 0xc8, 0xcc}
JPEG_SCAN = 0xda
MAX_JPEG_SIDE = 65500


def compressed_size(message: Any) -> tuple[int, int]:
    """
    Return (width, height) of a `sensor_msgs/CompressedImage` without decoding it.

    Raises ImageRejected as `compressed_image_size` does, also 'encoding' for depth and Bayer.
    """
    _is_swapped(message.format)
    return compressed_image_size(bytes(message.data))


def compressed_image_size(data: bytes) -> tuple[int, int]:
    """
    Return (width, height) as the header of a JPEG or PNG has them.

    Raises ImageRejected with the reason 'empty', 'encoding' (no JPEG or PNG of 8 bits), 'size'
    (zero or above 64 megapixels) or 'data' (no header, no end, or far too many scans).
    """
    if not data:
        raise ImageRejected('empty', 'data: expected a JPEG or PNG, got no bytes')
    if data.startswith(JPEG_START):
        width, height = _jpeg_size(data)
    elif data.startswith(PNG_START):
        width, height = _png_size(data)
    else:
        raise ImageRejected(
            'encoding', 'data: expected a JPEG or PNG, got bytes that start with '
            f'{data[:8]!r}')
    if min(width, height) < 1 or width * height > MAX_PIXELS:
        raise ImageRejected('size', f'size: expected 1x1 to {MAX_PIXELS} pixels, '
                            f'got {width}x{height}')
    return width, height


def read_compressed_image(message: Any) -> np.ndarray:
    """
    Return the picture of a `sensor_msgs/CompressedImage` as RGB uint8 (H, W, 3).

    The bytes decide between JPEG and PNG; `format` says, as image_transport writes it, whether
    red and blue changed places. An orientation in EXIF is ignored.
    Raises ImageRejected as `compressed_size` does, and 'data' for what cannot be decoded.
    """
    width, height = compressed_size(message)
    try:
        image = cv2.imdecode(np.frombuffer(message.data, np.uint8),
                             cv2.IMREAD_COLOR | cv2.IMREAD_IGNORE_ORIENTATION)
    except cv2.error as error:
        raise _broken(f'OpenCV cannot decode it ({error.err})') from None
    if image is None or image.shape[:2] != (height, width):
        raise _broken(f'OpenCV cannot decode the {width}x{height} pixels of its header')
    # The OpenCV of ROS 2 Jazzy decodes to BGR only.
    return image if _is_swapped(message.format) else cv2.cvtColor(
        image, cv2.COLOR_BGR2RGB, image)


def jpeg_fields(image: np.ndarray, quality: int) -> dict[str, Any]:
    """Return the fields below the header for a uint8 RGB (H, W, 3) image; quality 1 to 100."""
    return {'format': JPEG_FORMAT, 'data': encode_jpeg(image, quality)}


def encode_jpeg(image: np.ndarray, quality: int) -> np.ndarray:
    """
    Return the JPEG, uint8 (N,), of uint8 RGB (H, W, 3) or grey (H, W); quality 1 to 100.

    Raises ImageRejected('size') for what is too large for a JPEG.
    """
    height, width = image.shape[:2]
    if max(height, width) > MAX_JPEG_SIDE:
        raise ImageRejected('size', f'size: a JPEG has at most {MAX_JPEG_SIDE} pixels a side, got '
                            f'{width}x{height}')
    if image.ndim == 3:
        image = cv2.cvtColor(image, cv2.COLOR_RGB2BGR)
    return cv2.imencode('.jpg', image, [cv2.IMWRITE_JPEG_QUALITY, quality])[1].reshape(-1)


def _is_swapped(form: str) -> bool:
    """Say whether 'ENCODING; jpeg compressed TARGET' names RGB where the file says BGR."""
    if 'compressedDepth' in form or 'bayer' in form.rpartition('compressed')[2]:
        raise ImageRejected(
            'encoding', f'format: expected a colour or grey image, got {form!r:.80}')
    return form.rpartition('compressed')[1:] in (('compressed', ' rgb8'), ('compressed', ' rgba8'))


def _broken(words: str) -> ImageRejected:
    return ImageRejected('data', f'data: {words}; is the message truncated?')


def _png_size(data: bytes) -> tuple[int, int]:
    if data[12:16] != b'IHDR' or len(data) < 33:
        raise _broken('a PNG without a header')
    if data[24] > 8:
        raise ImageRejected('encoding', f'data: expected a PNG of 8 bits, got {data[24]}')
    if not data.rstrip(b'\0').endswith(PNG_END):
        raise _broken('a PNG without an end')
    return int.from_bytes(data[16:20], 'big'), int.from_bytes(data[20:24], 'big')


def _jpeg_size(data: bytes) -> tuple[int, int]:
    """Walk from marker to marker up to the first scan; the size lies in between."""
    # Some drivers fill their buffer up behind the end.
    if not data.rstrip(b'\0').endswith(JPEG_END):
        raise _broken('a JPEG without an end')
    if data.count(bytes([0xff, JPEG_SCAN])) > MAX_SCANS:
        raise _broken(f'a JPEG of more than {MAX_SCANS} scans')
    place = 2
    sizes = set()
    while place + 4 <= len(data) and data[place] == 0xff:
        marker = data[place + 1]
        if marker == 0xff:  # A fill byte.
            place += 1
            continue
        if marker == JPEG_SCAN:
            break
        segment = data[place + 4:place + 2 + int.from_bytes(data[place + 2:place + 4], 'big')]
        if marker in JPEG_FRAMES:
            if len(segment) < 6 or segment[0] != 8:
                raise ImageRejected('encoding', 'data: expected a JPEG of 8 bits')
            sizes.add((int.from_bytes(segment[3:5], 'big'), int.from_bytes(segment[1:3], 'big')))
        place += 4 + len(segment)
    if len(sizes) != 1:
        raise _broken('a JPEG without one size')
    return sizes.pop()
