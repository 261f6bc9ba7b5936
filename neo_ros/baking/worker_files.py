"""
What the parts of a scene memory are made of: files, of which each reads what it needs.

All photos of a scene may be larger than memory, and Ray's workers see the same files.
"""
from collections.abc import Iterable, Iterator
from contextlib import contextmanager, suppress
from dataclasses import dataclass, replace
from functools import lru_cache
from pathlib import Path
from typing import BinaryIO
from zipfile import BadZipFile

from neo_ros.baking.keyframes import Photos
from neo_ros.errors import NeoError
from neo_ros.field.device import read_field
from neo_ros.field.radiance_field import RadianceField
from neo_ros.geometry import Intrinsics
from neo_ros.machine.files import whole_file
from neo_ros.scenes.posed_images import PosedImages
import numpy as np

_NONE = np.zeros((0, 1, 1, 3), np.uint8)


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
    def unpack(cls, field: Path, photos: PosedImages, scale: float, folder: Path
               ) -> 'SharedScene':
        """
        Write the photos' files, one photo after the other; NeoError where there is no room.

        They may be gigabytes: whole ones that a run left which was broken off are taken.
        """
        each, camera = range(len(photos)), photos.intrinsics.scaled(scale)
        return cls.of_rows(
            field, camera, photos.T_world_cam,
            (photos.read_image(index, scale) for index in each), (
                np.ones((camera.height, camera.width), bool) if one is None else one
                for one in (photos.read_usable(index, scale) for index in each))
            if any(photos.mask_paths) else None, folder)

    @classmethod
    def of_rows(cls, field: Path, camera: Intrinsics, T_world_cam: np.ndarray,
                images: Iterable[np.ndarray], usable: Iterable[np.ndarray] | None, folder: Path
                ) -> 'SharedScene':
        """Write photos of a camera, and which of their pixels are usable, one after the other."""
        shape = (len(T_world_cam), camera.height, camera.width)
        return cls(field.absolute(), Photos(_NONE, camera, T_world_cam),
                   _keep_rows(folder / 'images.npy', (*shape, 3), np.uint8, images),
                   None if usable is None else _keep_rows(
                       folder / 'usable.npy', shape, bool, usable))

    def read_photos(self) -> Photos:
        """Return the photos; their pixels are read when they are looked at."""
        return replace(self.photos, images=_mapped(self.images), usable=(
            None if self.usable is None else _mapped(self.usable)))

    def read_field(self) -> RadianceField:
        """Return the field; a worker reads it once for many jobs."""
        return _field(self.field, self.field.stat().st_mtime_ns)


def _mapped(path: Path) -> np.ndarray:
    # Kernels are compiled for arrays that can be written to, as others are that they are given.
    return np.asarray(np.load(path, mmap_mode='c'))


@lru_cache(maxsize=1)
def _field(path: Path, written: int) -> RadianceField:
    return read_field(path, 'cpu')


def keep_array(path: Path, array: np.ndarray) -> Path:
    """Write an array where workers find it; returns the absolute path."""
    path = path.absolute()
    with kept_file(path) as file:
        np.save(file, array)
    return path


def _keep_rows(path: Path, shape: tuple[int, ...], dtype: type, rows: Iterable[np.ndarray]
               ) -> Path:
    """Write an array row by row, as `keep_array` does, where it is not there."""
    path = path.absolute()
    with suppress(OSError, ValueError):
        there = _mapped(path)
        if (there.shape, there.dtype) == (shape, dtype):
            return path
    with suppress(OSError):  # There may be room for one; what is in the way is told below.
        path.unlink()
    with kept_file(path) as file:
        np.lib.format.write_array_header_1_0(file, {
            'descr': np.lib.format.dtype_to_descr(np.dtype(dtype)), 'fortran_order': False,
            'shape': shape})
        for row in rows:
            file.write(np.ascontiguousarray(row).data)
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
