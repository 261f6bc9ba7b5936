"""
Splats into a voxel field: what they hide and show, summed up at its grid points.

A splat's opacity is that of a ray through its middle, so its density is such that a ray across its
thinnest axis meets just that. Most are thinner than a voxel: each is widened by half a voxel, and
keeps its mass.
"""
import math

from neo_ros.field.grid_points import dilated, numbered
from neo_ros.field.splat_file import GREY, Splats
from neo_ros.field.splat_kernels import add_splats, REACH
from neo_ros.field.voxel_field import AIR_KEPT, BAND_0, DARKEST, VoxelField
from numba import get_num_threads
import numpy as np

# Grid points, most of them in air: not kept.
VOXELS = 12_000_000
WIDENED = 0.5       # deviation, voxels
MOST_OPAQUE = 0.99  # an opacity of 1 would be endless density
# Thickness of a voxel, at most: walls of many splats would be met by their outermost ones.
THICKEST = 6.0


def splat_field(splats: Splats, centre: np.ndarray, half_extent: np.ndarray, shell: float,
                near: float, voxels: int = VOXELS) -> VoxelField:
    """Return a sparse field over an inner box (centre, half extent (3,)) that shows the splats."""
    from scipy.ndimage import maximum_filter
    field = VoxelField.empty(voxels, centre, half_extent, shell, 0, near=near)
    place, covariance = _in_voxels(field, splats)
    wide = covariance + WIDENED ** 2 * np.eye(3)
    deviations = np.sqrt(np.maximum(np.linalg.eigvalsh(covariance), 0))
    mass = (-np.log(1 - np.minimum(splats.opacity, MOST_OPAQUE)) / math.sqrt(2 * math.pi)
            * deviations[:, 1] * deviations[:, 2] / np.sqrt(np.linalg.det(wide)))
    reach = REACH * np.sqrt(np.einsum('nii->ni', wide))
    shape = np.array(field.shape)
    shown = ((place + reach > 0) & (place - reach < shape - 1)).all(-1) & (mass > 1e-4)
    parts = (place[shown], np.linalg.inv(wide[shown]), mass[shown])
    thickness = np.zeros((len(field.row_of), 1), np.float32)
    add_splats(*parts, np.ones((shown.sum(), 1), np.float32), field.row_of, shape,
               get_num_threads(), thickness)
    peak = maximum_filter(thickness.reshape(field.shape), 5, mode='nearest').reshape(-1, 1)
    thickness *= np.minimum(1, THICKEST / np.maximum(peak, 1e-9))
    # The inverse of the softplus that makes density of what is stored.
    field.grid = np.log(np.expm1(np.maximum(thickness, 1e-5))) - np.float32(field.shift)
    kept = dilated(field.matter, AIR_KEPT).ravel()
    field.row_of = numbered(kept)
    channels, terms = splats.harmonics.shape[1:]
    sums = np.zeros((int(kept.sum()), 1 + channels * terms), np.float32)
    weighed = np.concatenate([np.ones((len(place), 1), np.float32),
                              splats.harmonics.reshape(len(place), -1)], 1)
    add_splats(*parts, weighed[shown], field.row_of, shape, get_num_threads(), sums)
    mean = (sums[:, 1:] / np.maximum(sums[:, :1], 1e-9)).reshape(-1, channels, terms)
    field.grid = np.concatenate([field.grid[kept], _coefficients(mean)], 1)
    field.update_occupancy()
    return field


def _coefficients(mean: np.ndarray) -> np.ndarray:
    """Return (V, 3K) of a field, whose colour is a sigmoid, for linear harmonics (V, 3, K)."""
    colour = np.clip(GREY + BAND_0 * mean[..., 0], DARKEST, 1 - DARKEST)
    result = mean / (colour * (1 - colour))[..., None]
    result[..., 0] = np.log(colour / (1 - colour)) / BAND_0
    return result.reshape(len(mean), -1).astype(np.float32)


def _in_voxels(field: VoxelField, splats: Splats) -> tuple[np.ndarray, np.ndarray]:
    """Return centres (N, 3) and covariances (N, 3, 3) in voxels: outside, the world shrinks."""
    size = (np.array(field.shape) - 1) / 2
    place = field.grid_position(splats.centres)
    little = 1e-4 * field.half_extent * np.maximum(
        1, np.abs((splats.centres - field.centre) / field.half_extent).max(-1, keepdims=True))
    slopes = np.stack([
        (field.grid_position(splats.centres + little * axis) - place)
        / little[:, index, None] for index, axis in enumerate(np.eye(3))], -1)
    axes = size[:, None] * slopes @ splats.axes
    return (place + 1) * size, axes @ axes.swapaxes(1, 2)
