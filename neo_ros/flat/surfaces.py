"""Points on the demo flat's solids: which face, where on it, in metres and as shares of it."""
from dataclasses import dataclass
import math

from neo_ros.flat.shapes import BOX, FACES, FRUSTUM, Solids
from neo_ros.machine.compiled import njit
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
    count = len(solid)
    face = np.empty(count, np.int64)
    found = np.empty((5, count), np.float32)  # u, v, across, up, slant
    turns = np.stack([np.cos(solids.yaw), np.sin(solids.yaw)], axis=1).astype(np.float32)
    _locate(solids.kind, solids.centre.astype(np.float32), solids.half.astype(np.float32), turns,
            solid, points, directions, face, found)
    return SurfacePoints(solid, face, *found)


@njit(error_model='numpy', nogil=True)
def _locate(kinds, centres, halves, turns, solid, points, directions, face, found):
    one, half_one = np.float32(1), np.float32(0.5)
    for m in range(len(solid)):
        index = solid[m]
        half, cos, sin = halves[index], turns[index, 0], turns[index, 1]
        x = points[m, 0] - centres[index, 0]
        y = points[m, 1] - centres[index, 1]
        z = points[m, 2] - centres[index, 2]
        a, b, c = directions[m, 0], directions[m, 1], directions[m, 2]
        length = math.sqrt(a * a + b * b + c * c)
        a, b, c = a / length, b / length, c / length
        turned = sin != 0 or cos != one
        if turned:
            x, y = cos * x + sin * y, cos * y - sin * x
            a, b = cos * a + sin * b, cos * b - sin * a
        if kinds[index] != BOX:
            face[m], u, v, across, up, slant = _locate_round(
                kinds[index] == FRUSTUM, (x, y, z), half, (a, b, c))
        else:
            off = (abs(x) / half[0], abs(y) / half[1], abs(z) / half[2])
            axis = 0
            if off[1] > off[0]:
                axis = 1
            if off[2] > off[axis]:
                axis = 2
            i, j = (1 if axis == 0 else 0), (1 if axis == 2 else 2)
            local = (x, y, z)
            face[m] = 2 * axis + (1 if local[axis] > 0 else 0)
            # Patterns of unturned solids go on in world coordinates, across the pieces of a wall.
            u = local[i] + half[i] if turned else points[m, i]
            v = local[j] + half[j] if turned else points[m, j]
            across = local[i] / half[i] * half_one + half_one
            up = local[j] / half[j] * half_one + half_one
            slant = abs((a, b, c)[axis])
        found[0, m], found[1, m] = u, v
        found[2, m] = min(max(across, np.float32(0)), one)
        found[3, m] = min(max(up, np.float32(0)), one)
        found[4, m] = slant


@njit(error_model='numpy', nogil=True)
def _locate_round(frustum, local, half, ray):
    x, y, z = local
    bottom, top = half[0], half[1]
    height = half[2]
    widest = max(bottom, top)
    if frustum:
        radius = (bottom + top) / 2 + (top - bottom) / (2 * height) * z
        if abs(z) / height > math.hypot(x, y) / max(radius, 1e-6):
            return (2 if z > 0 else 1, x, y, x / widest * 0.5 + 0.5, y / widest * 0.5 + 0.5,
                    abs(ray[2]))
        normal = (x, y, (bottom - top) / (2 * height) * radius)
    else:
        normal = (x / half[0] ** 2, y / half[1] ** 2, z / half[2] ** 2)
    across = math.atan2(y, x) / (2 * math.pi) + 0.5
    up = z / height * 0.5 + 0.5
    length = max(math.sqrt(normal[0] ** 2 + normal[1] ** 2 + normal[2] ** 2), 1e-9)
    slant = abs(normal[0] * ray[0] + normal[1] * ray[1] + normal[2] * ray[2]) / length
    return 0, across * 2 * math.pi * widest, up * 2 * height, across, up, slant


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


def _turned(vectors: np.ndarray, cos: np.ndarray, sin: np.ndarray) -> np.ndarray:
    x, y = vectors[:, 0], vectors[:, 1]
    return np.stack([cos * x + sin * y, cos * y - sin * x, vectors[:, 2]], axis=1)


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
