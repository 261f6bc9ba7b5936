"""Compiled loops that compare a photo with what the scene memory shows."""
import math
from typing import NamedTuple

from neo_ros.machine.compiled import njit
from neo_ros.memory.kernels import CLOSEST, FAST
import numpy as np

# Mean squares of pixels along a direction, above which places span it.
SPANNED = 1e-6


class PhotoLevel(NamedTuple):
    """A camera image at one scale, grey float32 (h, w) in [0, 1], and its gradients."""

    grey: np.ndarray
    gradient_x: np.ndarray
    gradient_y: np.ndarray


class GuideLevel(NamedTuple):
    """
    What the memory shows at one scale: grey float32 (h, w) in [0, 1].

    depth float32 (h, w), z in metres, 0 = unknown; rays (h, w, 3) of its camera, z = 1.
    """

    grey: np.ndarray
    depth: np.ndarray
    rays: np.ndarray


class Warp(NamedTuple):
    """
    What takes the guide to the photo.

    T float64 (4, 4) from the guide's camera to the photo's; gain times the photo's grey plus bias
    is the guide's.
    """

    T: np.ndarray
    gain: float
    bias: float


@njit(**FAST)
def normal_equations(level, guide_level, camera, warp, scale, redescending, H, g):
    """
    Sum up one Gauss-Newton step of the photometric alignment.

    level PhotoLevel, guide_level GuideLevel, camera Pinhole of both, warp Warp. Residual:
    gain photo(warped) + bias - guide, with Huber's or, if `redescending`, Geman and McClure's
    weights of this scale.
    H (8, 8) and g (8,) are filled for (translation, rotation, gain, bias).
    Returns the mean robust cost of the residuals and the share of the guide's known pixels that
    the photo sees.
    """
    photo, gradient_x, gradient_y = level
    guide, depth, rays = guide_level
    fx, fy, cx, cy = camera
    T, gain, bias = warp
    rows, columns = guide.shape
    H[:] = 0
    g[:] = 0
    J = np.empty(8)
    error, count, known = 0.0, 0, 0
    for i in range(rows):
        for j in range(columns):
            z0 = depth[i, j]
            if z0 <= 0:
                continue
            known += 1
            x0, y0 = rays[i, j, 0] * z0, rays[i, j, 1] * z0
            x = T[0, 0] * x0 + T[0, 1] * y0 + T[0, 2] * z0 + T[0, 3]
            y = T[1, 0] * x0 + T[1, 1] * y0 + T[1, 2] * z0 + T[1, 3]
            z = T[2, 0] * x0 + T[2, 1] * y0 + T[2, 2] * z0 + T[2, 3]
            if z < CLOSEST:
                continue
            u, v = fx * x / z + cx - 0.5, fy * y / z + cy - 0.5
            if not (0 <= u < columns - 1 and 0 <= v < rows - 1):
                continue
            u0, v0 = int(u), int(v)
            a, b = u - u0, v - v0
            w00, w01, w10, w11 = (1 - a) * (1 - b), a * (1 - b), (1 - a) * b, a * b
            value = (w00 * photo[v0, u0] + w01 * photo[v0, u0 + 1]
                     + w10 * photo[v0 + 1, u0] + w11 * photo[v0 + 1, u0 + 1])
            du = gain * fx * (w00 * gradient_x[v0, u0] + w01 * gradient_x[v0, u0 + 1]
                              + w10 * gradient_x[v0 + 1, u0] + w11 * gradient_x[v0 + 1, u0 + 1])
            dv = gain * fy * (w00 * gradient_y[v0, u0] + w01 * gradient_y[v0, u0 + 1]
                              + w10 * gradient_y[v0 + 1, u0] + w11 * gradient_y[v0 + 1, u0 + 1])
            r = gain * value + bias - guide[i, j]
            if redescending:
                # Geman-McClure: what differs much, somebody who stands there, has no say.
                weight = 1 / (1 + (r / scale) ** 2) ** 2
                error += r * r / (1 + (r / scale) ** 2)
            elif abs(r) <= scale:
                weight = 1.0
                error += r * r
            else:
                weight = scale / abs(r)
                error += scale * (2 * abs(r) - scale)
            J[0], J[1], J[2] = du / z, dv / z, -(du * x + dv * y) / (z * z)
            J[3] = y * J[2] - z * J[1]
            J[4] = z * J[0] - x * J[2]
            J[5] = x * J[1] - y * J[0]
            J[6], J[7] = value, 1.0
            for m in range(8):
                wj = weight * J[m]
                g[m] += wj * r
                for n in range(m, 8):
                    H[m, n] += wj * J[n]
            count += 1
    for m in range(8):
        for n in range(m):
            H[m, n] = H[n, m]
    return error / max(count, 1), count / max(known, 1)


@njit(**FAST)
def _add_products(J, weights, count, sums):
    """Add to sums (n, n) the weighted products of the first `count` columns of J (n, N)."""
    weighted = np.empty(count)
    for m in range(len(J)):
        for k in range(count):
            weighted[k] = weights[k] * J[m, k]
        for n in range(m, len(J)):
            total = 0.0
            for k in range(count):
                total += weighted[k] * J[n, k]
            sums[m, n] += total
            sums[n, m] = sums[m, n]


@njit(**FAST)
def equations_in_place(level, guide_level, camera, scale, H):
    """
    Do what `normal_equations` does where guide and photo have one pose and exposure, redescending.

    Nothing is looked up between pixels there: that takes a fifth of the time. H (8, 8) is filled
    with the products of the derivatives; returns the mean robust cost. The outermost pixels, whose
    gradients have one side, are left out.
    """
    photo, gradient_x, gradient_y = level
    guide, depth, _ = guide_level
    rows, columns = guide.shape
    H[:] = 0
    J, weights = np.empty((8, columns - 2)), np.empty(columns - 2)
    error, known = 0.0, 0.0
    for i in range(1, rows - 1):
        y = (i + 0.5 - camera.cy) / camera.fy
        for k in range(columns - 2):
            j = k + 1
            x, z = (j + 0.5 - camera.cx) / camera.fx, max(depth[i, j], CLOSEST)
            du, dv = camera.fx * gradient_x[i, j], camera.fy * gradient_y[i, j]
            r = photo[i, j] - guide[i, j]
            share = 1 / (1 + (r / scale) ** 2)
            counts = 1.0 if depth[i, j] > CLOSEST else 0.0
            known += counts
            error += counts * r * r * share
            weights[k] = counts * share * share
            along = du * x + dv * y
            J[0, k], J[1, k], J[2, k] = du / z, dv / z, -along / z
            J[3, k], J[4, k], J[5, k] = -y * along - dv, du + x * along, x * dv - y * du
            J[6, k], J[7, k] = photo[i, j], 1.0
        _add_products(J, weights, columns - 2, H)
    return error / max(known, 1)


@njit(**FAST)
def detail_correlation(a, b, kept):
    """
    Return the correlation of a and b (h, w) without the planes through them; 0 if one is flat.

    kept bool (h, w): the pixels that count.
    """
    count, mean = 0, np.zeros(4)
    for i in range(a.shape[0]):
        for j in range(a.shape[1]):
            if kept[i, j]:
                count += 1
                mean[0] += i
                mean[1] += j
                mean[2] += a[i, j]
                mean[3] += b[i, j]
    mean /= max(count, 1)
    sums, pixel = np.zeros((4, 4)), np.empty(4)
    for i in range(a.shape[0]):
        for j in range(a.shape[1]):
            if kept[i, j]:
                pixel[0], pixel[1] = i - mean[0], j - mean[1]
                pixel[2], pixel[3] = a[i, j] - mean[2], b[i, j] - mean[3]
                for m in range(4):
                    for n in range(4):
                        sums[m, n] += pixel[m] * pixel[n]
    for k in range(2):  # By elimination: of what is left, less what grows by row, and by column.
        # Directions that the places do not span, such as one row of pixels, have no slope.
        if sums[k, k] <= SPANNED * count:
            continue
        for m in range(k + 1, 4):
            slope = sums[k, m] / sums[k, k]
            for n in range(m, 4):
                sums[m, n] -= slope * sums[k, n]
    norm = math.sqrt(max(sums[2, 2], 0.0) * max(sums[3, 3], 0.0))
    return sums[2, 3] / norm if norm > 1e-6 else 0.0


@njit(**FAST)
def line_errors(a, b, kept):
    """
    Fit a = slope b + offset, arrays (N,), to the `kept` ones, bool (N,), by least squares.

    Returns the slope, and the absolute errors of all, float32 (N,).
    """
    count, mean_a, mean_b, ab, bb = 0, 0.0, 0.0, 0.0, 0.0
    for i in range(len(a)):
        if kept[i]:
            count += 1
            mean_a += a[i]
            mean_b += b[i]
    mean_a, mean_b = mean_a / max(count, 1), mean_b / max(count, 1)
    for i in range(len(a)):
        if kept[i]:
            ab += (a[i] - mean_a) * (b[i] - mean_b)
            bb += (b[i] - mean_b) ** 2
    slope = ab / max(bb, 1e-9)
    errors = np.empty(len(a), np.float32)
    for i in range(len(a)):
        errors[i] = abs(a[i] - mean_a - slope * (b[i] - mean_b))
    return slope, errors
