"""Compiled loops that tell which of two states of a thing an image shows. None is parallel."""
import math
from typing import NamedTuple

from neo_ros.machine.compiled import njit
from neo_ros.memory.change_kernels import NEAREST, SAME
from neo_ros.memory.kernels import FAST
import numpy as np

OTHER, STAYS, NEITHER = 0, 1, 2


class Look(NamedTuple):
    """
    An image and what was shown there.

    image float32 (h, w, 3), in the memory's exposure; depth float32 (h, w), metres, of what was
    shown, 0 = unknown; contradicted bool (h, w). R (3, 3), t (3,), float32: from the world to the
    camera.
    """

    image: np.ndarray
    depth: np.ndarray
    contradicted: np.ndarray
    R: np.ndarray
    t: np.ndarray


@njit(**FAST)
def _project(point, look, camera):
    """Return row, column (-1 outside) and depth of a point."""
    R, t = look.R, look.t
    z = R[2, 0] * point[0] + R[2, 1] * point[1] + R[2, 2] * point[2] + t[2]
    if z < NEAREST:
        return -1, -1, z
    u = camera.fx * (R[0, 0] * point[0] + R[0, 1] * point[1] + R[0, 2] * point[2] + t[0]) / z
    v = camera.fy * (R[1, 0] * point[0] + R[1, 1] * point[1] + R[1, 2] * point[2] + t[1]) / z
    u += camera.cx
    v += camera.cy
    if not (0 <= u < look.depth.shape[1] and 0 <= v < look.depth.shape[0]):
        return -1, -1, z
    return int(v), int(u), z


@njit(**FAST)
def _off(colour, look, row, column, aside):
    """Return by how many grey levels the pixel near one that is most like a colour differs."""
    least = np.float32(256)
    for i in range(max(row - aside, 0), min(row + aside + 1, look.image.shape[0])):
        for j in range(max(column - aside, 0), min(column + aside + 1, look.image.shape[1])):
            off = np.float32(0)
            for k in range(3):
                off = max(off, abs(look.image[i, j, k] - colour[k]))
            least = min(least, off)
    return least


@njit(**FAST)
def weigh(points, colours, depths, parts, other, look, camera, aside, alike, different, votes,
          said):
    """
    Count what an image says of each part: votes float32 (parts, 3) grow.

    points, colours (N, 2, 3), depths (N, 2): as Samples'; parts int64 (N,): which part; other
    int8 (parts,): which of the two is not shown, -1: it is not asked for. aside: pixels; alike,
    different: grey levels. OTHER: the image contradicts what is shown, and shows the other
    state; STAYS: it agrees with what is shown where the other state would be seen; NEITHER: it
    contradicts both. said bool (3, h, w): set where it says so, but for STAYS.

    From farther away than the patch saw it many samples share a pixel, which is one witness.
    """
    for i in range(len(parts)):
        part = parts[i]
        state = other[part]
        if state < 0 or depths[i, 1] <= 0 or depths[i, 0] <= 0:
            continue
        row, column, z = _project(points[i, state], look, camera)
        if row < 0 or look.depth[row, column] <= 0:
            continue
        weight = min(depths[i, state] / z, np.float32(1)) ** 2
        off = _off(colours[i, state], look, row, column, aside)
        if look.contradicted[row, column]:
            if off < alike:
                votes[part, OTHER] += weight
                said[OTHER, row, column] = True
            elif off > different:
                votes[part, NEITHER] += weight
                said[NEITHER, row, column] = True
            continue
        if depths[i, state] < depths[i, 1 - state] * (1 - SAME):
            # The other state is nearer: it would hide what is seen.
            if off > different and look.depth[row, column] > z * (1 - SAME):
                votes[part, STAYS] += weight
            continue
        row, column, z = _project(points[i, 1 - state], look, camera)
        if row < 0 or look.contradicted[row, column] or look.depth[row, column] <= 0 or abs(
                look.depth[row, column] - z) > SAME * z:
            continue
        if _off(colours[i, state], look, row, column, aside) > different:
            votes[part, STAYS] += weight


@njit(**FAST)
def key_of(x, y, z, cell):
    """Return the number of the cell that a point lies in; far away some share one."""
    one = np.int64(1 << 21)
    return ((np.int64(math.floor(x / cell)) % one) * one
            + np.int64(math.floor(y / cell)) % one) * one + np.int64(math.floor(z / cell)) % one


@njit(**FAST)
def keys_of(points, cell, keys):
    """Fill keys int64 (N,) of points float32 (N, 3)."""
    for i in range(len(points)):
        keys[i] = key_of(points[i, 0], points[i, 1], points[i, 2], cell)


@njit(**FAST)
def find_cells(depth, rays, R, t, cell, cells, found):
    """
    Tell which pixels show a surface in one of the cells: found float32 (h, w), 1 or 0.

    depth float32 (h, w); rays (h, w, 3), z = 1; R (3, 3), t (3,): from the camera to the world;
    cells int64 (C,): their numbers, rising.
    """
    for i in range(depth.shape[0]):
        for j in range(depth.shape[1]):
            d = depth[i, j]
            found[i, j] = 0
            if d <= 0:
                continue
            x, y, z = rays[i, j, 0] * d, rays[i, j, 1] * d, rays[i, j, 2] * d
            key = key_of(R[0, 0] * x + R[0, 1] * y + R[0, 2] * z + t[0],
                         R[1, 0] * x + R[1, 1] * y + R[1, 2] * z + t[1],
                         R[2, 0] * x + R[2, 1] * y + R[2, 2] * z + t[2], cell)
            low, high = 0, len(cells)
            while low < high:
                middle = (low + high) // 2
                if cells[middle] < key:
                    low = middle + 1
                else:
                    high = middle
            if low < len(cells) and cells[low] == key:
                found[i, j] = 1
