"""What an image says for one place of a scene and against another, where both could show it."""
from collections.abc import Sequence

import cv2
from neo_ros.memory.looking import Looker
from neo_ros.memory.sight import CameraImage, Sight
from neo_ros.memory.thresholds import AmbiguityThresholds
import numpy as np


def ask(looker: Looker, image: CameraImage, sights: Sequence[Sight]) -> np.ndarray:
    """Return how much of an image speaks against each place for each other one, (N, N)."""
    finest, limits = looker.aligner.levels[0], looker.thresholds.ambiguity
    own = _in_unit_range(image.pixels, (finest.width, finest.height))
    misfits = [_misfit_of(own, sight, limits) for sight in sights]
    return np.array([[speaks_against(one, other, limits) for other in misfits]
                     for one in misfits])


def least_refuted(evidence: np.ndarray) -> int:
    """
    Return the place against which the least speaks for any other.

    Between the others a third one's word does not count: between two equal places it is chance.
    """
    return int(evidence.max(1).argmin())


def _misfit_of(image: np.ndarray, sight: Sight, limits: AmbiguityThresholds) -> np.ndarray:
    part, size = sight.part, image.shape[1::-1]
    depth = cv2.resize(np.where(part.stretched, 0, part.depth), size,
                       interpolation=cv2.INTER_NEAREST)
    square = np.ones((3, 3), np.uint8)
    near, far = cv2.erode(depth, square), cv2.dilate(depth, square)
    known = (near > 0) & (far < (1 + limits.leap) * near)
    shown = _in_unit_range(part.image, size)
    return misfit(image, shown, known, limits)


def misfit(image: np.ndarray, shown: np.ndarray, known: np.ndarray,
           limits: AmbiguityThresholds) -> np.ndarray:
    """
    Return by how much an image differs from what a place shows, float32 (h, w), smoothed.

    image, shown: RGB float32 (h, w, 3) in [0, 1], whose exposures and white balances may differ.
    The channel that differs most counts. NaN where not known.
    """
    if not known.any():
        return np.full(known.shape, np.nan, np.float32)
    if np.ptp(image, axis=-1).mean() < limits.colourless:  # Of a camera that sees no colours.
        shown = shown.mean(-1, keepdims=True)
    a, b = shown[known], image[known]
    gain = ((a - a.mean(0)) * (b - b.mean(0))).mean(0) / np.maximum(a.var(0), 1e-6)
    off = np.abs(image - (b.mean(0) + gain * (shown - a.mean(0)))).max(-1)
    size = max(round(limits.around * image.shape[1]), 1)
    share = cv2.blur(known.astype(np.float32), (size, size))
    mean = cv2.blur(np.where(known, off, 0).astype(np.float32), (size, size))
    return np.where(share >= 0.5, mean / np.maximum(share, 0.5), np.nan)


def _in_unit_range(pixels: np.ndarray, size: tuple[int, int]) -> np.ndarray:
    """Return colours of 0 to 255 as float32 (h, w, 3) in [0, 1], of this width and height."""
    shrunk = cv2.resize(pixels, size, interpolation=cv2.INTER_AREA)
    scaled: np.ndarray = shrunk.astype(np.float32) / 255
    return scaled


def speaks_against(one: np.ndarray, other: np.ndarray,
                   limits: AmbiguityThresholds) -> float:
    """Return the share of an image in which `one` misfits and `other` fits, less the reverse."""
    def share(bad: np.ndarray, good: np.ndarray) -> float:
        return float(((bad > limits.contradiction) & (good < bad / 2)).mean())
    return share(one, other) - share(other, one)
