"""A camera's calibration from a file of its own: camera_calibration's YAML or transforms' keys."""
from pathlib import Path
from types import SimpleNamespace
from typing import Any

from neo_ros.captures.nerfstudio import read_lens_keys
from neo_ros.errors import ImageRejected, SceneError
from neo_ros.geometry.lens import Lens
from neo_ros.messages import camera_info_of
from neo_ros.messages.camera_info import read_lens
import yaml

_OPTION = '--camera-info'
_SHAPE = {'camera_matrix': 9, 'rectification_matrix': 9, 'projection_matrix': 12}


def read_camera_file(path: Path, image_topic: str = '') -> Lens:
    """
    Return the lens of the images on a topic; rectified images take the projection matrix.

    Raises SceneError that names what is missing.
    """
    where = f'{_OPTION} {path}'
    try:
        # JSON is YAML, too.
        content = yaml.safe_load(path.read_text(encoding='utf-8'))
    except OSError as error:
        raise SceneError(f'{where}: cannot read it: {error.strerror}') from error
    except (ValueError, yaml.YAMLError) as error:
        raise SceneError(f'{where}: expected YAML or JSON: {error}') from error
    if isinstance(content, dict) and 'camera_matrix' in content:
        try:
            return read_lens(camera_info_of(_as_camera_info(content, where), image_topic))
        except ImageRejected as error:
            raise SceneError(f'{where}: {error}') from error
    if isinstance(content, dict) and {'w', 'h'} <= content.keys():
        return read_lens_keys(content, where)
    raise SceneError(
        f"{where}: expected camera_calibration's YAML (image_width, image_height, camera_matrix, "
        'distortion_model, distortion_coefficients) or the keys of a transforms.json (w, h, fl_x, '
        f'fl_y, cx, cy, k1 ...), got {_keys(content)}')


def _as_camera_info(content: dict[str, Any], where: str) -> Any:
    """Return an object with the fields of a CameraInfo."""
    roi = SimpleNamespace(x_offset=0, y_offset=0, width=0, height=0, do_rectify=False)
    try:
        k, r, p = (_values(content, name, count) for name, count in _SHAPE.items())
        return SimpleNamespace(
            width=int(content['image_width']), height=int(content['image_height']), k=k, p=p,
            r=r, d=[float(value) for value in content['distortion_coefficients']['data']],
            distortion_model=str(content['distortion_model']), binning_x=0, binning_y=0, roi=roi)
    except KeyError as error:
        raise SceneError(f'{where}: expected the key {error.args[0]}, got {_keys(content)}'
                         ) from error
    except (TypeError, ValueError) as error:
        raise SceneError(f'{where}: {error}') from error


def _values(content: dict[str, Any], name: str, count: int) -> list[float]:
    if name != 'camera_matrix' and name not in content:
        return [0.0] * count
    values = [float(value) for value in content[name]['data']]
    if len(values) != count:
        raise ValueError(f'{name}: expected {count} numbers, got {len(values)}')
    return values


def _keys(content: Any) -> str:
    return ', '.join(map(str, content)) if isinstance(content, dict) else type(content).__name__
