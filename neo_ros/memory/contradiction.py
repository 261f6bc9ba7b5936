"""Where an image contradicts the memory, but for edges that lie a little aside."""
from dataclasses import dataclass

import cv2
import numpy as np


@dataclass(frozen=True)
class ContradictionThresholds:
    """What counts as another thing."""

    # Pixels that edges may lie aside: what the memory shows as near as that explains a colour.
    aside: int = 2
    # The mean over squares of so many pixels counts, grey levels: where it is as high as the
    # first something else is seen, as far as it is higher than the second around it.
    around: int = 5
    seed: float = 30.0
    grown: float = 8.0
    # Parts of fewer pixels are left out; the others are taken so much larger.
    least: int = 12
    larger: int = 2


def contradiction(image: np.ndarray, shown: np.ndarray, known: np.ndarray,
                  limits: ContradictionThresholds = ContradictionThresholds()) -> np.ndarray:
    """
    Return by how many grey levels an image contradicts what is shown, float32 (h, w).

    image, shown float32 RGB (h, w, 3) of one exposure; known bool (h, w): 0 elsewhere.
    """
    side = 2 * limits.aside + 1
    kernel = np.ones((side, side), np.uint8)
    # Both ways: what came is shown nowhere around there, and what left is seen nowhere.
    over = np.maximum(image - cv2.dilate(shown, kernel), shown - cv2.dilate(image, kernel))
    under = np.maximum(cv2.erode(shown, kernel) - image, cv2.erode(image, kernel) - shown)
    off = np.maximum.reduce(cv2.split(np.maximum(np.maximum(over, under), 0)))
    off[~known] = 0
    return cv2.blur(off, (limits.around, limits.around))


def contradicted(score: np.ndarray, limits: ContradictionThresholds = ContradictionThresholds()
                 ) -> np.ndarray:
    """Return where something else is seen, bool (h, w), by `contradiction`."""
    count, labels, about, _ = cv2.connectedComponentsWithStats(
        (score > limits.grown).astype(np.uint8), connectivity=8)
    seeds = np.zeros(count, bool)
    seeds[np.unique(labels[score > limits.seed])] = True
    seeds &= about[:, cv2.CC_STAT_AREA] >= limits.least
    seeds[0] = False
    side = 2 * limits.larger + 1
    return cv2.dilate(seeds[labels].astype(np.uint8), np.ones((side, side), np.uint8)) > 0
