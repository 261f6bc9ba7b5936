"""Compiled loops over cells of a field: which images contradict them, which rays meet them."""
from neo_ros.machine.compiled import njit
from numba import prange

FAST = {'nsz', 'arcp', 'contract', 'afn', 'reassoc'}
# Globals, as kernels are compiled with their values in them. A surface that an image agrees with
# may lie so much farther than the memory says, as a share of the distance.
SAME_SURFACE = 0.04
# Metres that a point lies before the camera at least.
NEAREST = 0.1


@njit(parallel=True, fastmath=FAST, error_model='numpy')
def count_votes(points, rotations, positions, pinhole, depth, off, slack, behind, against, agree):
    """
    Count for points float32 (N, 3) the images that contradict what was there, and that agree.

    rotations (P, 3, 3) camera to world, positions (P, 3), pinhole (fx, fy, cx, cy); depth float32
    (P, h, w), z in metres, where the memory shows a surface, 0 = unknown; off bool (P, h, w): the
    image contradicts it. An image agrees with what lies before its surface, up to `slack` metres
    behind it; it contradicts what lies up to `behind` metres behind its surface. Fills int32 (N,).
    """
    fx, fy, cx, cy = pinhole
    height, width = depth.shape[1], depth.shape[2]
    for i in prange(len(points)):
        votes_against, votes_for = 0, 0
        for n in range(len(positions)):
            R = rotations[n]
            px = points[i, 0] - positions[n, 0]
            py = points[i, 1] - positions[n, 1]
            pz = points[i, 2] - positions[n, 2]
            z = R[0, 2] * px + R[1, 2] * py + R[2, 2] * pz
            if z < NEAREST:
                continue
            u = fx * (R[0, 0] * px + R[1, 0] * py + R[2, 0] * pz) / z + cx
            v = fy * (R[0, 1] * px + R[1, 1] * py + R[2, 1] * pz) / z + cy
            if not (0 <= u < width and 0 <= v < height):
                continue
            surface = depth[n, int(v), int(u)]
            if surface <= 0:
                continue
            if off[n, int(v), int(u)]:
                votes_against += z <= surface + behind
            else:
                votes_for += z <= (1 + SAME_SURFACE) * surface + slack
        against[i], agree[i] = votes_against, votes_for


@njit(parallel=True, fastmath=FAST, error_model='numpy')
def rays_meet(origin, rays_d, reach, box, shape, cells, near, met):
    """
    Tell which unit rays float32 (N, 3) from one point meet a marked cell nearer than `reach` (N,).

    box, shape as in `FieldArrays`; cells uint8 (X * Y * Z,); near in metres. Fills met uint8 (N,).
    """
    sx, sy, sz = shape[0], shape[1], shape[2]
    shell, voxel = box[6], box[7]
    extent = 1 + shell
    for r in prange(len(rays_d)):
        met[r] = 0
        t = near
        while t < reach[r]:
            qx = (origin[0] + t * rays_d[r, 0] - box[0]) / box[3]
            qy = (origin[1] + t * rays_d[r, 1] - box[1]) / box[4]
            qz = (origin[2] + t * rays_d[r, 2] - box[2]) / box[5]
            n = max(abs(qx), abs(qy), abs(qz))
            stretch = 1.0
            if n > 1:
                if shell == 0 or n > 100:
                    break
                squeeze = (extent - shell / n) / n
                stretch = n  # Cells are larger out here; none is passed over.
                qx, qy, qz = qx * squeeze, qy * squeeze, qz * squeeze
            x = min(max(int((qx / extent + 1) * 0.5 * (sx - 1)), 0), sx - 2)
            y = min(max(int((qy / extent + 1) * 0.5 * (sy - 1)), 0), sy - 2)
            z = min(max(int((qz / extent + 1) * 0.5 * (sz - 1)), 0), sz - 2)
            if cells[(x * sy + y) * sz + z]:
                met[r] = 1
                break
            t += 0.5 * voxel * stretch
