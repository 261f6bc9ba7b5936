"""A camera's calibration from a file of its own: camera_calibration's YAML or transforms' keys."""
from pathlib import Path

from neo_ros.captures.nerfstudio import read_lens_keys
from neo_ros.errors import ConfigError, ImageRejected, SceneError
from neo_ros.geometry.lens import Lens
from neo_ros.messages import camera_info_of
from neo_ros.messages.camera_info import read_lens
from neo_ros.messages.camera_info_file import as_camera_info, read_yaml

_OPTION = '--camera-info'
_OR_KEYS = ' or the keys of a transforms.json (w, h, fl_x, fl_y, cx, cy, k1 ...)'


def read_camera_file(path: Path, image_topic: str = '') -> Lens:
    """
    Return the lens of the images on a topic; rectified images take the projection matrix.

    Raises SceneError that names what is missing.
    """
    where = f'{_OPTION} {path}'
    try:
        content = read_yaml(path)
        if (isinstance(content, dict) and {'w', 'h'} <= content.keys()
                and 'camera_matrix' not in content):
            return read_lens_keys(content, where)
        return read_lens(camera_info_of(as_camera_info(content, path, _OR_KEYS), image_topic))
    except ImageRejected as error:
        raise SceneError(f'{where}: {error}') from error
    except ConfigError as error:
        raise SceneError(f'{_OPTION} {error}') from error
