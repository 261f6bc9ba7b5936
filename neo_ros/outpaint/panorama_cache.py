"""Panoramas in files: for machines whose memory is small, and trainings that are broken off."""
from contextlib import suppress
from dataclasses import dataclass
import errno
import json
from pathlib import Path

from neo_ros.errors import NeoError
from neo_ros.field.panorama import Panorama
from neo_ros.geometry import Band
from neo_ros.machine.files import whole_file
import numpy as np

# Bytes before the image in its file.
HEADER = 128
TOO_MANY = (errno.EMFILE, errno.ENFILE)


@dataclass(frozen=True)
class DrawnPanorama:
    """A panorama, and the positions (3,) that were refused before it, with the reasons."""

    panorama: Panorama
    refused: list[tuple[str, np.ndarray]]


class PanoramaCache:
    """
    A folder of panoramas that holds at most `limit` bytes.

    Files appear whole or not at all, so a killed training loses the one that it was writing. They
    are read as the system pages them in, and each stays open: the process may then have as many
    files open as the system lets it. What an earlier training left above the limit is deleted.
    """

    def __init__(self, folder: Path, limit: float) -> None:
        self.folder, self.limit = folder, limit
        _allow_open_files()
        folder.mkdir(parents=True, exist_ok=True)
        for partial in folder.glob('*.partial'):
            partial.unlink()
        self.used = _size(*folder.iterdir())
        for path in sorted(folder.iterdir(), reverse=True):
            if self.used > limit:
                self.used -= _size(path)
                path.unlink()

    def read(self, index: int, band: Band, size: tuple[int, int]) -> DrawnPanorama | None:
        """
        Return panorama `index`, None where it is not there, damaged or of another (H, W).

        Raises NeoError where no more files can be open.
        """
        try:
            notes = json.loads(self._path(index, 'json').read_text())
            image = np.load(self._path(index, 'npy'), mmap_mode='r')
            if image.shape != (*size, 4) or image.dtype != np.uint8:
                return None
            return DrawnPanorama(
                Panorama(np.array(notes['position']), image, band, notes['opacity'],
                         notes['blocked']),
                [(reason, np.array(position)) for reason, position in notes['refused']])
        except (OSError, ValueError, EOFError, KeyError, TypeError) as error:
            if isinstance(error, OSError) and error.errno in TOO_MANY:
                raise self._cannot_keep(error) from error
            return None

    def write(self, index: int, drawn: DrawnPanorama) -> DrawnPanorama:
        """
        Keep panorama `index`; returns it as it is in the file, or as it came where that is full.

        Raises NeoError where it cannot be written.
        """
        panorama = drawn.panorama
        notes = json.dumps({
            'position': panorama.position.tolist(), 'opacity': panorama.opacity,
            'blocked': panorama.blocked,
            'refused': [(reason, position.tolist()) for reason, position in drawn.refused]})
        files = image_file, notes_file = self._path(index, 'npy'), self._path(index, 'json')
        others = self.used - _size(*files)
        if others + HEADER + panorama.image.nbytes + len(notes) > self.limit:
            return drawn
        try:
            # The notes come last: where they are, the image is whole, and theirs.
            notes_file.unlink(missing_ok=True)
            with whole_file(image_file) as partial, partial.open('wb') as file:
                np.save(file, panorama.image)
            with whole_file(notes_file) as partial:
                partial.write_text(notes)
        except OSError as error:
            raise self._cannot_keep(error) from error
        self.used = others + _size(*files)
        return self.read(index, panorama.band, panorama.image.shape[:2]) or drawn

    def _cannot_keep(self, error: OSError) -> NeoError:
        remedy = ('raise the limit of open files (ulimit -Hn)' if error.errno in TOO_MANY
                  else 'make room')
        return NeoError(f'{self.folder}: cannot keep panoramas: {error.strerror}; {remedy} and '
                        'start the training again, or lower --cache-gb')

    def _path(self, index: int, suffix: str) -> Path:
        return self.folder / f'{index:06d}.{suffix}'


def _allow_open_files() -> None:
    """Let the process have as many files open as it may; systems begin with 1024."""
    # Windows has no such limits; macOS may refuse what it calls its own.
    with suppress(ImportError, OSError, ValueError):
        import resource

        _, most = resource.getrlimit(resource.RLIMIT_NOFILE)
        resource.setrlimit(resource.RLIMIT_NOFILE, (most, most))


def _size(*files: Path) -> int:
    """Count the bytes of those files that are there."""
    return sum(path.stat().st_size for path in files if path.exists())
