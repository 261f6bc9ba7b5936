"""Write what an evaluation leaves behind, with errors that say what to do."""
import os
from pathlib import Path
import shutil
import tempfile

from neo_ros.errors import NeoError


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
    partial = path.with_name(f'{path.name}.partial')
    try:
        path.parent.mkdir(parents=True, exist_ok=True)
        try:
            partial.write_bytes(content)
            partial.replace(path)
        finally:
            partial.unlink(missing_ok=True)
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
            # A copy that was broken off must not be taken for the whole file.
            partial = target.with_name(f'{target.name}.partial')
            shutil.copyfile(source, partial)
            partial.replace(target)
    except OSError as error:
        raise _cannot_write(target, error) from error


def _cannot_write(path: Path, error: OSError) -> NeoError:
    return NeoError(f'{path}: cannot write: {error.strerror}; choose another output folder')
