"""From one camera message to the content of the wide messages: the node's and the replay's way."""
from collections.abc import Hashable
from dataclasses import dataclass
import threading
import time
from typing import Any, Protocol

import cv2
from neo_ros.errors import ImageRejected
from neo_ros.geometry import CameraPose, Intrinsics, ViewExpansion
from neo_ros.messages.camera_fit import camera_key, CameraFit
from neo_ros.messages.compressed_image import compressed_size, read_compressed_image
from neo_ros.messages.image import read_image
from neo_ros.messages.stamps import NS_PER_S, stamp_of
import numpy as np


class Guide(Protocol):
    """What the scene memory knows of a frame, as memory's Guide."""

    @property
    def pose(self) -> CameraPose:
        """Where the camera is in the scene."""

    @property
    def covariance(self) -> np.ndarray:
        """Of the pose, float64 (6, 6), see memory's Guide."""

    @property
    def agreement(self) -> float:
        """Correlation of memory and image, in [-1, 1]."""

    @property
    def found(self) -> str:
        """What the pose comes from."""

    @property
    def landmarks(self) -> int:
        """How many of them were matched with this image."""

    def trusted_depth(self, wide_image: np.ndarray, confidence: np.ndarray) -> np.ndarray:
        """Return float32 (H, W), metres along the optical axis, NaN = unknown."""

    def panorama(self, wide_image: np.ndarray, width: int) -> Any:
        """Draw the whole sphere, see memory's Panorama."""


class Hints(Protocol):
    """Where the camera may be, as `hints.PoseHints`."""

    def take_prior(self) -> CameraPose | None:
        """Return where somebody says that the camera is, once."""

    def motion(self, from_ns: int, to_ns: int) -> np.ndarray | None:
        """Return how the camera has moved between two stamps, (4, 4)."""


class View(Protocol):
    """A widened image and how sure the model is of its pixels, as in runtime's WideView."""

    @property
    def wide_image(self) -> np.ndarray:
        """Uint8 RGB (H, W, 3)."""

    @property
    def confidence(self) -> np.ndarray:
        """Uint8 (H, W), 255 = sure."""

    @property
    def guided(self) -> bool:
        """Whether the scene memory knew where the camera is."""

    @property
    def guide(self) -> Guide | None:
        """What it knows; None while the network works alone."""

    @property
    def ambiguous(self) -> bool:
        """Whether the network works alone because several places look like the image."""


class SceneScorer(Protocol):
    """Tells images of the trained scene from others, as runtime's SceneCheck does."""

    def score(self, image: np.ndarray, confidence: np.ndarray) -> float:
        """Return 0 for an image of the scene, up to 1 for anything else."""


class Extrapolator(Protocol):
    """What is needed of a FovExtrapolator."""

    @property
    def expansion(self) -> ViewExpansion:
        """The source and target views of the model."""

    @property
    def scene_check(self) -> SceneScorer | None:
        """What knows the scene; None where the model's card holds no reference."""

    def expand(self, image: np.ndarray, prior: CameraPose | None = None,
               motion: np.ndarray | None = None, pace: float = 1.0,
               stamp_ns: int | None = None) -> View:
        """Widen one camera image, uint8 RGB (h, w, 3); hints: where and when it may be from."""

    def reset(self) -> None:
        """Forget where the camera was."""


@dataclass(frozen=True)
class WideFrame:
    """
    The outputs of one frame.

    image: uint8 RGB (H, W, 3) and confidence: uint8 (H, W), 255 = sure; None where the network
    did not run. extrapolated_mask: uint8 (H, W), 255 = made up by the model. camera_info: the
    fields of the wide CameraInfo. out_of_scene: 0 = an image of the trained scene, 1 = nothing
    like it; None where the network did not run or its card holds no reference. guided: the scene
    memory knew where the camera is. camera_note: what was done to the image to make it the
    model's view. stages_ms: milliseconds spent in 'decode', 'infer' and 'check'. view: the wide
    camera, pixels. guide: what the memory knows; it computes what it is asked for. ambiguous: it
    knows several places that look like this, and not which one it is.
    """

    image: np.ndarray | None
    confidence: np.ndarray | None
    extrapolated_mask: np.ndarray
    camera_info: dict[str, Any]
    out_of_scene: float | None
    guided: bool
    camera_note: str
    stages_ms: dict[str, float]
    view: Intrinsics
    guide: Guide | None = None
    ambiguous: bool = False


@dataclass(frozen=True)
class PaceThresholds:
    """When stamps say that images are missing between two of them."""

    # Times between images that differ by less of the time before are one pace: the stamps of
    # cameras are not exact to some milliseconds, and a camera in step is to give the same bits.
    least: float = 0.25
    # After so many times as long a robot may have done anything.
    most: float = 4.0
    # After so long it may be anywhere: nobody follows a camera that was carried meanwhile. Not
    # measured; a search costs 0.2 s, a place that is kept wrongly costs the whole view.
    longest_s: float = 30.0
    # Time that runs back by more has begun anew, as `node.robot_frames.ANEW`: a bag that is played
    # again. Less is images that overtook one another.
    back_s: float = 1.0


class FrameProcessor:
    """
    Checks and decodes a frame, widens it, and says how long that took.

    `rectify`, which may change at any time, takes the distortion out of the images first; `hints`
    say where the camera may be. One
    frame at a time: a second thread waits, because an extrapolator serves one only.
    """

    def __init__(self, extrapolator: Extrapolator, rectify: bool = False,
                 pace: PaceThresholds = PaceThresholds()) -> None:
        self.rectify = rectify
        self.hints: Hints | None = None
        self._pace_limits = pace
        self._stamp_ns: int | None = None
        self._interval_ns = 0  # From the image before the last one to that one.
        self._extrapolator = extrapolator
        self._expansion = extrapolator.expansion
        self._mask = np.where(self._expansion.extrapolated_mask, 255, 0).astype(np.uint8)
        self._fit: tuple[Hashable, CameraFit] | None = None
        self._busy = threading.Lock()

    def reset(self) -> None:
        """Forget where the camera was; the next image may be from anywhere."""
        with self._busy:
            self._forget()

    def _forget(self) -> None:
        self._stamp_ns, self._interval_ns = None, 0
        self._extrapolator.reset()

    def process(self, image_message: Any, camera_info_message: Any | None,
                infer: bool = True) -> WideFrame:
        """
        Return the outputs for a `sensor_msgs/Image` or `CompressedImage` and its `CameraInfo`.

        Without a CameraInfo the image's size has to do, and the wide camera is the one that the
        model was trained with. Another camera is cropped and resampled, see `CameraFit`. The
        confidence of what the model made up sinks for images unlike the trained scene. With
        `infer` False the frame is checked, but not widened.
        Raises ImageRejected with the reasons of `read_image` or `read_compressed_image`, and
        'size', 'camera_info' or 'camera' for another camera than the model's.
        """
        with self._busy:
            return self._process(image_message, camera_info_message, infer)

    def _process(self, image_message: Any, camera_info_message: Any | None,
                 infer: bool) -> WideFrame:
        started = time.perf_counter()
        fit = self._find_fit(camera_info_message)
        image = fit.apply(self._read(image_message, fit, camera_info_message is not None))
        decoded = checked = inferred = time.perf_counter()
        wide = confidence = score = None
        if infer:
            wide = self._extrapolator.expand(image, **self._take_hints(image_message))
            inferred = time.perf_counter()
            score = self._score(image, wide)
            confidence = self._lowered(wide.confidence, score or 0.0)
            checked = time.perf_counter()
        return WideFrame(
            image=wide.wide_image if wide else None, confidence=confidence,
            extrapolated_mask=self._mask, camera_info=fit.camera_info, out_of_scene=score,
            guided=wide is not None and wide.guided, camera_note=fit.note,
            stages_ms={'decode': 1e3 * (decoded - started), 'infer': 1e3 * (inferred - decoded),
                       'check': 1e3 * (checked - inferred)},
            view=self._expansion.target, guide=wide.guide if wide else None,
            ambiguous=wide is not None and wide.ambiguous)

    def _take_hints(self, message: Any) -> dict[str, Any]:
        header = getattr(message, 'header', None)
        if header is None:  # Pixels alone, as of an evaluation.
            return {}
        now = stamp_of(header)
        if self._begins_anew(now):
            self._forget()
        before, self._stamp_ns = self._stamp_ns, now
        found: dict[str, Any] = {
            'pace': self._pace(now - before if before is not None else 0), 'stamp_ns': now}
        if self.hints is not None:
            found |= {'prior': self.hints.take_prior(), 'motion': (
                None if before is None else self.hints.motion(before, now))}
        return {name: hint for name, hint in found.items() if hint is not None}

    def _begins_anew(self, now_ns: int) -> bool:
        """Say whether the stamps tell of a pause after which the camera may be anywhere."""
        if self._stamp_ns is None:
            return False
        passed_s, limits = (now_ns - self._stamp_ns) / NS_PER_S, self._pace_limits
        return not -limits.back_s <= passed_s <= limits.longest_s

    def _pace(self, interval_ns: int) -> float | None:
        """Return by how much an interval is longer than the one before; None: about as long."""
        last, self._interval_ns = self._interval_ns, interval_ns
        if min(last, interval_ns) <= 0:
            return None
        pace, limits = interval_ns / last, self._pace_limits
        steady = abs(pace - 1) < limits.least or not 1 / limits.most <= pace <= limits.most
        return None if steady else pace

    def _find_fit(self, message: Any | None) -> CameraFit:
        key = (self.rectify, camera_key(message))
        if self._fit is None or self._fit[0] != key:
            self._fit = (key, CameraFit(message, self._expansion, key[0]))
        return self._fit[1]

    def _read(self, message: Any, fit: CameraFit, announced: bool) -> np.ndarray:
        compressed = hasattr(message, 'format')
        # Before decoding: a file of some kilobytes may claim any size.
        size = compressed_size(message) if compressed else (message.width, message.height)
        if size != fit.size:
            source = self._expansion.source
            raise ImageRejected(
                'size', f'size: the image is {size[0]}x{size[1]}, the camera_info says '
                f'{fit.size[0]}x{fit.size[1]}' if announced else
                f'size: the model takes {source.width}x{source.height}, the image is '
                f'{size[0]}x{size[1]}; resize it, publish its camera_info, or train a model for '
                'this camera')
        return read_compressed_image(message) if compressed else read_image(message)

    def _score(self, image: np.ndarray, wide: View) -> float | None:
        if wide.guided:
            return 0.0  # The image agrees with the memory of the scene.
        check = self._extrapolator.scene_check
        return check.score(image, wide.confidence) if check is not None else None

    def _lowered(self, confidence: np.ndarray, score: float) -> np.ndarray:
        """Return the confidence times (1 - score) where the camera did not see."""
        if score == 0:
            return confidence
        lowered = cv2.convertScaleAbs(confidence, alpha=1 - score)
        seen = self._expansion.observed
        lowered[seen] = confidence[seen]
        return lowered
