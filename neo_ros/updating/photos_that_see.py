"""Which photos see what has changed, and what of them is out of date, or right again."""
from pathlib import Path

from neo_ros.baking.keyframes import BakingRules
from neo_ros.baking.worker_files import SharedScene
from neo_ros.field.rendering import render_rays, world_rays
from neo_ros.field.voxel_field import VoxelField
from neo_ros.pictures.usable import shrunk
from neo_ros.updating.changed_space import ChangedSpace
from neo_ros.updating.compared_photos import ComparedPhotos
from neo_ros.updating.driven_photos import Drive
from neo_ros.updating.refit import StillRight
from neo_ros.updating.update_run import UpdateRun
import numpy as np


def photos_that_see(old: VoxelField, field: VoxelField, space: ChangedSpace,
                    compared: ComparedPhotos
                    ) -> tuple[list[int], np.ndarray, np.ndarray, np.ndarray]:
    """
    Return which photos see changed space, the last are the new ones; how far; wrong and right.

    Wrong, bool (N, h, w), are pixels of photos of before that show what is there no more; not
    those that show what is behind something new. And pixels of new ones that show what did not
    become part of the scene, such as somebody who walked by. Right are stale pixels that show
    what is there again.
    """
    rules, small = BakingRules(), compared.photos.intrinsics
    reached = space.reached_by(field, compared, rules.one_surface)
    chosen = [index for index, pixels in enumerate(reached) if pixels.any()]
    assert compared.photos.usable is not None
    passing = (compared.depth > 0) & ~compared.agrees & ~reached & ~compared.stale
    reached[compared.old:] = compared.photos.usable[compared.old:] & ~passing[compared.old:]
    judge = StillRight(old, field, space, compared)
    seen, wrong, stale = compared.depth[chosen], passing[chosen], compared.stale[chosen]
    right = np.zeros_like(stale)
    for place, index in enumerate(chosen):
        origin, rays = world_rays(small, compared.pose(index))
        pixels = reached[index]
        now = render_rays(field, origin, rays[pixels])
        seen[place][pixels] = np.where(now.coverage > rules.least_coverage, now.depth, 0)
        if index < compared.old:
            agree = judge.of(index, pixels, origin, rays, now.image)
            right[place] = stale[place] & agree
            past, depth = pixels & ~agree, compared.depth[index]
            past &= compared.photos.usable[index]  # Else it is out of date already.
            # A surface outside of the space did not change, whatever is before it now.
            outside = past & (depth > 0)
            outside[outside] = ~space.holds(
                field, origin + depth[outside][:, None] * rays[outside])
            seen[place][outside] = depth[outside]
            wrong[place] = past & ~outside
    seen[wrong | stale & ~right] = 0
    return chosen, seen, wrong, right


def keep_photos(run: UpdateRun, drive: Drive, compared: ComparedPhotos, chosen: list[int],
                wrong: np.ndarray, right: np.ndarray, field: Path, folder: Path) -> SharedScene:
    """Keep chosen photos, and what of them shows what is there, in files: they may be large."""
    camera = run.camera

    def usable(index: int, *small: np.ndarray) -> np.ndarray:
        off, back = (shrunk(one, camera.width, camera.height) for one in small)
        now, stale = run.masks(index)
        return (now | stale & back) & ~off

    return SharedScene.of_rows(
        field, camera, compared.photos.T_world_cam[chosen],
        (run.image(drive, index) for index in chosen),
        map(usable, chosen, wrong, right), folder)
