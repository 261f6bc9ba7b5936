"""Read the files that make a model: regular ones of sensible size, each of them once."""
from io import BufferedReader
import os
from pathlib import Path
import stat

from neo_ros.errors import ModelError

# Far above any model of ours: what is larger would only fill a robot's memory.
MAX_BYTES = 1 << 30


def read_model_bytes(path: Path, what: str = 'model') -> bytes:
    """
    Return the bytes of a file; `what` is what it is called in messages.

    Raises ModelError as `open_model_file` does, and where the file cannot be read.
    """
    with open_model_file(path, what) as file:
        try:
            # Not as much as may be: Python makes room for all that is asked for.
            return file.read(os.fstat(file.fileno()).st_size)
        except OSError as error:
            raise ModelError(f'{path}: cannot read the {what}: {error.strerror}') from error


def open_model_file(path: Path, what: str, most_bytes: int = MAX_BYTES) -> BufferedReader:
    """
    Open a file to read; `what` is what it is called in messages.

    Raises ModelError for a file that is missing, empty, larger than `most_bytes`, or no regular
    one: a pipe or device could never end. A symbolic link is followed.
    """
    try:
        # Without O_NONBLOCK, opening a pipe would wait for a writer.
        descriptor = os.open(path, os.O_RDONLY | os.O_NONBLOCK)
    except FileNotFoundError:
        raise ModelError(f'{path}: no such {what} file') from None
    except ValueError as error:
        raise ModelError(f'{path!s:.200}: cannot read the {what}: {error}') from None
    except OSError as error:
        raise ModelError(f'{path}: cannot read the {what}: {error.strerror}') from error
    try:
        found = os.fstat(descriptor)
        if not stat.S_ISREG(found.st_mode):
            raise ModelError(f'{path}: cannot read the {what}: expected a regular file')
        if found.st_size == 0:
            raise ModelError(f'{path}: expected a {what}, the file is empty')
        if found.st_size > most_bytes:
            raise ModelError(f'{path}: expected a {what} of at most {most_bytes >> 20} MB, '
                             f'got {found.st_size >> 20} MB')
        return os.fdopen(descriptor, 'rb')
    except BaseException:
        os.close(descriptor)
        raise
