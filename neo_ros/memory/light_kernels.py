"""Compiled loops over the cells in which the light of a scene is kept."""
import math

from neo_ros.machine.compiled import njit
from neo_ros.memory.kernels import FAST
import numpy as np


@njit(**FAST)
def _corners(x, y, z, low, cell, shape, index, share):
    """Fill index (8, 3) and share (8,) of the cells around a point; outside the nearest ones."""
    place = ((x - low[0]) / cell, (y - low[1]) / cell, (z - low[2]) / cell)
    for corner in range(8):
        share[corner] = np.float32(1)
        for axis in range(3):
            at = min(max(place[axis], np.float32(0)), np.float32(shape[axis] - 1))
            first = min(int(math.floor(at)), shape[axis] - 2)
            off = np.float32(at - first)
            upper = (corner >> axis) & 1
            index[corner, axis] = first + upper
            share[corner] *= off if upper else np.float32(1) - off


@njit(**FAST)
def look_up_light(points, low, cell, cells, weight, before, light):
    """
    Fill light (M, 3) at points (M, 3), of which `before` (M, 3) is known from coarser cells.

    cells float32 (X, Y, Z, 4): sums of light times trust, and of trust; low (3,): the middle of
    the first cell; cell: their distance; weight: of what is known before.
    """
    index, share = np.empty((8, 3), np.int64), np.empty(8, np.float32)
    for m in range(len(points)):
        _corners(points[m, 0], points[m, 1], points[m, 2], low, cell, cells.shape, index, share)
        trust = weight
        red, green, blue = (weight * before[m, 0], weight * before[m, 1], weight * before[m, 2])
        for corner in range(8):
            one = cells[index[corner, 0], index[corner, 1], index[corner, 2]]
            red += share[corner] * one[0]
            green += share[corner] * one[1]
            blue += share[corner] * one[2]
            trust += share[corner] * one[3]
        light[m, 0], light[m, 1], light[m, 2] = red / trust, green / trust, blue / trust


@njit(**FAST)
def add_light(points, light, trust, low, cell, most, cells):
    """Add what points (M, 3) show, as `look_up_light` keeps it; a cell trusts `most` at most."""
    index, share = np.empty((8, 3), np.int64), np.empty(8, np.float32)
    for m in range(len(points)):
        if trust[m] <= 0:
            continue
        _corners(points[m, 0], points[m, 1], points[m, 2], low, cell, cells.shape, index, share)
        for corner in range(8):
            one = cells[index[corner, 0], index[corner, 1], index[corner, 2]]
            more = share[corner] * trust[m]
            for c in range(3):
                one[c] += more * light[m, c]
            one[3] += more
            if one[3] > most:
                for c in range(3):
                    one[c] *= most / one[3]
                one[3] = most
