"""Fit a field anew in a part of its space, and leave the rest bit by bit as it was."""
from collections.abc import Callable, Sequence
from dataclasses import dataclass, replace
from typing import NamedTuple

import cv2
from neo_ros.baking.keyframes import BakingRules, Photos
from neo_ros.field import kernels
from neo_ros.field.config import FieldConfig
from neo_ros.field.fitting import FieldTrainer
from neo_ros.field.grid_points import dilated
from neo_ros.field.rendering import render_rays, world_rays
from neo_ros.field.voxel_field import AIR_KEPT, VoxelField
from neo_ros.geometry import CameraPose
from neo_ros.machine.progress import no_progress, Progress
from neo_ros.memory.contradiction import contradicted, contradiction
from neo_ros.updating.changed_space import around, ChangedSpace, ChangeRules, space_of
from neo_ros.updating.compared_photos import ComparedPhotos
from neo_ros.updating.photo_votes import CellVotes, shown_twice
import numpy as np
from scipy import ndimage


@dataclass(frozen=True)
class FitLength:
    """
    How long a fit takes: each pixel is fitted so often, in a number of steps between these.

    The fit of a part takes no more steps than that of the whole did.
    """

    passes: float = 12.0
    least_steps: int = 600
    most_steps: int = 3000


@dataclass(frozen=True)
class RefitRules(FitLength):
    """How long it takes, and what stays."""

    # Of the steps; then what is as before goes back, and old photos that agree with what the new
    # ones have made have their say.
    new_alone: float = 0.6
    # A surface has changed where photos contradict it, the fit is nearer to them, by more than so
    # many grey levels, and so many of them see that, of all that see the surface.
    grey_levels: float = 15.0
    least_photos: int = 3
    least_share: float = 0.3
    # Photos of before show what was there, not what is: where more than so many founders for each
    # that does are nearer to the fit, the field was poor, and nothing has changed.
    most_as_new: float = 0.5
    # Cells before and behind a surface that are of it; and around all that has changed.
    thick: float = 1.5
    margin: int = 1


def refit(field: VoxelField, space: ChangedSpace, compared: ComparedPhotos,
          read: Callable[[Sequence[int]], Photos], config: FieldConfig,
          seed: int, minutes: float | None = None, progress: Progress = no_progress,
          rules: RefitRules = RefitRules()) -> tuple[VoxelField, ChangedSpace]:
    """
    Return the field as new photos show it, and what of the space has changed in truth.

    All other grid points stay as they are. read: some of the photos, in the size that fields are
    fitted to. minutes: of fitting; None: as many as it takes.
    """
    beyond = BakingRules.one_surface
    reached = space.reached_by(field, compared, beyond)
    usable = reached.copy()
    usable[:compared.old] = False
    if not usable.any():
        return field, ChangedSpace(np.zeros_like(space.cells), [])
    chosen = np.flatnonzero(reached.any((1, 2)))
    photos = read(chosen.tolist())
    fitted_to = _in_size_of(photos, usable[chosen])
    trainer = trainer_of(replace(photos, usable=fitted_to), compared.gains[chosen], config, seed,
                         minutes, rules, pixels=int(usable.sum()))
    trainer.change_only(*opened(field, space))
    fit_until(trainer, rules.new_alone, progress)
    fitted = trainer.field
    space = truly_changed(field, fitted, usable, compared, space, rules)
    if not space.places:
        return field, space
    narrower, points = opened(field, space)
    rows = points.ravel()
    narrower.grid[narrower.row_of[rows]] = fitted.grid[fitted.row_of[rows]]
    narrower.update_occupancy()
    usable[:] = space.reached_by(field, compared, beyond)
    usable[:compared.old] = still_right(field, narrower, space, compared, usable, rules)
    fitted_to[:] = _in_size_of(photos, usable[chosen])
    trainer.change_only(narrower, points)
    fit_until(trainer, 1.0, progress)
    usable[:compared.old] = False
    return _finished(field, trainer.field, space, usable, compared), space


def _in_size_of(photos: Photos, small: np.ndarray) -> np.ndarray:
    """Enlarge which pixels of smaller photos count, bool (N, h, w); masks leave theirs out."""
    assert photos.usable is not None
    size = photos.usable.shape[:0:-1]
    return photos.usable & np.stack([cv2.resize(
        one, size, interpolation=cv2.INTER_NEAREST_EXACT) for one in small.view(np.uint8)]).view(
            bool)


def trainer_of(photos: Photos, gains: np.ndarray, config: FieldConfig, seed: int,
               minutes: float | None, rules: FitLength, depths: np.ndarray | None = None,
               pixels: int | None = None) -> FieldTrainer:
    """
    Return a trainer that fits the usable pixels of photos, whose gains (N, 3) are known.

    depths: of the photos, see `FieldTrainer`; pixels: so many count; None: all that are usable.
    """
    assert photos.usable is not None
    pixels = int(photos.usable.sum()) if pixels is None else pixels
    most = rules.most_steps
    if config.minutes is None:  # Else the training did not read its steps.
        most = min(most, config.steps)
    steps = int(np.clip(rules.passes * pixels / config.rays_per_step, rules.least_steps, most))
    trainer = FieldTrainer(
        photos.images, photos.intrinsics, photos.T_world_cam,
        replace(config, steps=steps, minutes=minutes, exposure=False, vignetting=False,
                sharpness=0.0), seed, depths=depths, usable=photos.usable)
    trainer.camera.log_gain = -np.log(gains).astype(np.float32)
    return trainer


def fit_until(trainer: FieldTrainer, share: float, progress: Progress) -> None:
    """Fit on until a share of the fit is done."""
    while trainer.share < share:
        trainer.train_step()
        progress(*trainer.done)


def opened(field: VoxelField, space: ChangedSpace) -> tuple[VoxelField, np.ndarray]:
    """Return a copy of the field that keeps all points of a space, and these, bool (X, Y, Z)."""
    points = dilated(space.cells, 0)
    copy = field.keeping((field.row_of >= 0) | points.ravel())
    copy.searched = space.cells
    copy.update_occupancy()
    return copy, points


def truly_changed(old: VoxelField, new: VoxelField, reached: np.ndarray,
                  compared: ComparedPhotos, space: ChangedSpace, rules: RefitRules
                  ) -> ChangedSpace:
    """
    Return the cells whose surfaces are others in the new field, which only new photos show.

    reached bool (N, h, w): their pixels that see the space.
    """
    seen = _seen_differently(old, new, reached, compared, rules)
    # What left is seen through, what came is seen; haze on the way is neither.
    changed = np.zeros_like(space.cells)
    for photos, matter in ((seen.through, old.matter), (seen.surface, new.matter)):
        changed |= matter & (photos >= rules.least_photos) & (
            photos >= rules.least_share * (photos + seen.same))
    changed &= space.cells
    changed = ndimage.binary_closing(changed, np.ones((3, 3, 3))) & space.cells
    found = space_of(old, changed, seen.through, ChangeRules(), 0)
    before = found.reached_by(old, compared, BakingRules.one_surface) & ~compared.stale
    before[compared.old:] = False
    worse = _seen_differently(new, old, before, compared, rules).through
    before[:compared.old][~compared.founders] = False
    better = _seen_differently(old, new, before, compared, rules).through
    places = [place for place in found.places if worse[tuple(place.cells.T)].sum()
              * rules.most_as_new > better[tuple(place.cells.T)].sum()]
    kept = around(old, places, rules.margin)
    return ChangedSpace(kept.cells & space.cells, kept.places)


class _Seen(NamedTuple):
    """
    How many photos see each cell of a field, three times int32 (X, Y, Z).

    through, surface: in pixels that are nearer to another field, before the other's surface or at
    it, and at it; same: in other pixels.
    """

    through: np.ndarray
    surface: np.ndarray
    same: np.ndarray


def _seen_differently(one: VoxelField, other: VoxelField, reached: np.ndarray,
                      compared: ComparedPhotos, rules: RefitRules) -> _Seen:
    """Ask photos which of two fields they show; reached bool (N, h, w): the pixels that count."""
    votes = CellVotes(one, 3, rules.thick)
    for shown in shown_twice(one, other, reached, compared):
        nearer = shown.off[0] - shown.off[1] > rules.grey_levels / 255
        if shown.index >= compared.old:
            nearer &= ~compared.agrees[shown.index][shown.pixels]
        surface = shown.views[1].depth
        for kind, (chosen, begin) in enumerate((
                (nearer, shown.first), (nearer, surface), (~nearer, shown.first))):
            votes.add(shown, kind, chosen, begin, surface)
    return _Seen(*votes.counts)


def still_right(before: VoxelField, after: VoxelField, space: ChangedSpace,
                compared: ComparedPhotos, reached: np.ndarray,
                rules: RefitRules = RefitRules()) -> np.ndarray:
    """Judge reached pixels of all photos of before, see `StillRight`: bool (old, h, w)."""
    judge, right = StillRight(before, after, space, compared, rules), reached[:compared.old].copy()
    for index in map(int, np.flatnonzero(right.any((1, 2)))):
        origin, rays = world_rays(compared.photos.intrinsics, compared.pose(index))
        now = render_rays(after, origin, rays[right[index]])
        right[index] = judge.of(index, right[index], origin, rays, now.image)
    return right


class StillRight:
    """
    Tells which pixels of photos of before show what an updated field shows there.

    Pixels behind matter that came do not: beside slats and legs they seem to agree, would wear
    these away, and paint them in the colours of the floor. Stale ones may show that very thing,
    which came back: then they are nearer to the updated field.
    """

    def __init__(self, before: VoxelField, after: VoxelField, space: ChangedSpace,
                 compared: ComparedPhotos, rules: RefitRules = RefitRules()) -> None:
        self._before, self._compared, self._rules = before, compared, rules
        self._came = ChangedSpace(ndimage.binary_dilation(
            after.matter & ~before.matter & space.cells, np.ones((3, 3, 3))) & space.cells, [])

    def of(self, index: int, reached: np.ndarray, origin: np.ndarray, rays: np.ndarray,
           now: np.ndarray) -> np.ndarray:
        """
        Return those of the reached pixels of a photo, bool (h, w).

        rays (h, w, 3) from origin (3,), unit vectors; now float32 (M, 3): the colours, 0 ... 1,
        that the updated field has in the reached ones.
        """
        compared = self._compared
        pixels, stale = reached.copy(), compared.stale[index]
        current = pixels & ~stale
        pixels[current] = ~self._came.met_by(
            self._before, origin, rays[current],
            (1 + BakingRules.one_surface) * compared.depth[index][current])
        image, gain = compared.photos.images[index].astype(np.float32), compared.gains[index]
        shown = image.copy()
        shown[pixels] = 255 * now[pixels[reached]] / gain
        asked = pixels & stale
        if asked.any():
            then = 255 * render_rays(self._before, origin, rays[asked]).image / gain
            off_then, off = (np.abs(one - image[asked]).max(-1) for one in (then, shown[asked]))
            came_back = np.zeros(pixels.shape, np.uint8)
            came_back[asked] = off_then - off > self._rules.grey_levels
            # Beside them both fields may have one colour.
            pixels &= ~stale | (cv2.dilate(came_back, np.ones((3, 3), np.uint8)) > 0)
        return pixels & ~contradicted(contradiction(image, shown, pixels))


def _finished(field: VoxelField, fitted: VoxelField, space: ChangedSpace, reached: np.ndarray,
              compared: ComparedPhotos) -> VoxelField:
    """Leave air out, and note as seen what the new photos reach."""
    found = fitted.keeping((field.row_of >= 0) | (fitted.row_of >= 0) & dilated(
        fitted.matter & space.cells, AIR_KEPT).ravel())
    found.searched = None
    found.update_occupancy()
    seen, photos = np.zeros_like(found.seen), compared.photos
    for T, pixels in zip(photos.T_world_cam[compared.old:], reached[compared.old:]):
        origin, rays = world_rays(photos.intrinsics, CameraPose(T))
        rays_d = np.ascontiguousarray(rays[pixels], np.float32)
        kernels.mark_seen(np.broadcast_to(origin, rays_d.shape).copy(), rays_d, found.arrays,
                          seen)
    found.seen |= seen & space.cells.ravel().view(np.uint8)
    return found
