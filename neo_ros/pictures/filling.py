"""Blend overlapping pictures band by band, and extend a picture beyond its edges."""
from collections.abc import Sequence

import cv2
import numpy as np

BANDS = 4
# Weights are sharpened so for the finest bands: detail from one picture, colour from all.
SHARPEN = 4.0


def blend_bands(images: Sequence[np.ndarray], weights: Sequence[np.ndarray]) -> np.ndarray:
    """
    Blend pictures (H, W, 3) float32 with weights (H, W) float32 by Laplacian pyramids.

    Coarse bands are weighted means, fine ones come from nearly the best picture alone. Where all
    weights are 0 the result is not defined.
    """
    result: list[np.ndarray] = []
    total: list[np.ndarray] = []
    best = np.maximum(np.max(weights, axis=0), 1e-12)
    for image, weight in zip(images, weights):
        share = weight / best
        for level, (band, soft, sharp) in enumerate(zip(
                _laplacian(image), _gaussian(weight), _gaussian(weight * share ** SHARPEN))):
            used = (soft if level == BANDS else sharp)[..., None]
            if level == len(result):
                result.append(np.zeros_like(band))
                total.append(np.zeros_like(used))
            result[level] += band * used
            total[level] += used
    blended = result[-1] / np.maximum(total[-1], 1e-6)
    for band, weight in zip(result[-2::-1], total[-2::-1]):
        blended = _grown(blended, band) + band / np.maximum(weight, 1e-6)
    return blended


def extend_edges(image: np.ndarray, known: np.ndarray) -> np.ndarray:
    """
    Fill the unknown pixels of (H, W, 3) float32 from the known ones (H, W) bool.

    Each takes the nearest known pixel, softer the farther it is: edges go on for a little way
    and then fade.
    """
    if known.all() or not known.any():
        return image
    distance, label = cv2.distanceTransformWithLabels(
        (~known).astype(np.uint8), cv2.DIST_L2, 5, labelType=cv2.DIST_LABEL_PIXEL)
    owner = np.zeros(int(label.max()) + 1, np.int64)
    owner[label[known]] = np.flatnonzero(known)
    nearest = image.reshape(-1, 3)[owner[label]].astype(np.float32)
    result = np.where(known[..., None], image, nearest)
    soft = result
    for sigma in (2.0, 4.0, 8.0, 16.0):
        soft = cv2.GaussianBlur(soft, (0, 0), sigma)
        share = np.clip(distance / sigma - 1, 0, 1)[..., None]
        result = np.where(known[..., None], image, result * (1 - share) + soft * share)
    return result.astype(np.float32)


def sample_pixels(image: np.ndarray, where: np.ndarray) -> np.ndarray:
    """Look up an image (H, W, ...) at pixels float32 (h, w, 2), bilinear; the rim goes on."""
    x, y = np.moveaxis(where - np.float32(0.5), -1, 0)
    return cv2.remap(image, np.ascontiguousarray(x), np.ascontiguousarray(y), cv2.INTER_LINEAR,
                     borderMode=cv2.BORDER_REPLICATE)


def sample_mask(mask: np.ndarray, where: np.ndarray) -> np.ndarray:
    """Look up a mask, bool (H, W), as `sample_pixels`; True where all that is blended is."""
    # Weights add up to a little less than 1.
    whole: np.ndarray = sample_pixels(mask.astype(np.float32), where) > 0.9999
    return whole


def _gaussian(image: np.ndarray) -> list[np.ndarray]:
    levels = [image]
    for _ in range(BANDS):
        levels.append(cv2.pyrDown(levels[-1]))
    return levels


def _laplacian(image: np.ndarray) -> list[np.ndarray]:
    levels = _gaussian(image)
    return [fine - _grown(coarse, fine) for fine, coarse in zip(levels, levels[1:])] + levels[-1:]


def _grown(coarse: np.ndarray, fine: np.ndarray) -> np.ndarray:
    return cv2.pyrUp(coarse, dstsize=(fine.shape[1], fine.shape[0]))
