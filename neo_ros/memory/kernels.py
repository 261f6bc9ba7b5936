"""
Compiled loops of the scene memory: draw keyframes from a new pose, compare them with a photo.

The depths of a keyframe are the vertices of a mesh, joined by triangles: seen from a pose
nearby, the mesh with the keyframe's colours on it is the scene.
"""
import math
from typing import Any

from neo_ros.memory.compiled import njit
from numba import prange
import numpy as np

FAST: dict[str, Any] = {
    'nogil': True, 'fastmath': {'nsz', 'arcp', 'contract', 'afn', 'reassoc'},
    'error_model': 'numpy'}
# Neighbours that parallax pulls apart by more than this, pixels, lie on two surfaces. What is
# stretched between them is drawn only where nothing else is seen.
TEAR = 1.0
# A surface has to be this much nearer to hide what a closer keyframe shows.
NEARER = 0.97
CLOSEST = 0.05
# Horizontal bands of the target that are drawn side by side; fixed, so that no result depends
# on the number of cores.
BANDS = 8


@njit(parallel=True, **FAST)
def project_vertices(rays, depth, offset, rotation, fx, fy, cx, cy, vertices, spans):
    """
    Project a keyframe's vertices into a camera.

    rays (h, w, 3) unit directions in the world, depth (h, w) metres along them (0 = unknown),
    offset (3,) keyframe minus camera position, rotation (3, 3) world to camera. vertices
    (3, h, w): u, v in pixels and 1 / z in 1 / metres, 0 where unknown or behind the camera.
    spans (h, 2): smallest and largest v of a row.
    """
    for i in prange(rays.shape[0]):
        low, high = np.float32(1e9), np.float32(-1e9)
        for j in range(rays.shape[1]):
            d = depth[i, j]
            vertices[2, i, j] = 0
            if d <= 0:
                continue
            px = rays[i, j, 0] * d + offset[0]
            py = rays[i, j, 1] * d + offset[1]
            pz = rays[i, j, 2] * d + offset[2]
            z = rotation[2, 0] * px + rotation[2, 1] * py + rotation[2, 2] * pz
            if z < CLOSEST:
                continue
            x = rotation[0, 0] * px + rotation[0, 1] * py + rotation[0, 2] * pz
            y = rotation[1, 0] * px + rotation[1, 1] * py + rotation[1, 2] * pz
            v = fy * y / z + cy
            vertices[0, i, j] = fx * x / z + cx
            vertices[1, i, j] = v
            vertices[2, i, j] = 1 / z
            low, high = min(low, v), max(high, v)
        spans[i, 0], spans[i, 1] = low, high


@njit(**FAST)
def _draw_triangle(ax, ay, az, bx, by, bz, cx, cy, cz, row, column, upper, texture, ratio,
                   low, high, own, fill, image, inverse, rank):
    """
    Draw half a quad; counter-clockwise halves are seen from behind and left out.

    a, b, c: u, v in pixels and 1 / z. The quad's upper left vertex is (row, column); `upper`:
    this is its upper left half.
    """
    area = (bx - ax) * (cy - ay) - (by - ay) * (cx - ax)
    if area <= 1e-9:
        return
    # Pixel centres lie at +0.5.
    left = max(int(math.ceil(min(ax, bx, cx) - 0.5)), 0)
    right = min(int(math.floor(max(ax, bx, cx) - 0.5)), image.shape[1] - 1)
    top = max(int(math.ceil(min(ay, by, cy) - 0.5)), low)
    bottom = min(int(math.floor(max(ay, by, cy) - 0.5)), high - 1)
    rows, columns = texture.shape[0], texture.shape[1]
    scale = 1 / area
    for y in range(top, bottom + 1):
        for x in range(left, right + 1):
            px, py = x + np.float32(0.5), y + np.float32(0.5)
            wa = ((bx - px) * (cy - py) - (by - py) * (cx - px)) * scale
            wb = ((cx - px) * (ay - py) - (cy - py) * (ax - px)) * scale
            wc = 1 - wa - wb
            if wa < -1e-5 or wb < -1e-5 or wc < -1e-5:
                continue
            near = wa * az + wb * bz + wc * cz
            seen = inverse[y, x]
            if seen > 0:
                # Of its own keyframe the nearest counts, of a later one what is clearly nearer.
                if rank[y, x] == own:
                    if near <= seen:
                        continue
                elif fill or near * NEARER <= seen:
                    continue
            inverse[y, x] = near
            rank[y, x] = own
            # Where in the quad, then where in the texture.
            across = wb if upper else wa + wb
            down = wc if upper else wb + wc
            s = (column + across + np.float32(0.5)) * ratio + (columns - np.float32(0.5))
            t = max((row + down + np.float32(0.5)) * ratio - np.float32(0.5), np.float32(0))
            s0 = int(s)
            t0 = min(int(t), rows - 2)
            fs, ft = s - s0, t - t0
            s0 = s0 % columns
            s1 = s0 + 1 if s0 + 1 < columns else 0
            for k in range(3):
                upper_side = texture[t0, s0, k] + fs * (
                    np.float32(texture[t0, s1, k]) - np.float32(texture[t0, s0, k]))
                lower_side = texture[t0 + 1, s0, k] + fs * (
                    np.float32(texture[t0 + 1, s1, k]) - np.float32(texture[t0 + 1, s0, k]))
                image[y, x, k] = upper_side + ft * (lower_side - upper_side)


@njit(**FAST)
def _any_empty(inverse, low, high):
    for y in range(low, high):
        for x in range(inverse.shape[1]):
            if inverse[y, x] == 0:
                return True
    return False


@njit(parallel=True, **FAST)
def draw_keyframe(vertices, spans, depth, texture, wraps, reach, own, fill,
                  image, inverse, rank):
    """
    Draw the mesh of one keyframe into a view.

    vertices, spans as `project_vertices` left them; depth (h, w) metres and texture
    (n h, n w, 3) uint8 of the keyframe; `wraps`: its last column is a neighbour of its first;
    reach: its distance from the camera times the focal length. `fill` draws what is torn, into
    empty pixels; else the rest is drawn. image (H, W, 3) float32, inverse (H, W) float32 1 / z,
    0 = empty, and rank (H, W) int8, the keyframe's number `own` of each pixel, are filled.
    """
    rows, columns = depth.shape
    height, width = inverse.shape
    ratio = np.float32(texture.shape[0] / rows)
    for band in prange(BANDS):
        low, high = band * height // BANDS, (band + 1) * height // BANDS
        if fill and not _any_empty(inverse, low, high):
            continue
        for i in range(rows - 1):
            if min(spans[i, 0], spans[i + 1, 0]) > high or max(spans[i, 1], spans[i + 1, 1]) < low:
                continue
            for j in range(columns if wraps else columns - 1):
                k = j + 1 if j + 1 < columns else 0
                az, bz = vertices[2, i, j], vertices[2, i, k]
                cz, dz = vertices[2, i + 1, j], vertices[2, i + 1, k]
                if az == 0 or bz == 0 or cz == 0 or dz == 0:
                    continue
                ay, by = vertices[1, i, j], vertices[1, i, k]
                cy, dy = vertices[1, i + 1, j], vertices[1, i + 1, k]
                if max(ay, by, cy, dy) < low or min(ay, by, cy, dy) > high:
                    continue
                ax, bx = vertices[0, i, j], vertices[0, i, k]
                cx, dx = vertices[0, i + 1, j], vertices[0, i + 1, k]
                if max(ax, bx, cx, dx) < 0 or min(ax, bx, cx, dx) > width:
                    continue
                da, db, dc, dd = depth[i, j], depth[i, k], depth[i + 1, j], depth[i + 1, k]
                nearest, farthest = min(da, db, dc, dd), max(da, db, dc, dd)
                if (reach * (farthest - nearest) > TEAR * nearest * farthest) != fill:
                    continue
                _draw_triangle(ax, ay, az, bx, by, bz, cx, cy, cz, i, j, True, texture, ratio,
                               low, high, own, fill, image, inverse, rank)
                _draw_triangle(bx, by, bz, dx, dy, dz, cx, cy, cz, i, j, False, texture, ratio,
                               low, high, own, fill, image, inverse, rank)


@njit(**FAST)
def normal_equations(photo, gradient_x, gradient_y, guide, depth, rays, fx, fy, cx, cy,
                     T, gain, bias, scale, redescending, H, g):
    """
    Sum up one Gauss-Newton step of the photometric alignment.

    photo, its gradients, guide (h, w) float32 grey in [0, 1]; depth (h, w) z of the guide's
    pixels in metres, 0 = unknown; rays (h, w, 3) of the guide's camera, z = 1; T (4, 4) from the
    guide's camera to the photo's. Residual: gain photo(warped) + bias - guide, with Huber's or,
    if `redescending`, Geman and McClure's weights of this scale.
    H (8, 8) and g (8,) are filled for (translation, rotation, gain, bias).
    Returns the mean robust cost of the residuals and the share of the guide's known pixels that
    the photo sees.
    """
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
