"""What the readers of all formats return: frames as they were recorded, posed or not."""
from collections.abc import Callable, Iterator, Sequence
from dataclasses import dataclass, replace
import os
from pathlib import Path

from neo_ros.geometry import CameraPose
from neo_ros.geometry.lens import Lens
from neo_ros.pictures.depth import nearest, read_numbers
from neo_ros.pictures.photo import read_photo
import numpy as np

ImageStream = Callable[[Sequence[int]], Iterator[tuple[int, np.ndarray | None]]]


@dataclass(frozen=True, eq=False)
class DepthSource:
    """
    Where the depth of an image is, along its camera's optical axis.

    It shows what the image shows, in any size, unless it has a lens of its own.

    unit        metres that one step of its numbers means
    file        a picture of one channel; None where the capture's `depth_stream` has it
    invalid     the number that means unknown, beside 0 and what is not finite
    confidence  a picture whose 0 means that the depth is not to be trusted
    lens        the camera that measured it, where that is not the image's
    T_image_depth  (4, 4), where that camera stands in another place: its pose in the image's
    """

    unit: float
    file: Path | None = None
    invalid: int | None = None
    confidence: Path | None = None
    lens: Lens | None = None
    T_image_depth: np.ndarray | None = None

    def read(self) -> np.ndarray | None:
        """Return the numbers of the file, (h, w), 0 where they are not to be trusted."""
        assert self.file is not None
        numbers = read_numbers(self.file)
        if numbers is None or numbers.ndim != 2 or numbers.dtype not in (np.uint16, np.float32):
            return None
        if self.confidence is None:
            return numbers
        trust = read_numbers(self.confidence)
        if trust is None or trust.ndim != 2:
            return None
        return np.where(nearest(trust, numbers.shape[1], numbers.shape[0]) > 0, numbers, 0)

    def metres(self, numbers: np.ndarray) -> np.ndarray:
        """Return float32 (h, w) metres, 0 = unknown, of the numbers that were stored."""
        known = np.isfinite(numbers) & (numbers > 0)
        if self.invalid is not None:
            known &= numbers != self.invalid
        return np.where(known, numbers, 0).astype(np.float32) * np.float32(self.unit)


@dataclass(frozen=True)
class MaskSource:
    """A picture of what of a photo does not show the scene: black, or white."""

    file: Path
    white_is_ignored: bool = False


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
    depth     its depth, where it was measured
    mask      which pixels are left out, where somebody says so
    raw_lens  the camera that depth and mask belong to, where the image was made straight since
    """

    name: str
    pose: CameraPose | None
    lens: Lens | None
    path_id: int = 0
    stamp_ns: int | None = None
    file: Path | None = None
    depth: DepthSource | None = None
    mask: MaskSource | None = None
    raw_lens: Lens | None = None


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
    quarter_turns  of the cameras about where they look, after which the photos stand upright
    depth_stream  yields (index, numbers (h, w) or None) for depth that is no file
    """

    frames: tuple[CapturedFrame, ...]
    notes: tuple[str, ...] = ()
    stream: ImageStream | None = None
    origin: str = ''
    z_up: bool = False
    arbitrary_scale: bool = False
    depth_stream: ImageStream | None = None
    quarter_turns: int = 0

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

    def depths(self, indices: Sequence[int]) -> Iterator[tuple[int, np.ndarray | None]]:
        """
        Yield (index, float32 (h, w) metres, 0 = unknown) for frames that have depth.

        In the size it was measured in; None for depth that cannot be read.
        """
        measured = [index for index in indices if self.frames[index].depth is not None]
        stream = self.depth_stream or self._depth_files
        for index, numbers in stream(measured):
            depth = self.frames[index].depth
            assert depth is not None
            yield index, None if numbers is None else depth.metres(numbers)

    def _depth_files(self, indices: Sequence[int]) -> Iterator[tuple[int, np.ndarray | None]]:
        for index in indices:
            depth = self.frames[index].depth
            assert depth is not None and depth.file is not None
            yield index, depth.read()

    def subset(self, indices: Sequence[int], note: str = '') -> 'Capture':
        """Keep the frames at `indices`, in that order, and say why in a note."""
        chosen = list(indices)
        stream, depth_stream = self.stream, self.depth_stream
        return replace(
            self, frames=tuple(self.frames[index] for index in chosen),
            notes=self.notes + ((note,) if note else ()),
            stream=None if stream is None else _chosen(stream, chosen),
            depth_stream=None if depth_stream is None else _chosen(depth_stream, chosen))


def origin_of(source: Path, topics: Sequence[str] = ()) -> str:
    """
    Describe the files of a bag or video: another recording has others.

    topics: of a bag, those that are read. Two cameras may share stamps, frame and lens.
    """
    files = sorted(path for path in source.iterdir() if path.is_file()) if (
        source.is_dir()) else [source]
    states = [(str(path.resolve()), path.stat().st_size, path.stat().st_mtime_ns)
              for path in files]
    return repr([*states, *topics])


def scene_name(file: Path, folder: Path) -> str:
    """Keep the folders of images below `folder`; those beside it come to 'beside/'."""
    parts = Path(os.path.relpath(file, folder)).parts
    return Path(*('beside' if part == '..' else part for part in parts)).as_posix()


def name_beside(folder: str, photo: str) -> str:
    """Return where depth or mask of a photo goes in the scene: below `folder`, always as PNG."""
    name = photo.removeprefix('images/')
    return f'{folder}/{name}' if name.endswith('.png') else f'{folder}/{name}.png'


def files_beside(scene: Path, folder: str, names: Sequence[str | None],
                 sources: Sequence[DepthSource | MaskSource | None]) -> dict[int, Path]:
    """Return the files of depth or masks by index, of frames that have both name and source."""
    return {index: scene / name_beside(folder, name)
            for index, (name, source) in enumerate(zip(names, sources))
            if name is not None and source is not None}


def _chosen(stream: ImageStream, chosen: Sequence[int]) -> ImageStream:
    def read(indices: Sequence[int]) -> Iterator[tuple[int, np.ndarray | None]]:
        back = {chosen[index]: index for index in indices}
        for original, image in stream(list(back)):
            yield back[original], image

    return read
