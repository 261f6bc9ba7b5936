"""From one camera message to the content of the wide messages: the node's and the replay's way."""
from dataclasses import dataclass
import time
from typing import Any, Protocol

from neo_ros.errors import ImageRejected
from neo_ros.geometry import ViewExpansion
from neo_ros.messages.camera_info import (
    camera_info_fields, check_same_camera, expand_camera_info, read_camera_info)
from neo_ros.messages.image import read_image
import numpy as np


class View(Protocol):
    """A widened image and how sure the model is of its pixels, as in runtime's WideView."""

    @property
    def wide_image(self) -> np.ndarray:
        """Uint8 RGB (H, W, 3)."""

    @property
    def confidence(self) -> np.ndarray:
        """Uint8 (H, W), 255 = sure."""


class Extrapolator(Protocol):
    """What is needed of a FovExtrapolator."""

    @property
    def expansion(self) -> ViewExpansion:
        """The source and target views of the model."""

    def expand(self, image: np.ndarray) -> View:
        """Widen one camera image, uint8 RGB (h, w, 3)."""


@dataclass(frozen=True)
class WideFrame:
    """
    The outputs of one frame.

    image: uint8 RGB (H, W, 3) and confidence: uint8 (H, W), 255 = sure; None where the network
    did not run. extrapolated_mask: uint8 (H, W), 255 = made up by the model. camera_info: the
    fields of the wide CameraInfo. stages_ms: milliseconds spent in 'decode' and 'infer'.
    """

    image: np.ndarray | None
    confidence: np.ndarray | None
    extrapolated_mask: np.ndarray
    camera_info: dict[str, Any]
    stages_ms: dict[str, float]


class FrameProcessor:
    """Checks and decodes a frame, widens it, and says how long that took."""

    def __init__(self, extrapolator: Extrapolator) -> None:
        self._extrapolator = extrapolator
        self._expansion = extrapolator.expansion
        self._mask = np.where(self._expansion.extrapolated_mask, 255, 0).astype(np.uint8)

    def process(self, image_message: Any, camera_info_message: Any | None,
                infer: bool = True) -> WideFrame:
        """
        Return the outputs for a `sensor_msgs/Image` and its `CameraInfo`, if known.

        Without a CameraInfo the image's size has to do, and the wide camera is the one that the
        model was trained with. With `infer` False the frame is checked, but not widened.
        Raises ImageRejected with the reasons of `read_image`, and 'size', 'camera_info' or
        'camera' for another camera than the model's.
        """
        started = time.perf_counter()
        self._check_size(image_message)
        image = read_image(image_message)
        camera_info = self._camera_info(camera_info_message)
        decoded = time.perf_counter()
        wide = self._extrapolator.expand(image) if infer else None
        inferred = time.perf_counter()
        return WideFrame(
            image=wide.wide_image if wide else None,
            confidence=wide.confidence if wide else None,
            extrapolated_mask=self._mask, camera_info=camera_info,
            stages_ms={'decode': 1e3 * (decoded - started), 'infer': 1e3 * (inferred - decoded)})

    def _check_size(self, message: Any) -> None:
        source = self._expansion.source
        if (message.width, message.height) != (source.width, source.height):
            raise ImageRejected(
                'size', f'size: the model takes {source.width}x{source.height}, the image is '
                f'{message.width}x{message.height}; resize it, or train a model for this camera')

    def _camera_info(self, message: Any | None) -> dict[str, Any]:
        if message is None:
            return camera_info_fields(self._expansion.target)
        check_same_camera(read_camera_info(message), self._expansion.source)
        return expand_camera_info(message, self._expansion)
