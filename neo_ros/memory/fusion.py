"""Join camera image, guide and the network's picture into one wide view."""
from dataclasses import dataclass

import cv2
from neo_ros.geometry import ViewExpansion
from neo_ros.memory.sight import Guide
import numpy as np

# Gaps are filled from their surroundings, over squares of these sides, pixels: the smallest first,
# the largest for the gaps in the largest view that a model may have.
GAPS = (9, 33, 129, 513, 2049)


@dataclass(frozen=True)
class FusionThresholds:
    """
    How image and guide are joined, and what error that lets expect.

    The expected error of a guided pixel, in grey levels, is the sum of `seam` (or `seen_before`),
    `contradicted`, `slope` and `stretched`. All but `contradicted` are fitted to photos of two
    rooms and a kitchen that the memory was not made of.
    """

    # The difference between image and guide is smoothed over blocks of so many pixels, and carried
    # over the seam as far as this share of the image's width.
    block: int = 8
    reach: float = 0.12
    # Grey levels of difference that are healed at most: beyond, somebody stands in the image.
    most_healed: float = 24.0
    # So much of the difference at the nearest part of the seam.
    seam: float = 0.35
    # More of what it has beyond so many levels, where the camera contradicts the memory.
    contradicted: float = 0.65
    contradiction: float = 10.0
    # So much of the picture's slope, in levels a pixel: edges lie a little aside.
    slope: float = 0.37
    # More where colours are stretched over a gap.
    stretched: float = 4.4
    # Where the last images show the surface, instead of the seam: so much of what they differ
    # there (walks of a demo flat and a kitchen of their own: 0.3 to 0.9).
    seen_before: float = 0.5
    least_error: float = 1.0
    # Of a gap that is filled from around it.
    gap_error: float = 38.0
    # Share of the wide view that may be missing before the network is worth its time.
    most_missing: float = 0.02


def fuse(image: np.ndarray, guide: Guide, network_image: np.ndarray | None,
         expansion: ViewExpansion, thresholds: FusionThresholds = FusionThresholds()
         ) -> tuple[np.ndarray, np.ndarray]:
    """
    Return the wide image, uint8 RGB (H, W, 3), and the expected error of its pixels.

    The camera's pixels stay as they are. Around them the guide is drawn, its colours bent to
    the last images' where these saw the surface, and to the present one's near the seam; where
    the memory knows nothing, the network's image, uint8 (H, W, 3), fills in, or without one the
    colours around the gap. The error, float32 (H, W) in units of full brightness, follows from
    how image and guide differ at the nearest part of the seam or in the last images, and from
    the guide's edges; it is NaN where the network's picture is.
    """
    rows, columns = expansion.observed
    inside = guide.known[rows, columns]
    difference = cv2.subtract(image, guide.image[rows, columns], dtype=cv2.CV_32F)
    correction, error = _carried_outward(difference, inside, expansion, thresholds)
    if guide.seen_before is not None:
        seen, weight = guide.seen_before
        rest = 1 - weight
        correction = cv2.multiply(correction, cv2.merge([rest] * 3))
        cv2.add(correction, seen, dst=correction)
        magnitude = cv2.transform(
            np.abs(seen), np.full((1, 3), thresholds.seen_before / 3, np.float32))
        error = cv2.scaleAdd(weight, thresholds.least_error,
                             cv2.add(cv2.multiply(error, rest), magnitude))
    wide = cv2.add(guide.image, correction, dtype=cv2.CV_8U)
    unknown = ~guide.known
    if network_image is not None:
        wide[unknown] = network_image[unknown]
    elif unknown.any():
        wide = _filled(wide, guide.known)
    error = np.maximum(cv2.scaleAdd(_slope(wide), thresholds.slope, error),
                       np.float32(thresholds.least_error))
    error[guide.stretched] += thresholds.stretched
    error[unknown] = np.nan if network_image is not None else thresholds.gap_error
    error /= 255
    wide[rows, columns] = image
    error[rows, columns] = 0
    return wide, error


def _carried_outward(difference: np.ndarray, inside: np.ndarray, expansion: ViewExpansion,
                     thresholds: FusionThresholds) -> tuple[np.ndarray, np.ndarray]:
    """
    Spread the differences float32 (h, w, 3) of the observed window smoothly over the wide view.

    Only those `inside`, bool (h, w), count; the others are set to 0. Returns what is to be added
    to the guide, float32 (H, W, 3): the mean of the nearest differences, fading with the distance
    from the seam; and the error that the nearest absolute differences let expect, float32 (H, W),
    which does not fade.
    """
    difference[~inside] = 0
    magnitude = cv2.transform(np.abs(difference), np.full((1, 3), 1 / 3, np.float32))
    healed = np.clip(difference, -thresholds.most_healed, thresholds.most_healed)
    coarse = np.dstack([_on_blocks(layer, expansion, thresholds.block)
                        for layer in (healed, magnitude, inside.astype(np.float32))])
    small = coarse.shape[1::-1]
    spread = cv2.GaussianBlur(coarse, (0, 0), thresholds.reach * small[0] / 2)
    # A second, wide blur gives a value even where the first one gives none.
    everywhere = cv2.GaussianBlur(coarse, (0, 0), small[0] / 4) + coarse.mean((0, 1)) * 1e-3
    total = spread + 1e-3 * everywhere
    mean = total[..., :-1] / np.maximum(total[..., -1:], 1e-9)
    # Far from the seam nothing is known of the difference: the correction fades, the error stays.
    mean[..., :3] *= np.minimum(2 * spread[..., -1:], 1)
    seam = mean[..., 3]
    expected = thresholds.seam * seam + thresholds.contradicted * np.maximum(
        seam - thresholds.contradiction, 0)
    return (_from_blocks(mean[..., :3], expansion, thresholds.block),
            _from_blocks(expected, expansion, thresholds.block))


def _on_blocks(window: np.ndarray, expansion: ViewExpansion, block: int) -> np.ndarray:
    """Average float32 (h, w[, 3]) of the observed window over the wide view's blocks; else 0."""
    rows, columns = expansion.observed
    target, channels = expansion.target, window.shape[2:]
    coarse = np.zeros((-(-target.height // block), -(-target.width // block), *channels),
                      np.float32)
    # The window need not begin and end where blocks do.
    padded = cv2.copyMakeBorder(window, rows.start % block, -rows.stop % block,
                                columns.start % block, -columns.stop % block, cv2.BORDER_CONSTANT)
    part = coarse[rows.start // block:-(-rows.stop // block),
                  columns.start // block:-(-columns.stop // block)]
    part[:] = cv2.resize(padded, part.shape[1::-1], interpolation=cv2.INTER_AREA)
    return coarse


def _from_blocks(coarse: np.ndarray, expansion: ViewExpansion, block: int) -> np.ndarray:
    """Interpolate what `_on_blocks` is like in the wide view."""
    size = (coarse.shape[1] * block, coarse.shape[0] * block)
    fine = cv2.resize(coarse, size, interpolation=cv2.INTER_LINEAR)
    return fine[:expansion.target.height, :expansion.target.width]


def _slope(image: np.ndarray) -> np.ndarray:
    """Return how steep the grey of RGB uint8 (H, W, 3) is, levels a pixel, float32 (H, W)."""
    grey = cv2.cvtColor(image, cv2.COLOR_RGB2GRAY)
    across, down = (cv2.Sobel(grey, cv2.CV_32F, *order, scale=1 / 8) for order in ((1, 0), (0, 1)))
    return cv2.blur(cv2.magnitude(across, down), (3, 3))


def _filled(image: np.ndarray, known: np.ndarray) -> np.ndarray:
    """Fill what is not known, bool (H, W), with the mean of the known colours around it."""
    result, weight = image.astype(np.float32), known.astype(np.float32)
    result *= weight[..., None]
    for side in GAPS:
        if weight.all():
            break
        around = cv2.blur(weight, (side, side))
        gap = (weight == 0) & (around > 1e-6)
        colours = cv2.blur(result, (side, side))
        result[gap] = colours[gap] / around[gap][:, None]
        weight[gap] = 1
    return np.clip(result + 0.5, 0, 255).astype(np.uint8)
