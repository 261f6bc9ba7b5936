"""
Depth of Record3D, float32 metres: N.exr of its export, LZFSE in a .r3d, there with confidence.

N.depth has as many numbers as a picture of the photo's aspect, in any size; N.conf, which only
lidar has, a byte for each: 0 is not to be trusted, 1 and 2 are.
"""
from collections.abc import Callable, Iterator, Sequence
from contextlib import AbstractContextManager
from importlib.util import find_spec
import math
from pathlib import PurePosixPath

from neo_ros.captures.capture import ImageStream
import numpy as np

# Returns the bytes of a file of the recording, None where there is none that can be read.
ReadFile = Callable[[str], bytes | None]
OpenFiles = Callable[[], AbstractContextManager[ReadFile]]


def advice_where_unread(package: str) -> str:
    """Return what to install for depth that needs this package; empty where it is there."""
    return '' if find_spec(package) is not None else (
        "depth maps are not read; they need: pip install '.[record3d]' in a checkout")


def depth_name(image: str) -> str:
    """Return the name of the depth that was recorded with an image."""
    return str(PurePosixPath(image).with_suffix('.depth'))


def depth_stream(open_files: OpenFiles, images: Sequence[str], size: tuple[int, int]
                 ) -> ImageStream:
    """
    Make the `depth_stream` of a .r3d; images: names of the frames' photos in it.

    size: width and height of the depth, or of the photo, whose aspect it has.
    """
    def read(indices: Sequence[int]) -> Iterator[tuple[int, np.ndarray | None]]:
        with open_files() as read_file:
            for index in indices:
                confidence = str(PurePosixPath(images[index]).with_suffix('.conf'))
                yield index, decode_depth(read_file(depth_name(images[index])),
                                          read_file(confidence), size)

    return read


def decode_depth(depth: bytes | None, confidence: bytes | None, size: tuple[int, int]
                 ) -> np.ndarray | None:
    """Return float32 (h, w) metres, 0 where it is not to be trusted; None for broken bytes."""
    metres = _decompressed(depth, np.dtype('<f4'), size)
    if metres is None or confidence is None:
        return metres
    trust = _decompressed(confidence, np.dtype(np.uint8), size)
    return None if trust is None or trust.shape != metres.shape else (
        np.where(trust > 0, metres, np.float32(0)))


def _decompressed(data: bytes | None, dtype: np.dtype, size: tuple[int, int]
                  ) -> np.ndarray | None:
    import lzfse
    try:
        numbers = np.frombuffer(lzfse.decompress(data or b''), dtype)
    except (lzfse.error, ValueError, MemoryError):  # That is what it says of a file cut off.
        return None
    width = round(math.sqrt(len(numbers) * size[0] / size[1]))
    if width == 0 or len(numbers) % width or len(numbers) == 0:
        return None
    return numbers.reshape(-1, width)
