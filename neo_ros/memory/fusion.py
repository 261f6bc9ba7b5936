"""Join camera image and guide into one wide view."""
from dataclasses import dataclass

import cv2
from neo_ros.geometry import ViewExpansion
from neo_ros.memory import colour_kernels as kernels
from neo_ros.memory.sight import Guide
import numpy as np

# Gaps are filled from their surroundings in a picture so many times smaller, over squares of
# these sides in its pixels: the smallest first, the largest for the gaps in the largest view that
# a model may have.
SHRUNK, GAPS = 4, (3, 9, 33, 129, 513)


@dataclass(frozen=True)
class FusionThresholds:
    """
    How image and guide are joined, and what error that lets expect.

    The expected error of a guided pixel, in grey levels, is the sum of `seam` (or `seen_before`),
    `contradicted`, `slope` and `stretched`. All but `contradicted` are fitted to photos of two
    rooms and a kitchen that the memory was not made of.
    """

    # The difference between image and guide is smoothed over blocks of so many pixels at least, at
    # most so many blocks across the wide view, and carried over the seam as far as this share of
    # the width.
    block: int = 8
    blocks: int = 64
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
    # More where a thing is shown that may be in its other state, unless the last images saw it.
    # Chairs that were moved and put back, walks of their own: the error there is 8 levels in the
    # right state and 18 in the wrong one, where 5 and 11 were expected without.
    two_states: float = 6.0
    # Of a gap that is filled from around it.
    gap_error: float = 38.0
    # Edges are drawn in steps, and lie a little aside: pixels around which depth differs by more
    # than this share, or that are stretched, are smoothed over their neighbours (pixels, sigma).
    leap: float = 0.1
    edge_sigma: float = 0.6


def fuse(image: np.ndarray, guide: Guide, expansion: ViewExpansion,
         thresholds: FusionThresholds = FusionThresholds()) -> tuple[np.ndarray, np.ndarray]:
    """
    Return the wide image, uint8 RGB (H, W, 3), and the expected error of its pixels.

    The camera's pixels stay as they are. Around them the guide is drawn, its colours bent to
    the last images' where these saw the surface, and to the present one's near the seam; where
    the memory knows nothing, the colours around the gap fill it. Edges of depth are smoothed by
    less than a pixel. The error, float32 (H, W) in units of full brightness, follows from how
    image and guide differ at the nearest part of the seam or in the last images, from the
    guide's edges, and from things that may have changed.
    """
    rows, columns = expansion.observed
    # Of one kind wherever it is from: for another the kernels would be compiled anew, for seconds.
    image = np.ascontiguousarray(image).view()
    image.flags.writeable = False
    carried, block = _carried_outward(image, guide, expansion, thresholds)
    wide, error = np.empty(guide.image.shape, np.uint8), np.empty(guide.known.shape, np.float32)
    kernels.bend_colours(image, (rows.start, columns.start), guide.image, carried, block,
                         _seen_before(guide), np.float32(thresholds.seen_before),
                         np.float32(thresholds.least_error), wide, error)
    known = guide.known.copy()
    known[rows, columns] = True
    if not known.all():
        _fill(wide, known)
    kernels.add_slope(_slope(wide), np.float32(thresholds.slope), guide.stretched,
                      np.float32(thresholds.stretched), np.float32(thresholds.least_error), error)
    edges = _edges(guide, thresholds.leap)
    edges[rows, columns] = 0
    cv2.copyTo(cv2.GaussianBlur(wide, (3, 3), thresholds.edge_sigma), edges, wide)
    if guide.two_states is not None:
        seen = 0 if guide.seen_before is None else guide.seen_before.at(known.shape).weight
        error += guide.two_states * (1 - seen) * np.float32(thresholds.two_states / 255)
    error[~known] = thresholds.gap_error / 255
    error[rows, columns] = 0
    return wide, error


def _seen_before(guide: Guide) -> np.ndarray:
    """Return differences and weight of the last images, float32 (n, W, 4), as fine as they are."""
    width = guide.known.shape[1]
    if guide.seen_before is None:
        return np.zeros((1, width, 4), np.float32)
    seen = np.dstack(guide.seen_before)
    return cv2.resize(seen, (width, len(seen)), interpolation=cv2.INTER_LINEAR)


def _carried_outward(image: np.ndarray, guide: Guide, expansion: ViewExpansion,
                     thresholds: FusionThresholds) -> tuple[np.ndarray, int]:
    """
    Spread the differences of image and guide in the observed window over the wide view.

    Returns float32 (n, W, 4), and for how many rows of the view each of its n rows stands: what is
    to be added to the guide, the mean of the nearest differences, fading with the distance from
    the seam; and the error that the nearest absolute differences let expect, which does not fade.
    """
    rows, columns = expansion.observed
    target = expansion.target
    block = max(thresholds.block, target.width // thresholds.blocks)
    coarse = np.empty((-(-target.height // block), -(-target.width // block), 5), np.float32)
    kernels.average_differences(image, guide.image, guide.known, (rows.start, columns.start),
                                block, np.float32(thresholds.most_healed), coarse)
    small = coarse.shape[1::-1]
    spread = cv2.GaussianBlur(coarse, (0, 0), thresholds.reach * small[0] / 2)
    # A second, wide blur gives a value even where the first one gives none.
    everywhere = cv2.GaussianBlur(coarse, (0, 0), small[0] / 4) + coarse.mean((0, 1)) * 1e-3
    total = spread + 1e-3 * everywhere
    mean = total[..., :-1] / np.maximum(total[..., -1:], 1e-9)
    # Far from the seam nothing is known of the difference: the correction fades, the error stays.
    mean[..., :3] *= np.minimum(2 * spread[..., -1:], 1)
    seam = mean[..., 3]
    mean[..., 3] = thresholds.seam * seam + thresholds.contradicted * np.maximum(
        seam - thresholds.contradiction, 0)
    across = cv2.resize(mean, (small[0] * block, small[1]), interpolation=cv2.INTER_LINEAR)
    return np.ascontiguousarray(across[:, :target.width]), block


def _slope(image: np.ndarray) -> np.ndarray:
    """Return how steep the grey of RGB uint8 (H, W, 3) is, levels a pixel, float32 (H, W)."""
    grey = cv2.cvtColor(image, cv2.COLOR_RGB2GRAY)
    across, down = (cv2.Sobel(grey, cv2.CV_32F, *order, scale=1 / 8) for order in ((1, 0), (0, 1)))
    # Not cv2.magnitude, whose last bits depend on where in memory its arguments lie.
    return cv2.blur(np.sqrt(across * across + down * down), (3, 3))


def _edges(guide: Guide, leap: float) -> np.ndarray:
    """Tell beside which pixels depth leaps, or is not known; uint8 (H, W), 0 = beside none."""
    edges = guide.stretched.astype(np.uint8)
    if guide.remembered_depth is None:
        return edges
    around = np.ones((3, 3), np.uint8)
    farthest, nearest = (change(guide.remembered_depth, around) for change in (
        cv2.dilate, cv2.erode))
    return cv2.bitwise_or(edges, cv2.compare(farthest, (1 + leap) * nearest, cv2.CMP_GT))


def _fill(image: np.ndarray, known: np.ndarray) -> None:
    """Fill what is not known, bool (H, W), with the mean of the known colours around it."""
    height, width = known.shape
    result = np.empty((-(-height // SHRUNK), -(-width // SHRUNK), 3), np.float32)
    weight = np.empty(result.shape[:2], np.float32)
    kernels.shrink_known(image, known, SHRUNK, result, weight)
    for side in GAPS:
        if weight.all():
            break
        around = cv2.blur(weight, (side, side))
        gap = (weight == 0) & (around > 1e-6)
        colours = cv2.blur(result, (side, side))
        result[gap] = colours[gap] / around[gap][:, None]
        weight[gap] = 1
    kernels.fill_unknown(image, known, SHRUNK, result)
