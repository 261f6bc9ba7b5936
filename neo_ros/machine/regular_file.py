"""Read the files that make a model: regular ones of sensible size, each of them once."""
import os
from pathlib import Path
import stat

from neo_ros.errors import ModelError

# Far above any model of ours: what is larger would only fill a robot's memory.
MAX_BYTES = 1 << 30


def read_model_bytes(path: Path, what: str = 'model') -> bytes:
    """
    Return the bytes of a file; `what` is what it is called in messages.

    Raises ModelError for a file that is missing, empty, larger than MAX_BYTES, or no regular
    one: a pipe or device could never end. A symbolic link is followed.
    """
    try:
        # Without O_NONBLOCK, opening a pipe would wait for a writer.
        descriptor = os.open(path, os.O_RDONLY | os.O_NONBLOCK)
        with os.fdopen(descriptor, 'rb') as file:
            found = os.fstat(descriptor)
            if not stat.S_ISREG(found.st_mode):
                raise ModelError(f'{path}: cannot read the {what}: expected a regular file')
            if found.st_size == 0:
                raise ModelError(f'{path}: expected a {what}, the file is empty')
            if found.st_size > MAX_BYTES:
                raise ModelError(f'{path}: expected a {what} of at most {MAX_BYTES >> 20} MB, '
                                 f'got {found.st_size >> 20} MB')
            return file.read(MAX_BYTES)
    except FileNotFoundError:
        raise ModelError(f'{path}: no such {what} file') from None
    except ValueError as error:
        if isinstance(error, ModelError):
            raise
        raise ModelError(f'{path!s:.200}: cannot read the {what}: {error}') from None
    except OSError as error:
        raise ModelError(f'{path}: cannot read the {what}: {error.strerror}') from error
