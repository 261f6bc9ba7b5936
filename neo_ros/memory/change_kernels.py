"""
Compiled loops that put what has changed into the keyframes of the scene memory.

They run where keyframes are decoded, beside the camera's loops: none of them is parallel.
"""
import math
from typing import NamedTuple

from neo_ros.machine.compiled import njit
from neo_ros.memory.kernels import FAST
import numpy as np

# Depths of one surface differ by no more than this share; the memory's own are not better.
SAME = np.float32(0.1)
# Neighbours in a patch whose depths differ by more than this share lie on two surfaces.
TORN = np.float32(0.1)
# Triangles that a patch saw so much more coarsely than the keyframe are not drawn: texels a pixel
# along each side, in those of a surface that both see alike. Less where only colours differ.
STRETCHED, REPAINTED = np.float32(2.5), np.float32(1.3)
# A surface that stays keeps colours that differ by fewer grey levels: its own are finer.
ALIKE = np.float32(30)
NEAREST = np.float32(0.05)
# Vertices of a mesh are looked at in squares of so many along each side.
BLOCK = 8


class Seen(NamedTuple):
    """
    A patch: image uint8 RGB (h, w, 3), depth float32 (h, w), metres, 0 = not changed.

    R (3, 3), t (3,), float32: from the world, the keyframe's position as origin, to the camera.
    """

    image: np.ndarray
    depth: np.ndarray
    R: np.ndarray
    t: np.ndarray


class Sphere(NamedTuple):
    """
    A keyframe as it is changed, at the resolution of its texture, and the part of the sphere.

    texture uint8 RGB (H, W, 3); surface float32 (H, W), metres along the ray, 0 = unknown;
    quality float32 (H, W), pixels a metre that it was seen with, 0 = from before; top, low,
    rise, width: as a Band's, radians; wraps.
    """

    texture: np.ndarray
    surface: np.ndarray
    quality: np.ndarray
    top: np.float32
    low: np.float32
    rise: np.float32
    width: np.float32
    wraps: bool


@njit(**FAST)
def bound_blocks(rays, depth, blocks):
    """
    Find a ball around the vertices of each block of a mesh: blocks (h / BLOCK, w / BLOCK, 4).

    Rounded up; x, y, z and radius, metres, from the keyframe; the radius is -1 for no vertices.
    """
    for row in range(blocks.shape[0]):
        for column in range(blocks.shape[1]):
            low, high = np.full(3, np.inf), np.full(3, -np.inf)
            for i in range(row * BLOCK, min((row + 1) * BLOCK, depth.shape[0])):
                for j in range(column * BLOCK, min((column + 1) * BLOCK, depth.shape[1])):
                    if depth[i, j] > 0:
                        for k in range(3):
                            at = rays[i, j, k] * depth[i, j]
                            low[k], high[k] = min(low[k], at), max(high[k], at)
            blocks[row, column, 3] = -1
            if low[0] <= high[0]:
                reach = 0.0
                for k in range(3):
                    blocks[row, column, k] = (low[k] + high[k]) / 2
                    reach += (high[k] - low[k]) ** 2
                blocks[row, column, 3] = math.sqrt(reach) / 2 + 1e-3


@njit(**FAST)
def _in_view(ball, seen, camera, farthest):
    """Tell whether a ball (x, y, z, radius) may be in the view of a patch, and no farther."""
    R, t, radius = seen.R, seen.t, ball[3]
    z = R[2, 0] * ball[0] + R[2, 1] * ball[1] + R[2, 2] * ball[2] + t[2]
    if radius < 0 or z + radius < NEAREST or z - radius > farthest:
        return False
    for axis in range(2):
        at = R[axis, 0] * ball[0] + R[axis, 1] * ball[1] + R[axis, 2] * ball[2] + t[axis]
        focal, centre = (camera.fx, camera.cx) if axis == 0 else (camera.fy, camera.cy)
        rest = seen.depth.shape[1 - axis] - centre
        if focal * at + centre * z < -radius * math.sqrt(focal ** 2 + centre ** 2) or \
                rest * z - focal * at < -radius * math.sqrt(focal ** 2 + rest ** 2):
            return False
    return True


@njit(**FAST)
def _sees_through(x, y, z0, seen, camera):
    """Tell whether a patch sees what is behind a point, from the keyframe."""
    height, width = seen.depth.shape
    R, t = seen.R, seen.t
    z = R[2, 0] * x + R[2, 1] * y + R[2, 2] * z0 + t[2]
    if z < NEAREST:
        return False
    u = camera.fx * (R[0, 0] * x + R[0, 1] * y + R[0, 2] * z0 + t[0]) / z + camera.cx
    v = camera.fy * (R[1, 0] * x + R[1, 1] * y + R[1, 2] * z0 + t[1]) / z + camera.cy
    if not (1 <= u < width - 1 and 1 <= v < height - 1):
        return False
    row, column = int(v), int(u)
    if seen.depth[row, column] <= 0:
        return False
    # At an edge the nearer surface counts.
    for a in range(row - 1, row + 2):
        for b in range(column - 1, column + 2):
            if 0 < seen.depth[a, b] * (1 - SAME) <= z:
                return False
    return True


@njit(**FAST)
def carve(rays, depth, blocks, seen, camera):
    """
    Take out what a patch sees through: depth (h, w) of a keyframe becomes 0 there.

    rays (h, w, 3) unit directions in the world, depth in metres along them; blocks as
    `bound_blocks` makes them; camera a Pinhole. Returns how many vertices were taken out.
    """
    count = 0
    farthest = seen.depth.max()  # It sees through nothing behind that: other rooms cost no time.
    for row in range(blocks.shape[0]):
        for column in range(blocks.shape[1]):
            if not _in_view(blocks[row, column], seen, camera, farthest):
                continue
            for i in range(row * BLOCK, min((row + 1) * BLOCK, depth.shape[0])):
                for j in range(column * BLOCK, min((column + 1) * BLOCK, depth.shape[1])):
                    d = depth[i, j]
                    if d > 0 and _sees_through(rays[i, j, 0] * d, rays[i, j, 1] * d,
                                               rays[i, j, 2] * d, seen, camera):
                        depth[i, j] = 0
                        count += 1
    return count


@njit(**FAST)
def _on_sphere(sphere, x, y, z):
    """Return column, row (in texels, pixel centres at +0.5) and distance of a point."""
    height, width = sphere.surface.shape
    azimuth = math.atan2(y, x) - sphere.low
    turn = np.float32(2 * math.pi)
    azimuth -= turn * math.floor(azimuth / turn)
    flat = math.sqrt(x * x + y * y)
    column = (1 - azimuth / sphere.width) * width
    row = (sphere.top - math.atan2(z, flat)) / sphere.rise * height
    return np.float32(column), np.float32(row), np.float32(math.sqrt(flat * flat + z * z))


@njit(**FAST)
def shows_any(points, sphere):
    """
    Tell whether a keyframe may show one of some points, float32 (N, 3), metres from it.

    sphere.surface: the depths of the mesh, not of the texture.
    """
    rows, columns = sphere.surface.shape
    # No surface hides what is unknown. Most patches of a building are farther off than all walls.
    known = sphere.surface.min() > 0
    farthest = sphere.surface.max() * (1 + SAME) * np.float32(1.001)
    for n in range(len(points)):
        if known and (points[n, 0] ** 2 + points[n, 1] ** 2 + points[n, 2] ** 2) > farthest ** 2:
            continue
        column, row, distance = _on_sphere(sphere, points[n, 0], points[n, 1], points[n, 2])
        # What lies between points may be beside a vertex.
        for a in range(int(row) - 1, int(row) + 2):
            for b in range(int(column) - 1, int(column) + 2):
                if 0 <= a < rows and (sphere.wraps or 0 <= b < columns):
                    there = sphere.surface[a, b % columns]
                    if there <= 0 or distance <= there * (1 + SAME):
                        return True
    return False


@njit(**FAST)
def _draw_triangle(a, b, c, side, quality, sphere):
    """
    Draw a triangle of (column, row, distance, red, green, blue) into the sphere.

    side: of a pixel that both see alike, texels.
    """
    height, width = sphere.surface.shape
    area = (b[0] - a[0]) * (c[1] - a[1]) - (b[1] - a[1]) * (c[0] - a[0])
    if not np.float32(1e-6) < area < (STRETCHED * side) ** 2:
        return  # Seen from behind, or stretched.
    repaints = area < (REPAINTED * side) ** 2
    half = np.float32(0.5)
    top = max(int(math.ceil(min(a[1], b[1], c[1]) - half)), 0)
    bottom = min(int(math.floor(max(a[1], b[1], c[1]) - half)), height - 1)
    left = int(math.ceil(min(a[0], b[0], c[0]) - half))
    right = int(math.floor(max(a[0], b[0], c[0]) - half))
    outside = np.float32(-1e-4)
    for y in range(top, bottom + 1):
        py = y + half
        for column in range(left, right + 1):
            px = column + half
            wb = ((px - a[0]) * (c[1] - a[1]) - (py - a[1]) * (c[0] - a[0])) / area
            wc = ((b[0] - a[0]) * (py - a[1]) - (b[1] - a[1]) * (px - a[0])) / area
            wa = 1 - wb - wc
            if min(wa, min(wb, wc)) < outside:
                continue
            x = column
            if x < 0 or x >= width:
                if not sphere.wraps:
                    continue
                x = x - width if x >= width else x + width
            near = wa * a[2] + wb * b[2] + wc * c[2]
            there = sphere.surface[y, x]
            if there > 0:
                if near > there * (1 + SAME):
                    continue
                if near > there * (1 - SAME) and (
                        quality <= sphere.quality[y, x]
                        or (sphere.quality[y, x] == 0 and not repaints)):
                    continue
                if near > there * (1 - SAME) and sphere.quality[y, x] == 0:
                    apart = np.float32(0)
                    for k in range(3):
                        apart = max(apart, abs(wa * a[3 + k] + wb * b[3 + k] + wc * c[3 + k]
                                               - sphere.texture[y, x, k]))
                    if apart < ALIKE:
                        continue
            sphere.surface[y, x] = near
            sphere.quality[y, x] = quality
            for k in range(3):
                sphere.texture[y, x, k] = np.uint8(
                    wa * a[3 + k] + wb * b[3 + k] + wc * c[3 + k] + half)


@njit(**FAST)
def draw_patch(seen, camera, sphere):
    """Draw what a patch saw into a keyframe, as far as nothing there hides it."""
    height, width = seen.depth.shape
    R, t = seen.R, seen.t
    vertex = np.empty((2, width, 6), np.float32)  # The row above, and this one.
    texel = sphere.surface.shape[0] / sphere.rise
    turn = np.float32(sphere.surface.shape[1])
    for i in range(height):
        for j in range(width):
            vertex[0, j] = vertex[1, j]
            d = seen.depth[i, j]
            if d <= 0:
                continue
            cx = (j + np.float32(0.5) - camera.cx) / camera.fx * d - t[0]
            cy = (i + np.float32(0.5) - camera.cy) / camera.fy * d - t[1]
            cz = d - t[2]
            column, row, distance = _on_sphere(
                sphere, R[0, 0] * cx + R[1, 0] * cy + R[2, 0] * cz,
                R[0, 1] * cx + R[1, 1] * cy + R[2, 1] * cz,
                R[0, 2] * cx + R[1, 2] * cy + R[2, 2] * cz)
            vertex[1, j, 0], vertex[1, j, 1], vertex[1, j, 2] = column, row, distance
            for k in range(3):
                vertex[1, j, 3 + k] = seen.image[i, j, k]
        if i == 0:
            continue
        for j in range(width - 1):
            da, db = seen.depth[i - 1, j], seen.depth[i - 1, j + 1]
            dc, dd = seen.depth[i, j], seen.depth[i, j + 1]
            least, most = min(da, db, dc, dd), max(da, db, dc, dd)
            if least <= 0 or most - least > TORN * least:
                continue
            a, b = vertex[0, j].copy(), vertex[0, j + 1].copy()
            c, e = vertex[1, j].copy(), vertex[1, j + 1].copy()
            for corner in (b, c, e):  # Across the seam of the panorama.
                if corner[0] - a[0] > turn / 2:
                    corner[0] -= turn
                elif a[0] - corner[0] > turn / 2:
                    corner[0] += turn
            # A pixel seen alike by both has so many texels along each side.
            side = texel / camera.fx * least / max(a[2], NEAREST)
            quality = np.float32(camera.fx / least)
            _draw_triangle(a, b, c, side, quality, sphere)
            _draw_triangle(b, e, c, side, quality, sphere)


@njit(**FAST)
def take_depths(sphere, depth):
    """Give the mesh, depth (h, w), the depths that were drawn over half of a vertex's texels."""
    rows, columns = depth.shape
    finer = sphere.surface.shape[0] // rows
    for i in range(rows):
        for j in range(columns):
            count = 0
            chosen = np.float32(0)
            for y in range(i * finer, (i + 1) * finer):
                for x in range(j * finer, (j + 1) * finer):
                    if sphere.quality[y, x] > 0:
                        count += 1
                        # A mean of two surfaces would hang between them.
                        if chosen == 0 or (y - i * finer == x - j * finer == finer // 2):
                            chosen = sphere.surface[y, x]
            if 2 * count >= finer * finer:
                depth[i, j] = chosen
