"""A place that the scene did not have: fitted by itself, and taken into the scene's field."""
from collections.abc import Sequence
from dataclasses import dataclass, replace
import logging

from neo_ros.baking.keyframes import Photos, seen_by_photos
from neo_ros.errors import SceneError
from neo_ros.field import kernels
from neo_ros.field.config import FieldConfig
from neo_ros.field.enlarging import enlarged, filled
from neo_ros.field.fitting import FieldTrainer
from neo_ros.field.grid_points import dilated
from neo_ros.field.rendering import render_rays, world_rays
from neo_ros.field.voxel_field import AIR_KEPT, VoxelField
from neo_ros.geometry import CameraPose
from neo_ros.machine.progress import no_progress, Progress
from neo_ros.training.photo_depth import depth_among
from neo_ros.updating.changed_space import ChangedPlace, ChangedSpace
from neo_ros.updating.compared_photos import ComparedPhotos
from neo_ros.updating.kernels import count_votes, pinholes
from neo_ros.updating.placing import Placed
from neo_ros.updating.refit import fit_until, FitLength, trainer_of
import numpy as np
from scipy import ndimage

logger = logging.getLogger(__name__)


@dataclass(frozen=True)
class GrowthRules(FitLength):
    """When a place is new, and how it is fitted."""

    passes: float = 4.0
    least_steps: int = 800
    most_steps: int = 6000

    # Photos that were taken where fewer than so many photos of before look: so many make a place.
    least_looks: int = 2
    least_photos: int = 8
    # Of the steps the place is fitted in a field of its own, with its own box, coarse to fine;
    # then in the scene's.
    alone: float = 0.7
    # Cells behind a surface that are seen with it.
    behind: float = 2.0


@dataclass(frozen=True, eq=False)
class Growth:
    """
    A field with a new place, and the poses of photos that were taken in it, (M, 4, 4).

    space: its cells; tied: all images that were placed, and what they show.
    """

    field: VoxelField
    space: ChangedSpace
    T: np.ndarray
    tied: Placed


def stand_outside(compared: ComparedPhotos, placed: int, rules: GrowthRules = GrowthRules()
                  ) -> np.ndarray:
    """Return which of the last photos were taken where none of before looks; none if few were."""
    count = len(compared.photos.images)
    new = np.arange(count - placed, count)
    outside = new[_looks(compared.photos.T_world_cam[new, :3, 3], compared.photos,
                         compared.depth_of_before(), 0) < rules.least_looks]
    return outside if len(outside) >= rules.least_photos else outside[:0]


def grow(field: VoxelField, compared: ComparedPhotos, outside: np.ndarray, tied: Placed,
         chosen: Sequence[int], photos: Photos, config: FieldConfig, seed: int,
         minutes: float | None = None, progress: Progress = no_progress,
         rules: GrowthRules = GrowthRules()) -> Growth | None:
    """
    Take a place into the field that no photo of before shows; None where nothing comes of it.

    outside: the photos that were taken there, see `stand_outside`; chosen: all that see it, and
    photos: these at the resolution of the fit. To the last ones the memory shows nothing: their
    gains and depth in `compared` are filled. What the field has stays as it is. minutes: of
    fitting; None: as many as it takes.
    """
    T = compared.photos.T_world_cam
    new = np.arange(len(T) - tied.elsewhere, len(T))
    gains = _gains(compared, chosen, np.isin(chosen, new))
    assert photos.usable is not None
    depths = None if tied.points is None else np.stack(list(depth_among(
        photos.images, photos.intrinsics, photos.T_world_cam, tied.points, range(len(chosen)))))
    trainer = trainer_of(replace(photos, usable=photos.usable.copy()), gains, config, seed,
                         minutes, rules, depths)
    fit_until(trainer, rules.alone, progress)
    own = trainer.finished()
    at = T[outside, :3, 3]  # What lies far from there, behind windows, is left to the shell.
    try:
        larger = enlarged(
            field, np.maximum(own.centre - own.half_extent, at.min(0) - config.margin),
            np.minimum(own.centre + own.half_extent, at.max(0) + config.margin))
    except SceneError as error:
        logger.warning('%s', error)
        return None
    cells = _new_cells(larger, own, compared, chosen, at, rules)
    grown, points = filled(larger, own, cells)
    if not points.any():
        return None
    assert trainer.usable is not None
    trainer.usable &= _in_place(grown, cells, photos)
    if not trainer.usable.any():
        return None
    trainer.change_only(grown, points)
    fit_until(trainer, 1.0, progress)
    grown = _finished(larger, trainer, cells)
    usable = compared.photos.usable
    assert usable is not None
    shown = Photos(compared.photos.images[new], compared.photos.intrinsics, T[new], usable[new])
    compared.depth[new], compared.gains[new] = seen_by_photos(grown, shown)
    usable[new] &= compared.depth[new] > 0
    index = np.argwhere(cells)
    points = grown.world_points(index + 0.5)
    near = points[(np.abs(points - grown.centre) <= grown.half_extent).all(1)]
    near = near if len(near) else points
    place = ChangedPlace(index, near.min(0), near.max(0), len(outside))
    return Growth(grown, ChangedSpace(cells, [place]), T[outside], tied)


def _gains(compared: ComparedPhotos, chosen: Sequence[int], unknown: np.ndarray) -> np.ndarray:
    """Return gains of photos (N, 3); those that are unknown, bool (N,), have the others' mean."""
    gains = compared.gains[chosen].copy()
    if not unknown.all():
        gains[unknown] = gains[~unknown].mean(0)
    return gains


def _looks(points: np.ndarray, photos: Photos, depth: np.ndarray, behind: float) -> np.ndarray:
    """
    Count the photos that see points (N, 3), up to `behind` metres behind a surface: (N,).

    depth float32 (M, h, w), metres along the ray, of the first M photos.
    """
    everything = np.ones(depth.shape, bool)
    against, looks = np.zeros((2, len(points)), np.int32)
    count_votes(points.astype(np.float32),
                pinholes(photos.intrinsics, photos.T_world_cam[:len(depth)]), depth,
                ~everything, everything, ~everything, np.float32(behind), np.float32(0), against,
                looks, np.ones(len(points), np.float32))
    return looks


def _new_cells(field: VoxelField, own: VoxelField, compared: ComparedPhotos,
               chosen: Sequence[int], positions: np.ndarray, rules: GrowthRules) -> np.ndarray:
    """
    Return the cells, bool (X, Y, Z), that photos see in a field of their own, and none of before.

    Of these, what hangs together with a place where one was taken, positions (M, 3).
    """
    photos, behind = compared.photos, rules.behind * field.voxel
    assert photos.usable is not None
    theirs = Photos(photos.images[chosen], photos.intrinsics, photos.T_world_cam[chosen],
                    photos.usable[chosen])
    seen, known = (seen_by_photos(one, theirs)[0] for one in (own, field))
    # What they show behind surfaces that the field has, through the door, is shown roughly.
    hidden = (known > 0) & ((seen == 0) | (known < seen))
    seen[hidden] = known[hidden]
    depth = compared.depth_of_before()
    cells = np.zeros(field.shape, bool)
    for plane in range(field.shape[0] - 1):  # One by one: positions are float64.
        indices = np.moveaxis(np.indices((1, *(size - 1 for size in field.shape[1:]))), 0, -1)
        index = indices.reshape(-1, 3) + np.array([plane, 0, 0])
        points = field.world_points(index + 0.5)
        found = _looks(points, theirs, seen, behind) > 0
        found[found] = _looks(points[found], photos, depth, behind) == 0
        cells[tuple(index[found].T)] = True
    labels, _ = ndimage.label(cells)
    reached = np.unique(labels[tuple(field.cells_at(positions).T)])
    return np.isin(labels, reached[reached > 0])


def _in_place(field: VoxelField, cells: np.ndarray, photos: Photos) -> np.ndarray:
    """
    Tell which pixels of photos show a surface in the new cells, or none: bool (N, H, W).

    Through a door that was closed they show what the field does not: it would be painted on air.
    """
    found = np.zeros(photos.images.shape[:3], bool)
    space = ChangedSpace(cells, [])
    for pixels, T in zip(found, photos.T_world_cam):
        origin, rays = world_rays(photos.intrinsics, CameraPose(T))
        shown = render_rays(field, origin, rays)
        points = (origin + shown.depth[..., None] * rays).reshape(-1, 3)
        pixels[:] = (shown.opacity < 0.5) | space.holds(field, points).reshape(pixels.shape)
    return found


def _finished(field: VoxelField, trainer: FieldTrainer, cells: np.ndarray) -> VoxelField:
    """Leave out of the new cells the air, and what no photo reaches; note as seen what they do."""
    fitted = trainer.field
    seen = np.zeros_like(fitted.seen)
    for rays_o, rays_d in trainer.photo_rays():
        kernels.mark_seen(rays_o, rays_d, fitted.arrays, seen)
    seen &= cells.ravel().view(np.uint8)
    kept = dilated(fitted.matter & cells, AIR_KEPT) & dilated(
        seen.view(bool).reshape(fitted.shape), 0)
    found = fitted.keeping((field.row_of >= 0) | (fitted.row_of >= 0) & kept.ravel())
    found.seen = field.seen | seen
    found.update_occupancy()
    return found
