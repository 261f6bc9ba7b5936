"""
Does this image come from the scene that the model was trained on? A score without any truth.

A Gaussian over a few measures of an image (its colours, its sharpness, how sure the network is),
fitted to the training photos when the model is exported, says how unusual an image is. Another
room, a covered lens, darkness and blur all are.
"""
import base64
from collections.abc import Callable, Sequence
from dataclasses import dataclass
import sys
from typing import Any

import cv2
from neo_ros.errors import ModelError
from neo_ros.geometry import ViewExpansion
from neo_ros.runtime.card_fields import check_number, check_text
import numpy as np

# Steps per colour channel of the histogram: 4 x 4 x 4 colours.
STEPS = 4
HISTOGRAM = STEPS ** 3
# The histogram, then brightness, contrast, two of sharpness, and the network's confidence.
MEASURES = HISTOGRAM + 5
# Colours are counted on about so many pixels a side: more change little but the time.
SMALL_SIDE = 96


@dataclass(frozen=True)
class SceneCheckThresholds:
    """How a reference is fitted, and how a score follows from how unusual an image is."""

    # Added to the covariance, as a share of its mean variance: colours that no photo has would
    # otherwise have no variance at all.
    shrinkage: float = 0.1
    # One photo in five sets the threshold instead of the Gaussian, whose own photos flatter it.
    calibration_every: int = 5
    # Photos at random poses also look at bare walls from close by, which tell little of the scene.
    usual_share: float = 0.9
    steepness: float = 4.0
    # A camera's exposure is not always the one of the training photos.
    most_gain: float = 1.25
    # Fewer photos say too little.
    least_photos: int = 20
    # A photo of which masks leave less says too little.
    least_usable: float = 0.5


@dataclass(frozen=True, kw_only=True)
class SceneReference:
    """
    What images of the trained scene look like; a part of the model card.

    mean: of the measures. whitening: lower triangular, `|whitening @ (measures - mean)|` is how
    unusual an image is. Both float32, little endian, base64. threshold: how unusual (squared) an
    image may be; most training photos lie below.
    """

    mean: str
    whitening: str
    threshold: float

    def __post_init__(self) -> None:
        for name, count in (('mean', MEASURES), ('whitening', MEASURES ** 2)):
            text = getattr(self, name)
            check_text(name, text)
            try:
                values = _unpack(text)
            except ValueError:
                values = np.empty(0)
            if values.size != count or not np.isfinite(values).all():
                raise ModelError(f'{name}: expected {count} finite float32 values in base64, '
                                 f'got {text!r:.80}')
        check_number('threshold', self.threshold, sys.float_info.min)


class SceneCheck:
    """Scores images against the reference of one scene."""

    def __init__(self, reference: SceneReference, expansion: ViewExpansion,
                 thresholds: SceneCheckThresholds = SceneCheckThresholds()) -> None:
        self._steepness = thresholds.steepness
        self._expansion = expansion
        self._mean = _unpack(reference.mean)
        self._whitening = _unpack(reference.whitening).reshape(MEASURES, MEASURES)
        self._threshold = reference.threshold

    def score(self, image: np.ndarray, confidence: np.ndarray) -> float:
        """
        Return how unlike the trained scene an image is: 0 = as trained, 1 = nothing like it.

        `image` is the camera's, uint8 RGB (h, w, 3); `confidence` is what the network gave for
        it, uint8 (H, W), 255 where the camera saw. 0.5 = as unusual as the most unusual tenth
        of the training photos.
        """
        measures = measure_image(image, confidence, self._expansion)
        unusual = float(_unusual(measures, self._mean, self._whitening))
        return 1 / (1 + (self._threshold / max(unusual, 1e-9)) ** self._steepness)


def fit_scene_reference(photos: Sequence[np.ndarray] | np.ndarray,
                        predict_confidence: Callable[[np.ndarray], np.ndarray],
                        expansion: ViewExpansion,
                        usable: Sequence[np.ndarray] | np.ndarray | None = None,
                        thresholds: SceneCheckThresholds = SceneCheckThresholds()
                        ) -> SceneReference | None:
    """
    Learn what the scene looks like from its photos, as they are and a little brighter or darker.

    `photos`: N of uint8 RGB (h, w, 3), each looked at once. `predict_confidence` runs the network
    on one and returns its confidence, uint8 (H, W). `usable`: N of bool (h, w), likewise, what
    shows the scene; None: all.
    Returns None for fewer than `thresholds.least_photos`.
    """
    body = None if usable is None else _own_body(usable)

    def shown(index: int) -> np.ndarray | None:
        return None if usable is None or body is None else usable[index] | body

    told = [index for index, one in enumerate(map(shown, range(len(photos))))
            if one is None or one.mean() >= thresholds.least_usable]
    if len(told) < thresholds.least_photos:
        return None
    random = np.random.default_rng(0)
    measures = []
    for place, index in enumerate(told):
        gain = np.exp(random.uniform(-1, 1) * np.log(thresholds.most_gain)) if place % 2 else 1.0
        image = np.minimum(np.rint(photos[index] * gain), 255).astype(np.uint8)
        measures.append(measure_image(image, predict_confidence(image), expansion, shown(index)))
    return _fit(np.stack(measures), thresholds)


def _own_body(usable: Sequence[np.ndarray] | np.ndarray) -> np.ndarray:
    """
    Tell what is left out of most photos: bool (h, w).

    It is the robot itself, which its camera sees when it runs, too.
    """
    count = np.zeros(usable[0].shape, int)
    for one in usable:
        count += one
    return count < len(usable) / 2


def _fit(measures: np.ndarray, thresholds: SceneCheckThresholds) -> SceneReference:
    every = thresholds.calibration_every
    calibration = np.arange(len(measures)) % every == every // 2
    fitted = measures[~calibration]
    mean, spread = fitted.mean(0), fitted.std(0) + 1e-3
    # All colours share one spread, or the rare ones would count as much as the common ones.
    spread[:HISTOGRAM] = fitted[:, :HISTOGRAM].std() + 1e-3
    covariance = np.cov(((fitted - mean) / spread).T)
    covariance += thresholds.shrinkage * np.trace(covariance) / MEASURES * np.eye(MEASURES)
    whitening = np.linalg.inv(np.linalg.cholesky(covariance)) / spread
    unusual = _unusual(measures[calibration], mean, whitening)
    return SceneReference(mean=_pack(mean), whitening=_pack(whitening),
                          threshold=round(float(np.quantile(unusual, thresholds.usual_share)), 4))


def measure_image(image: np.ndarray, confidence: np.ndarray, expansion: ViewExpansion,
                  usable: np.ndarray | None = None) -> np.ndarray:
    """
    Return the measures of one image, float64 (MEASURES,).

    usable: bool (h, w), what the measures of the image are taken of; None: all of it.
    """
    grey = cv2.cvtColor(image, cv2.COLOR_RGB2GRAY)
    seen = None if usable is None else usable.astype(np.uint8)
    mean, deviation = cv2.meanStdDev(grey, mask=seen)
    # What a pixel differs from its neighbour, and from the mean of its two: blur changes the
    # second more than the first.
    count = grey.size if seen is None else cv2.countNonZero(seen)
    sharpness = [sum(_change(grey, seen, *parts) for parts in both) / count / 255
                 for both in (_NEIGHBOURS, _TWO_NEIGHBOURS)]
    sure = (cv2.sumElems(confidence)[0] - 255 * grey.size) / (confidence.size - grey.size)
    step = max(max(grey.shape) // SMALL_SIDE, 1)
    steps = image[::step, ::step] // (256 // STEPS)
    colours = (steps[..., 0] * STEPS + steps[..., 1]) * STEPS + steps[..., 2]
    if usable is not None:
        colours = colours[usable[::step, ::step]]
    histogram = np.bincount(colours.reshape(-1), minlength=HISTOGRAM) / colours.size
    return np.concatenate([np.sqrt(histogram), np.log([
        mean[0, 0] / 255 + 0.01, deviation[0, 0] / 255 + 0.01, *np.add(sharpness, 1e-3),
        max(sure, 0) + 1])])


def _unusual(measures: np.ndarray, mean: np.ndarray, whitening: np.ndarray) -> np.ndarray:
    """Return how far measures (..., MEASURES) are from the mean, squared."""
    away = measures - mean
    # To be surer than usual is nothing to worry about.
    away[..., -1] = np.minimum(away[..., -1], 0)
    return np.square(away @ whitening.T).sum(-1)


# Down and across: pixels, and the one or two beside each.
_NEIGHBOURS = ((np.s_[1:], np.s_[:-1]), (np.s_[:, 1:], np.s_[:, :-1]))
_TWO_NEIGHBOURS = ((np.s_[1:-1], np.s_[2:], np.s_[:-2]),
                   (np.s_[:, 1:-1], np.s_[:, 2:], np.s_[:, :-2]))


def _change(grey: np.ndarray, seen: np.ndarray | None, here: Any, *beside: Any) -> float:
    """Sum how far pixels `here` are from the mean of those beside; only where all are seen."""
    first, last = grey[beside[0]], grey[beside[-1]]
    other = first if len(beside) == 1 else cv2.addWeighted(first, 0.5, last, 0.5, 0)
    mask = (None if seen is None
            else np.minimum.reduce([seen[part] for part in (here, *beside)]))
    return cv2.norm(grey[here], other, cv2.NORM_L1, mask)


def _pack(values: np.ndarray) -> str:
    return base64.b64encode(np.ascontiguousarray(values, '<f4').tobytes()).decode()


def _unpack(text: str) -> np.ndarray:
    """Return float64 (N,); raises ValueError for what is not base64 of float32."""
    return np.frombuffer(base64.b64decode(text, validate=True), '<f4').astype(np.float64)
