"""The compiled loops that tell which remembered depth can be trusted."""
from neo_ros.machine.compiled import njit
from neo_ros.memory.kernels import FAST
import numpy as np

# Where the last images hardly saw a surface, what they say counts as if they had seen so much.
LEAST_SEEN = np.float32(0.1)


@njit(**FAST)
def _mirrored(index, count):
    """Return an index beyond the ends as OpenCV's BORDER_REFLECT_101 does."""
    while not 0 <= index < count and count > 1:
        index = -index if index < 0 else 2 * (count - 1) - index
    return index if count > 1 else 0


@njit(**FAST)
def _differences(image, other, y, left, off):
    """Fill off (w,) with the mean difference of the channels in row y, from column `left` on."""
    third = np.float32(1 / 3)
    for x in range(len(off)):
        total = np.float32(0)
        for c in range(3):
            if other is None:
                total += abs(image[y, left + x, c])
            else:
                total += abs(image[y, left + x, c] - np.float32(other[y, left + x, c]))
        off[x] = total * third


@njit(**FAST)
def _exchange(new, old, totals):
    """Take the row `new` into totals (w,), in the place of `old`."""
    for x in range(len(new)):
        totals[x] += new[x] - old[x]
        old[x] = new[x]


@njit(**FAST)
def _sum_around(totals, padded, sums):
    """Fill sums (w,) with those of as many neighbours as padded (w + 2 half,) has room for."""
    width = len(totals)
    half = (len(padded) - width) // 2
    # Slices, as an index that may be negative is looked at one by one.
    middle = padded[half:half + width]
    for x in range(width):
        middle[x] = sums[x] = totals[x]
    for x in range(half):
        padded[x] = totals[_mirrored(x - half, width)]
        padded[half + width + x] = totals[_mirrored(width + x, width)]
    for k in range(half):
        before, behind = padded[k:k + width], padded[2 * half - k:2 * half - k + width]
        for x in range(width):
            sums[x] += before[x] + behind[x]


@njit(**FAST)
def _forget_contradicted(image, other, weight, window, half, limit, depth):
    """
    Set depth (H, W) to NaN where, in the mean over squares, two images differ by more than limit.

    image float32 (H, W, 3); other uint8 (H, W, 3), or None where image is a difference already,
    times weight, float32 (H, W), or None; window: first row and column, and those behind the last.
    The squares reach `half` pixels to all sides, mirrored at the window.
    """
    top, left, bottom, right = window
    height, width, side = bottom - top, right - left, 2 * half + 1
    # Columns are summed up first, so that every row is looked at once.
    rows, totals = np.zeros((side, width), np.float32), np.zeros(width)
    weights, weight_totals = np.zeros((side, width), np.float32), np.zeros(width)
    off, padded = np.empty(width, np.float32), np.empty(width + 2 * half, np.float32)
    sums, shares = np.empty(width, np.float32), np.full(width, np.float32(side * side))
    least = np.float32(0) if weight is None else LEAST_SEEN * np.float32(side * side)
    for row in range(-half, height + half):
        y, slot = top + _mirrored(row, height), (row + half) % side
        _differences(image, other, y, left, off)
        _exchange(off, rows[slot], totals)
        if weight is not None:
            _exchange(weight[y, left:right], weights[slot], weight_totals)
        if row < half:
            continue
        _sum_around(totals, padded, sums)
        if weight is not None:
            _sum_around(weight_totals, padded, shares)
        told = depth[top + row - half, left:right]
        for x in range(width):
            # Both are weighted: that compares without a division.
            if sums[x] > limit * max(shares[x], least):
                told[x] = np.nan


@njit(**FAST)
def fill_trusted_depth(remembered, stretched, confidence, least_confidence, images, window, seen,
                       half, limit, depth):
    """
    Fill depth float32 (H, W) with what is remembered, or NaN where it is not to be told.

    remembered float32 (H, W), 0 = unknown; stretched bool (H, W); confidence uint8 (H, W); images:
    what the memory shows, float32 (H, W, 3), and what was made of it, uint8 (H, W, 3), which are
    compared in the `window`; seen: see `SeenBefore`, or None; half, limit: see
    `_forget_contradicted`.
    """
    for y in range(depth.shape[0]):
        for x in range(depth.shape[1]):
            told = (remembered[y, x] > 0 and not stretched[y, x]
                    and confidence[y, x] >= least_confidence)
            depth[y, x] = remembered[y, x] if told else np.nan
    if window[0] < window[2]:
        _forget_contradicted(images[0], images[1], None, window, half, limit, depth)
    if seen is not None:
        _forget_contradicted(seen[0], None, seen[1], (0, 0, *depth.shape), half, limit, depth)
