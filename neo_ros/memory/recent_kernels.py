"""The compiled loop that brings what the last images showed into the present wide view."""
from typing import NamedTuple

from neo_ros.machine.compiled import njit
from neo_ros.memory.kernels import CLOSEST, FAST
from numba import prange
import numpy as np

# A surface counts as seen by an image if the depth there is the same within this share.
SAME_DEPTH = 0.03
# Beside the border of an image it counts less, over so many pixels.
FEATHER = np.float32(4)
# Two images that differ by so many grey levels from one another contradict each other.
CONTRADICTING = np.float32(12)
# What one image adds, as a share of what is still open: the memory is an estimate, too.
SHARE = np.float32(0.6)
ENOUGH = np.float32(0.98)


class SeenImages(NamedTuple):
    """
    N images of one camera, and where n of them were taken, the newest first.

    differences float32 (N, h, w, 3), grey levels, exposed as the memory; depths float32 (N, h, w)
    metres, 0 = unknown; trusts float32 (N, h, w) in [0, 1]; order int64 (n,): which of the N;
    R float32 (n, 3, 3), t float32 (n, 3), from the camera of the view to them.
    """

    differences: np.ndarray
    depths: np.ndarray
    trusts: np.ndarray
    order: np.ndarray
    R: np.ndarray
    t: np.ndarray


@njit(**FAST)
def project(camera, R, t, k, x, y, z):
    """Return column, row and depth of a point in camera k, R[k] and t[k] to it, a Pinhole."""
    depth = R[k, 2, 0] * x + R[k, 2, 1] * y + R[k, 2, 2] * z + t[k, 2]
    return (camera.fx * (R[k, 0, 0] * x + R[k, 0, 1] * y + R[k, 0, 2] * z + t[k, 0]) / depth
            + camera.cx,
            camera.fy * (R[k, 1, 0] * x + R[k, 1, 1] * y + R[k, 1, 2] * z + t[k, 1]) / depth
            + camera.cy, depth)


@njit(**FAST)
def between(images, k, y, x, down, right, c):
    """Return channel c of images[k] so far (in [0, 1]) from pixel (y, x) to the next ones."""
    one = np.float32(1)
    top = (one - right) * images[k, y, x, c] + right * images[k, y, x + 1, c]
    low = (one - right) * images[k, y + 1, x, c] + right * images[k, y + 1, x + 1, c]
    return (one - down) * top + down * low


@njit(parallel=True, **FAST)
def bring_differences(rays, depth, gain, seen, twins, camera, brought, weight):
    """
    Look up, for every pixel of a view, how images that saw its surface differed from the memory.

    rays (H, W, 3) of the view, z = 1; depth (H, W) metres, 0 = not asked for; gain (3,) from the
    memory's exposure to the view's; seen SeenImages of the camera, a Pinhole of float32; `twins`:
    the newest two are from one pose, or nearly so, and cannot confirm each other. A difference
    that is not trusted counts where another image has the same.
    Fills weight (H, W) in [0, 1] and brought (H, W, 3), the mean difference times the weight.
    """
    differences, depths, trusts, order, R, t = seen
    images, height, width = len(order), depths.shape[1], depths.shape[2]
    zero, half, one = np.float32(0), np.float32(0.5), np.float32(1)
    for y in prange(depth.shape[0]):
        found = np.empty((images, 3), np.float32)
        shares, sure = np.empty(images, np.float32), np.empty(images, np.float32)
        which = np.empty(images, np.int64)
        for x in range(depth.shape[1]):
            weight[y, x] = 0
            for c in range(3):
                brought[y, x, c] = 0
            d = depth[y, x]
            if d <= 0:
                continue
            px, py, pz = rays[y, x, 0] * d, rays[y, x, 1] * d, rays[y, x, 2] * d
            count = 0
            for k in range(images):
                u, v, z = project(camera, R, t, k, px, py, pz)
                if z < CLOSEST:
                    continue
                inside = min(min(u, width - u), min(v, height - v)) - half
                if not inside > 0:
                    continue
                own = order[k]
                if abs(depths[own, int(v), int(u)] - z) > SAME_DEPTH * z:
                    continue
                which[count] = k
                shares[count] = min(inside / FEATHER, one)
                sure[count] = trusts[own, int(v), int(u)]
                x0, y0 = min(int(u - half), width - 2), min(int(v - half), height - 2)
                ax, ay = u - half - x0, v - half - y0
                for c in range(3):
                    found[count, c] = between(differences, own, y0, x0, ay, ax, c)
                count += 1
            total = zero
            for k in range(count):
                trust = sure[k]
                for other in range(count):
                    if trust < 1 and other != k and not (twins and which[k] + which[other] == 1):
                        apart = zero
                        for c in range(3):
                            apart = max(apart, abs(found[k, c] - found[other, c]))
                        same = min(one, 2 * max(one - apart / CONTRADICTING, zero))
                        trust = max(trust, shares[other] * same)
                share = SHARE * shares[k] * trust * (one - total)
                total += share
                for c in range(3):
                    brought[y, x, c] += share * gain[c] * found[k, c]
                if total > ENOUGH:
                    break
            weight[y, x] = total
