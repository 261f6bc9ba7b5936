"""`sensor_msgs/CompressedImage` (JPEG, PNG, WebP, TIFF) to RGB arrays and back."""
from typing import Any

import cv2
from neo_ros.errors import ImageRejected
from neo_ros.messages.image_encodings import DEPTH, ENCODINGS, MIN_BAYER_SIDE, to_8_bit
from neo_ros.pictures.header import as_stored, broken_picture, PictureHeader, read_header
import numpy as np

# The form that image_transport's plugins understand: what it was, and what the JPEG holds.
JPEG_FORMAT = 'rgb8; jpeg compressed bgr8'
MAX_JPEG_SIDE = 65500
# What the file calls blue is red.
SWAPPED = ('rgb8', 'rgba8', 'rgb16', 'rgba16')
# Words of `format` that mean a stream, of which no message can be decoded alone.
VIDEO_FORMATS = ('h264', 'h265', 'hevc', 'av1', 'vp9')


def compressed_size(message: Any) -> tuple[int, int]:
    """
    Return (width, height) of a `sensor_msgs/CompressedImage` without decoding it.

    Raises ImageRejected as `read_header` does, also 'encoding' for depth and video.
    """
    _check_format(message.format, depth_as_grey=True)
    header = read_header(bytes(message.data))
    return header.width, header.height


def read_compressed_image(message: Any, depth_as_grey: bool = False) -> np.ndarray:
    """
    Return the picture of a `sensor_msgs/CompressedImage` as RGB uint8 (H, W, 3).

    The bytes decide between JPEG, PNG, WebP and TIFF, and where the picture ends; `format` says,
    as image_transport writes it, whether red and blue changed places, and whether it is a Bayer
    mosaic. Samples of 16 bits are scaled as `to_8_bit` does. An orientation in EXIF is ignored.
    Raises ImageRejected as `compressed_size` does, 'encoding' for 16UC1 unless `depth_as_grey`,
    and 'data' for what cannot be decoded.
    """
    form = message.format
    _check_format(form, depth_as_grey)
    header = read_header(bytes(message.data))
    was, target = _encodings(form)
    pattern = target if target.startswith('bayer_') else was
    if pattern.startswith('bayer_') and pattern in ENCODINGS and target in (
            '', 'mono8', 'mono16', pattern):
        mosaic = _decode(message.data, header, cv2.IMREAD_UNCHANGED)
        if mosaic.ndim == 2:
            return _demosaiced(mosaic, pattern)
    image = to_8_bit(_decode(message.data, header, cv2.IMREAD_COLOR))
    # The OpenCV of ROS 2 Jazzy decodes to BGR only.
    return image if target in SWAPPED else cv2.cvtColor(image, cv2.COLOR_BGR2RGB, image)


def video_format(form: str) -> str | None:
    """Return the name of the video codec that a CompressedImage's `format` says, or None."""
    word = form.partition(';')[0].strip().lower()
    return word if word in VIDEO_FORMATS else None


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


def _decode(data: Any, header: PictureHeader, flags: int) -> np.ndarray:
    """Return uint8 or uint16 (H, W[, 3]) as OpenCV decodes it."""
    if header.kind == 'TIFF':
        data = as_stored(bytes(data))
    try:
        image = cv2.imdecode(np.frombuffer(data, np.uint8)[:header.end],
                             flags | cv2.IMREAD_ANYDEPTH | cv2.IMREAD_IGNORE_ORIENTATION)
    except cv2.error as error:
        raise broken_picture(f'OpenCV cannot decode it ({error.err})') from None
    if image is None or image.shape[:2] != (header.height, header.width) or (
            image.dtype not in (np.uint8, np.uint16)):
        raise broken_picture(f'OpenCV cannot decode the {header.width}x{header.height} pixels of '
                             f'its {header.kind} header')
    return image


def _demosaiced(mosaic: np.ndarray, pattern: str) -> np.ndarray:
    if min(mosaic.shape) < MIN_BAYER_SIDE:
        raise ImageRejected(
            'size', f'size: expected at least {MIN_BAYER_SIDE}x{MIN_BAYER_SIDE} pixels of '
            f'{pattern}, got {mosaic.shape[1]}x{mosaic.shape[0]}')
    return to_8_bit(ENCODINGS[pattern].to_rgb(mosaic))


def _encodings(form: str) -> tuple[str, str]:
    """Return what 'ENCODING; jpeg compressed TARGET' says the image was, and is in the file."""
    return form.partition(';')[0].strip(), form.rpartition('compressed')[2].strip() if (
        'compressed' in form) else ''


def _check_format(form: str, depth_as_grey: bool) -> None:
    codec = video_format(form)
    if codec is not None:
        raise ImageRejected(
            'encoding', f'format: expected single pictures, got {codec}, which is video: of it, '
            'no message can be decoded without those before it; publish JPEG (image_transport '
            'republish), or record a bag and import or replay that')
    if 'compressedDepth' in form or (
            not depth_as_grey and _encodings(form)[0] == DEPTH):
        raise ImageRejected(
            'encoding', f'format: expected a colour or grey image, got {form!r:.80}')
