"""Fit a field anew in a part of its space, and leave the rest bit by bit as it was."""
from dataclasses import dataclass, replace
import math
import time

import cv2
from neo_ros.baking.keyframes import Photos
from neo_ros.errors import NeoError
from neo_ros.field import kernels
from neo_ros.field.config import FieldConfig
from neo_ros.field.fitting import FieldTrainer
from neo_ros.field.rendering import render_rays, world_rays
from neo_ros.field.voxel_field import AIR_KEPT, dilated, VoxelField
from neo_ros.geometry import CameraPose
from neo_ros.machine.progress import no_progress, Progress
from neo_ros.memory.contradiction import contradicted, contradiction
from neo_ros.updating.changed_space import ChangedSpace
import numpy as np


@dataclass(frozen=True)
class RefitRules:
    """How long it takes."""

    # Each pixel is fitted so often, at most.
    passes: float = 12.0
    least_steps: int = 300
    most_steps: int = 3000
    # Of the steps; then old photos that agree with what the new ones have made have their say.
    new_alone: float = 0.6
    timed_steps: int = 20


@dataclass(frozen=True, eq=False)
class Reaching:
    """
    Small photos that see what may have changed: the first `old` ones of before, then new ones.

    photos: of one exposure and camera, usable in full where they show the scene; reached bool
    (N, h, w), pixels whose rays meet the changed space.
    """

    photos: Photos
    gains: np.ndarray
    reached: np.ndarray
    old: int


def refit(field: VoxelField, space: ChangedSpace, reaching: Reaching, config: FieldConfig,
          seed: int, minutes: float = math.inf, progress: Progress = no_progress,
          rules: RefitRules = RefitRules()) -> VoxelField:
    """Return the field as new photos show it; grid points that no changed cell has stay."""
    photos, usable = reaching.photos, reaching.reached.copy()
    usable[:reaching.old] = False
    if not usable.any():
        raise NeoError('update: no pixel of the new photos shows what has changed')
    per_step = config.rays_per_step
    steps = int(np.clip(rules.passes * usable.sum() / per_step, rules.least_steps,
                        rules.most_steps))
    corners = dilated(space.cells, 0)
    open_field = field.keeping((field.row_of >= 0) | corners.ravel())
    open_field.searched = space.cells
    open_field.update_occupancy()
    trainer = FieldTrainer(
        photos.images, photos.intrinsics, photos.T_world_cam,
        replace(config, steps=steps, minutes=None, exposure=False, vignetting=False,
                sharpness=0.0), seed, usable=usable)
    trainer.camera.log_gain = -np.log(reaching.gains).astype(np.float32)
    trainer.change_only(open_field, corners)
    old_photos_join, ends = False, time.monotonic() + 60 * minutes
    while trainer.step < trainer.config.steps:
        trainer.train_step()
        if trainer.step == rules.timed_steps and math.isfinite(minutes):
            each = trainer.seconds / trainer.step
            steps = min(steps, max(int((ends - time.monotonic()) / each), rules.timed_steps + 1))
            trainer.config = replace(trainer.config, steps=steps)
        if not old_photos_join and trainer.step >= rules.new_alone * trainer.config.steps:
            usable[:reaching.old] = agreeing(trainer.field, reaching)[:reaching.old]
            old_photos_join = True
        progress(trainer.step, trainer.config.steps)
    return _finished(field, trainer.field, space, reaching)


def agreeing(field: VoxelField, reaching: Reaching) -> np.ndarray:
    """Tell which of the reached pixels show what the field shows there: bool (N, h, w)."""
    photos, agree = reaching.photos, reaching.reached.copy()
    for image, T, gain, reached in zip(photos.images, photos.T_world_cam, reaching.gains, agree):
        origin, rays = world_rays(photos.intrinsics, CameraPose(T))
        image = image.astype(np.float32)
        shown = image.copy()
        shown[reached] = 255 * render_rays(field, origin, rays[reached]).image / gain
        reached &= ~contradicted(contradiction(image, shown, reached))
    return agree


def shrunk_photos(photos: Photos, focal: float) -> Photos:
    """Return photos of at most this focal length, pixels; a pixel is usable where all of it is."""
    camera = photos.intrinsics
    camera = camera.scaled(min(focal / camera.fx, 1.0))
    size = (camera.width, camera.height)
    return Photos(
        np.stack([cv2.resize(one, size, interpolation=cv2.INTER_AREA) for one in photos.images]),
        camera, photos.T_world_cam, None if photos.usable is None else np.stack(
            [cv2.resize((~one).astype(np.float32), size, interpolation=cv2.INTER_AREA) == 0
             for one in photos.usable]))


def _finished(field: VoxelField, fitted: VoxelField, space: ChangedSpace, reaching: Reaching
              ) -> VoxelField:
    """Leave air out, and note as seen what the new photos reach."""
    fitted.searched = None
    fitted.update_occupancy()
    matter = (fitted.skip == 0).reshape(fitted.shape) & space.cells
    found = fitted.keeping((field.row_of >= 0) | dilated(matter, AIR_KEPT).ravel() & (
        fitted.row_of >= 0))
    found.update_occupancy()
    seen, photos = np.zeros_like(found.seen), reaching.photos
    for T, reached in zip(photos.T_world_cam[reaching.old:], reaching.reached[reaching.old:]):
        origin, rays = world_rays(photos.intrinsics, CameraPose(T))
        rays_d = np.ascontiguousarray(rays[reached], np.float32)
        kernels.mark_seen(np.broadcast_to(origin, rays_d.shape).copy(), rays_d, found.arrays,
                          seen)
    found.seen |= seen & space.cells.ravel().view(np.uint8)
    return found
