"""What the readers of all formats return: frames as they were recorded, posed or not."""
from collections.abc import Callable, Iterator, Sequence
from dataclasses import dataclass, replace
import os
from pathlib import Path

from neo_ros.geometry import CameraPose
from neo_ros.geometry.lens import Lens
from neo_ros.pictures.photo import read_photo
import numpy as np

ImageStream = Callable[[Sequence[int]], Iterator[tuple[int, np.ndarray | None]]]


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
    pose: CameraPose | None
    lens: Lens | None
    path_id: int = 0
    stamp_ns: int | None = None
    file: Path | None = None


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
    stream: ImageStream | None = None
    origin: str = ''
    z_up: bool = False
    arbitrary_scale: bool = False

    def __len__(self) -> int:
        return len(self.frames)

    @property
    def posed(self) -> bool:
        """Whether every frame has a pose."""
        return all(frame.pose is not None for frame in self.frames)

    def images(self, indices: Sequence[int]) -> Iterator[tuple[int, np.ndarray | None]]:
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


def scene_name(file: Path, folder: Path) -> str:
    """Keep the folders of images below `folder`; those beside it come to 'beside/'."""
    parts = Path(os.path.relpath(file, folder)).parts
    return Path(*('beside' if part == '..' else part for part in parts)).as_posix()


def _chosen(stream: ImageStream, chosen: Sequence[int]) -> ImageStream:
    def read(indices: Sequence[int]) -> Iterator[tuple[int, np.ndarray | None]]:
        back = {chosen[index]: index for index in indices}
        for original, image in stream(list(back)):
            yield back[original], image

    return read
