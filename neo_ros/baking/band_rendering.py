"""
A panorama out of the field with few rays: on a surface depth goes on from ray to ray.

One ray in every block of pixels is cast first. Where the depths of those around a pixel differ, at
edges and in thin things, every pixel has a ray of its own; in between depth is interpolated.
"""
from neo_ros.field.kernels import FAST
from neo_ros.field.radiance_field import RadianceField
from neo_ros.field.rendering import render_rays
from neo_ros.machine.compiled import njit
from numba import prange
import numpy as np


def render_band(field: RadianceField, position: np.ndarray, rays: np.ndarray, block: int,
                wraps: bool, one_surface: float, far: float, least_coverage: float,
                wanted: np.ndarray | None = None) -> tuple[np.ndarray, np.ndarray, np.ndarray]:
    """
    Return depth float32 (h, w), metres along the ray, 0 = unknown, colours float32 (h, w, 3).

    And bool (h, w), which pixels had a ray of their own: those where depth leaps, and the
    `block_centres`.
    rays (h, w, 3), whole blocks of `block` squared pixels; wraps: the last column is a neighbour
    of the first; one_surface: depths that differ by less than this share are of one surface, and
    so are those of which one over the depth differs by less than `far`, 1/m; least_coverage: of a
    pixel, for its depth to be known. wanted bool (h / block, w / block): blocks that are cast, the
    others stay unknown and black; None: all.
    """
    def cast(directions: np.ndarray) -> tuple[np.ndarray, np.ndarray]:
        found = render_rays(field, position, directions)
        known = found.coverage > least_coverage
        return np.where(known, found.depth, 0).astype(np.float32), found.image

    centres = block_centres(rays, block)
    if wanted is None:
        wanted = np.ones(centres.shape[:2], np.bool_)
    few_depths, few_colours = (np.zeros(shape, np.float32) for shape in (
        wanted.shape, centres.shape))
    few_depths[wanted], few_colours[wanted] = cast(centres[wanted])
    if block == 1:
        return few_depths, few_colours, wanted
    depth = np.empty(rays.shape[:2], np.float32)
    colours = np.empty(rays.shape, np.float32)
    rough = np.empty(rays.shape[:2], np.bool_)
    _interpolate(few_depths, few_colours, _smooth(few_depths, wraps, one_surface, far), block,
                 wraps, depth, colours, rough)
    all_wanted = wanted.repeat(block, 0).repeat(block, 1)
    depth[~all_wanted], colours[~all_wanted] = 0, 0
    rough &= all_wanted
    depth[rough], colours[rough] = cast(rays[rough])
    block_centres(rough, block)[:] = True
    return depth, colours, rough


def block_centres(pixels: np.ndarray, block: int) -> np.ndarray:
    """Return a view of the pixel in the middle of each block, (h / block, w / block, ...)."""
    return pixels[block // 2::block, block // 2::block]


def mesh_depth(depth: np.ndarray, finer: int, one_surface: float) -> np.ndarray:
    """
    Take one depth of each block of finer x finer pixels: float32 (h, w) of (finer h, finer w).

    The median; but where the middle two of an even number lie on two surfaces, or one is unknown,
    the farther one: their mean would hang in mid-air.
    """
    height, width = depth.shape[0] // finer, depth.shape[1] // finer
    blocks = depth.reshape(height, finer, width, finer).swapaxes(1, 2).reshape(height, width, -1)
    blocks, count = np.sort(blocks, axis=-1), finer * finer
    near, far = blocks[..., (count - 1) // 2], blocks[..., count // 2]
    return np.where(far - near < one_surface * far, (near + far) / 2, far)


def _smooth(depths: np.ndarray, wraps: bool, one_surface: float, far: float) -> np.ndarray:
    """Tell of every 2x2 depths, and of those around them, whether all are of one surface."""
    padded = np.pad(depths, ((1, 2), (0, 0)), mode='edge')
    padded = np.pad(padded, ((0, 0), (1, 2)), mode='wrap' if wraps else 'edge')
    windows = np.lib.stride_tricks.sliding_window_view(padded, (4, 4))
    nearest, farthest = windows.min((2, 3)), windows.max((2, 3))
    smooth: np.ndarray = ((nearest >= (1 - one_surface) * farthest)
                          | (farthest - nearest < far * nearest * farthest))
    return smooth


@njit(parallel=True, **FAST)
def _interpolate(depths, colours, smooth, block, wraps, depth, all_colours, rough):
    """Fill depth and all_colours from those of every block where `smooth`; rough: where not."""
    high, wide = depths.shape
    for i in prange(depth.shape[0]):
        y = (i - block // 2) / block
        i0 = min(max(int(np.floor(y)), 0), max(high - 2, 0))
        i1, t = min(i0 + 1, high - 1), np.float32(y - i0)
        for j in range(depth.shape[1]):
            x = (j - block // 2) / block
            j0 = int(np.floor(x))
            if not wraps:
                j0 = min(max(j0, 0), max(wide - 2, 0))
            s = np.float32(x - j0)
            j1 = (j0 + 1) % wide if wraps else min(j0 + 1, wide - 1)
            j0 = j0 % wide
            rough[i, j] = not smooth[i0, j0]
            if rough[i, j]:
                continue
            a, b, c, d = (1 - s) * (1 - t), s * (1 - t), (1 - s) * t, s * t
            depth[i, j] = 0
            if depths[i0, j0] > 0:
                # On a plane one over the depth changes evenly, but for the turn of the rays.
                depth[i, j] = 1 / (a / depths[i0, j0] + b / depths[i0, j1]
                                   + c / depths[i1, j0] + d / depths[i1, j1])
            for k in range(3):
                all_colours[i, j, k] = (a * colours[i0, j0, k] + b * colours[i0, j1, k]
                                        + c * colours[i1, j0, k] + d * colours[i1, j1, k])
