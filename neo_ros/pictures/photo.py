"""Photos as files: which there are in a folder, and their pixels."""
from collections.abc import Iterable, Sequence
import importlib.util
import io
from pathlib import Path

import cv2
from neo_ros.errors import SceneError
from neo_ros.machine.names import natural_key
from neo_ros.pictures.header import as_stored, jpeg_is_whole, JPEG_START
import numpy as np

# What phones write; read with the extra `heic`.
HEIC_SUFFIXES = ('.heic', '.heif')
PHOTO_SUFFIXES = ('.jpg', '.jpeg', '.png', '.bmp', '.tif', '.tiff', '.webp', '.ppm', '.pgm',
                  *HEIC_SUFFIXES)
# Before the names of instant-ngp's masks, which lie among the photos.
DYNAMIC_MASK = 'dynamic_mask_'
# Pixels lie as the intrinsics describe them: a viewer's rotation (EXIF) must not turn them.
READ_FLAGS = cv2.IMREAD_COLOR | cv2.IMREAD_IGNORE_ORIENTATION


def read_photo(path: Path, upright: bool = False) -> np.ndarray | None:
    """
    Read an image file as RGB uint8 (H, W, 3), None if it cannot be read or was cut off.

    16-bit photos are scaled to 8 bit (full scale stays full scale), grayscale becomes three
    equal channels, transparency is dropped; upright: turned as a viewer shows it (EXIF). HEIC
    photos are always upright, and need the extra `heic`.
    """
    try:
        data = path.read_bytes()
    except OSError:
        return None
    return _decode_heic(data) if path.suffix.lower() in HEIC_SUFFIXES else (
        decode_photo(data, upright))


def decode_photo(data: bytes, upright: bool = False) -> np.ndarray | None:
    """Decode what an image file holds, as `read_photo`; HEIC is not taken."""
    # OpenCV fills with grey what a file that was cut off lacks.
    if not data or data.startswith(JPEG_START) and not jpeg_is_whole(data):
        return None
    image = cv2.imdecode(np.frombuffer(data if upright else as_stored(data), np.uint8),
                         cv2.IMREAD_COLOR if upright else READ_FLAGS)
    return None if image is None else cv2.cvtColor(image, cv2.COLOR_BGR2RGB)


def _decode_heic(data: bytes) -> np.ndarray | None:
    try:
        import pillow_heif
    except ImportError:
        return None
    try:
        image = np.asarray(pillow_heif.open_heif(io.BytesIO(data), convert_hdr_to_8bit=True))
    except (ValueError, OSError, RuntimeError, EOFError, SyntaxError):
        return None
    return np.ascontiguousarray(
        image[..., :3] if image.ndim == 3 else np.repeat(image[..., None], 3, axis=-1))


def heic_advice(paths: Iterable[Path]) -> str:
    """Return how HEIC photos would be read, where there are some and the extra is missing."""
    if not any(path.suffix.lower() in HEIC_SUFFIXES for path in paths) or (
            importlib.util.find_spec('pillow_heif') is not None):
        return ''
    return "; HEIC photos need: pip install '.[heic]' in a checkout"


def photo_size(path: Path) -> tuple[int, int] | None:
    """Return (width, height) of an image file, None if it cannot be read."""
    image = read_photo(path)
    return None if image is None else (image.shape[1], image.shape[0])


def first_photo_size(paths: Sequence[Path], source: Path) -> tuple[int, int]:
    """Return the size of the first image that can be read; SceneError if none can."""
    for path in paths:
        size = photo_size(path)
        if size is not None:
            return size
    raise SceneError(f'{source}: none of the {len(paths)} images can be read{heic_advice(paths)}')


def list_photos(folder: Path) -> list[Path]:
    """
    Return the photos of a folder in natural order: img2 comes before img10.

    Hidden files are none: macOS adds a ._img2.jpg to img2.jpg.
    """
    if not folder.is_dir():
        return []
    return sorted((path for path in folder.iterdir()
                   if path.suffix.lower() in PHOTO_SUFFIXES and path.is_file()
                   and not path.name.startswith(('.', DYNAMIC_MASK))),
                  key=lambda path: natural_key(path.name))
