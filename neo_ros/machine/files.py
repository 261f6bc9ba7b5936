"""Where the package finds what it ships with, and how files come to be whole, or say why not."""
from collections.abc import Iterator
from contextlib import contextmanager
import errno
import hashlib
import os
from pathlib import Path
import shutil
import tempfile

from neo_ros.errors import NeoError

PACKAGE = 'neo_ros'
# The disk is, or what a user may have of it.
FULL = {errno.ENOSPC, errno.EDQUOT}


def share_dir() -> Path:
    """
    Return the folder that holds `models/`, `config/` and `launch/`.

    In a source checkout that is the repository; installed, it is share/neo_ros of the prefix
    above this file (pip), or of a prefix on AMENT_PREFIX_PATH (colcon). Raises NeoError where
    there is none.
    """
    here = Path(__file__).resolve()
    listed = os.environ.get('AMENT_PREFIX_PATH', '').split(os.pathsep)
    prefixes = [*here.parents[2:], *(Path(prefix) for prefix in listed if prefix)]
    for share in (here.parents[2], *(prefix / 'share' / PACKAGE for prefix in prefixes)):
        if (share / 'package.xml').is_file():
            return share
    raise NeoError(f'{PACKAGE}: expected share/{PACKAGE} in a prefix above {here} or on '
                   'AMENT_PREFIX_PATH; install the package again')


@contextmanager
def whole_file(path: Path) -> Iterator[Path]:
    """
    Yield the name to write a file under, which takes the name `path` once it is whole.

    An error, a kill or a full disk in between leaves what was at `path`. Errors pass through.
    """
    partial = path.with_name(f'{path.name}.partial')
    try:
        yield partial
        partial.replace(path)
    finally:
        partial.unlink(missing_ok=True)


def see_to_disk(path: Path) -> None:
    """Wait until a file, or the names in a folder, would outlive a power cut; raises OSError."""
    descriptor = os.open(path, os.O_RDONLY)
    try:
        os.fsync(descriptor)
    except OSError as error:
        if error.errno != errno.EINVAL:  # A file system that cannot do it for this.
            raise
    finally:
        os.close(descriptor)


def make_output_folder(folder: Path) -> Path:
    """
    Make a folder, and prove that files can be written to it, before the long work starts.

    Raises NeoError with the reason.
    """
    try:
        folder.mkdir(parents=True, exist_ok=True)
        with tempfile.TemporaryFile(dir=folder):
            pass
    except OSError as error:
        raise _cannot_write(folder, error) from error
    return folder


def write_bytes(path: Path, content: bytes) -> None:
    """
    Write a file, whole or not at all, and make the folders above it.

    Raises NeoError with the reason.
    """
    try:
        path.parent.mkdir(parents=True, exist_ok=True)
        with whole_file(path) as partial:
            partial.write_bytes(content)
    except OSError as error:
        raise _cannot_write(path, error) from error


def sha256_of(path: Path) -> str:
    """Return the SHA-256 of a file, hex digits; it is never wholly in memory."""
    with path.open('rb') as file:
        return hashlib.file_digest(file, 'sha256').hexdigest()


def share_file(source: Path, target: Path) -> None:
    """
    Make a large file appear in another folder, too, or copy it where the disk cannot.

    What was at `target` is replaced. Raises NeoError with the reason.
    """
    try:
        target.unlink(missing_ok=True)
        try:
            # Of a relative symbolic link the file: the link would lead nowhere from there.
            os.link(os.path.realpath(source), target)
        except OSError:
            with whole_file(target) as partial:
                shutil.copyfile(source, partial)
    except OSError as error:
        raise _cannot_write(target, error) from error


def what_to_do(error: OSError, otherwise: str) -> str:
    """Return what a user can do where a file cannot be written."""
    return 'make room, and give the same command again' if error.errno in FULL else otherwise


def _cannot_write(path: Path, error: OSError) -> NeoError:
    advice = what_to_do(error, 'choose another output folder')
    return NeoError(f'{path}: cannot write: {error.strerror}; {advice}')
