"""
Gauss-Newton steps of an alignment in one compiled loop.

In Python they took a quarter of the time that an alignment of a small view takes.
"""
import math
from typing import NamedTuple

from neo_ros.machine.compiled import njit
from neo_ros.memory.alignment_kernels import normal_equations, Warp
from neo_ros.memory.kernels import FAST
import numpy as np


class Descent(NamedTuple):
    """
    How Gauss-Newton steps are taken, see `AlignmentThresholds`.

    scale, redescending: of the residuals' weights, see `normal_equations`; gains: the least and
    the largest one.
    """

    scale: float
    redescending: bool
    iterations: int
    still: float
    damping: float
    lost: float
    gains: tuple[float, float]


# The cost of a warp that has lost the image.
LOST = 1e30


@njit(**FAST)
def descend(level, guide_level, camera, warp, descent):
    """Return the Warp that steps at one scale lead to; the rest as in `normal_equations`."""
    depths = guide_level.depth.ravel()
    depths = depths[depths > 0]
    away = max(np.median(depths), 0.5) if len(depths) else 1.0
    H, g, step = np.empty((8, 8)), np.empty(8), np.empty(8)
    kept, before = warp, LOST
    for iteration in range(descent.iterations + 1):
        error, overlap = normal_equations(level, guide_level, camera, warp, descent.scale,
                                          descent.redescending, H, g)
        # Pixels that are lost must not look like an improvement.
        cost = error / overlap if overlap >= descent.lost else LOST
        if cost > before:
            return kept
        if iteration == descent.iterations:
            break  # The last step, too, had to be an improvement.
        kept, before = warp, cost
        for m in range(8):
            H[m, m] += descent.damping * (H[m, m] + 1e-6)
        _solve(H, g, step)
        warp = _stepped(warp, step, descent.gains)
        moved = camera.fx * (math.sqrt(step[0] ** 2 + step[1] ** 2 + step[2] ** 2) / away
                             + math.sqrt(step[3] ** 2 + step[4] ** 2 + step[5] ** 2))
        if moved < descent.still:
            break
    return warp


@njit(**FAST)
def _solve(H, g, step):
    """Fill step (N,) with the x of H x = -g; of H (N, N), positive definite, nothing is left."""
    size = len(g)
    for m in range(size):
        for n in range(m):
            total = H[m, n]
            for k in range(n):
                total -= H[m, k] * H[k, k] * H[n, k]
            H[m, n] = total / H[n, n]
        for k in range(m):
            H[m, m] -= H[m, k] ** 2 * H[k, k]
        H[m, m] = max(H[m, m], 1e-30)
    for m in range(size):
        step[m] = -g[m]
        for k in range(m):
            step[m] -= H[m, k] * step[k]
    for m in range(size):
        step[m] /= H[m, m]
    for m in range(size - 1, -1, -1):
        for k in range(m + 1, size):
            step[m] -= H[k, m] * step[k]


@njit(**FAST)
def _stepped(warp, step, gains):
    """Return a Warp moved on by a step (8,): a translation, a rotation, gain and bias."""
    x, y, z = step[3], step[4], step[5]
    angle = math.sqrt(x * x + y * y + z * z)
    along, across = 1.0, 0.5
    if angle > 1e-8:
        along, across = math.sin(angle) / angle, (1 - math.cos(angle)) / angle ** 2
    move = np.eye(4)
    move[0, 0] -= across * (y * y + z * z)
    move[1, 1] -= across * (x * x + z * z)
    move[2, 2] -= across * (x * x + y * y)
    move[0, 1], move[1, 0] = across * x * y - along * z, across * x * y + along * z
    move[0, 2], move[2, 0] = across * x * z + along * y, across * x * z - along * y
    move[1, 2], move[2, 1] = across * y * z - along * x, across * y * z + along * x
    move[:3, 3] = step[:3]
    T = np.zeros((4, 4))
    for i in range(4):
        for j in range(4):
            for k in range(4):
                T[i, j] += move[i, k] * warp.T[k, j]
    least, most = gains
    return Warp(T, min(max(warp.gain + step[6], least), most), warp.bias + step[7])
