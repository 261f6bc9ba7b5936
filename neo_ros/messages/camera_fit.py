"""From the camera that is there to the one that the model was trained with."""
from collections.abc import Hashable
from typing import Any

import cv2
from neo_ros.errors import ImageRejected
from neo_ros.geometry import Intrinsics, ViewExpansion
from neo_ros.geometry.lens import Lens
from neo_ros.messages.camera_info import (
    camera_info_fields, CENTRE, describe_camera, expand_camera_info, is_same_camera,
    read_camera_info, read_lens, read_matrix)
import numpy as np

# Pixels of the model's view that may lie outside the camera's, as a share of its side: what
# calibrations differ by. They repeat the edge.
SLACK = 0.01
# Above this ratio of focal lengths a plain interpolation skips pixels: shrink by area first.
SHRINK_ABOVE = 1.25
# Rows and columns of the grid on which a lens is checked.
CHECKED_PIXELS = 17
# How the note of a camera begins whose calibration nobody said.
NO_CAMERA_INFO = 'no camera_info: the camera is assumed to be'


class CameraFit:
    """
    How images of one camera become images of the model's.

    The model's own camera passes untouched. Another one is cropped and resampled where it sees
    all of the trained view; otherwise it is refused, because a network that sees another field
    of view than the trained one is wrong (the paper lost 5.3 dB). With `rectify` the distortion
    of the camera is taken out by the same interpolation.

    size: width and height of the images that it takes. camera_info: fields of the wide view's
    CameraInfo below the header. note: in words, what is done to the images.
    """

    def __init__(self, message: Any | None, expansion: ViewExpansion, rectify: bool) -> None:
        """
        Take a `sensor_msgs/CameraInfo`; without one, the image's size has to do.

        Raises ImageRejected('camera_info') for messages that describe no camera, for distortion
        without `rectify`, and ('camera') for a camera that does not see the trained view.
        """
        self._maps: tuple[np.ndarray, np.ndarray] | None = None
        self._shrunk: tuple[int, int] | None = None
        self._model = expansion.source
        self.note = f'{NO_CAMERA_INFO} {describe_camera(self._model)}'
        self.size = (self._model.width, self._model.height)
        if message is None:
            self.camera_info = camera_info_fields(expansion.target)
            return
        camera = read_camera_info(message, distorted=rectify)
        lens = read_lens(message)
        self.size = (camera.width, camera.height)
        self.note = 'as the model takes it'
        if lens.is_pinhole and is_same_camera(camera, self._model):
            self.camera_info = expand_camera_info(message, expansion)
            return
        rotation = np.eye(3)
        if not lens.is_pinhole:
            rotation = read_matrix(message.r, 'r', 9).reshape(3, 3)
            rotation = rotation if rotation.any() else np.eye(3)
        self._find_maps(lens, rotation)
        self.camera_info = self._resampled_info(message, camera, expansion, not lens.is_pinhole)

    def apply(self, image: np.ndarray) -> np.ndarray:
        """Return the model's view, uint8 RGB (h, w, 3), of an image of `size`."""
        if self._maps is None:
            return image
        if self._shrunk is not None:
            image = cv2.resize(image, self._shrunk, interpolation=cv2.INTER_AREA)
        return cv2.remap(image, *self._maps, cv2.INTER_LINEAR, borderMode=cv2.BORDER_REPLICATE)

    def _find_maps(self, lens: Lens, rotation: np.ndarray) -> None:
        model, camera = self._model, lens.intrinsics
        # Where each pixel of the model's view lies in the camera's image.
        across, down = lens.straighten_maps(model, rotation)
        outside = max(-across.min(), across.max() - (camera.width - 1),
                      -down.min(), down.max() - (camera.height - 1))
        if not outside <= SLACK * max(camera.width, camera.height) + CENTRE or not (
                lens.is_pinhole or _is_seen(model, lens, rotation)):
            raise ImageRejected(
                'camera', f'camera: the model expects {describe_camera(model)}, the camera is '
                f'{describe_camera(camera)} and does not see all of that; use a wider camera, or '
                'train a model for this one')
        self.note = (f'{"" if lens.is_pinhole else "rectified and "}resampled from '
                     f'{describe_camera(camera)}')
        shrink = min(camera.fx / model.fx, camera.fy / model.fy)
        if shrink > SHRINK_ABOVE:
            width, height = round(camera.width / shrink), round(camera.height / shrink)
            self._shrunk = (width, height)
            across = (across + CENTRE) * np.float32(width / camera.width) - CENTRE
            down = (down + CENTRE) * np.float32(height / camera.height) - CENTRE
        self._maps = cv2.convertMaps(across.astype(np.float32), down.astype(np.float32),
                                     cv2.CV_16SC2)

    def _resampled_info(self, message: Any, camera: Intrinsics, expansion: ViewExpansion,
                        rectified: bool) -> dict[str, Any]:
        """Describe the model's wide view; R and the stereo baseline of P are the camera's."""
        fields = camera_info_fields(expansion.target)
        p = read_matrix(message.p, 'p', 12)
        for index, focal, divisor in ((3, self._model.fx, p[0]), (7, self._model.fy, p[5])):
            # P[3] = -fx * baseline: with another fx it is another number.
            fields['p'][index] = p[index] * focal / divisor if divisor else 0.0
        # The image was turned into the rectified frame already; turning twice would be wrong.
        r = np.eye(3).reshape(-1) if rectified else read_matrix(message.r, 'r', 9)
        return fields | {'r': r}


def assumed_camera(note: str) -> str:
    """Return what a camera is taken for by the note of its fit; empty where it is known."""
    return f'{note}, without distortion' if note.startswith(NO_CAMERA_INFO) else ''


def camera_key(message: Any | None) -> Hashable:
    """Return what tells two CameraInfo messages apart, apart from their headers."""
    if message is None:
        return None
    roi = message.roi
    return (message.width, message.height, message.distortion_model, message.binning_x,
            message.binning_y, roi.x_offset, roi.y_offset, roi.width, roi.height,
            *(np.asarray(values, np.float64).tobytes()
              for values in (message.d, message.k, message.r, message.p)))


def _is_seen(model: Intrinsics, lens: Lens, rotation: np.ndarray) -> bool:
    """Say whether the lens shows the model's view, and does not fold other rays into it."""
    x = np.linspace(0, model.width - 1, CHECKED_PIXELS) + CENTRE
    y = np.linspace(0, model.height - 1, CHECKED_PIXELS) + CENTRE
    points = np.stack(np.meshgrid((x - model.cx) / model.fx, (y - model.cy) / model.fy), -1)
    rays = np.concatenate([points, np.ones((*points.shape[:2], 1))], -1).reshape(-1, 3) @ rotation
    if not (rays[:, 2] > 0).all():
        return False
    tolerance = (1 + SLACK * model.width) / max(model.fx, model.fy)
    return lens.sees(rays[:, :2] / rays[:, 2:], tolerance)
