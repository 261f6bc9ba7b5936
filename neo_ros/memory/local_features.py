"""
Local features of an image, and which of two images' features show the same.

RootSIFT (Lowe, 2004; Arandjelovic and Zisserman, 2012), on images enlarged.
"""
from typing import NamedTuple

import cv2
import numpy as np

MAGNIFY = 2.0     # small images have few features: twice as large they have five times as many
CONTRAST = 0.01   # SIFT's threshold; walls of rooms are faint
MOST_FEATURES = 1024


class Features(NamedTuple):
    """
    Where the features of an image are and what they look like.

    points       float32 (N, 2), pixels of the image, top-left corner (0, 0)
    descriptors  float32 (N, 128), RootSIFT of length 1
    """

    points: np.ndarray
    descriptors: np.ndarray


def find_features(image: np.ndarray, magnify: float = MAGNIFY,
                  most: int = MOST_FEATURES, contrast: float = CONTRAST) -> Features:
    """Find the `most` strongest features of an RGB uint8 image (H, W, 3), enlarged."""
    grey = cv2.cvtColor(image, cv2.COLOR_RGB2GRAY)
    large = cv2.resize(grey, None, fx=magnify, fy=magnify, interpolation=(
        cv2.INTER_CUBIC if magnify > 1 else cv2.INTER_AREA))
    found, descriptors = cv2.SIFT.create(
        most, contrastThreshold=contrast, edgeThreshold=15).detectAndCompute(large, None)
    if descriptors is None:
        return Features(np.zeros((0, 2), np.float32), np.zeros((0, 128), np.float32))
    # OpenCV counts from the centre of the first pixel.
    points = (np.array([one.pt for one in found], np.float32) + 0.5) / magnify
    # SIFT keeps ties beyond `most`.
    points, descriptors = points[:most], descriptors[:most]
    share = descriptors / np.maximum(descriptors.sum(1, keepdims=True), 1e-6)
    return Features(points, np.sqrt(share).astype(np.float32))


def match_features(first: np.ndarray, second: np.ndarray, ratio: float) -> np.ndarray:
    """
    Pair descriptors (N, 128) and (M, 128) that are each other's nearest: int64 (K, 2).

    The nearest must be closer than `ratio` times the second nearest (Lowe, 2004).
    """
    if len(first) < 2 or len(second) < 2:
        return np.zeros((0, 2), np.int64)
    likeness = first @ second.T
    rows = np.arange(len(first))
    best = likeness.argmax(1)
    nearest = likeness[rows, best]
    likeness[rows, best] = -1
    runner_up = likeness.max(1)
    likeness[rows, best] = nearest
    # The squared distance of unit vectors is 2 - 2 * likeness.
    distance, further = np.maximum(2 - 2 * nearest, 0), np.maximum(2 - 2 * runner_up, 0)
    # Two that are the same but for rounding are not told apart.
    kept = np.flatnonzero(distance < ratio ** 2 * further - 1e-6)
    # Few are left whose own nearest is to be found, down the columns, which is slow.
    kept = kept[likeness[:, best[kept]].argmax(0) == kept]
    return np.stack([kept, best[kept]], 1)
