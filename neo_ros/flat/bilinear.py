"""Where a place lies between the values of a bitmap, for compiled loops."""
import math

from neo_ros.machine.compiled import njit
import numpy as np


@njit(error_model='numpy', nogil=True)
def neighbours(share, size, wraps):
    """
    Return the indices of the two values around a place, and how far it is from the first one.

    share float32: of a line of `size` values, each at the middle of its part. wraps: the last one
    is beside the first, and the line goes on for ever; else those at the ends do.
    """
    place = share * np.float32(size) - np.float32(0.5)
    first = math.floor(place)
    part = np.float32(place - first)
    if wraps:
        return first % size, (first + 1) % size, part
    return min(max(first, 0), size - 1), min(max(first + 1, 0), size - 1), part
