"""Where the things of a scene are, from what a coarse field shows of them."""
from collections.abc import Iterable
from dataclasses import dataclass
import math

from neo_ros.field.radiance_field import RadianceField
from neo_ros.field.rendering import render_rays, Rendering
from neo_ros.field.voxel_field import VoxelField
import numpy as np


@dataclass(frozen=True)
class FineBox:
    """
    Where a fit's fine voxels may lie, low and high (3,) metres, and how large they are.

    They are on the lattice of `VoxelField.on_lattice`; what lies outside is in the shell.
    """

    low: np.ndarray
    high: np.ndarray
    edge: float


def content_box(field: VoxelField, rendering: Rendering, rays_o: np.ndarray, rays_d: np.ndarray,
                origins: np.ndarray, fine: FineBox | None) -> tuple[np.ndarray, np.ndarray]:
    """
    Return the inner box, centre and half extent (3,), of what rays (R, 3) of photos show.

    Surfaces that the photos see lie inside, up to a few percent that may be a view through
    a window; those are left to the contracted shell. So do the photos' own places, origins (N, 3).
    """
    points = rays_o + rendering.depth[:, None] * rays_d
    inside = np.abs(field.grid_position(points)).max(-1) * (1 + field.shell) < 1
    points = points[inside & (rendering.opacity > 0.9)]
    if len(points) < 100:
        centre, half_extent = field.centre, field.half_extent
    else:
        low = np.minimum(np.percentile(points, 2, axis=0), origins.min(0))
        high = np.maximum(np.percentile(points, 98, axis=0), origins.max(0))
        pad = 0.04 * (high - low).max()
        centre, half_extent = (low + high) / 2, (high - low) / 2 + pad
    if fine is None:
        return centre, half_extent
    low = np.maximum(centre - half_extent, fine.low)
    high = np.minimum(centre + half_extent, fine.high)
    return (low + high) / 2, (high - low) / 2


def nearest_content(field: RadianceField, photos: Iterable[tuple[np.ndarray, np.ndarray]],
                    percent: float) -> float:
    """
    Return how near, metres, any photo came to so many percent of its pixels; inf: to nothing.

    photos: rays_o and rays_d (R, 3) of each. From a finer field nothing would follow, it has
    blobs there: what one photo alone shows is fitted best right before its lens, and hides the
    room from poses beside it.
    """
    nearest = math.inf
    for rays_o, rays_d in photos:
        shown = render_rays(field, rays_o, rays_d)
        depth = np.where(shown.opacity > 0.9, shown.depth, np.inf)
        nearest = min(nearest, float(np.percentile(depth, percent, method='lower')))
    return nearest
