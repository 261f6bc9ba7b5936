"""
Compiled loops that fit the voxel field: differentiate, scatter, Adam.

The layout of the field is that of `kernels`. Every gradient is added by the one thread that owns
its voxel, in ray order, so results do not depend on the number of threads or their timing.
"""
import math
from typing import NamedTuple

from neo_ros.field.kernels import (
    FAST, march, MIN_WEIGHT, RaySamples, sample_colour, sh_basis)
from neo_ros.machine.compiled import njit
from numba import prange
import numpy as np

# Adam's corrections of the moments by the number of updates; in the end there is none.
CORRECTION = 1 - np.array([0.9, 0.99]) ** np.arange(4000)[:, None]

# Of the distance: what a depth camera is off by, and voxels are wide. The compiler needs it here.
DEPTH_SHARE = np.float32(0.02)


class Batch(NamedTuple):
    """
    What a step of the fit works on: R rays of P pixels, float32.

    The R / P rays of a pixel follow one another, and their mean is its colour. rays_o and rays_d
    (R, 3), jitter (R,) in [0, 1); per pixel (P, 3) target, gain of its photo, and background, and
    distance (P,), metres along the ray to what a depth camera saw there, 0 = unknown.
    """

    rays_o: np.ndarray
    rays_d: np.ndarray
    jitter: np.ndarray
    target: np.ndarray
    gain: np.ndarray
    background: np.ndarray
    distance: np.ndarray


class LossWeights(NamedTuple):
    """
    Weights of the terms of the loss, float32; see `differentiate_rays`.

    robust is no weight but the error of a colour from which on a pixel loses its own; 0 = never.
    """

    distortion: np.float32
    pointwise: np.float32
    sparsity: np.float32
    depth: np.float32
    robust: np.float32


class SampleSlopes(NamedTuple):
    """
    The samples of R rays, S at most of each, and the gradient of every one.

    cell int64 (R, S); float32: frac (R, S, 3), d_density (R, S), d_rgb (R, S, 3) with respect to
    the sigmoid's argument; counts int64 (R,).
    """

    cell: np.ndarray
    frac: np.ndarray
    d_density: np.ndarray
    d_rgb: np.ndarray
    counts: np.ndarray


class _Pixel(NamedTuple):
    """A pixel's slope of its own colour error, (3,), and its part of the batch."""

    slope: np.ndarray
    gain: np.ndarray
    target: np.ndarray
    background: np.ndarray
    distance: np.float32
    trust: np.float32


@njit(parallel=True, **FAST)
def differentiate_rays(batch, field, weights, slopes, error, d_gain):
    """
    Render rays and emit the gradient of every sample (no gradient is added here).

    Takes a Batch, FieldArrays and LossWeights. Loss per ray: squared error of the pixel's colour,
    `distortion` times the distortion loss of mip-NeRF 360 (eq. 15, its first sum),
    `pointwise` times the samples' own weighted squared error (DirectVoxGO, section 4), and
    `sparsity` times the sum of the samples' opacities. Where depth was measured, less `depth`
    times the share of the ray's weight that is near it, see `near_measured`. With `robust` an
    error e of the colour counts as e / (1 + e / robust^2) (Geman and McClure).
    Fills SampleSlopes, and per pixel error (P,) and d_gain (P, 3).
    """
    rays_o, rays_d, jitter, target, gain, background, distance = batch
    cell, frac, d_density, d_rgb, count = slopes
    terms = field.terms
    pixels = target.shape[0]
    each = rays_o.shape[0] // pixels
    limit = cell.shape[1]
    chunk = 32
    for block in prange((pixels + chunk - 1) // chunk):
        alpha = np.empty((each, limit), np.float32)
        depth = np.empty((each, limit), np.float32)
        raw = np.empty((each, limit), np.float32)
        rgb = np.empty((each, limit, 3), np.float32)
        light = np.empty(each, np.float32)
        value = np.empty(limit, np.float32)
        basis = np.empty(terms, np.float32)
        blend = np.empty(3 * terms, np.float32)
        mean = np.empty(3, np.float32)
        slope = np.empty(3, np.float32)
        for p in range(block * chunk, min((block + 1) * chunk, pixels)):
            mean[:] = 0
            for k in range(each):
                r = p * each + k
                n, light[k] = march(
                    rays_o[r, 0], rays_o[r, 1], rays_o[r, 2],
                    rays_d[r, 0], rays_d[r, 1], rays_d[r, 2], jitter[r], field,
                    RaySamples(cell[r], frac[r], alpha[k], depth[k], raw[k]))
                count[r] = n
                sh_basis(rays_d[r, 0], rays_d[r, 1], rays_d[r, 2], basis)
                left = np.float32(1)
                for i in range(n):
                    weight = left * alpha[k, i]
                    left *= 1 - alpha[k, i]
                    if weight < MIN_WEIGHT:
                        rgb[k, i, 0] = -1
                        continue
                    sample_colour(field, cell[r, i], frac[r, i, 0], frac[r, i, 1],
                                  frac[r, i, 2], basis, blend, rgb[k, i])
                    for channel in range(3):
                        mean[channel] += weight * rgb[k, i, channel]
                for channel in range(3):
                    mean[channel] += light[k] * background[p, channel]
            error[p] = 0
            for channel in range(3):
                colour = mean[channel] / each
                difference = gain[p, channel] * colour - target[p, channel]
                error[p] += difference * difference
                d_gain[p, channel] = 2 * difference * colour
                slope[channel] = 2 * difference * gain[p, channel]
            trust = np.float32(1)
            if weights.robust > 0:
                trust = 1 / (1 + error[p] / (weights.robust * weights.robust)) ** 2
                for channel in range(3):
                    slope[channel] *= trust
                    d_gain[p, channel] *= trust
            pixel = _Pixel(slope, gain[p], target[p], background[p], distance[p], trust)
            for k in range(each):
                r = p * each + k
                samples = RaySamples(cell[r], frac[r], alpha[k], depth[k], raw[k])
                _ray_gradient(count[r], light[k], samples, rgb[k], pixel, weights, field.step,
                              value, d_density[r], d_rgb[r])


@njit(**FAST)
def near_measured(depth, distance):
    """
    Tell how well a sample agrees with measured depth: 1 at it, 0 far from it.

    Geman and McClure's function of the difference over a share of the distance, as a sensor's
    noise grows: a reading that is all wrong (glass, an edge) hardly pulls.
    """
    off = (depth - distance) / (DEPTH_SHARE * distance)
    return 1 / (1 + off * off)


@njit(**FAST)
def _ray_gradient(n, light, samples, rgb, pixel, weights, step, value, d_density, d_rgb):
    """Fill d_density and d_rgb of one ray; `value` is dL/dweight of each sample."""
    _, _, alpha, depth, raw = samples
    slope, gain, target, background, distance, trust = pixel
    distortion, pointwise, sparsity, measured, _ = weights
    pointwise *= trust
    # Distances enter the distortion loss as t / (t + 1): near and far count alike.
    total_w = np.float32(0)
    total_ws = np.float32(0)
    left = np.float32(1)
    for i in range(n):
        weight = left * alpha[i]
        left *= 1 - alpha[i]
        s = depth[i] / (depth[i] + 1)
        total_w += weight
        total_ws += weight * s
    before_w = np.float32(0)
    before_ws = np.float32(0)
    left = np.float32(1)
    behind = light * (slope[0] * background[0] + slope[1] * background[1]
                      + slope[2] * background[2])
    for i in range(n):
        weight = left * alpha[i]
        left *= 1 - alpha[i]
        s = depth[i] / (depth[i] + 1)
        spread = (s * before_w - before_ws
                  + (total_ws - before_ws - weight * s) - s * (total_w - before_w - weight))
        before_w += weight
        before_ws += weight * s
        v = distortion * 2 * spread
        if distance > 0:
            v -= measured * near_measured(depth[i], distance)
        if rgb[i, 0] >= 0:
            for channel in range(3):
                c = rgb[i, channel]
                own = gain[channel] * c - target[channel]
                v += slope[channel] * c + pointwise * own * own
                d_rgb[i, channel] = (
                    weight * (slope[channel] + 2 * pointwise * own * gain[channel])
                    * c * (1 - c))
        else:
            for channel in range(3):
                d_rgb[i, channel] = 0
        value[i] = v
        behind += weight * v
    left = np.float32(1)
    for i in range(n):
        weight = left * alpha[i]
        behind -= weight * value[i]
        keep = 1 - alpha[i]
        # d alpha / d sigma = step * (1 - alpha); d sigma / d raw = sigmoid(raw)
        slope_alpha = step * keep / (1 + math.exp(-raw[i]))
        d_density[i] = (left * value[i] - behind / max(keep, 1e-6) + sparsity) * slope_alpha
        left *= keep


@njit(parallel=True, **FAST)
def scatter_gradients(rays_d, samples, field, threads, gradient, touched):
    """Add the SampleSlopes to `gradient` (V, 1 + 3K) and mark the rows in `touched`."""
    cell, frac, d_density, d_rgb, count = samples
    row_of, terms = field.row_of, field.terms
    sy, sz = field.shape[1], field.shape[2]
    for owner in prange(threads):
        basis = np.empty(terms, np.float32)
        slopes = np.empty(3 * terms, np.float32)
        for r in range(len(rays_d)):  # There is room for more.
            sh_basis(rays_d[r, 0], rays_d[r, 1], rays_d[r, 2], basis)
            for i in range(count[r]):
                fx, fy, fz = frac[r, i, 0], frac[r, i, 1], frac[r, i, 2]
                coloured = d_rgb[r, i, 0] != 0 or d_rgb[r, i, 1] != 0 or d_rgb[r, i, 2] != 0
                for channel in range(3):
                    for k in range(terms):
                        slopes[channel * terms + k] = d_rgb[r, i, channel] * basis[k]
                for corner in range(8):
                    a, b, c = (corner >> 2) & 1, (corner >> 1) & 1, corner & 1
                    point = cell[r, i] + (a * sy + b) * sz + c
                    if (point >> 5) % threads != owner:
                        continue
                    row = row_of[point]
                    weight = ((fx if a else 1 - fx) * (fy if b else 1 - fy)
                              * (fz if c else 1 - fz))
                    touched[row] = 1
                    gradient[row, 0] += weight * d_density[r, i]
                    if coloured:
                        for k in range(3 * terms):
                            gradient[row, 1 + k] += weight * slopes[k]


@njit(parallel=True, **FAST)
def adam_step(grid, gradient, first, second, touched, steps, rate):
    """
    Adam on the touched rows only, then clear their gradients and marks.

    Rows that no ray has touched keep their moments (DirectVoxGO's masked Adam); `steps` (V,)
    counts a row's own updates for the bias correction.
    """
    columns = grid.shape[1]
    chunk = 4096
    rows = grid.shape[0]
    for block in prange((rows + chunk - 1) // chunk):
        for row in range(block * chunk, min((block + 1) * chunk, rows)):
            if not touched[row]:
                continue
            touched[row] = 0
            steps[row] += 1
            correct_first, correct_second = CORRECTION[min(steps[row], len(CORRECTION) - 1)]
            for k in range(columns):
                slope = gradient[row, k]
                gradient[row, k] = 0
                first[row, k] = 0.9 * first[row, k] + 0.1 * slope
                second[row, k] = 0.99 * second[row, k] + 0.01 * slope * slope
                grid[row, k] -= (rate * (first[row, k] / correct_first)
                                 / (math.sqrt(second[row, k] / correct_second) + 1e-8))
