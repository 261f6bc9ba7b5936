"""Where the package finds the models, settings and launch files it ships with."""
from pathlib import Path
import sys

PACKAGE = 'neo_ros'


def share_dir() -> Path:
    """
    Return the folder that holds `models/`, `config/` and `launch/`.

    In a source checkout that is the repository; installed, it is the package's share folder of
    the ament prefix (colcon) or of the Python environment (pip).
    """
    checkout = Path(__file__).resolve().parent.parent
    if (checkout / 'package.xml').is_file():
        return checkout
    for prefix in _ament_prefixes():
        share = prefix / 'share' / PACKAGE
        if (share / 'package.xml').is_file():
            return share
    raise FileNotFoundError(
        f'{PACKAGE}: expected its share folder below AMENT_PREFIX_PATH or {sys.prefix}; '
        'reinstall the package')


def _ament_prefixes() -> list[Path]:
    import os
    listed = os.environ.get('AMENT_PREFIX_PATH', '').split(os.pathsep)
    return [Path(prefix) for prefix in listed if prefix] + [Path(sys.prefix)]
