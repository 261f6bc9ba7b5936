"""What the readers of all formats return: frames as they were recorded, posed or not."""
from dataclasses import dataclass, replace
import os
from pathlib import Path
import re
from typing import Callable, Iterator, Optional, Sequence

import cv2
from neo_ros.errors import SceneError
from neo_ros.geometry import CameraPose
from neo_ros.picture_header import jpeg_is_whole, JPEG_START
from neo_ros.scenes.lens import Lens
import numpy as np

PHOTO_SUFFIXES = ('.jpg', '.jpeg', '.png', '.bmp', '.tif', '.tiff', '.webp', '.ppm', '.pgm')
# Pixels lie as the intrinsics describe them: a viewer's rotation (EXIF) must not turn them.
READ_FLAGS = cv2.IMREAD_COLOR | cv2.IMREAD_IGNORE_ORIENTATION
Progress = Callable[[int, int], None]
ImageStream = Callable[[Sequence[int]], Iterator[tuple[int, Optional[np.ndarray]]]]


def no_progress(done: int, total: int) -> None:
    """Show nothing."""


@dataclass(frozen=True)
class CapturedFrame:
    """
    One image of a capture.

    name      where it goes in the scene folder, as a relative path; no two alike
    pose      None where the capture has no poses
    lens      None where the capture has no calibration
    path_id   walk, run or sequence that it belongs to
    stamp_ns  when it was taken, where that is known
    file      the image file, where there is one
    """

    name: str
    pose: Optional[CameraPose]
    lens: Optional[Lens]
    path_id: int = 0
    stamp_ns: Optional[int] = None
    file: Optional[Path] = None


@dataclass(frozen=True)
class Capture:
    """
    Frames in the order in which they were taken, as far as that is known.

    notes   what was left out or changed, in plain sentences
    stream  yields (index, RGB uint8 (H, W, 3) or None if unreadable) for indices, in any order;
            None for frames that are files
    origin  what tells the source of a stream from any other one
    z_up    the format says that the world's z axis points up
    arbitrary_scale  nobody knows how long a unit of the poses is
    """

    frames: tuple[CapturedFrame, ...]
    notes: tuple[str, ...] = ()
    stream: Optional[ImageStream] = None
    origin: str = ''
    z_up: bool = False
    arbitrary_scale: bool = False

    def __len__(self) -> int:
        return len(self.frames)

    @property
    def posed(self) -> bool:
        """Whether every frame has a pose."""
        return all(frame.pose is not None for frame in self.frames)

    def images(self, indices: Sequence[int]) -> Iterator[tuple[int, Optional[np.ndarray]]]:
        """Yield (index, RGB uint8 (H, W, 3)); None for images that cannot be read."""
        if self.stream is not None:
            yield from self.stream(indices)
            return
        for index in indices:
            file = self.frames[index].file
            assert file is not None, 'a frame has a file or its capture a stream'
            yield index, read_photo(file)

    def subset(self, indices: Sequence[int], note: str = '') -> 'Capture':
        """Keep the frames at `indices`, in that order, and say why in a note."""
        chosen = list(indices)
        stream = self.stream
        return replace(
            self, frames=tuple(self.frames[index] for index in chosen),
            notes=self.notes + ((note,) if note else ()),
            stream=None if stream is None else _chosen(stream, chosen))


def origin_of(source: Path) -> str:
    """Describe the files of a bag or video: another recording has others."""
    files = sorted(path for path in source.iterdir() if path.is_file()) if (
        source.is_dir()) else [source]
    return repr([(str(path.resolve()), path.stat().st_size, path.stat().st_mtime_ns)
                 for path in files])


def read_photo(path: Path, upright: bool = False) -> Optional[np.ndarray]:
    """
    Read an image file as RGB uint8 (H, W, 3), None if it cannot be read or was cut off.

    16-bit photos are scaled to 8 bit (full scale stays full scale), grayscale becomes three
    equal channels, transparency is dropped; upright: turned as a viewer shows it (EXIF).
    """
    try:
        data = path.read_bytes()
    except OSError:
        return None
    # OpenCV fills with grey what a file that was cut off lacks.
    if not data or data.startswith(JPEG_START) and not jpeg_is_whole(data):
        return None
    image = cv2.imdecode(np.frombuffer(data, np.uint8),
                         cv2.IMREAD_COLOR if upright else READ_FLAGS)
    return None if image is None else cv2.cvtColor(image, cv2.COLOR_BGR2RGB)


def photo_size(path: Path) -> Optional[tuple[int, int]]:
    """Return (width, height) of an image file, None if it cannot be read."""
    image = read_photo(path)
    return None if image is None else (image.shape[1], image.shape[0])


def first_photo_size(paths: Sequence[Path], source: Path) -> tuple[int, int]:
    """Return the size of the first image that can be read; SceneError if none can."""
    for path in paths:
        size = photo_size(path)
        if size is not None:
            return size
    raise SceneError(f'{source}: none of the {len(paths)} images can be read')


def list_photos(folder: Path) -> list[Path]:
    """Return the image files of a folder in natural order: img2 comes before img10."""
    if not folder.is_dir():
        return []
    return sorted((path for path in folder.iterdir()
                   if path.suffix.lower() in PHOTO_SUFFIXES and path.is_file()),
                  key=lambda path: natural_key(path.name))


def natural_key(name: str) -> list[tuple[int, str]]:
    """Sort key by which digits count as numbers."""
    return [(int(part), '') if part.isdecimal() else (-1, part)
            for part in re.split(r'(\d+)', name)]


def scene_name(file: Path, folder: Path) -> str:
    """Keep the folders of images below `folder`; those beside it come to 'beside/'."""
    parts = Path(os.path.relpath(file, folder)).parts
    return Path(*('beside' if part == '..' else part for part in parts)).as_posix()


def listed(names: Sequence[object], most: int = 5) -> str:
    """Name the first few of many for a message."""
    shown = ', '.join(str(name) for name in names[:most])
    return shown + (f' and {len(names) - most} more' if len(names) > most else '')


def _chosen(stream: ImageStream, chosen: Sequence[int]) -> ImageStream:
    def read(indices: Sequence[int]) -> Iterator[tuple[int, Optional[np.ndarray]]]:
        back = {chosen[index]: index for index in indices}
        for original, image in stream(list(back)):
            yield back[original], image

    return read
