"""Exact rays against the solids of the demo flat: for one camera, and for any bundle of rays."""
from collections.abc import Iterator
from dataclasses import dataclass

from neo_ros.flat.shapes import BOX, FRUSTUM, Solids
from neo_ros.geometry import CameraPose, Intrinsics
import numpy as np

NEAR = 1e-3  # metres; hits closer than this belong to the surface a ray starts on
# The world outside the windows is the inside of this box: every ray ends somewhere.
OUTSIDE = np.array([[-22.0, -24.0, -9.0], [32.0, 28.0, 22.0]])
_CORNERS = np.array([[i & 1, i >> 1 & 1, i >> 2 & 1] for i in range(8)], bool)
_EDGES = np.array([(i, i | 1 << bit) for i in range(8) for bit in range(3) if not i >> bit & 1])
Vector = tuple  # three scalars or arrays: x, y, z


@dataclass(frozen=True)
class Hits:
    """What rays met: `distance` along the ray as given, `solid` index, -1 for outside."""

    distance: np.ndarray
    solid: np.ndarray


def camera_directions(intrinsics: Intrinsics, pose: CameraPose, samples: int) -> np.ndarray:
    """
    World directions through samples x samples points of each pixel, on an even grid.

    Returns float32 (3, height * samples, width * samples), each one metre along the optical
    axis. The sub-pixel offset is added last, so that crops of a view get identical rays.
    """
    offset = (np.arange(samples) + 0.5) / samples
    x = ((np.arange(intrinsics.width) - intrinsics.cx)[:, None] + offset).ravel() / intrinsics.fx
    y = ((np.arange(intrinsics.height) - intrinsics.cy)[:, None] + offset).ravel() / intrinsics.fy
    R = pose.T_world_cam[:3, :3]
    directions = np.empty((3, len(y), len(x)), np.float32)
    for axis in range(3):
        across, down, ahead = R[axis]
        directions[axis] = (across * x + ahead)[None, :] + (down * y)[:, None]
    return directions


def cast_camera(solids: Solids, intrinsics: Intrinsics, pose: CameraPose,
                directions: np.ndarray) -> Hits:
    """
    Find the nearest solid along all rays of one camera.

    directions float32 (3, h, w) from `camera_directions`. Each solid is tried only inside the
    rectangle its bounding box covers in the image, nearest solids first, and not at all where
    that rectangle is already filled by something nearer: this changes the time, not the result.
    """
    inverse = inverse_directions(directions)
    hits = leave_outside(tuple(pose.position.tolist()), inverse)
    cast_into(hits, solids, intrinsics, pose, directions, inverse)
    return hits


def cast_into(hits: Hits, solids: Solids, intrinsics: Intrinsics, pose: CameraPose,
              directions: np.ndarray, inverse: np.ndarray, first: int = 0) -> None:
    """
    Put into `hits`, in place, what `cast_camera` finds nearer; the solids count from `first`.

    pose and directions in the frame of the solids; inverse from `inverse_directions`.
    """
    origin = tuple(pose.position.tolist())
    samples = directions.shape[2] // intrinsics.width
    for window, index in unhidden(hits.distance, solids.lower, solids.upper, intrinsics, pose,
                                  samples):
        rays = directions[(slice(None), *window)]
        found = _hit(solids, index, origin, tuple(rays), tuple(inverse[(slice(None), *window)]))
        closer = found < hits.distance[window]
        np.copyto(hits.distance[window], found, where=closer)
        hits.solid[window][closer] = first + index


def unhidden(distance: np.ndarray, lower: np.ndarray, upper: np.ndarray, intrinsics: Intrinsics,
             pose: CameraPose, samples: int) -> Iterator[tuple[tuple[slice, slice], int]]:
    """
    Yield the boxes (N, 3) that a camera sees, the nearest first: rows and columns, and index.

    `distance` (h, w) may shrink meanwhile: a box behind all of it is left out.
    """
    rectangles, nearest = _screen_rectangles(lower, upper, intrinsics, pose, samples)
    for index in np.argsort(nearest, kind='stable'):
        left, right, top, bottom = rectangles[index]
        if left >= right or top >= bottom:
            continue
        window = (slice(top, bottom), slice(left, right))
        if distance[window].max() >= nearest[index]:
            yield window, int(index)


def cast_rays(solids: Solids, candidates: np.ndarray, origins: np.ndarray,
              directions: np.ndarray) -> Hits:
    """
    Find the nearest of the solids `candidates` (indices) along any rays.

    origins and directions float32 (3, M).
    """
    inverse = inverse_directions(directions)
    hits = leave_outside(tuple(origins), inverse)
    for index in candidates:
        found = _hit(solids, index, tuple(origins), tuple(directions), tuple(inverse))
        closer = found < hits.distance
        hits.distance[closer] = found[closer]
        hits.solid[closer] = index
    return hits


def _screen_rectangles(lower: np.ndarray, upper: np.ndarray, intrinsics: Intrinsics,
                       pose: CameraPose, samples: int) -> tuple[np.ndarray, np.ndarray]:
    """Bound each box in the image: (N, 4) left right top bottom in samples; depth (N,)."""
    corners = np.where(_CORNERS[None], upper[:, None], lower[:, None]) - pose.position
    camera = corners @ pose.T_world_cam[:3, :3]
    start, end = camera[:, _EDGES[:, 0]], camera[:, _EDGES[:, 1]]
    near = 0.02
    with np.errstate(divide='ignore', invalid='ignore'):
        along = (near - start[..., 2]) / (end[..., 2] - start[..., 2])
    crosses = (along > 0) & (along < 1)
    cut = start + np.where(crosses, along, 0)[..., None] * (end - start)
    points = np.concatenate([camera, cut], axis=1)
    seen = np.concatenate([camera[..., 2] >= near, crosses], axis=1)
    depth = np.maximum(points[..., 2], near)
    bounds = []
    for axis, focal, centre, size in ((0, intrinsics.fx, intrinsics.cx, intrinsics.width),
                                      (1, intrinsics.fy, intrinsics.cy, intrinsics.height)):
        pixel = (points[..., axis] / depth * focal + centre) * samples
        low = np.where(seen, pixel, np.inf).min(axis=1) - 1
        high = np.where(seen, pixel, -np.inf).max(axis=1) + 2
        bounds += [np.clip(low, 0, size * samples), np.clip(high, 0, size * samples)]
    nearest = np.where(seen, points[..., 2], np.inf).min(axis=1) - 1e-4
    return np.stack(bounds, axis=1).astype(int), nearest


def _hit(solids: Solids, index: int, origin: Vector, direction: Vector,
         inverse: Vector) -> np.ndarray:
    centre, yaw = solids.centre[index].tolist(), float(solids.yaw[index])
    origin = tuple(o - c for o, c in zip(origin, centre))
    if yaw:
        cos, sin = float(np.cos(yaw)), float(np.sin(yaw))
        origin = _turned(origin, cos, sin)
        direction = _turned(direction, cos, sin)
    half = solids.half[index].tolist()
    if solids.kind[index] == BOX:
        if yaw:
            inverse = tuple(inverse_directions(axis) for axis in direction)
        return _hit_box(origin, inverse, half)
    if solids.kind[index] == FRUSTUM:
        return _hit_frustum(origin, direction, half)
    return _hit_ellipsoid(origin, direction, half)


def _turned(vector: Vector, cos: float, sin: float) -> Vector:
    x, y, z = vector
    return cos * x + sin * y, cos * y - sin * x, z


def inverse_directions(directions: np.ndarray) -> np.ndarray:
    """Return 1 / directions, without zeros."""
    return 1 / np.where(np.abs(directions) < 1e-9, np.float32(1e-9), directions)


def leave_outside(origin: Vector, inverse: np.ndarray, outside: np.ndarray = OUTSIDE) -> Hits:
    """Return where rays end that meet no solid: on the box (2, 3) around the world."""
    lower, upper = outside.tolist()
    exits = [np.where(inverse[i] > 0, upper[i] - origin[i], lower[i] - origin[i]) * inverse[i]
             for i in range(3)]
    distance = np.minimum(np.minimum(exits[0], exits[1]), exits[2]).astype(np.float32)
    return Hits(distance, np.full(distance.shape, -1, np.int32))


def _hit_box(origin: Vector, inverse: Vector, half: list[float]) -> np.ndarray:
    near = far = None
    for o, i, h in zip(origin, inverse, half):
        first, second = (-h - o) * i, (h - o) * i
        low, high = np.minimum(first, second), np.maximum(first, second)
        near = low if near is None else np.maximum(near, low)
        far = high if far is None else np.minimum(far, high)
    assert near is not None and far is not None
    return np.where((near <= far) & (near > NEAR), near, np.inf)


def _hit_frustum(origin: Vector, direction: Vector, half: list[float]) -> np.ndarray:
    bottom, top, height = half
    radius, slope = (bottom + top) / 2, (top - bottom) / (2 * height)
    dx, dy, dz = direction
    flat = dx * dx + dy * dy + 1e-12
    # Solve from the point nearest to the axis: float32 keeps thin legs thin that way.
    start = -(origin[0] * dx + origin[1] * dy) / flat
    x, y, z = origin[0] + start * dx, origin[1] + start * dy, origin[2] + start * dz
    there = radius + slope * z
    a = flat - (slope * dz) ** 2
    b = x * dx + y * dy - slope * dz * there
    root = b * b - a * (x * x + y * y - there * there)
    side = start + (-b - np.sqrt(np.maximum(root, 0))) / np.where(np.abs(a) < 1e-9, 1e-9, a)
    valid = (root >= 0) & (np.abs(origin[2] + side * dz) <= height) & (side > NEAR)
    nearest = np.where(valid, side, np.inf)
    inverse = inverse_directions(dz)
    for level, cap in ((-height, bottom), (height, top)):
        t = (level - origin[2]) * inverse
        u, v = origin[0] + t * dx, origin[1] + t * dy
        valid = (u * u + v * v <= cap * cap) & (t > NEAR)
        nearest = np.where(valid, np.minimum(nearest, t), nearest)
    return nearest


def _hit_ellipsoid(origin: Vector, direction: Vector, half: list[float]) -> np.ndarray:
    o = [value / h for value, h in zip(origin, half)]
    d = [value / h for value, h in zip(direction, half)]
    square = d[0] * d[0] + d[1] * d[1] + d[2] * d[2]
    start = -(o[0] * d[0] + o[1] * d[1] + o[2] * d[2]) / square
    x, y, z = (o[i] + start * d[i] for i in range(3))
    root = 1 - (x * x + y * y + z * z)
    t = start - np.sqrt(np.maximum(root, 0) / square)
    return np.where((root >= 0) & (t > NEAR), t, np.inf)
