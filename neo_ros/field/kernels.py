"""
Compiled loops that look into the voxel field: march, colour, composite, mark.

One grid point is one row of `grid` (V, 1 + 3K) float32: raw density, then K spherical-harmonic
coefficients for each of R, G, B. `row_of` (X * Y * Z) int32 tells which row, -1 where air is not
kept: no ray samples it (the links of Plenoxels, Fridovich-Keil et al., CVPR 2022). Rows count up
along z, so of two kept points one above the other the second has the next row. Positions are
contracted to grid coordinates as in DirectVoxGO's unbounded scenes (after mip-NeRF 360): inside
the inner box the map is linear, and the world outside fills a shell of relative thickness `shell`.
"""
import math
from typing import Any, NamedTuple

from neo_ros.machine.compiled import njit
from numba import prange
import numpy as np

# These three are globals as kernels are compiled with their values in them.
# Light that is left is taken for none; at 8 bits a pixel this is far below one step.
MIN_TRANSMITTANCE = 1e-4
# Samples that contribute less get no colour lookup. All samples of a new field are faint
# (initial_alpha): without their colour's pull, bright surfaces would fade instead of forming.
MIN_WEIGHT = 1e-6
# In a view of a fitted field samples are seen from this weight on. Without the others, of which
# thin haze has many, views of living_room stay the same but for 61 dB.
MIN_SHOWN = 1e-3
FAST: dict[str, Any] = {
    'fastmath': {'nsz', 'arcp', 'contract', 'afn', 'reassoc'},
    'error_model': 'numpy'}


class FieldArrays(NamedTuple):
    """
    A radiance field, as kernels take it.

    grid and row_of are described above; shape int64 (3,); skip and seen uint8 (X * Y * Z,) per
    cell: `skip` 0 = occupied, n = at least n cells to the nearest occupied one.
    box float64 (8,): centre xyz, half extent xyz, shell, voxel edge in metres. step in voxels,
    near in metres, shift of the raw density; terms per colour; limit of a ray's samples.
    """

    grid: np.ndarray
    row_of: np.ndarray
    shape: np.ndarray
    skip: np.ndarray
    seen: np.ndarray
    box: np.ndarray
    step: float
    near: float
    shift: float
    terms: int
    limit: int


class RaySamples(NamedTuple):
    """
    Samples of one ray, S at most, in the order in which it meets them.

    cell int64 (S,); float32: frac (S, 3) place in the cell, alpha (S,), depth (S,) metres,
    raw (S,) density before its activation.
    """

    cell: np.ndarray
    frac: np.ndarray
    alpha: np.ndarray
    depth: np.ndarray
    raw: np.ndarray


@njit(**FAST)
def sh_basis(dx, dy, dz, basis):
    """Fill real spherical harmonics of degree 0, 1 or 2 (by the length of `basis`)."""
    basis[0] = 0.28209479
    if basis.shape[0] > 1:
        basis[1] = -0.48860251 * dy
        basis[2] = 0.48860251 * dz
        basis[3] = -0.48860251 * dx
    if basis.shape[0] > 4:
        basis[4] = 1.09254843 * dx * dy
        basis[5] = -1.09254843 * dy * dz
        basis[6] = 0.31539157 * (2 * dz * dz - dx * dx - dy * dy)
        basis[7] = -1.09254843 * dx * dz
        basis[8] = 0.54627421 * (dx * dx - dy * dy)


@njit(**FAST)
def opacity(density, step):
    """Return the opacity of `step` voxels of this raw density (DirectVoxGO, eq. 4 to 8)."""
    # 1 - exp(-step softplus(density)), which is a power of 1 + exp(density).
    if step == 0.5:
        return 1 - 1 / math.sqrt(1 + math.exp(min(density, 80.0)))
    return 1 - math.exp(-step * (density if density > 15 else math.log1p(math.exp(density))))


@njit(**FAST)
def march(ox, oy, oz, dx, dy, dz, jitter, field, samples):
    """
    Walk one ray and store its samples in occupied cells.

    d must be a unit vector. Returns the number of samples and the light left behind the last one.
    """
    grid, row_of, skip, box, step = field.grid, field.row_of, field.skip, field.box, field.step
    near, shift = field.near, field.shift
    cell, frac, alpha, depth, raw = samples
    sx, sy, sz = field.shape[0], field.shape[1], field.shape[2]
    shell, voxel = box[6], box[7]
    extent = 1 + shell
    count = 0
    light = 1.0
    length = step * voxel
    t = near + jitter * length
    limit = alpha.shape[0]
    while count < limit:
        qx = (ox + t * dx - box[0]) / box[3]
        qy = (oy + t * dy - box[1]) / box[4]
        qz = (oz + t * dz - box[2]) / box[5]
        n = max(abs(qx), abs(qy), abs(qz))
        stretch = 1.0
        if n > 1:
            if shell == 0 or n > 1000:
                break
            squeeze = (extent - shell / n) / n
            # Out here a ray crosses fewer cells a metre than inside the box: outwards shell / n^2
            # as many, sideways `squeeze`. n grows with the largest of |q|.
            if abs(qx) >= max(abs(qy), abs(qz)):
                growth = math.copysign(dx / box[3], qx * dx)
            elif abs(qy) >= abs(qz):
                growth = math.copysign(dy / box[4], qy * dy)
            else:
                growth = math.copysign(dz / box[5], qz * dz)
            growth *= (2 * shell / n - extent) / (n * n)
            vx, vy, vz = (squeeze * dx + growth * qx * box[3], squeeze * dy + growth * qy * box[4],
                          squeeze * dz + growth * qz * box[5])
            stretch = 1 / max(math.sqrt(vx * vx + vy * vy + vz * vz), 1e-9)
            qx *= squeeze
            qy *= squeeze
            qz *= squeeze
        gx = (qx / extent + 1) * 0.5 * (sx - 1)
        gy = (qy / extent + 1) * 0.5 * (sy - 1)
        gz = (qz / extent + 1) * 0.5 * (sz - 1)
        ix = min(max(int(gx), 0), sx - 2)
        iy = min(max(int(gy), 0), sy - 2)
        iz = min(max(int(gz), 0), sz - 2)
        free = skip[(ix * sy + iy) * sz + iz]
        if free > 0:
            hops = max(int((free - 1) / step), 1)
            t += hops * length * stretch
            continue
        fx, fy, fz = gx - ix, gy - iy, gz - iz
        base = (ix * sy + iy) * sz + iz
        value = np.float32(0)
        for corner in range(8):
            a, b, c = (corner >> 2) & 1, (corner >> 1) & 1, corner & 1
            weight = ((fx if a else 1 - fx) * (fy if b else 1 - fy) * (fz if c else 1 - fz))
            value += weight * grid[row_of[base + (a * sy + b) * sz] + c, 0]
        density = value + shift
        a_i = opacity(density, step)  # Interpolated first, activated after.
        cell[count] = base
        frac[count, 0] = fx
        frac[count, 1] = fy
        frac[count, 2] = fz
        alpha[count] = a_i
        raw[count] = density
        depth[count] = t
        count += 1
        light *= 1 - a_i
        t += length * stretch
        if light < MIN_TRANSMITTANCE:
            break
    return count, light


@njit(**FAST)
def sample_colour(field, base, fx, fy, fz, basis, blend, rgb):
    """
    Interpolate the coefficients of one sample and evaluate its colour in (0, 1).

    blend (3 K,) is scratch: rows are added whole, which the compiler does many columns at once.
    """
    grid, row_of = field.grid, field.row_of
    sy, sz = field.shape[1], field.shape[2]
    terms = basis.shape[0]
    blend[:] = 0
    for corner in range(8):
        a, b, c = (corner >> 2) & 1, (corner >> 1) & 1, corner & 1
        weight = (fx if a else 1 - fx) * (fy if b else 1 - fy) * (fz if c else 1 - fz)
        row = row_of[base + (a * sy + b) * sz] + c
        if terms == 1:  # Too few for that.
            for k in range(3):
                blend[k] += weight * grid[row, 1 + k]
        else:
            for k in range(3 * terms):
                blend[k] += weight * grid[row, 1 + k]
    for channel in range(3):
        value = np.float32(0)
        for k in range(terms):
            value += basis[k] * blend[channel * terms + k]
        rgb[channel] = 1 / (1 + math.exp(-value))


@njit(parallel=True, **FAST)
def render_rays(rays_o, rays_d, field, background, out):
    """
    Render unit rays (N, 3) into out (N, 6).

    R, G, B in [0, 1], depth in metres along the ray, opacity, and that part of the opacity that
    lies in seen voxels. Depth is the median of the weights: at the edge of a chair the mean lies
    on no surface, and haze behind a wall would push the wall back.
    """
    n = rays_o.shape[0]
    chunk = 64
    limit, length = field.limit, field.step * field.box[7]
    for block in prange((n + chunk - 1) // chunk):
        cell = np.empty(limit, np.int64)
        frac = np.empty((limit, 3), np.float32)
        alpha = np.empty(limit, np.float32)
        depth = np.empty(limit, np.float32)
        raw = np.empty(limit, np.float32)
        samples = RaySamples(cell, frac, alpha, depth, raw)
        basis = np.empty(field.terms, np.float32)
        blend = np.empty(3 * field.terms, np.float32)
        rgb = np.empty(3, np.float32)
        for r in range(block * chunk, min((block + 1) * chunk, n)):
            count, light = march(
                rays_o[r, 0], rays_o[r, 1], rays_o[r, 2],
                rays_d[r, 0], rays_d[r, 1], rays_d[r, 2], 0.5, field, samples)
            sh_basis(rays_d[r, 0], rays_d[r, 1], rays_d[r, 2], basis)
            total = np.zeros(6, np.float32)
            left = np.float32(1)
            half = 0.5 * (1 + light)
            for i in range(count):
                weight = left * alpha[i]
                if left > half and left - weight <= half:
                    total[3] = depth[i] + ((left - half) / weight - 0.5) * length
                left -= weight
                total[4] += weight
                total[5] += weight * (field.seen[cell[i]] > 0)
                if weight < MIN_SHOWN:
                    continue
                sample_colour(field, cell[i], frac[i, 0], frac[i, 1], frac[i, 2], basis, blend,
                              rgb)
                for channel in range(3):
                    total[channel] += weight * (rgb[channel] - background)
            for channel in range(3):
                out[r, channel] = background + total[channel]
            out[r, 3] = total[3]
            out[r, 4] = total[4]
            out[r, 5] = total[5]


@njit(parallel=True, **FAST)
def mark_seen(rays_o, rays_d, field, seen):
    """
    Mark every cell that a training ray reaches with light left; marks never race to differ.

    `seen` is an argument of its own: a parallel loop that only writes to a member of a tuple is
    taken for one without effect, and numba leaves it out.
    """
    n = rays_o.shape[0]
    chunk = 64
    limit = field.limit
    for block in prange((n + chunk - 1) // chunk):
        cell = np.empty(limit, np.int64)
        frac = np.empty((limit, 3), np.float32)
        alpha = np.empty(limit, np.float32)
        depth = np.empty(limit, np.float32)
        raw = np.empty(limit, np.float32)
        samples = RaySamples(cell, frac, alpha, depth, raw)
        for r in range(block * chunk, min((block + 1) * chunk, n)):
            count, _ = march(
                rays_o[r, 0], rays_o[r, 1], rays_o[r, 2],
                rays_d[r, 0], rays_d[r, 1], rays_d[r, 2], 0.5, field, samples)
            left = 1.0
            for i in range(count):
                if left < 0.05:
                    break
                seen[cell[i]] = 1
                left *= 1 - alpha[i]


@njit(parallel=True, **FAST)
def mark_occupied(grid, row_of, shape, step, shift, threshold, occupied):
    """Mark cells (at their low corner's index) where any corner's opacity passes the threshold."""
    sx, sy, sz = shape[0], shape[1], shape[2]
    for ix in prange(sx - 1):
        for iy in range(sy - 1):
            for iz in range(sz - 1):
                base = (ix * sy + iy) * sz + iz
                best = np.float32(-np.inf)
                for corner in range(8):
                    a, b, c = (corner >> 2) & 1, (corner >> 1) & 1, corner & 1
                    row = row_of[base + (a * sy + b) * sz + c]
                    if row < 0:
                        best = np.float32(-np.inf)
                        break
                    best = max(best, grid[row, 0])
                occupied[base] = opacity(best + shift, step) > threshold
