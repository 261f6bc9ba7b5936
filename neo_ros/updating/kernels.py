"""Compiled loops over photos and cells of a field: what is contradicted, and what rays meet."""
import math
from typing import NamedTuple

from neo_ros.field.voxel_field import VoxelField
from neo_ros.geometry import Intrinsics
from neo_ros.machine.compiled import njit
from numba import prange
import numpy as np

FAST = {'nsz', 'arcp', 'contract', 'afn', 'reassoc'}
# Metres that a point lies before the camera at least; a global, as kernels are compiled with its
# value in them.
NEAREST = 0.1


class Pinholes(NamedTuple):
    """Cameras alike: rotations float32 (P, 3, 3) to the world, positions (P, 3), pixels."""

    rotations: np.ndarray
    positions: np.ndarray
    fx: np.float32
    fy: np.float32
    cx: np.float32
    cy: np.float32


def pinholes(camera: Intrinsics, T_world_cam: np.ndarray) -> Pinholes:
    """Return cameras at poses (P, 4, 4), as kernels take them."""
    return Pinholes(np.ascontiguousarray(T_world_cam[:, :3, :3], np.float32),
                    np.ascontiguousarray(T_world_cam[:, :3, 3], np.float32),
                    *map(np.float32, (camera.fx, camera.fy, camera.cx, camera.cy)))


@njit(fastmath=FAST, error_model='numpy')
def _seen_at(point, cameras, n, width, height):
    """Return column and row of a world point in photo n, -1 if it is not in it, and distance."""
    R, T = cameras.rotations[n], cameras.positions[n]
    px, py, pz = point[0] - T[0], point[1] - T[1], point[2] - T[2]
    away = R[0, 2] * px + R[1, 2] * py + R[2, 2] * pz
    distance = math.sqrt(px * px + py * py + pz * pz)
    if away < NEAREST:
        return -1, -1, distance
    u = cameras.fx * (R[0, 0] * px + R[1, 0] * py + R[2, 0] * pz) / away + cameras.cx
    v = cameras.fy * (R[0, 1] * px + R[1, 1] * py + R[2, 1] * pz) / away + cameras.cy
    if not (0 <= u < width and 0 <= v < height):
        return -1, -1, distance
    return int(u), int(v), distance


@njit(parallel=True, fastmath=FAST, error_model='numpy')
def ask_witnesses(points, colours, cameras, depth, images, gains, is_founder, one_surface,
                  grey_levels, witnesses, founders, same):
    """
    Count the photos that see points float32 (N, 3), the founders, and those that show it alike.

    is_founder bool (P,): of these alone those that show these colours there are counted.

    colours float32 (N, 3) in 0 ... 255; cameras: Pinholes; depth float32 (P, h, w), metres along
    the ray, 0 = unknown; images uint8 (P, h, w, 3), which gains (P, 3) multiply. A photo sees a
    point whose distance is the depth there, but for a share `one_surface`. Fills int32 (N,).
    """
    height, width = depth.shape[1], depth.shape[2]
    for i in prange(len(points)):
        count, count_founders, alike = 0, 0, 0
        for n in range(len(depth)):
            u, v, distance = _seen_at(points[i], cameras, n, width, height)
            if u < 0 or abs(depth[n, v, u] - distance) > one_surface * distance:
                continue
            count += 1
            if not is_founder[n]:
                continue
            count_founders += 1
            most = 0.0
            for k in range(3):
                most = max(most, abs(colours[i, k] - images[n, v, u, k] * gains[n, k]))
            alike += most <= grey_levels
        witnesses[i], founders[i], same[i] = count, count_founders, alike


@njit(parallel=True, fastmath=FAST, error_model='numpy')
def count_votes(points, cameras, depth, contradicts, agrees, painted, behind, thick, against,
                agree, cosine):
    """
    Count for points float32 (N, 3) the photos that contradict what was there, and that agree.

    cameras: Pinholes; depth float32 (P, h, w), metres along the ray to what the memory shows,
    0 = unknown; contradicts, agrees, painted bool (P, h, w). What a photo says holds for all
    points on its ray, up to `behind` metres behind the surface; but where that was painted anew,
    for those within `thick` metres before it and a third of that behind. Fills int32 (N,), and
    float32 (N,) cosine: the widest angle between the first that contradicts and another.
    """
    height, width = depth.shape[1], depth.shape[2]
    for i in prange(len(points)):
        votes_against, votes_for, least, first = 0, 0, 1.0, 0
        for n in range(len(depth)):
            u, v, distance = _seen_at(points[i], cameras, n, width, height)
            if u < 0 or depth[n, v, u] <= 0 or distance > depth[n, v, u] + behind:
                continue
            votes_for += agrees[n, v, u]
            if painted[n, v, u] and not -thick < distance - depth[n, v, u] < thick / 3:
                continue
            if contradicts[n, v, u]:
                if votes_against == 0:
                    first = n
                one, other = cameras.positions[first], cameras.positions[n]
                along, lengths, others = 0.0, 0.0, 0.0
                for k in range(3):
                    along += (points[i, k] - one[k]) * (points[i, k] - other[k])
                    lengths += (points[i, k] - one[k]) ** 2
                    others += (points[i, k] - other[k]) ** 2
                least = min(least, along / math.sqrt(lengths * others))
                votes_against += 1
        against[i], agree[i], cosine[i] = votes_against, votes_for, least


@njit(error_model='numpy')
def _cell_at(origin, rays_d, r, t, box, shape):
    """Return the cell that a ray meets after t metres, -1 far outside, and how large it is."""
    shell = box[6]
    extent = 1 + shell
    qx = (origin[0] + t * rays_d[r, 0] - box[0]) / box[3]
    qy = (origin[1] + t * rays_d[r, 1] - box[1]) / box[4]
    qz = (origin[2] + t * rays_d[r, 2] - box[2]) / box[5]
    n = max(abs(qx), abs(qy), abs(qz))
    stretch = 1.0
    if n > 1:
        if shell == 0 or n > 100:
            return -1, stretch
        squeeze = (extent - shell / n) / n
        stretch = n  # Cells are larger out here; none is passed over.
        qx, qy, qz = qx * squeeze, qy * squeeze, qz * squeeze
    x = min(max(int((qx / extent + 1) * 0.5 * (shape[0] - 1)), 0), shape[0] - 2)
    y = min(max(int((qy / extent + 1) * 0.5 * (shape[1] - 1)), 0), shape[1] - 2)
    z = min(max(int((qz / extent + 1) * 0.5 * (shape[2] - 1)), 0), shape[2] - 2)
    return (x * shape[1] + y) * shape[2] + z, stretch


@njit(fastmath=FAST, error_model='numpy')
def _unlike(point, colour, but, beyond, is_surface, cameras, depth, contradicts, images, gains,
            one_surface, least, most):
    """
    Return by how much photos show another colour at a point, grey levels, -1 if few see it.

    beyond: it lies behind what was there; then those see it that contradict that.
    """
    height, width = depth.shape[1], depth.shape[2]
    total, count = 0.0, 0
    for n in range(len(depth)):
        u, v, distance = _seen_at(point, cameras, n, width, height)
        if n == but or u < 0 or depth[n, v, u] <= 0:
            continue
        if is_surface:
            if abs(depth[n, v, u] - distance) > one_surface * distance:
                continue
        elif distance > (1 + one_surface) * depth[n, v, u] and not (
                beyond and contradicts[n, v, u]):
            continue
        alike = most
        # An edge lies a pixel aside.
        for y in range(max(v - 1, 0), min(v + 2, height)):
            for x in range(max(u - 1, 0), min(u + 2, width)):
                off = 0.0
                for k in range(3):
                    off = max(off, abs(colour[k] - images[n, y, x, k] * gains[n, k]))
                alike = min(alike, off)
        total += alike
        count += 1
    return total / count if count >= least else -1.0


@njit(parallel=True, fastmath=FAST, error_model='numpy')
def compare_depths(origin, rays_d, reach, colours, but, cameras, depth, contradicts, images, gains,
                   box, shape, cells, near, behind, thick, one_surface, least, most, at_surface,
                   elsewhere):
    """
    Say how much photos differ about what is at a surface, and where they differ least elsewhere.

    On unit rays float32 (N, 3) from one point of photo `but`, which shows colours float32 (N, 3):
    at `reach` (N,), and in cells uint8 (X * Y * Z,) that are not 0 before that, or up to `behind`
    metres behind it; further than `thick` from it. Photos as in `ask_witnesses`, of which `least`
    have to see it, and contradicts bool (P, h, w). Fills float32 (N,) with mean differences in
    grey levels, of which `most` count; at_surface is -1 where few see it.
    """
    for r in prange(len(rays_d)):
        point = np.empty(3, np.float32)
        for k in range(3):
            point[k] = origin[k] + reach[r] * rays_d[r, k]
        at_surface[r] = _unlike(point, colours[r], but, False, True, cameras, depth, contradicts,
                                images, gains, one_surface, least, most)
        best, t = most, near
        while t < reach[r] + behind:
            beyond = t > reach[r]
            cell, _ = _cell_at(origin, rays_d, r, t, box, shape)
            if abs(t - reach[r]) > thick and (beyond or cell >= 0 and cells[cell] != 0):
                for k in range(3):
                    point[k] = origin[k] + t * rays_d[r, k]
                unlike = _unlike(point, colours[r], but, beyond, False, cameras, depth,
                                 contradicts, images, gains, one_surface, least, most)
                if unlike >= 0:
                    best = min(best, unlike)
            t += 0.5 * box[7]
        elsewhere[r] = best


@njit(parallel=True, error_model='numpy')
def rays_meet(origin, rays_d, reach, box, shape, apart, near, met):
    """
    Tell which unit rays float32 (N, 3) from one point meet marked cells.

    Nearer than `reach` (N,); apart uint8 (X * Y * Z,): as `cells_apart` tells of them; box, shape
    as in `FieldArrays`; near in metres. Fills met uint8 (N,).
    """
    for r in prange(len(rays_d)):
        met[r] = 0
        t = near
        while t < reach[r]:
            cell, stretch = _cell_at(origin, rays_d, r, t, box, shape)
            if cell < 0:
                break
            if apart[cell] == 0:
                met[r] = 1
                break
            step = 0.5 * box[7] * stretch
            # Up to so many steps on, no cell is marked. Cells are larger outside of the inner box.
            steps = 2 * int(apart[cell]) - 2
            if steps < 2 or stretch > 1 or not _in_box(origin, rays_d, r, t + steps * step, box):
                steps = 1
            for _ in range(steps):
                t += step


@njit(error_model='numpy')
def _in_box(origin, rays_d, r, t, box):
    """Tell whether a ray is within the inner box after t metres."""
    for k in range(3):
        if not abs(origin[k] + t * rays_d[r, k] - box[k]) < box[3 + k]:
            return False
    return True


def rays_meet_cells(field: VoxelField, apart: np.ndarray, origin: np.ndarray, rays_d: np.ndarray,
                    reach: np.ndarray) -> np.ndarray:
    """
    Tell which unit rays (..., 3) from one point (3,) meet marked cells of a field: bool (...).

    apart uint8 (X, Y, Z): as `cells_apart` tells of them; reach float32 (...): metres along the
    ray to what hides the rest, 0 = nothing does.
    """
    met = np.empty(reach.size, np.uint8)
    rays_meet(np.asarray(origin, np.float64),
              np.ascontiguousarray(rays_d.reshape(-1, 3), np.float32),
              np.where(reach > 0, reach, np.inf).ravel().astype(np.float32), field.box,
              np.array(field.shape), apart.ravel(), field.near, met)
    return met.reshape(reach.shape).view(bool)


@njit(error_model='numpy')
def count_spans(origin, rays_d, begin, end, box, shape, stamp, last, counts):
    """
    Count in int32 (X * Y * Z,) the photos that see a cell on rays between begin and end (N,).

    Rays as in `rays_meet`, all of one photo; last int32 (X * Y * Z,): its `stamp` notes that it
    was counted.
    """
    for r in range(len(rays_d)):
        t = begin[r]
        while t < end[r]:
            cell, stretch = _cell_at(origin, rays_d, r, t, box, shape)
            if cell < 0:
                break
            if last[cell] != stamp:
                last[cell] = stamp
                counts[cell] += 1
            t += 0.5 * box[7] * stretch
