"""A camera's calibration from a file, as camera_calibration writes it (YAML)."""
import math
from pathlib import Path
from types import SimpleNamespace
from typing import Any

from neo_ros.errors import ConfigError
import yaml

_SHAPE = {'camera_matrix': 9, 'rectification_matrix': 9, 'projection_matrix': 12}


def read_camera_info_file(path: Path) -> Any:
    """Return an object with the fields of a CameraInfo; raises ConfigError that names a lack."""
    return as_camera_info(read_yaml(path), path)


def read_yaml(path: Path) -> Any:
    """Return what a YAML file holds, or one of JSON; raises ConfigError."""
    try:
        return yaml.safe_load(path.read_text(encoding='utf-8'))
    except OSError as error:
        raise ConfigError(f'{path}: cannot read it: {error.strerror}') from error
    except (ValueError, yaml.YAMLError) as error:
        raise ConfigError(f'{path}: expected YAML or JSON: {error}') from error


def as_camera_info(content: Any, path: Path, other: str = '') -> Any:
    """
    Return what camera_calibration wrote as an object with the fields of a CameraInfo.

    Raises ConfigError that names a lack; other: what else the file at this path might have held.
    """
    if not isinstance(content, dict) or 'camera_matrix' not in content:
        raise ConfigError(
            f"{path}: expected camera_calibration's YAML (image_width, image_height, "
            f'camera_matrix, distortion_model, distortion_coefficients){other}, got '
            f'{_keys(content)}')
    roi = SimpleNamespace(x_offset=0, y_offset=0, width=0, height=0, do_rectify=False)
    try:
        k, r, p = (_values(content, name, count) if name in content else [0.0] * count
                   for name, count in _SHAPE.items())
        width, height = (_size(content, name) for name in ('image_width', 'image_height'))
        return SimpleNamespace(
            width=width, height=height, k=k, p=p, r=r,
            d=_values(content, 'distortion_coefficients'),
            distortion_model=str(content['distortion_model']), binning_x=0, binning_y=0, roi=roi)
    except KeyError as error:
        raise ConfigError(f'{path}: expected the key {error.args[0]}, got {_keys(content)}'
                          ) from error
    except ValueError as error:
        raise ConfigError(f'{path}: {error}') from error


def _size(content: dict[str, Any], name: str) -> int:
    size = content[name]
    if type(size) is not int or size <= 0:
        raise ValueError(f'{name}: expected a number of pixels, got {size!r:.40}')
    return size


def _values(content: dict[str, Any], name: str, count: int | None = None) -> list[float]:
    """Return so many numbers, any if None; raises ValueError and, without the key, KeyError."""
    part = content[name]
    try:  # YAML 1.1 takes 5e-05, which has no point, for a word.
        values = [float(value) for value in part['data']]
    except (KeyError, TypeError, ValueError):
        values = [math.nan]
    if not all(map(math.isfinite, values)):
        raise ValueError(f'{name}: expected finite numbers under the key data, got {part!r:.80}')
    if count is not None and len(values) != count:
        raise ValueError(f'{name}: expected {count} numbers, got {len(values)}')
    return values


def _keys(content: Any) -> str:
    return ', '.join(map(str, content)) if isinstance(content, dict) else type(content).__name__
