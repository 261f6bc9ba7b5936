"""Points on the demo flat's solids: which face, where on it, in metres and as shares of it."""
from dataclasses import dataclass

from neo_ros.flat.shapes import BOX, FACES, FRUSTUM, Solids
import numpy as np

# The two axes along the faces of a box, by the axis of the face's normal; the second goes up.
_ALONG = np.array([[1, 2], [0, 2], [0, 1]])


@dataclass(frozen=True)
class SurfacePoints:
    """
    M points on solids, all arrays of length M.

    solid, face  indices; solid * FACES + face names a chart of the light map
    u, v         metres along the face
    across, up   the same as shares of the face in [0, 1]
    slant        |cosine| between the ray and the normal
    """

    solid: np.ndarray
    face: np.ndarray
    u: np.ndarray
    v: np.ndarray
    across: np.ndarray
    up: np.ndarray
    slant: np.ndarray


def locate(solids: Solids, solid: np.ndarray, points: np.ndarray,
           directions: np.ndarray) -> SurfacePoints:
    """Take solid (M,), points and ray directions (M, 3) float32 to places on the surfaces."""
    half = solids.half.astype(np.float32)[solid]
    local = points - solids.centre.astype(np.float32)[solid]
    yaw = solids.yaw[solid]
    turned = np.flatnonzero(yaw)
    cos, sin = np.cos(yaw[turned]).astype(np.float32), np.sin(yaw[turned]).astype(np.float32)
    local[turned] = _turned(local[turned], cos, sin)
    rays = directions / np.sqrt((directions * directions).sum(axis=1, keepdims=True))
    rays[turned] = _turned(rays[turned], cos, sin)
    # Patterns of unturned solids go on in world coordinates, across the pieces of a wall.
    patterned = np.where((yaw == 0)[:, None], points, local + half)
    kind = solids.kind[solid]
    rows = np.arange(len(solid))
    axis = np.argmax(np.abs(local) / half, axis=1)
    face = 2 * axis + (local[rows, axis] > 0)
    i, j = _ALONG[axis, 0], _ALONG[axis, 1]
    u, v = patterned[rows, i], patterned[rows, j]
    across = local[rows, i] / half[rows, i] * 0.5 + 0.5
    up = local[rows, j] / half[rows, j] * 0.5 + 0.5
    slant = np.abs(rays[rows, axis])
    round_ = np.flatnonzero(kind != BOX)
    if len(round_):
        found = _locate_round(kind[round_] == FRUSTUM, local[round_], half[round_], rays[round_])
        for target, values in zip((face, u, v, across, up, slant), found):
            target[round_] = values
    return SurfacePoints(solid, face, u, v, np.clip(across, 0, 1), np.clip(up, 0, 1), slant)


def _turned(vectors: np.ndarray, cos: np.ndarray, sin: np.ndarray) -> np.ndarray:
    x, y = vectors[:, 0], vectors[:, 1]
    return np.stack([cos * x + sin * y, cos * y - sin * x, vectors[:, 2]], axis=1)


def _locate_round(frustum: np.ndarray, local: np.ndarray, half: np.ndarray,
                  rays: np.ndarray) -> tuple[np.ndarray, ...]:
    x, y, z = local.T
    bottom, top, height = half.T
    height = np.where(frustum, height, half[:, 2])
    radius = np.where(frustum, (bottom + top) / 2 + (top - bottom) / (2 * height) * z, bottom)
    cap = frustum & (np.abs(z) / height > np.hypot(x, y) / np.maximum(radius, 1e-6))
    across = np.arctan2(y, x) / np.float32(2 * np.pi) + np.float32(0.5)
    up = z / height * 0.5 + 0.5
    widest = np.maximum(bottom, top)
    u, v = across * 2 * np.pi * widest, up * 2 * height
    slope = (bottom - top) / (2 * height)
    normal = np.where(frustum[:, None], np.stack([x, y, slope * radius], axis=1),
                      local / half ** 2)
    normal = normal / np.maximum(np.linalg.norm(normal, axis=1, keepdims=True), 1e-9)
    slant = np.where(cap, np.abs(rays[:, 2]), np.abs((normal * rays).sum(axis=1)))
    face = np.where(cap, np.where(z > 0, 2, 1), 0)
    across = np.where(cap, x / widest * 0.5 + 0.5, across)
    up = np.where(cap, y / widest * 0.5 + 0.5, up)
    return face, np.where(cap, x, u), np.where(cap, y, v), across, up, slant


def face_sizes(solids: Solids) -> np.ndarray:
    """Return width and height in metres of all charts, (N * FACES, 2); 0 where no face is."""
    sizes = np.zeros((len(solids), FACES, 2))
    for index in range(len(solids)):
        a, b, c = solids.half[index]
        if solids.kind[index] == BOX:
            sizes[index] = 2 * solids.half[index][_ALONG.repeat(2, axis=0)]
        elif solids.kind[index] == FRUSTUM:
            sizes[index, 0] = 2 * np.pi * max(a, b), 2 * c
            sizes[index, 1:3] = 2 * max(a, b)
        else:
            sizes[index, 0] = np.pi * (a + b), 2 * c
    return sizes.reshape(-1, 2)


def chart_places(solids: Solids, index: int, face: int, across: np.ndarray,
                 up: np.ndarray) -> tuple[np.ndarray, np.ndarray]:
    """Return world points and outward normals (M, 3) at shares of a face: undoes `locate`."""
    half = solids.half[index]
    a, b = across * 2 - 1, up * 2 - 1
    points, normals = np.zeros((len(a), 3)), np.zeros((len(a), 3))
    if solids.kind[index] == BOX:
        axis = face // 2
        i, j = _ALONG[axis]
        points[:, i], points[:, j] = a * half[i], b * half[j]
        points[:, axis] = half[axis] * (2 * (face % 2) - 1)
        normals[:, axis] = 2 * (face % 2) - 1
    elif solids.kind[index] == FRUSTUM and face:
        widest = max(half[0], half[1])
        radius = half[face - 1]
        x, y = a * widest, b * widest
        shrink = np.minimum(1, 0.95 * radius / np.maximum(np.hypot(x, y), 1e-9))
        points = np.stack([x * shrink, y * shrink, np.full(len(a), (2 * face - 3) * half[2])], 1)
        normals[:, 2] = 2 * face - 3
    else:
        points, normals = _round_places(solids.kind[index] == FRUSTUM, half, np.pi * a, b)
    cos, sin = np.cos(-solids.yaw[index]), np.sin(-solids.yaw[index])
    normals /= np.linalg.norm(normals, axis=1, keepdims=True)
    return _turned(points, cos, sin) + solids.centre[index], _turned(normals, cos, sin)


def _round_places(frustum: bool, half: np.ndarray, angle: np.ndarray,
                  b: np.ndarray) -> tuple[np.ndarray, np.ndarray]:
    if frustum:
        radius = (half[0] + half[1]) / 2 + (half[1] - half[0]) / 2 * b
        points = np.stack([radius * np.cos(angle), radius * np.sin(angle), half[2] * b], axis=1)
        slope = np.full(len(b), (half[0] - half[1]) / (2 * half[2]))
        return points, np.stack([np.cos(angle), np.sin(angle), slope], axis=1)
    ring = np.sqrt(np.maximum(1 - b * b, 1e-4))
    # `locate` measures the angle in metres, so the same angle is taken in the flattened circle.
    towards = np.stack([np.cos(angle), np.sin(angle)], axis=1)
    reach = ring / np.hypot(towards[:, 0] / half[0], towards[:, 1] / half[1])
    points = np.stack([towards[:, 0] * reach, towards[:, 1] * reach, half[2] * b], axis=1)
    return points, points / half ** 2
