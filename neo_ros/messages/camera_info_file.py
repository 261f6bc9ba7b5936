"""A camera's calibration from a file, as camera_calibration writes it (YAML)."""
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
        k, r, p = (_values(content, name, count) for name, count in _SHAPE.items())
        return SimpleNamespace(
            width=int(content['image_width']), height=int(content['image_height']), k=k, p=p,
            r=r, d=[float(value) for value in content['distortion_coefficients']['data']],
            distortion_model=str(content['distortion_model']), binning_x=0, binning_y=0, roi=roi)
    except KeyError as error:
        raise ConfigError(f'{path}: expected the key {error.args[0]}, got {_keys(content)}'
                          ) from error
    except (TypeError, ValueError) as error:
        raise ConfigError(f'{path}: {error}') from error


def _values(content: dict[str, Any], name: str, count: int) -> list[float]:
    if name != 'camera_matrix' and name not in content:
        return [0.0] * count
    values = [float(value) for value in content[name]['data']]
    if len(values) != count:
        raise ValueError(f'{name}: expected {count} numbers, got {len(values)}')
    return values


def _keys(content: Any) -> str:
    return ', '.join(map(str, content)) if isinstance(content, dict) else type(content).__name__
