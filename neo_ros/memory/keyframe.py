"""One keyframe of the scene memory, and the pictures that it is stored as."""
from contextlib import suppress
from dataclasses import dataclass
import mmap

import cv2
from neo_ros.errors import ModelError
import numpy as np

# Inverse depth is stored in so many steps from infinity to CLOSEST metres; finer ones would be
# noise that does not compress.
STEPS = 4095
CLOSEST = 0.25
JPEG_QUALITY = 86
# Textures are so many times as fine as the view, which keeps them sharp when they are drawn.
FINER = 3.0
# By how much a decoder can shrink them for views that are smaller.
REDUCED = {1: cv2.IMREAD_COLOR, 2: cv2.IMREAD_REDUCED_COLOR_2, 4: cv2.IMREAD_REDUCED_COLOR_4,
           8: cv2.IMREAD_REDUCED_COLOR_8}

Packed = tuple[bytes, bytes]  # texture and depth, as files of pictures


@dataclass(frozen=True, eq=False)
class Keyframe:
    """
    A panorama with depth, seen from `position` (3,), world metres.

    depth float32 (h, w), metres along the ray, 0 = unknown; texture uint8 RGB (n h, n w, 3).
    """

    position: np.ndarray
    depth: np.ndarray
    texture: np.ndarray


def compress(keyframe: Keyframe) -> Packed:
    """Return a keyframe's texture as JPEG and its inverse depth as PNG."""
    return (encode_image('.jpg', keyframe.texture[..., ::-1],
                         [cv2.IMWRITE_JPEG_QUALITY, JPEG_QUALITY]),
            encode_image('.png', code_of(keyframe.depth), []))


def code_of(depth: np.ndarray) -> np.ndarray:
    """Return what a depth's PNG holds, uint16, of metres, float32; 0 = unknown in both."""
    nearness = STEPS * CLOSEST / np.maximum(depth, CLOSEST)
    return np.where(depth > 0, np.maximum(nearness + 0.5, 1), 0).astype(np.uint16)


def encode_image(kind: str, image: np.ndarray, options: list[int]) -> bytes:
    """Compress an image; raises ModelError where OpenCV cannot."""
    done, coded = cv2.imencode(kind, image, options)
    if not done:
        raise ModelError(f'scene memory: OpenCV cannot write {kind}')
    return coded.tobytes()


def depth_of(coded: np.ndarray) -> np.ndarray:
    """Return the metres, float32, that a depth's PNG means, uint16; 0 = unknown."""
    return np.where(coded > 0, STEPS * CLOSEST / np.maximum(coded, 1), 0).astype(np.float32)


def decode_image(content: bytes, flags: int) -> np.ndarray | None:
    """Decode what OpenCV reads; None where it cannot."""
    try:
        return cv2.imdecode(np.frombuffer(content, np.uint8), flags)
    except cv2.error:  # Of what is larger than OpenCV takes.
        return None


def on_own_pages(array: np.ndarray) -> np.ndarray:
    """Return a copy outside of malloc's heap, where it would leave a hole when it is dropped."""
    pages = mmap.mmap(-1, array.nbytes, mmap.MAP_PRIVATE | mmap.MAP_ANONYMOUS)
    # Not every kernel has large pages, which take a third of the time.
    with suppress(AttributeError, OSError):
        pages.madvise(mmap.MADV_HUGEPAGE)
    copy = np.frombuffer(pages, array.dtype).reshape(array.shape)
    copy[:] = array
    return copy
