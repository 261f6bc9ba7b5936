"""Photos say which of two fields they show, and vote on the cells that their rays meet."""
from collections.abc import Iterator
from dataclasses import dataclass

from neo_ros.field.rendering import render_rays, Rendering, world_rays
from neo_ros.field.voxel_field import VoxelField
from neo_ros.updating.compared_photos import ComparedPhotos
from neo_ros.updating.kernels import count_spans
import numpy as np


@dataclass(frozen=True, eq=False)
class ShownTwice:
    """
    M pixels of a photo, and what two fields show there.

    index: of the photo; pixels bool (h, w); origin (3,), unit rays float32 (M, 3); views: of both
    fields; off float32 (2, M): by how much each differs from the photo, in 0 ... 1.
    """

    index: int
    pixels: np.ndarray
    origin: np.ndarray
    rays: np.ndarray
    views: tuple[Rendering, Rendering]
    off: np.ndarray

    @property
    def first(self) -> np.ndarray:
        """Distance of the nearer one of both surfaces, float32 (M,), metres."""
        return np.minimum(self.views[0].depth, self.views[1].depth)


def shown_twice(one: VoxelField, other: VoxelField, reached: np.ndarray,
                compared: ComparedPhotos) -> Iterator[ShownTwice]:
    """Yield each photo with pixels, reached bool (N, h, w), as both fields show them."""
    photos = compared.photos
    for index in map(int, np.flatnonzero(reached.any((1, 2)))):
        pixels = reached[index]
        origin, rays = world_rays(photos.intrinsics, compared.pose(index))
        rays = np.ascontiguousarray(rays[pixels], np.float32)
        views = render_rays(one, origin, rays), render_rays(other, origin, rays)
        photo = photos.images[index][pixels] * (compared.gains[index] / 255)
        yield ShownTwice(index, pixels, origin.astype(np.float64), rays, views, np.stack(
            [np.abs(view.image - photo).max(-1) for view in views]))


class CellVotes:
    """Counts the photos that see each cell of a field on spans of their rays, kind by kind."""

    def __init__(self, field: VoxelField, kinds: int, thick: float) -> None:
        self._field, self._thick = field, thick * field.voxel
        self._counts = np.zeros((kinds, len(field.row_of)), np.int32)
        self._last = np.zeros(len(field.row_of), np.int32)

    def add(self, shown: ShownTwice, kind: int, chosen: np.ndarray, begin: np.ndarray,
            end: np.ndarray) -> None:
        """Count those that chosen pixels, bool (M,), meet from a bit before begin to after end."""
        field = self._field
        count_spans(shown.origin, shown.rays[chosen],
                    np.maximum(begin[chosen] - self._thick, field.near), end[chosen] + self._thick,
                    field.box, np.array(field.shape),
                    len(self._counts) * shown.index + kind + 1, self._last, self._counts[kind])

    @property
    def counts(self) -> np.ndarray:
        """Of each kind, int32 (kinds, X, Y, Z)."""
        return self._counts.reshape(-1, *self._field.shape)
