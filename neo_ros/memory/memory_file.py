"""
The file of a scene memory: what is in it is checked, and its keyframes stay in it.

A memory of a building has more keyframes than a robot has room for: each is read when it is
drawn, and the system keeps those it has memory for.
"""
from collections.abc import Iterator, Mapping, Sequence
from contextlib import contextmanager
import hashlib
from io import BufferedReader
import os
from pathlib import Path
import struct
from typing import Any
import weakref
from zipfile import ZIP_STORED, ZipFile

from neo_ros.errors import ModelError
from neo_ros.machine.regular_file import open_model_file
import numpy as np

# Far above the memory of a building: what is larger would only fill a robot's disk.
MOST_BYTES = 1 << 34
MOST_ARRAY = 1 << 30  # Of what is kept in memory.
# A size in the file that may be any but 0.
ANY = -1
# Before the name of a file in an archive; its last four bytes tell how long name and extra are.
_ZIP_HEADER = 30


class Pieces(Sequence[bytes]):
    """Pieces of an open file that follow one another, read when they are asked for."""

    def __init__(self, file: BufferedReader, path: Path, start: int, sizes: np.ndarray) -> None:
        self._file, self._path = os.dup(file.fileno()), path
        self._ends, self._sizes = start + np.cumsum(sizes), sizes
        self._as_opened = self._stamp()
        weakref.finalize(self, os.close, self._file)

    def __len__(self) -> int:
        """Return how many there are."""
        return len(self._sizes)

    def __getitem__(self, index: Any) -> Any:
        """Return the bytes of one; raises ModelError where the file is another one by now."""
        size = int(self._sizes[index])
        content = os.pread(self._file, size, int(self._ends[index]) - size)
        if self._stamp() != self._as_opened:
            raise ModelError(f'{self._path}: the scene memory was changed while it was in use; '
                             'load the model again, and put new files in the place of old ones '
                             'by renaming them')
        return content

    def _stamp(self) -> tuple[int, int]:
        found = os.fstat(self._file)
        return found.st_size, found.st_mtime_ns


class MemoryFields:
    """The arrays in the file of a scene memory; raises ValueError for what is not as expected."""

    def __init__(self, arrays: Mapping[str, np.ndarray], archive: ZipFile, file: BufferedReader,
                 path: Path) -> None:
        self._arrays, self._archive, self._file, self._path = arrays, archive, file, path

    def __contains__(self, name: str) -> bool:
        """Tell whether there is an array of this name."""
        return name in self._arrays

    def read(self, name: str, dtype: type, shape: tuple[int, ...]) -> np.ndarray:
        """Return an array of finite numbers of this dtype and shape; ANY: of one or more."""
        if f'{name}.npy' in self._archive.NameToInfo and (
                self._archive.getinfo(f'{name}.npy').file_size > MOST_ARRAY):
            raise ValueError(f'{name}: expected at most {MOST_ARRAY >> 20} MB')
        found = self._arrays[name]
        _check(name, found.dtype, found.shape, dtype, shape)
        if found.dtype.kind == 'f' and not np.isfinite(found).all():
            raise ValueError(f'{name}: expected finite numbers')
        return found

    def pieces(self, name: str, count: int) -> Pieces:
        """Return the pieces that an array of bytes is put together from, left in the file."""
        sizes = self.read(f'{name}_sizes', np.int64, (count,))
        item = self._archive.getinfo(f'{name}s.npy')
        self._file.seek(item.header_offset + _ZIP_HEADER - 4)
        self._file.seek(sum(struct.unpack('<HH', self._file.read(4))), os.SEEK_CUR)
        np.lib.format.read_magic(self._file)
        shape, _, dtype = np.lib.format.read_array_header_1_0(self._file)
        _check(f'{name}s', dtype, shape, np.uint8, (ANY,))
        length, start = shape[0], self._file.tell()
        if start + length > os.fstat(self._file.fileno()).st_size:
            raise ValueError(f'{name}s: expected {length} bytes, the file ends before')
        if sizes.min() < 1 or sizes.max() > length or sizes.sum() != length:
            raise ValueError(
                f'{name}_sizes: expected sizes that add up to {length} bytes')
        return Pieces(self._file, self._path, start, sizes)


def _check(name: str, dtype: np.dtype, shape: tuple[int, ...], expected: type,
           sizes: tuple[int, ...]) -> None:
    """Raise ValueError unless an array has this dtype and these sizes; ANY: of one or more."""
    if dtype != expected or len(shape) != len(sizes) or not all(
            size == wanted or (wanted == ANY and size > 0)
            for size, wanted in zip(shape, sizes)):
        raise ValueError(f'{name}: expected {np.dtype(expected)} {sizes}, got {dtype} '
                         f'{shape}'.replace(str(ANY), 'any'))


@contextmanager
def open_memory_file(path: Path, sha256: str) -> Iterator[MemoryFields]:
    """
    Open what `write_memory_file` wrote, and only that.

    Raises ModelError as `open_model_file` does, when it is not the file that `sha256` tells of,
    and for whatever is raised while it is open.
    """
    try:
        file = open_model_file(path, 'scene memory', MOST_BYTES)
    except ModelError as error:
        raise ModelError(f'{error}; copy it again and keep it beside the model file') from None
    with file:
        found = hashlib.file_digest(file, 'sha256').hexdigest()
        if found != sha256:
            raise ModelError(f'{path}: expected the scene memory with sha256 {sha256}, as the '
                             f'model card says, got {found}; copy model and memory together')
        try:
            with ZipFile(file) as archive:
                # What is packed could unpack to more than fits in memory.
                if any(item.compress_type != ZIP_STORED for item in archive.infolist()):
                    raise ValueError('its arrays are packed')
                file.seek(0)
                with np.load(file, allow_pickle=False) as arrays:
                    yield MemoryFields(arrays, archive, file, path)
        except ModelError:
            raise
        except Exception as error:  # zipfile and numpy raise a dozen types.
            raise ModelError(f'{path}: expected a scene memory: {error}; export it again'
                             ) from error
