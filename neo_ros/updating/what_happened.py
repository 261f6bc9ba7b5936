"""What happened in a changed place, by what new photos show there."""
from dataclasses import dataclass
from enum import Enum

from neo_ros.field.rendering import render_rays, world_rays
from neo_ros.field.voxel_field import VoxelField
from neo_ros.updating.changed_space import ChangedPlace
from neo_ros.updating.compared_photos import ComparedPhotos
import numpy as np
from scipy import ndimage


class Event(Enum):
    """What new photos say of a place; the values are words of a report."""

    CAME = 'came'
    LEFT = 'left'
    REPAINTED = 'looks otherwise'


@dataclass(frozen=True)
class EventRules:
    """When a pixel tells of a thing, and when enough of them do."""

    # A thing came, or left, where what is seen is nearer, or farther, by more than so many voxels
    # and a share of the distance.
    thick: float = 1.5
    one_surface: float = 0.05
    # Of all pixels that tell of a place; and how many photos do.
    least_share: float = 0.2
    least_photos: int = 3


def what_happened(old: VoxelField, new: VoxelField, places: list[ChangedPlace],
                  compared: ComparedPhotos, rules: EventRules = EventRules()
                  ) -> list[list[Event]]:
    """
    Return what happened in each place, that first of which most pixels tell; may be nothing.

    Where new photos contradict the memory the fields of before and after the fit say how far away
    the surface was, and is.
    """
    place_of = np.zeros(old.shape, np.int32)
    for number, place in enumerate(places, 1):
        place_of[tuple(place.cells.T)] = number
    place_of = np.where(place_of, place_of, ndimage.grey_dilation(place_of, (3, 3, 3)))
    pixels, photos = np.zeros((2, len(places) + 1, len(Event)), np.int64)
    for index in range(compared.old, len(compared.photos.images)):
        off = compared.contradicts[index]
        if not off.any():
            continue
        origin, rays = world_rays(compared.photos.intrinsics, compared.pose(index))
        rays = np.ascontiguousarray(rays[off], np.float32)
        then, now = (render_rays(field, origin, rays).depth for field in (old, new))
        most = rules.thick * old.voxel + rules.one_surface * np.minimum(then, now)
        kind = np.select([now < then - most, now > then + most], [0, 1], 2)
        where = place_of[tuple(old.cells_at(origin + np.minimum(then, now)[:, None] * rays).T)]
        counts = np.zeros_like(pixels)
        np.add.at(counts, (where, kind), 1)
        pixels += counts
        photos += counts > 0
    return [_most(*counts, rules) for counts in zip(pixels[1:], photos[1:])]


def _most(pixels: np.ndarray, photos: np.ndarray, rules: EventRules) -> list[Event]:
    events = list(Event)
    return [events[kind] for kind in np.argsort(-pixels, kind='stable')
            if photos[kind] >= rules.least_photos
            and pixels[kind] >= rules.least_share * pixels.sum()]
