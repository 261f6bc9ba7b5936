"""Compiled loop that colours a panorama from the photos themselves."""
import math
from typing import NamedTuple

from neo_ros.baking.band_rendering import block_centres
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
# One over the distances of two points, 1/m, may differ by so much: half a metre aside that is less
# than a pixel of 200 a radian. So what is farther than 100 m is one surface, the sky above all,
# whose depth is chance, and any photo sees it that sees something as far.
FAR = 0.01
# How much a photo counts that is so many grey levels away from the field's colour: 1 / e.
COLOUR = 60.0
# Farther photos are coarser: so many radians for each time that a photo is farther away.
DISTANCE = 0.3
# A photo looks at a point from at most 60 degrees aside.
LEAST_COSINE = 0.5
# Neighbours in a coarse depth map of a photo, of which the nearer has at least this share of the
# other's distance, may be of one surface that slants.
SLANT = 0.7
# A point nearer to a photo's camera, metres, is not in it.
CLOSEST = 0.1
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

    images uint8 (M, H, W, 3); float32: depth (N, H, W) or coarser, metres along the ray, rotations
    (N, 3, 3) camera to world, positions (N, 3), gains (N, 3) that multiply a photo's colours to
    the scene's; fx, fy, cx, cy in pixels; numbers int64 (N,): which of the images the photos are,
    None: all, in their order. So nobody has to copy the N of more, which may be gigabytes.
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
    numbers: np.ndarray | None = None


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


@njit(**FAST)
def _sees(depth, u, v, length, coarser):
    """
    Tell whether a photo sees a point at `length` metres that falls on (u, v) of its depth (h, w).

    Where depth is coarser than the photo, one of the four neighbours has to agree, or to lie on
    either side of the point on one surface that slants.
    """
    slack = DEPTH_SHARE * length + DEPTH_METRES
    if not coarser:
        seen = depth[int(v), int(u)]
        return abs(seen - length) <= max(slack, FAR * seen * length)
    i = min(max(int(v - 0.5), 0), depth.shape[0] - 2)
    j = min(max(int(u - 0.5), 0), depth.shape[1] - 2)
    nearest, farthest = depth[i, j], depth[i, j]
    for k in range(4):
        seen = depth[i + k // 2, j + k % 2]
        if abs(seen - length) <= max(slack, FAR * seen * length):
            return True
        nearest, farthest = min(nearest, seen), max(farthest, seen)
    return nearest < length < farthest and nearest > SLANT * farthest


@njit(parallel=True, **FAST)
def choose_photos(panorama, posed, own, which, cost):
    """
    Choose, for every own pixel of a panorama, the photos that see its point most nearly alike.

    Takes PanoramaPixels, PhotoArrays and own bool (h, w); fills which int32 (h, w, BLENDED),
    -1 = none, and cost float64 of that shape, radians, the least first; others have none.
    """
    position, rays, depth, _ = panorama
    images, photo_depth, rotations, positions, _, fx, fy, cx, cy, _ = posed
    high, wide = images.shape[1], images.shape[2]
    # Depth may be coarser than the photos.
    across, down = photo_depth.shape[2] / wide, photo_depth.shape[1] / high
    offsets, squares = np.empty((len(positions), 3)), np.empty(len(positions))
    for n in range(len(positions)):
        squares[n] = 0
        for c in range(3):
            offsets[n, c] = position[c] - positions[n, c]
            squares[n] += offsets[n, c] ** 2
    for i in prange(depth.shape[0]):
        for j in range(depth.shape[1]):
            chosen, score = which[i, j], cost[i, j]
            chosen[:] = -1
            score[:] = 1e9
            d = depth[i, j]
            if d <= 0 or not own[i, j]:
                continue
            # Most photos are too far aside: the angle alone, squared, tells with few operations.
            least = SLACK * LEAST_COSINE ** 2
            for n in range(len(positions)):
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
                if z < CLOSEST:
                    continue
                u = fx * (R[0, 0] * px + R[1, 0] * py + R[2, 0] * pz) / z + cx
                v = fy * (R[0, 1] * px + R[1, 1] * py + R[2, 1] * pz) / z + cy
                if not (1 <= u < wide - 1 and 1 <= v < high - 1):
                    continue
                length = math.sqrt(px * px + py * py + pz * pz)
                cosine = (px * rays[i, j, 0] + py * rays[i, j, 1] + pz * rays[i, j, 2]) / length
                if cosine < LEAST_COSINE:
                    continue
                angle = math.acos(min(cosine, 1.0)) + DISTANCE * max(length / d - 1, 0.0)
                if angle >= score[-1]:
                    continue
                if not _sees(photo_depth[n], u * across, v * down, length, across < 1):
                    continue
                m = BLENDED - 1
                while m > 0 and score[m - 1] > angle:
                    score[m], chosen[m] = score[m - 1], chosen[m - 1]
                    m -= 1
                score[m], chosen[m] = angle, n
                least = SLACK * math.cos(min(score[-1], math.acos(LEAST_COSINE))) ** 2


@njit(**FAST)
def _between(a, b, c, d, s, t):
    """Interpolate four neighbours, row by row, s of the way across and t down."""
    return (1 - t) * ((1 - s) * a + s * b) + t * ((1 - s) * c + s * d)


@njit(**FAST)
def _read_cubic(photo, u, v, gain, colour):
    """Read a photo's colour, times its gain, at (u, v), pixel centres at whole numbers."""
    u0, v0 = int(u), int(v)
    for c in range(3):
        colour[c] = 0.0
    for p in range(4):
        line = min(max(v0 + p - 1, 0), photo.shape[0] - 1)
        for q in range(4):
            weight = cubic(p, v - v0) * cubic(q, u - u0)
            for c in range(3):
                colour[c] += weight * photo[line, min(max(u0 + q - 1, 0), photo.shape[1] - 1), c]
    for c in range(3):
        colour[c] *= gain[c]


@njit(parallel=True, **FAST)
def blend_photos(panorama, posed, which, cost, wraps, one_surface, out):
    """
    Colour a texture, uint8 (n h, n w, 3), of a panorama from the photos chosen for its pixels.

    Takes PanoramaPixels, PhotoArrays and what `choose_photos` filled; `wraps`: the last column is
    a neighbour of the first; one_surface: depths that differ by less than this share are of one.
    Photos are read by cubic interpolation: what a linear one blurs would be blurred once more when
    the panorama is drawn.
    """
    position, rays, depth, coarse = panorama
    images, _, rotations, positions, gains, fx, fy, cx, cy, numbers = posed
    high, wide = images.shape[1], images.shape[2]
    rows, columns = depth.shape
    tall, broad = out.shape[0] / rows, out.shape[1] / columns
    for i in prange(out.shape[0]):
        ray, own = np.empty(3), np.empty(3)
        colour, total = np.empty(3), np.empty(3)
        y = (i + 0.5) / tall - 0.5
        i0 = min(max(int(math.floor(y)), 0), max(rows - 2, 0))
        i1, t = min(i0 + 1, rows - 1), y - i0
        near_i = min(max(int(math.floor(y + 0.5)), 0), rows - 1)
        for j in range(out.shape[1]):
            x = (j + 0.5) / broad - 0.5
            j0 = int(math.floor(x))
            if not wraps:
                j0 = min(max(j0, 0), max(columns - 2, 0))
            s = x - j0
            near_j = int(math.floor(x + 0.5))
            near_j = near_j % columns if wraps else min(max(near_j, 0), columns - 1)
            j1 = (j0 + 1) % columns if wraps else min(j0 + 1, columns - 1)
            j0 = j0 % columns
            a, b, e, f = depth[i0, j0], depth[i0, j1], depth[i1, j0], depth[i1, j1]
            d = depth[near_i, near_j]
            # On one surface depth and colour of the field go on from pixel to pixel.
            s_in, t_in = min(max(s, 0.0), 1.0), min(max(t, 0.0), 1.0)
            nearest, farthest = min(a, b, e, f), max(a, b, e, f)
            smooth = (nearest > (1 - one_surface) * farthest
                      or farthest - nearest < FAR * nearest * farthest)
            if smooth:
                d = _between(a, b, e, f, s_in, t_in)
            for c in range(3):
                ray[c] = _between(rays[i0, j0, c], rays[i0, j1, c], rays[i1, j0, c],
                                  rays[i1, j1, c], s, t)
                own[c] = coarse[near_i, near_j, c]
                if smooth:
                    own[c] = _between(coarse[i0, j0, c], coarse[i0, j1, c], coarse[i1, j0, c],
                                      coarse[i1, j1, c], s_in, t_in)
            chosen, score = which[near_i, near_j], cost[near_i, near_j]
            # The field's own colour decides only where no photo agrees with it.
            weights = 1e-3
            for c in range(3):
                total[c] = 1e-3 * own[c]
            for m in range(BLENDED):
                n = chosen[m]
                if n < 0:
                    break
                R = rotations[n]
                px = position[0] - positions[n, 0] + ray[0] * d
                py = position[1] - positions[n, 1] + ray[1] * d
                pz = position[2] - positions[n, 2] + ray[2] * d
                z = R[0, 2] * px + R[1, 2] * py + R[2, 2] * pz
                u = fx * (R[0, 0] * px + R[1, 0] * py + R[2, 0] * pz) / z + cx - 0.5
                v = fy * (R[0, 1] * px + R[1, 1] * py + R[2, 1] * pz) / z + cy - 0.5
                if z < CLOSEST or not (0 <= u < wide - 1 and 0 <= v < high - 1):
                    continue  # Just outside, where the pixel's middle is inside.
                _read_cubic(images[numbers[n]], u, v, gains[n], colour)
                apart = 0.0
                for c in range(3):
                    apart += (colour[c] - own[c]) ** 2
                weight = (math.exp((score[0] - score[m]) / ANGLE)
                          * math.exp(-apart / (COLOUR * COLOUR)))
                weights += weight
                for c in range(3):
                    total[c] += weight * colour[c]
            for c in range(3):
                out[i, j, c] = min(max(total[c] / weights + 0.5, 0.0), 255.0)


def colour_from_photos(panorama: PanoramaPixels, posed: PhotoArrays, wraps: bool,
                       one_surface: float, out: np.ndarray, own: np.ndarray | None = None,
                       block: int = 1) -> None:
    """
    Colour `out`, uint8 (n h, n w, 3), see `choose_photos` and `blend_photos`.

    own: bool (h, w), pixels that photos are chosen for; others take those of the middle of their
    block of `block` squared pixels. None: all.
    """
    if posed.numbers is None:
        posed = posed._replace(numbers=np.arange(len(posed.images)))
    which = np.empty((*panorama.depth.shape, BLENDED), np.int32)
    cost = np.empty(which.shape)
    if own is None:
        own = np.ones(panorama.depth.shape, np.bool_)
    choose_photos(panorama, posed, own, which, cost)
    for chosen in (which, cost):
        middle = block_centres(chosen, block).repeat(block, 0).repeat(block, 1)
        np.copyto(chosen, middle, where=~own[..., None])
    blend_photos(panorama, posed, which, cost, wraps, one_surface, out)
