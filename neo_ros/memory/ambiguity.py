"""
Which places of a scene could show an image, and which of them it contradicts.

Rooms can look alike. A place that was searched for is believed only if no other place could be
it; the images that follow tell them apart, or nothing does.
"""
from dataclasses import dataclass

import cv2
from neo_ros.geometry import CameraPose
from neo_ros.memory.sight import Sight
import numpy as np


@dataclass(frozen=True)
class AmbiguityThresholds:
    """When another place counts as a rival, and when an image tells two places apart."""

    # A place is elsewhere when it is farther away than this, or looks farther to the side: nearer
    # ones become the same pose when they are aligned.
    elsewhere_metres: float = 1.0
    elsewhere_cosine: float = 0.94
    # Glances as like the image as the best one of the place that was found, but for so much
    # correlation, are looked at: a glance half a metre off loses as much.
    look_alike: float = 0.15
    most_rivals: int = 12
    # Grey levels in [0, 1] by which an image differs from what a place would show, as the mean
    # over a square of so large a share of its width; the place's rival must fit twice as well.
    contradiction: float = 0.05
    around: float = 0.06
    # Share of the image, summed over images, that has to speak for one place against another: a
    # picture on the far wall of a room covers as much.
    decisive: float = 0.01


@dataclass
class Hypothesis:
    """A place that could be it; `against` is the share of images that spoke for another place."""

    sight: Sight
    motion: np.ndarray
    against: float = 0.0


def is_elsewhere(one: CameraPose, other: CameraPose,
                 limits: AmbiguityThresholds = AmbiguityThresholds()) -> bool:
    """Tell whether two poses are of two places, and not one pose found twice."""
    return bool(np.linalg.norm(one.position - other.position) > limits.elsewhere_metres
                or one.forward @ other.forward < limits.elsewhere_cosine)


def misfit(image: np.ndarray, shown: np.ndarray, known: np.ndarray,
           limits: AmbiguityThresholds = AmbiguityThresholds()) -> np.ndarray:
    """
    Return by how much an image differs from what a place shows, float32 (h, w), smoothed.

    image, shown: grey float32 (h, w) in [0, 1], whose exposures may differ; 0 where not known.
    """
    a, b = shown[known], image[known]
    if len(a) < 2:
        return np.zeros_like(image)
    spread = float(a.std())
    gain = float(np.mean((a - a.mean()) * (b - b.mean()))) / max(spread ** 2, 1e-6)
    off = np.where(known, image - (b.mean() + gain * (shown - a.mean())), 0)
    size = max(round(limits.around * image.shape[1]), 1)
    share = cv2.blur(known.astype(np.float32), (size, size))
    return cv2.blur(np.abs(off).astype(np.float32), (size, size)) / np.maximum(share, 0.25)


def speaks_against(one: np.ndarray, other: np.ndarray,
                   limits: AmbiguityThresholds = AmbiguityThresholds()) -> float:
    """Return the share of an image in which `one` misfits and `other` fits, less the reverse."""
    def share(bad: np.ndarray, good: np.ndarray) -> float:
        return float(((bad > limits.contradiction) & (good < bad / 2)).mean())
    return share(one, other) - share(other, one)
