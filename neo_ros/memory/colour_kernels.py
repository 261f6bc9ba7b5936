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


@njit(parallel=True, **FAST)
def bend_colours(guide, correction, difference, weight, of_seen, least_error, wide, error):
    """
    Add to the guide what the seam and the last images correct, and tell the error that is left.

    guide, correction float32 (H, W, 3); difference and weight as `SeenBefore`'s; of_seen: the
    share of the differences that is expected as error. Fills wide uint8 (H, W, 3); error float32
    (H, W) holds the seam's, and is changed in place.
    """
    one, half, white = np.float32(1), np.float32(0.5), np.float32(255)
    share = np.float32(of_seen / 3)
    for y in prange(guide.shape[0]):
        for x in range(guide.shape[1]):
            rest, seen = one - weight[y, x], np.float32(0)
            for c in range(3):
                off = difference[y, x, c]
                seen += abs(off)
                colour = guide[y, x, c] + correction[y, x, c] * rest + off
                wide[y, x, c] = np.uint8(min(max(colour + half, np.float32(0)), white))
            error[y, x] = error[y, x] * rest + seen * share + weight[y, x] * least_error


@njit(parallel=True, **FAST)
def add_slope(slope, share, stretched, more, least, error):
    """Let error (H, W) grow by a share of the picture's slope, and by more where stretched."""
    for y in prange(error.shape[0]):
        for x in range(error.shape[1]):
            expected = max(error[y, x] + share * slope[y, x], least)
            error[y, x] = (expected + more if stretched[y, x] else expected) / np.float32(255)
