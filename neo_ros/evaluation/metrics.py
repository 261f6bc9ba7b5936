"""
Scores of a widened view against the truth: whole image, extrapolated ring, band at the seam.

All measures work on RGB uint8 with data range 255. The ring is what the model made up: where a
method pastes the observed centre, the whole image flatters it, the ring does not.
"""
from collections.abc import Iterable, Mapping
from typing import NamedTuple

import cv2
from neo_ros.errors import ImageRejected
from neo_ros.geometry import ViewExpansion
import numpy as np

PSNR_CAP_DB = 100.0  # JSON has no infinity; one uint8 step in a megapixel image is 113 dB
PARTS = ('whole', 'ring', 'seam')
SSIM_SIGMA = 1.5
SSIM_RADIUS = 5  # an 11x11 window, as Wang et al. use
_BOOTSTRAP_DRAWS = 2000


class Estimate(NamedTuple):
    """A mean with its 95 % interval; the interval is None where it cannot be known."""

    mean: float
    low: float | None
    high: float | None


def score_frame(truth: np.ndarray, prediction: np.ndarray, expansion: ViewExpansion,
                usable: np.ndarray | None = None) -> dict[str, float]:
    """
    Score one wide image (H, W, 3) RGB uint8 against the truth of the same shape.

    usable: bool (H, W), the pixels of the truth that show the scene; None: all. Returns
    whole_psnr, ring_psnr, seam_psnr (dB, at most 100) and whole_ssim, ring_ssim, seam_ssim; none
    of a part without a usable pixel. The ring is all extrapolated pixels, the seam the part of
    it within `seam_width` of the camera's window. Raises ImageRejected for images that are not
    uint8 of the expansion's target size.
    """
    check_pair(truth, prediction, expansion)
    whole, ring, seam = parts = scored_parts(expansion, usable)
    if usable is not None:
        prediction = left_out_alike(truth, prediction, usable)
    error = (truth.astype(np.float32) - prediction.astype(np.float32)) ** 2
    ssim = ssim_map(truth, prediction)
    # The rim, where the window hangs over the border, is left out of the whole score as
    # Wang et al. and scikit-image do; it stays in the ring, most of which it can be.
    inner = np.zeros_like(whole)
    inner[SSIM_RADIUS:-SSIM_RADIUS, SSIM_RADIUS:-SSIM_RADIUS] = True
    scores = {f'{name}_psnr': _psnr_of_mse(float(error[part].mean(dtype=np.float64)))
              for name, part in zip(PARTS, parts) if part.any()}
    return scores | {f'{name}_ssim': float(ssim[part].mean())
                     for name, part in zip(PARTS, (whole & inner, ring, seam)) if part.any()}


def scored_parts(expansion: ViewExpansion, usable: np.ndarray | None) -> tuple[np.ndarray, ...]:
    """Return the usable pixels, bool (H, W), of each of PARTS."""
    ring = expansion.extrapolated_mask
    parts = np.ones_like(ring), ring, expansion.seam_mask(seam_width(expansion))
    return parts if usable is None else tuple(part & usable for part in parts)


def left_out_alike(truth: np.ndarray, prediction: np.ndarray, usable: np.ndarray) -> np.ndarray:
    """
    Return the prediction with the truth's pixels where the truth does not show the scene.

    What looks at a neighbourhood (SSIM, LPIPS) finds no difference there.
    """
    return np.where(usable[..., None], prediction, truth)


def check_pair(truth: np.ndarray, prediction: np.ndarray, expansion: ViewExpansion) -> None:
    """Raise ImageRejected unless both are uint8 (H, W, 3) of the expansion's target size."""
    target = expansion.target
    expected = (target.height, target.width, 3)
    if min(expected[:2]) <= 2 * SSIM_RADIUS:
        raise ImageRejected('size', f'target: expected more than {2 * SSIM_RADIUS} pixels a side '
                            f'to score, got {target.width}x{target.height}')
    for name, image in (('truth', truth), ('prediction', prediction)):
        if image.dtype != np.uint8:
            raise ImageRejected('dtype', f'{name}: expected uint8 RGB in 0..255, got '
                                f'{image.dtype}; convert before scoring')
        if image.shape != expected:
            raise ImageRejected('size', f'{name}: expected shape {expected} as the view '
                                f'expansion says, got {image.shape}; resize or crop it first')


def seam_width(expansion: ViewExpansion) -> int:
    """Return the seam's width in pixels: 1/16 of the source's, so the same at every scale."""
    return max(1, round(expansion.source.width / 16))


def psnr(truth: np.ndarray, prediction: np.ndarray) -> float:
    """Peak signal to noise ratio of two uint8 arrays of one shape, dB, at most 100."""
    error = truth.astype(np.float64) - prediction.astype(np.float64)
    return _psnr_of_mse(float((error ** 2).mean()))


def ssim_map(truth: np.ndarray, prediction: np.ndarray) -> np.ndarray:
    """
    Structural similarity after Wang et al. (2004) of two uint8 images (H, W, C).

    Gaussian window (sigma 1.5, 11x11), population covariance, data range 255, mirrored borders:
    scikit-image's `structural_similarity(gaussian_weights=True, sigma=1.5,
    use_sample_covariance=False, data_range=255, full=True)`, without needing it on a robot.
    Returns float64 (H, W), the mean over the channels.
    """
    x, y = truth.astype(np.float64), prediction.astype(np.float64)
    mean_x, mean_y = _windowed(x), _windowed(y)
    var_x = _windowed(x * x) - mean_x ** 2
    var_y = _windowed(y * y) - mean_y ** 2
    covariance = _windowed(x * y) - mean_x * mean_y
    c1, c2 = (0.01 * 255) ** 2, (0.03 * 255) ** 2
    similarity = ((2 * mean_x * mean_y + c1) * (2 * covariance + c2)
                  / ((mean_x ** 2 + mean_y ** 2 + c1) * (var_x + var_y + c2)))
    return similarity.mean(axis=2)


def auroc(positive: np.ndarray, negative: np.ndarray) -> float:
    """Return the probability that a positive (N,) is above a negative (M,), ties count half."""
    below = np.sort(negative)
    ranks = np.searchsorted(below, positive, 'left') + np.searchsorted(below, positive, 'right')
    return float(ranks.mean() / 2 / len(below))


def summarise(frames: Iterable[Mapping[str, object]], seed: int = 0) -> dict[str, Estimate]:
    """
    Return the mean of every score over the frames with a bootstrap 95 % interval over paths.

    Frames hold a `path_id` and float scores; a score that some frames lack (the first of a walk
    has none before it) is averaged over the others. Neighbouring frames of a walk show nearly
    the same, so whole paths are drawn again, not frames. With a single path the interval is
    None: one walk says nothing about the next. With two or three it is the range over the
    paths, not 95 %: more than 2.5 % of the draws hold one path alone. Paths count that have the
    score.
    """
    frames = list(frames)
    if not frames:
        raise ValueError('frames: expected at least one scored frame, got none')
    names = [name for name in dict.fromkeys(name for frame in frames for name in frame)
             if all(isinstance(frame.get(name, 0.0), float) for frame in frames)]
    scores = np.array([[frame.get(name, np.nan) for name in names] for frame in frames],
                      np.float64)
    there = np.isfinite(scores)
    ids, path_of_frame = np.unique([frame['path_id'] for frame in frames], return_inverse=True)
    sums, counts = np.zeros((2, len(ids), len(names)))
    np.add.at(sums, path_of_frame, np.where(there, scores, 0))
    np.add.at(counts, path_of_frame, there)
    draws = np.random.default_rng(seed).integers(len(ids), size=(_BOOTSTRAP_DRAWS, len(ids)))
    drawn = counts[draws].sum(axis=1)
    # A draw of paths that all lack a score says nothing about it.
    means = sums[draws].sum(axis=1) / np.where(drawn > 0, drawn, np.nan)
    low, high = np.nanquantile(means, [0.025, 0.975], axis=0)
    known = (counts > 0).sum(axis=0) > 1
    return {name: Estimate(float(sums[:, i].sum() / counts[:, i].sum()),
                           float(low[i]) if known[i] else None,
                           float(high[i]) if known[i] else None)
            for i, name in enumerate(names)}


def _psnr_of_mse(mse: float) -> float:
    if mse == 0:
        return PSNR_CAP_DB
    return min(PSNR_CAP_DB, 10 * float(np.log10(255 ** 2 / mse)))


def _windowed(image: np.ndarray) -> np.ndarray:
    size = 2 * SSIM_RADIUS + 1
    return cv2.GaussianBlur(image, (size, size), SSIM_SIGMA, borderType=cv2.BORDER_REFLECT)
