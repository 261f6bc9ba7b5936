"""Compiled loops over the colours of a wide view: exposure, differences at the seam, blending."""
from neo_ros.machine.compiled import njit
from neo_ros.memory.kernels import FAST
from numba import prange
import numpy as np


@njit(parallel=True, **FAST)
def apply_gain(image, gain):
    """Multiply image, float32 (h, w, 3) in 0 ... 255, by gain float32 (3,), in place."""
    white = np.float32(255)
    for y in prange(image.shape[0]):
        for x in range(image.shape[1]):
            for c in range(3):
                image[y, x, c] = min(image[y, x, c] * gain[c], white)


@njit(parallel=True, **FAST)
def average_differences(image, guide, known, window, block, most, coarse):
    """
    Average over the blocks of a wide view how an image differs from the guide in its window.

    image uint8 (h, w, 3); guide float32 (H, W, 3) and known bool (H, W) of the wide view; window:
    its first row and column there; block: side in pixels; most: the difference that is healed.
    Fills coarse float32 (ceil(H / block), ceil(W / block), 5): differences, their magnitude, and
    1; 0 counts where there is no image, or nothing known.
    """
    top, left = window
    height, width = image.shape[0], image.shape[1]
    share = np.float32(1 / (block * block))
    for row in prange(coarse.shape[0]):
        for column in range(coarse.shape[1]):
            for c in range(5):
                coarse[row, column, c] = 0
            for y in range(max(row * block, top), min((row + 1) * block, top + height)):
                for x in range(max(column * block, left),
                               min((column + 1) * block, left + width)):
                    if not known[y, x]:
                        continue
                    magnitude = np.float32(0)
                    for c in range(3):
                        off = np.float32(image[y - top, x - left, c]) - guide[y, x, c]
                        coarse[row, column, c] += min(max(off, -most), most)
                        magnitude += abs(off)
                    coarse[row, column, 3] += magnitude * np.float32(1 / 3)
                    coarse[row, column, 4] += 1
            for c in range(5):
                coarse[row, column, c] *= share


@njit(**FAST)
def _between(index, scale, count):
    """Return the two, of `count` rows or columns, that one of a finer picture lies between."""
    at = max((index + np.float32(0.5)) * scale - np.float32(0.5), np.float32(0))
    first = min(int(at), count - 1)
    return first, min(first + 1, count - 1), at - np.float32(first)


@njit(**FAST)
def _bend_row(guide, carried, down, seen, seen_down, rule, wide, error):
    """Do `bend_colours` in one row: two rows each of carried and seen, and how far between."""
    one, half, white = np.float32(1), np.float32(0.5), np.float32(255)
    share, least = rule
    (upper, lower), (before, after) = carried, seen
    for x in range(len(error)):
        weight = before[x, 3] + seen_down * (after[x, 3] - before[x, 3])
        rest, known = one - weight, np.float32(0)
        for c in range(3):
            bend = upper[x, c] + down * (lower[x, c] - upper[x, c])
            off = before[x, c] + seen_down * (after[x, c] - before[x, c])
            known += abs(off)
            colour = guide[x, c] + bend * rest + off
            wide[x, c] = np.uint8(min(max(colour + half, np.float32(0)), white))
        seam = upper[x, 3] + down * (lower[x, 3] - upper[x, 3])
        error[x] = seam * rest + known * share + weight * least


@njit(parallel=True, **FAST)
def bend_colours(image, window, guide, carried, block, seen, of_seen, least_error, wide, error):
    """
    Join image and guide: bend the guide's colours, and tell the error that is left.

    image uint8 (h, w, 3), whose first row and column in the wide view are `window`; guide float32
    (H, W, 3); carried float32 (n, W, 4): the seam's correction and error, a row for every `block`
    rows of the view; seen float32 (m, W, 4): differences and weights of `SeenBefore`, in m rows as
    high as the view; of_seen: the share of the differences that is expected as error. Fills wide
    uint8 (H, W, 3) and error float32 (H, W), 0 in the window.
    """
    height, width = error.shape
    top, left = window
    bottom, right = top + image.shape[0], left + image.shape[1]
    rule = np.float32(of_seen / 3), least_error
    scale, seen_scale = np.float32(1 / block), np.float32(len(seen) / height)
    for y in prange(height):
        inside = top <= y < bottom
        a, b, down = _between(y, scale, len(carried))
        m, n, seen_down = _between(y, seen_scale, len(seen))
        for side in range(2 if inside else 1):
            first, end = (right, width) if side else (0, left if inside else width)
            _bend_row(guide[y, first:end], (carried[a, first:end], carried[b, first:end]), down,
                      (seen[m, first:end], seen[n, first:end]), seen_down, rule,
                      wide[y, first:end], error[y, first:end])
        if inside:
            wide[y, left:right] = image[y - top]
            error[y, left:right] = 0


@njit(parallel=True, **FAST)
def shrink_known(image, known, times, mean, weight):
    """
    Average what is known of image, uint8 (H, W, 3), over squares of `times` by `times` pixels.

    known bool (H, W). Fills mean float32 (h, w, 3), and weight float32 (h, w), 1 where any is
    known; else both are 0.
    """
    height, width = known.shape
    for row in prange(mean.shape[0]):
        for column in range(mean.shape[1]):
            red, green, blue, count = 0, 0, 0, 0
            for y in range(row * times, min((row + 1) * times, height)):
                for x in range(column * times, min((column + 1) * times, width)):
                    if known[y, x]:
                        count += 1
                        red += image[y, x, 0]
                        green += image[y, x, 1]
                        blue += image[y, x, 2]
            weight[row, column] = min(count, 1)
            share = np.float32(1 / max(count, 1))
            mean[row, column, 0] = red * share
            mean[row, column, 1] = green * share
            mean[row, column, 2] = blue * share


@njit(parallel=True, **FAST)
def fill_unknown(image, known, times, coarse):
    """Fill what is not known of image, uint8 (H, W, 3), from coarse, see `shrink_known`."""
    scale, half = np.float32(1 / times), np.float32(0.5)
    rows, columns = coarse.shape[:2]
    for y in prange(known.shape[0]):
        upper, lower, down = _between(y, scale, rows)
        for x in range(known.shape[1]):
            if known[y, x]:
                continue
            left, right, across = _between(x, scale, columns)
            for c in range(3):
                above = coarse[upper, left, c] + across * (
                    coarse[upper, right, c] - coarse[upper, left, c])
                below = coarse[lower, left, c] + across * (
                    coarse[lower, right, c] - coarse[lower, left, c])
                image[y, x, c] = np.uint8(above + down * (below - above) + half)


@njit(parallel=True, **FAST)
def add_slope(slope, share, stretched, more, least, error):
    """Let error (H, W) grow by a share of the picture's slope, and by more where stretched."""
    for y in prange(error.shape[0]):
        for x in range(error.shape[1]):
            expected = max(error[y, x] + share * slope[y, x], least)
            error[y, x] = (expected + more if stretched[y, x] else expected) / np.float32(255)
