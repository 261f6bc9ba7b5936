"""Camera messages for tests, without ROS."""
from types import SimpleNamespace

from neo_ros.geometry import Intrinsics
from neo_ros.messages import camera_info_fields, image_fields
import numpy as np


def noise_image(intrinsics: Intrinsics, seed: int) -> np.ndarray:
    """Return uint8 RGB noise of a camera's size."""
    return np.random.default_rng(seed).integers(
        0, 256, (intrinsics.height, intrinsics.width, 3), np.uint8)


def image_message(image: np.ndarray, header: object = None, **changes: object) -> SimpleNamespace:
    """Return something with the fields of sensor_msgs/Image."""
    return SimpleNamespace(header=header or header_without_a_clock(),
                           **(image_fields(image) | changes))


def header_without_a_clock(frame_id: object = '') -> SimpleNamespace:
    """Return something with the fields of std_msgs/Header, as of a camera that knows no time."""
    return SimpleNamespace(stamp=SimpleNamespace(sec=0, nanosec=0), frame_id=frame_id)


def camera_info_message(intrinsics: Intrinsics, **changes: object) -> SimpleNamespace:
    """Return something with the fields of sensor_msgs/CameraInfo."""
    roi = SimpleNamespace(x_offset=0, y_offset=0, width=0, height=0, do_rectify=False)
    fields = camera_info_fields(intrinsics) | {'roi': roi, 'binning_x': 0, 'binning_y': 0}
    return SimpleNamespace(**(fields | changes))
