"""The compiled loop that puts what a camera saw into a view of the scene memory."""
from typing import NamedTuple

from neo_ros.machine.compiled import njit
from neo_ros.memory.kernels import CLOSEST, FAST
from numba import prange
import numpy as np

# A surface counts as seen by an image if it lies between the depths there, within this share.
SAME_DEPTH = 0.05
# Beside the border of an image it counts less, over so many pixels.
FEATHER = np.float32(3)


class Brought(NamedTuple):
    """
    N images of one camera, the newest first.

    differences float32 (N, h, w, 3), by which they differ from the memory, in its exposure; depths
    float32 (N, h, w), metres, 0 = unknown; R float32 (N, 3, 3), t float32 (N, 3), from the camera
    of the view to them.
    """

    differences: np.ndarray
    depths: np.ndarray
    R: np.ndarray
    t: np.ndarray


@njit(parallel=True, **FAST)
def bring_newest(rays, depth, brought, camera, mark, picture, kinds):
    """
    Correct a view by how images of the same surfaces differ from the memory; the newest one wins.

    rays (H, W, 3) of the view, z = 1; depth (H, W) metres, 0 = unknown; camera of the images, a
    Pinhole of float32. Adds to picture float32 RGB (H, W, 3), and sets kinds uint8 (H, W) to
    `mark` there.
    """
    differences, depths, R, t = brought
    fx, fy, cx, cy = camera
    height, width = depths.shape[1], depths.shape[2]
    half, one = np.float32(0.5), np.float32(1)
    for y in prange(depth.shape[0]):
        for x in range(depth.shape[1]):
            d = depth[y, x]
            if d <= 0:
                continue
            px, py, pz = rays[y, x, 0] * d, rays[y, x, 1] * d, rays[y, x, 2] * d
            for k in range(len(differences)):
                z = R[k, 2, 0] * px + R[k, 2, 1] * py + R[k, 2, 2] * pz + t[k, 2]
                if z < CLOSEST:
                    continue
                u = fx * (R[k, 0, 0] * px + R[k, 0, 1] * py + R[k, 0, 2] * pz + t[k, 0]) / z + cx
                v = fy * (R[k, 1, 0] * px + R[k, 1, 1] * py + R[k, 1, 2] * pz + t[k, 1]) / z + cy
                inside = min(min(u, width - u), min(v, height - v)) - half
                if not inside > 0:
                    continue
                x0, y0 = min(int(u - half), width - 2), min(int(v - half), height - 2)
                # On a slanted surface the depths of neighbours differ by more.
                nearest = farthest = depths[k, y0, x0]
                for there in (depths[k, y0, x0 + 1], depths[k, y0 + 1, x0],
                              depths[k, y0 + 1, x0 + 1]):
                    nearest, farthest = min(nearest, there), max(farthest, there)
                if not nearest * (1 - SAME_DEPTH) < z < farthest * (1 + SAME_DEPTH):
                    continue
                ax, ay = u - half - x0, v - half - y0
                share = min(inside / FEATHER, one)
                for c in range(3):
                    top = (one - ax) * differences[k, y0, x0, c] \
                        + ax * differences[k, y0, x0 + 1, c]
                    low = (one - ax) * differences[k, y0 + 1, x0, c] \
                        + ax * differences[k, y0 + 1, x0 + 1, c]
                    picture[y, x, c] += share * ((one - ay) * top + ay * low)
                kinds[y, x] = mark
                break
