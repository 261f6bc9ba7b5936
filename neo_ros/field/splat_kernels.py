"""Compiled loop that sums splats up at the points of a voxel field."""
import math

from neo_ros.machine.compiled import njit
from numba import prange

# Deviations of a splat that are looked at. A global, as kernels are compiled with its value.
REACH = 3.0


@njit(parallel=True)
def add_splats(place, precision, mass, values, row_of, shape, threads, out):
    """
    Add each Gaussian's `values` (N, C), times its density, to the rows of its grid points.

    place (N, 3) and precision (N, 3, 3) in voxels, mass (N,) the density in the middle, row_of
    as a field's, out float32 (V, C). A thread owns planes of x: sums do not depend on timing.
    """
    sx, sy, sz = shape[0], shape[1], shape[2]
    for owner in prange(threads):
        for n in range(place.shape[0]):
            p = precision[n]
            # What is left of a plane's quadratic form after z, and then y, is chosen best.
            pyy = p[1, 1] - p[1, 2] * p[1, 2] / p[2, 2]
            pxy = p[0, 1] - p[0, 2] * p[1, 2] / p[2, 2]
            pxx = p[0, 0] - p[0, 2] * p[0, 2] / p[2, 2] - pxy * pxy / pyy
            rx = REACH / math.sqrt(pxx)
            first = max(math.ceil(place[n, 0] - rx), 0)
            for ix in range(first, min(math.floor(place[n, 0] + rx), sx - 1) + 1):
                if ix % threads != owner:
                    continue
                dx = ix - place[n, 0]
                ry = math.sqrt(max(REACH * REACH - pxx * dx * dx, 0.0) / pyy)
                cy = place[n, 1] - pxy / pyy * dx
                for iy in range(max(math.ceil(cy - ry), 0), min(math.floor(cy + ry), sy - 1) + 1):
                    dy = iy - place[n, 1]
                    b = p[0, 2] * dx + p[1, 2] * dy
                    rest = (p[0, 0] * dx * dx + 2 * p[0, 1] * dx * dy + p[1, 1] * dy * dy
                            - b * b / p[2, 2])
                    rz = math.sqrt(max(REACH * REACH - rest, 0.0) / p[2, 2])
                    cz = place[n, 2] - b / p[2, 2]
                    for iz in range(max(math.ceil(cz - rz), 0),
                                    min(math.floor(cz + rz), sz - 1) + 1):
                        row = row_of[(ix * sy + iy) * sz + iz]
                        if row < 0:
                            continue
                        dz = iz - cz
                        density = mass[n] * math.exp(-0.5 * (rest + p[2, 2] * dz * dz))
                        for k in range(values.shape[1]):
                            out[row, k] += density * values[n, k]
