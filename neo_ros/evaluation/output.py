"""Write what an evaluation leaves behind, with errors that say what to do."""
import os
from pathlib import Path
import shutil
import tempfile

from neo_ros.errors import NeoError
from neo_ros.paths import whole_file


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


def share_file(source: Path, target: Path) -> None:
    """
    Make a large file appear in another folder, too, or copy it where the disk cannot.

    What was at `target` is replaced. Raises NeoError with the reason.
    """
    try:
        target.unlink(missing_ok=True)
        try:
            os.link(source, target)
        except OSError:
            with whole_file(target) as partial:
                shutil.copyfile(source, partial)
    except OSError as error:
        raise _cannot_write(target, error) from error


def _cannot_write(path: Path, error: OSError) -> NeoError:
    return NeoError(f'{path}: cannot write: {error.strerror}; choose another output folder')
