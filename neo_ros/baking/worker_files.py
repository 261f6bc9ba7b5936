"""What Ray's workers make parts of a scene memory of: files that all their machines see."""
from collections.abc import Iterator
from contextlib import contextmanager
from dataclasses import dataclass, replace
from functools import lru_cache
from pathlib import Path
from typing import BinaryIO
from zipfile import BadZipFile

from neo_ros.baking.keyframes import Photos
from neo_ros.errors import NeoError
from neo_ros.field.device import read_field
from neo_ros.field.radiance_field import RadianceField
from neo_ros.machine.files import whole_file
import numpy as np


@dataclass(frozen=True, eq=False)
class SharedScene:
    """
    A field, and photos whose pixels lie in files too, of which a worker reads what it needs.

    photos: without pixels; images, usable: the files, usable is None where all pixels are.
    """

    field: Path
    photos: Photos
    images: Path
    usable: Path | None

    @classmethod
    def keep(cls, field: Path, photos: Photos, folder: Path) -> 'SharedScene':
        """Write the photos' files into a folder; NeoError where there is no room."""
        images = keep_array(folder / 'images.npy', photos.images)
        usable = None if photos.usable is None else keep_array(
            folder / 'usable.npy', photos.usable)
        none = np.zeros((0, 1, 1, 3), np.uint8)
        return cls(field.absolute(), replace(photos, images=none, usable=None), images, usable)

    def read_photos(self) -> Photos:
        """Return the photos; their pixels are read when they are looked at."""
        return replace(self.photos, images=np.load(self.images, mmap_mode='r'), usable=(
            None if self.usable is None else np.load(self.usable, mmap_mode='r')))

    def read_field(self) -> RadianceField:
        """Return the field; a worker reads it once for many jobs."""
        return _field(self.field, self.field.stat().st_mtime_ns)


@lru_cache(maxsize=1)
def _field(path: Path, written: int) -> RadianceField:
    return read_field(path, 'cpu')


def keep_array(path: Path, array: np.ndarray) -> Path:
    """Write an array where workers find it; returns the absolute path."""
    path = path.absolute()
    with kept_file(path) as file:
        np.save(file, array)
    return path


@contextmanager
def kept_file(path: Path) -> Iterator[BinaryIO]:
    """Write a file of what is made on the way; NeoError where there is no room."""
    try:
        path.parent.mkdir(parents=True, exist_ok=True)
        with whole_file(path) as partial, partial.open('wb') as file:
            yield file
    except OSError as error:
        raise NeoError(f'{path}: cannot keep the work: {error.strerror}; make room and give '
                       'the same command again') from error


def read_part(path: Path) -> dict[str, np.ndarray]:
    """Read the arrays of a finished part; NeoError where it is not there or damaged."""
    try:
        with np.load(path, allow_pickle=False) as data:
            return dict(data)
    except (OSError, ValueError, KeyError, EOFError, BadZipFile) as error:
        raise NeoError(f'{path}: expected what was made before: {error}; delete it, and run the '
                       'same command again') from error
