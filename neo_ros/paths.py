"""Where the package finds what it ships with, and how files come to be whole."""
from collections.abc import Iterator
from contextlib import contextmanager
import os
from pathlib import Path

from neo_ros.errors import NeoError

PACKAGE = 'neo_ros'


def share_dir() -> Path:
    """
    Return the folder that holds `models/`, `config/` and `launch/`.

    In a source checkout that is the repository; installed, it is share/neo_ros of the prefix
    above this file (pip), or of a prefix on AMENT_PREFIX_PATH (colcon). Raises NeoError where
    there is none.
    """
    here = Path(__file__).resolve()
    listed = os.environ.get('AMENT_PREFIX_PATH', '').split(os.pathsep)
    prefixes = [*here.parents[1:], *(Path(prefix) for prefix in listed if prefix)]
    for share in (here.parents[1], *(prefix / 'share' / PACKAGE for prefix in prefixes)):
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
