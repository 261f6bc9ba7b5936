"""Compiled loop that colours a panorama from the photos themselves."""
import math
from typing import NamedTuple

from neo_ros.field.kernels import FAST
from neo_ros.machine.compiled import njit
from numba import prange
import numpy as np

# Chosen by measuring, but globals: the kernel is compiled with their values in it.
# Photos that are blended in a pixel.
BLENDED = 4
# What a photo may differ from the field's depth, relative and in metres, and still see the point.
DEPTH_SHARE, DEPTH_METRES = 0.04, 0.02
# Radians by which a photo may look at a point from further aside than the best photo.
ANGLE = 0.05
# How much a photo counts that is so many grey levels away from the field's colour: 1 / e.
COLOUR = 60.0
# Farther photos are coarser: so many radians for each time that a photo is farther away.
DISTANCE = 0.3
# A photo looks at a point from at most 60 degrees aside.
LEAST_COSINE = 0.5
# For what rounding does to squared cosines.
SLACK = 1 - 1e-6


class PanoramaPixels(NamedTuple):
    """
    The panorama that is coloured: what the field shows there.

    position float32 (3,); rays (h, w, 3); depth float32 (h, w), metres along the ray,
    0 = unknown; coarse uint8 (h, w, 3), the field's own colours.
    """

    position: np.ndarray
    rays: np.ndarray
    depth: np.ndarray
    coarse: np.ndarray


class PhotoArrays(NamedTuple):
    """
    The photos that colour it, all of one camera.

    images uint8 (N, H, W, 3); float32: depth (N, H, W) metres along the ray, rotations (N, 3, 3)
    camera to world, positions (N, 3), gains (N, 3) that multiply a photo's colours to the
    scene's; fx, fy, cx, cy in pixels.
    """

    images: np.ndarray
    depth: np.ndarray
    rotations: np.ndarray
    positions: np.ndarray
    gains: np.ndarray
    fx: float
    fy: float
    cx: float
    cy: float


@njit(**FAST)
def cubic(k, t):
    """Catmull and Rom's weight of the k-th of four samples, t of the way from the second on."""
    if k == 0:
        return ((2 - t) * t - 1) * t / 2
    if k == 1:
        return (3 * t - 5) * t * t / 2 + 1
    if k == 2:
        return ((4 - 3 * t) * t + 1) * t / 2
    return (t - 1) * t * t / 2


@njit(parallel=True, **FAST)
def colour_from_photos(panorama, posed, out):
    """
    Blend, for every pixel of a panorama, the photos that see its point most nearly alike.

    Takes PanoramaPixels and PhotoArrays; fills out uint8 (h, w, 3). Photos are read by cubic
    interpolation: what a linear one blurs would be blurred once more when the panorama is drawn.
    """
    position, rays, depth, coarse = panorama
    photos, photo_depth, rotations, positions, gains, fx, fy, cx, cy = posed
    high, wide = photos.shape[1], photos.shape[2]
    offsets, squares = np.empty((len(photos), 3)), np.empty(len(photos))
    for n in range(len(photos)):
        squares[n] = 0
        for c in range(3):
            offsets[n, c] = position[c] - positions[n, c]
            squares[n] += offsets[n, c] ** 2
    for i in prange(depth.shape[0]):
        score = np.empty(BLENDED)
        which = np.empty(BLENDED, np.int64)
        us, vs = np.empty(BLENDED), np.empty(BLENDED)
        colour, total = np.empty(3), np.empty(3)
        across, down = np.empty(4), np.empty(4)
        for j in range(depth.shape[1]):
            out[i, j] = coarse[i, j]
            d = depth[i, j]
            if d <= 0:
                continue
            score[:] = 1e9
            which[:] = -1
            # Most photos are too far aside: the angle alone, squared, tells with few operations.
            least = SLACK * LEAST_COSINE ** 2
            for n in range(len(photos)):
                nearer = (offsets[n, 0] * rays[i, j, 0] + offsets[n, 1] * rays[i, j, 1]
                          + offsets[n, 2] * rays[i, j, 2])
                along = nearer + d
                if along <= 0 or along * along < least * (squares[n] + d * (nearer + along)):
                    continue
                px = offsets[n, 0] + rays[i, j, 0] * d
                py = offsets[n, 1] + rays[i, j, 1] * d
                pz = offsets[n, 2] + rays[i, j, 2] * d
                R = rotations[n]
                z = R[0, 2] * px + R[1, 2] * py + R[2, 2] * pz
                if z < 0.1:
                    continue
                u = fx * (R[0, 0] * px + R[1, 0] * py + R[2, 0] * pz) / z + cx
                v = fy * (R[0, 1] * px + R[1, 1] * py + R[2, 1] * pz) / z + cy
                if not (1 <= u < wide - 1 and 1 <= v < high - 1):
                    continue
                length = math.sqrt(px * px + py * py + pz * pz)
                cosine = (px * rays[i, j, 0] + py * rays[i, j, 1] + pz * rays[i, j, 2]) / length
                if cosine < LEAST_COSINE:
                    continue
                cost = math.acos(min(cosine, 1.0)) + DISTANCE * max(length / d - 1, 0.0)
                if cost >= score[-1]:
                    continue
                seen = photo_depth[n, int(v), int(u)]
                if abs(seen - length) > DEPTH_SHARE * length + DEPTH_METRES:
                    continue
                m = BLENDED - 1
                while m > 0 and score[m - 1] > cost:
                    score[m], which[m], us[m], vs[m] = (
                        score[m - 1], which[m - 1], us[m - 1], vs[m - 1])
                    m -= 1
                score[m], which[m], us[m], vs[m] = cost, n, u - 0.5, v - 0.5
                least = SLACK * math.cos(min(score[-1], math.acos(LEAST_COSINE))) ** 2
            # The field's own colour decides only where no photo agrees with it.
            weights = 1e-3
            for c in range(3):
                total[c] = 1e-3 * coarse[i, j, c]
            for m in range(BLENDED):
                if which[m] < 0:
                    break
                photo, gain = photos[which[m]], gains[which[m]]
                u0, v0 = int(us[m]), int(vs[m])
                for k in range(4):
                    across[k], down[k] = cubic(k, us[m] - u0), cubic(k, vs[m] - v0)
                apart = 0.0
                for c in range(3):
                    value = 0.0
                    for p in range(4):
                        y = min(max(v0 + p - 1, 0), high - 1)
                        for q in range(4):
                            x = min(max(u0 + q - 1, 0), wide - 1)
                            value += down[p] * across[q] * photo[y, x, c]
                    colour[c] = gain[c] * value
                    apart += (colour[c] - coarse[i, j, c]) ** 2
                weight = (math.exp((score[0] - score[m]) / ANGLE)
                          * math.exp(-apart / (COLOUR * COLOUR)))
                weights += weight
                for c in range(3):
                    total[c] += weight * colour[c]
            for c in range(3):
                out[i, j, c] = min(max(total[c] / weights + 0.5, 0.0), 255.0)
