"""Write what an evaluation leaves behind, with errors that say what to do."""
from pathlib import Path
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
    """Write a file and make the folders above it; raises NeoError with the reason."""
    try:
        path.parent.mkdir(parents=True, exist_ok=True)
        path.write_bytes(content)
    except OSError as error:
        raise _cannot_write(path, error) from error


def _cannot_write(path: Path, error: OSError) -> NeoError:
    return NeoError(f'{path}: cannot write: {error.strerror}; choose another output folder')
