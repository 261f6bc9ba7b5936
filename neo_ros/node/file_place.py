"""Where a file lies that a parameter names, in the ways of ROS."""
import os
from pathlib import Path
import sys
from urllib.parse import unquote

from ament_index_python.packages import get_package_share_directory, PackageNotFoundError
from neo_ros.errors import ConfigError
from neo_ros.machine.files import share_dir


def find_model(place: str) -> str:
    """Return the path of a model as `find_file` does; '' = the demo flat's."""
    return find_file('model', place) if place else str(share_dir() / 'models' / 'demo_flat.onnx')


def find_file(parameter: str, place: str) -> str:
    """
    Return a path: as it is, or of `~/...`, `file:///...`, `package://PACKAGE/...`.

    A package's files are those below its share folder. Raises ConfigError for another kind of
    address, and for a package or a user that does not exist.
    """
    scheme, mark, quoted = place.partition('://')
    if not mark:
        return _expand(parameter, place)
    rest = unquote(quoted)
    if scheme == 'file' and rest.startswith('/'):
        return rest
    if scheme != 'package':
        raise ConfigError(f'{parameter}: expected a path, file:///PATH or '
                          f'package://PACKAGE/PATH, got {place!r}')
    package, _, inside = rest.partition('/')
    # Nobody has set it where ROS comes from PyPI's wheels.
    os.environ['AMENT_PREFIX_PATH'] = os.environ.get('AMENT_PREFIX_PATH') or sys.prefix
    try:
        return str(Path(get_package_share_directory(package), inside))
    except (PackageNotFoundError, ValueError):
        raise ConfigError(f'{parameter}: there is no package {package!r} here (of {place!r}); is '
                          'its workspace sourced?') from None


def _expand(parameter: str, path: str) -> str:
    try:
        return str(Path(path).expanduser())
    except RuntimeError:
        raise ConfigError(f'{parameter}: expected the home of a user that exists, got '
                          f'{path!r}') from None
