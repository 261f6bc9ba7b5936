"""
Compiled loops that draw keyframes of the scene memory from a new pose.

The depths of a keyframe are the vertices of a mesh, joined by triangles: seen from a pose
nearby, the mesh with the keyframe's colours on it is the scene.
"""
import math
from typing import Any, NamedTuple

from neo_ros.machine.compiled import njit
from numba import prange
import numpy as np

FAST: dict[str, Any] = {
    'nogil': True, 'fastmath': {'nsz', 'arcp', 'contract', 'afn', 'reassoc'},
    'error_model': 'numpy'}
# A surface has to be this much nearer to hide what a closer keyframe shows.
NEARER = 0.97
CLOSEST = 0.05
# Horizontal bands of the target that are drawn side by side; fixed, so that no result depends
# on the number of cores.
BANDS = 8
# A pixel with a weight below this is not in the triangle; neighbours leave no gap between them.
# Triangles with less than this, twice their area in pixels, are not drawn.
OUTSIDE, FLAT = np.float32(-1e-5), np.float32(1e-9)
# Quads of a mesh, seen from a pose: out of view, whole, torn.
UNSEEN, WHOLE, TORN = 0, 1, 2


# What kernels take is defined in files of kernels: code kept on disk refers to fields by their
# place, and is made anew only where such a file has changed.
class Pinhole(NamedTuple):
    """Focal lengths and principal point of a camera, pixels."""

    fx: float | np.float32
    fy: float | np.float32
    cx: float | np.float32
    cy: float | np.float32


class Mesh(NamedTuple):
    """
    A keyframe's mesh in a view; see `project_vertices` and `sort_quads`.

    vertices float32 (3, h, w), kinds uint8 (h, w), spans float32 (h, 2, 2), texture uint8 RGB
    (n h, n w, 3).
    """

    vertices: np.ndarray
    kinds: np.ndarray
    spans: np.ndarray
    texture: np.ndarray


class Canvas(NamedTuple):
    """
    What is drawn into.

    image float32 RGB (H, W, 3); inverse float32 (H, W), 1 / z in 1 / metres, 0 = empty; rank int8
    (H, W), the number of the keyframe that is seen, -1 = none.
    """

    image: np.ndarray
    inverse: np.ndarray
    rank: np.ndarray


class Box(NamedTuple):
    """Pixels from the first to the last, both included."""

    left: int
    right: int
    top: int
    bottom: int


@njit(parallel=True, **FAST)
def project_vertices(rays, depth, offset, rotation, camera, vertices):
    """
    Project a keyframe's vertices into a camera.

    rays (h, w, 3) unit directions in the world, depth (h, w) metres along them (0 = unknown),
    offset (3,) keyframe minus camera position, rotation (3, 3) world to camera, camera Pinhole.
    vertices (3, h, w): u, v in pixels and 1 / z in 1 / metres, 0 where unknown or behind it.
    """
    for i in prange(rays.shape[0]):
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
            vertices[0, i, j] = camera.fx * x / z + camera.cx
            vertices[1, i, j] = camera.fy * y / z + camera.cy
            vertices[2, i, j] = 1 / z


@njit(parallel=True, **FAST)
def sort_quads(vertices, depth, wraps, reach, width, height, kinds, spans):
    """
    Tell which quads of a keyframe's mesh are in a view of (height, width) pixels.

    vertices as `project_vertices` left them; depth (h, w) metres; `wraps`: the last column is a
    neighbour of the first; reach: the keyframe's distance from the camera, metres, over the
    parallax that tears neighbours, radians.

    kinds (h, w) uint8: UNSEEN, WHOLE or TORN, of the quad whose upper left vertex it is; spans
    (h, 2, 2) float32: smallest and largest v of a row's whole and of its torn ones.
    """
    rows, columns = depth.shape
    for i in prange(rows):
        for torn in range(2):
            spans[i, torn, 0], spans[i, torn, 1] = np.float32(1e9), np.float32(-1e9)
        for j in range(columns):
            kinds[i, j] = UNSEEN
            k = j + 1 if j + 1 < columns else 0
            if i + 1 == rows or (k == 0 and not wraps):
                continue
            if vertices[2, i, j] == 0 or vertices[2, i, k] == 0 \
                    or vertices[2, i + 1, j] == 0 or vertices[2, i + 1, k] == 0:
                continue
            ax, bx = vertices[0, i, j], vertices[0, i, k]
            cx, dx = vertices[0, i + 1, j], vertices[0, i + 1, k]
            if max(ax, bx, cx, dx) < 0 or min(ax, bx, cx, dx) > width:
                continue
            ay, by = vertices[1, i, j], vertices[1, i, k]
            cy, dy = vertices[1, i + 1, j], vertices[1, i + 1, k]
            high, low = min(ay, by, cy, dy), max(ay, by, cy, dy)
            if low < 0 or high > height:
                continue
            da, db, dc, dd = depth[i, j], depth[i, k], depth[i + 1, j], depth[i + 1, k]
            nearest, farthest = min(da, db, dc, dd), max(da, db, dc, dd)
            torn = 1 if reach * (farthest - nearest) > nearest * farthest else 0
            kinds[i, j] = TORN if torn else WHOLE
            spans[i, torn, 0] = min(spans[i, torn, 0], high)
            spans[i, torn, 1] = max(spans[i, torn, 1], low)


@njit(**FAST)
def _draw_quad(quad, box, row, column, texture, ratio, own, fill, canvas):
    """
    Draw the two triangles a, b, c and b, d, c of a quad into the pixels of its box.

    quad: a to d, each (u, v, 1 / z), row by row; those that are seen from behind are left out.
    (row, column): the vertex a in the mesh; ratio: texture pixels a quad.
    """
    a, b, c, d = quad
    ax, ay, az = a
    bx, by, bz = b
    cx, cy, cz = c
    dx, dy, dz = d
    left, right, top, bottom = box
    image, inverse, rank = canvas
    upper = (bx - ax) * (cy - ay) - (by - ay) * (cx - ax)
    lower = (dx - bx) * (cy - by) - (dy - by) * (cx - bx)
    over_upper = np.float32(1) / upper if upper > FLAT else np.float32(0)
    over_lower = np.float32(1) / lower if lower > FLAT else np.float32(0)
    rows, columns = texture.shape[0], texture.shape[1]
    px = left + np.float32(0.5)
    for y in range(top, bottom + 1):
        py = y + np.float32(0.5)
        # Twice the signed areas that the box's first pixel makes with the sides; all change
        # evenly from pixel to pixel.
        bc = (bx - px) * (cy - py) - (by - py) * (cx - px)
        ca = (cx - px) * (ay - py) - (cy - py) * (ax - px)
        ab = (ax - px) * (by - py) - (ay - py) * (bx - px)
        dc = (dx - px) * (cy - py) - (dy - py) * (cx - px)
        bd = (bx - px) * (dy - py) - (by - py) * (dx - px)
        for x in range(left, right + 1):
            step = np.float32(x - left)
            if bc + step * (by - cy) >= 0:
                across = (ca + step * (cy - ay)) * over_upper
                down = (ab + step * (ay - by)) * over_upper
                if min(across, down) < OUTSIDE or over_upper == 0:
                    continue
                near = az + across * (bz - az) + down * (cz - az)
            else:
                before = (bd + step * (by - dy)) * over_lower
                above = (dc + step * (dy - cy)) * over_lower
                if min(before, above) < OUTSIDE or over_lower == 0:
                    continue
                near = dz + before * (cz - dz) + above * (bz - dz)
                across, down = np.float32(1) - before, np.float32(1) - above
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
            # Where in the texture.
            s = (column + across + np.float32(0.5)) * ratio + (columns - np.float32(0.5))
            t = max((row + down + np.float32(0.5)) * ratio - np.float32(0.5), np.float32(0))
            s0 = int(s)
            t0 = min(int(t), rows - 2)
            fs, ft = np.float32(s - s0), np.float32(t - t0)
            while s0 >= columns:
                s0 -= columns
            s1 = s0 + 1 if s0 + 1 < columns else 0
            for k in range(3):
                upper_left = np.float32(texture[t0, s0, k])
                lower_left = np.float32(texture[t0 + 1, s0, k])
                upper_side = upper_left + fs * (np.float32(texture[t0, s1, k]) - upper_left)
                lower_side = lower_left + fs * (np.float32(texture[t0 + 1, s1, k]) - lower_left)
                image[y, x, k] = upper_side + ft * (lower_side - upper_side)


@njit(**FAST)
def _any_empty(inverse, low, high):
    for y in range(low, high):
        for x in range(inverse.shape[1]):
            if inverse[y, x] == 0:
                return True
    return False


@njit(**FAST)
def _is_hidden(box, nearest, own, fill, canvas):
    """Tell whether `_draw_quad` would change no pixel of a box; nearest: the largest 1 / z."""
    for y in range(box.top, box.bottom + 1):
        for x in range(box.left, box.right + 1):
            seen = canvas.inverse[y, x]
            if seen <= 0 or canvas.rank[y, x] == own or not (fill or nearest * NEARER <= seen):
                return False
    return True


@njit(parallel=True, **FAST)
def draw_keyframe(mesh, own, fill, canvas):
    """
    Draw the Mesh of the keyframe with the number `own` into a Canvas.

    `fill` draws what is torn, into empty pixels; else the rest is drawn.
    """
    vertices, kinds, spans, texture = mesh
    rows, columns = kinds.shape
    height, width = canvas.inverse.shape
    ratio = np.float32(texture.shape[0] / rows)
    wanted, torn = (TORN, 1) if fill else (WHOLE, 0)
    for band in prange(BANDS):
        low, high = band * height // BANDS, (band + 1) * height // BANDS
        if fill and not _any_empty(canvas.inverse, low, high):
            continue
        for i in range(rows - 1):
            if spans[i, torn, 0] > high or spans[i, torn, 1] < low:
                continue
            for j in range(columns):
                if kinds[i, j] != wanted:
                    continue
                k = j + 1 if j + 1 < columns else 0
                ay, by = vertices[1, i, j], vertices[1, i, k]
                cy, dy = vertices[1, i + 1, j], vertices[1, i + 1, k]
                top = max(int(math.ceil(min(ay, by, cy, dy) - 0.5)), low)
                bottom = min(int(math.floor(max(ay, by, cy, dy) - 0.5)), high - 1)
                if top > bottom:
                    continue
                ax, bx = vertices[0, i, j], vertices[0, i, k]
                cx, dx = vertices[0, i + 1, j], vertices[0, i + 1, k]
                left = max(int(math.ceil(min(ax, bx, cx, dx) - 0.5)), 0)
                right = min(int(math.floor(max(ax, bx, cx, dx) - 0.5)), width - 1)
                if left > right:
                    continue
                az, bz = vertices[2, i, j], vertices[2, i, k]
                cz, dz = vertices[2, i + 1, j], vertices[2, i + 1, k]
                # A little more than the nearest vertex, for what rounding does.
                box = Box(left, right, top, bottom)
                if _is_hidden(box, max(az, bz, cz, dz) * np.float32(1.0001), own, fill, canvas):
                    continue
                quad = ((ax, ay, az), (bx, by, bz), (cx, cy, cz), (dx, dy, dz))
                _draw_quad(quad, box, i, j, texture, ratio, own, fill, canvas)
