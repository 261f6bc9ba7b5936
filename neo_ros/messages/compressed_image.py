"""`sensor_msgs/CompressedImage` (JPEG, PNG) to RGB arrays and back."""
from typing import Any

import cv2
from neo_ros.errors import ImageRejected
from neo_ros.pictures.header import broken_picture, compressed_image_size
import numpy as np

# The form that image_transport's plugins understand: what it was, and what the JPEG holds.
JPEG_FORMAT = 'rgb8; jpeg compressed bgr8'
MAX_JPEG_SIDE = 65500


def compressed_size(message: Any) -> tuple[int, int]:
    """
    Return (width, height) of a `sensor_msgs/CompressedImage` without decoding it.

    Raises ImageRejected as `compressed_image_size` does, also 'encoding' for depth and Bayer.
    """
    _is_swapped(message.format)
    return compressed_image_size(bytes(message.data))


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
        raise broken_picture(f'OpenCV cannot decode it ({error.err})') from None
    if image is None or image.shape[:2] != (height, width):
        raise broken_picture(f'OpenCV cannot decode the {width}x{height} pixels of its header')
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
