"""Bake keyframes anew where the scene has changed; elsewhere they stay as they are."""
from dataclasses import dataclass
from functools import lru_cache
from pathlib import Path
from typing import cast

import cv2
from neo_ros.baking.keyframes import (
    bake_keyframe, BakingRules, box_of, finer_slices, Photos)
from neo_ros.baking.plain_surfaces import (
    dominant_directions, hand_held, NO_DIRECTIONS, with_planes)
from neo_ros.baking.worker_files import keep_array, kept_file, read_part, SharedScene
from neo_ros.field.voxel_field import VoxelField
from neo_ros.machine.evenly import evenly
from neo_ros.machine.progress import no_progress, Progress
from neo_ros.machine.ray_jobs import make_on_ray
from neo_ros.memory.contradiction import contradicted, contradiction
from neo_ros.memory.keyframe import compress, Keyframe, Packed
from neo_ros.memory.scene_memory import SceneMemory
from neo_ros.updating.changed_space import ChangedSpace
import numpy as np

# Pixels of the mesh that are baked around those whose rays meet what has changed, and that are
# taken around those that did change.
AROUND, TAKEN = 4, 2
# That tell which way the walls face.
DIRECTION_KEYFRAMES = 24


@dataclass(frozen=True, eq=False)
class ChangeRecipe:
    """
    What all changed keyframes have in common.

    space: of the field, that has changed; memory: of before; photos: those that see what has
    changed; seen, gains, directions: as `bake_keyframe` takes them
    """

    space: ChangedSpace
    memory: SceneMemory
    photos: Photos
    seen: np.ndarray
    gains: np.ndarray
    directions: np.ndarray
    rules: BakingRules = BakingRules()

    def make(self, field: VoxelField, old: Keyframe) -> Packed | None:
        """
        Return an old keyframe as it is now; None where nothing in it has changed.

        Pixels whose surface was, and is, outside of the space are the old ones.
        """
        memory, rules = self.memory, self.rules
        rays = memory.band.rays(*old.depth.shape)
        met = self.space.met_by(field, old.position, rays, (1 + rules.one_surface) * old.depth)
        if not met.any():
            return None
        side = 2 * AROUND + 1
        wanted = cv2.dilate(met.view(np.uint8), np.ones((side, side), np.uint8)) > 0
        part, finer = box_of(wanted), len(old.texture) // len(old.depth)
        new = bake_keyframe(field, self.photos, self.seen, self.gains, old.position, memory.band,
                            (*old.depth.shape, finer), rules, wanted=wanted)
        new = _with_planes(old, new, wanted, rays, self.directions)
        inside = [self.space.holds(field, (old.position + depth[..., None] * rays[part]).reshape(
            -1, 3)).reshape(depth.shape) for depth in (old.depth[part], new.depth)]
        found = _changed(old, new, part, inside[0] | inside[1], rules)
        return None if found is None else compress(found)


@dataclass(frozen=True, eq=False)
class ChangeJob:
    """
    One keyframe that may have changed, as a worker on any machine can make it.

    out: where it comes to lie; memory: the file of before, with its SHA-256; scene: photos, and
    the field of now; cells, seen: files of these arrays; the others as in ChangeRecipe
    """

    out: Path
    index: int
    memory: Path
    sha256: str
    scene: SharedScene
    cells: Path
    seen: Path
    gains: np.ndarray
    directions: np.ndarray
    rules: BakingRules

    def recipe(self) -> ChangeRecipe:
        """Read the files."""
        return ChangeRecipe(
            ChangedSpace(np.load(self.cells), []), _memory(self.memory, self.sha256),
            self.scene.read_photos(), np.load(self.seen, mmap_mode='r'), self.gains,
            self.directions, self.rules)


@lru_cache(maxsize=1)
def _memory(path: Path, sha256: str) -> SceneMemory:
    """Read a memory; its bytes are summed up each time, and a worker does many jobs."""
    return SceneMemory.read(path, sha256)


def bake_changes(recipe: ChangeRecipe, field: VoxelField, progress: Progress = no_progress
                 ) -> dict[int, Packed]:
    """Return the keyframes that show another scene now, by their number."""
    changed = {}
    for index, old in enumerate(recipe.memory.each()):
        found = recipe.make(field, old)
        if found is not None:
            changed[index] = found
        progress(index + 1, len(recipe.memory.positions))
    return changed


def bake_changes_on_ray(recipe: ChangeRecipe, scene: SharedScene, memory: tuple[Path, str],
                        work: Path, progress: Progress = no_progress) -> dict[int, Packed]:
    """
    Let Ray's workers do what `bake_changes` does, to the same bytes.

    scene: the recipe's photos, and the field, where workers find them; memory: the file of before
    and its SHA-256; work: a folder for what they make.
    """
    work = work.absolute()
    cells, seen = (keep_array(work / name, array) for name, array in (
        ('cells.npy', recipe.space.cells), ('seen.npy', recipe.seen)))
    jobs = [ChangeJob(work / f'{index:06d}.npz', index, memory[0].absolute(), memory[1], scene,
                      cells, seen, recipe.gains, recipe.directions, recipe.rules)
            for index in range(len(recipe.memory.positions))]
    for done, _ in enumerate(make_on_ray(make_change, jobs, 'the keyframe was not made'), 1):
        progress(done, len(jobs))
    changed = {}
    for job in jobs:
        part = read_part(job.out)
        if part:
            changed[job.index] = part['texture'].tobytes(), part['depth'].tobytes()
    return changed


def make_change(job: ChangeJob) -> None:
    """Make one keyframe anew, and leave it in its file; an empty one where nothing changed."""
    recipe, field = job.recipe(), cast(VoxelField, job.scene.read_field())
    found = recipe.make(field, recipe.memory.keyframe(job.index))
    arrays = {} if found is None else {'texture': found[0], 'depth': found[1]}
    with kept_file(job.out) as file:
        np.savez(file, allow_pickle=False, **{
            name: np.frombuffer(content, np.uint8) for name, content in arrays.items()})


def directions_of(memory: SceneMemory) -> np.ndarray:
    """Return the directions that the surfaces of a scene face, see `dominant_directions`."""
    if hand_held(memory.positions):
        return NO_DIRECTIONS
    depths = [memory.keyframe(int(index)).depth
              for index in evenly(len(memory.positions), DIRECTION_KEYFRAMES)]
    rays = memory.band.rays(*depths[0].shape)
    return dominant_directions(depths, [rays] * len(depths))


def _with_planes(old: Keyframe, new: Keyframe, wanted: np.ndarray, rays: np.ndarray,
                 directions: np.ndarray) -> Keyframe:
    """
    Return a part of the old keyframe, with the new one where wanted, and its planes.

    wanted bool (h, w), of the old one. The edges of planes may lie outside of the part.
    """
    part, finer = box_of(wanted), len(old.texture) // len(old.depth)
    depth, texture = old.depth.copy(), old.texture.copy()
    depth[wanted] = new.depth[wanted[part]]
    fine = finer_slices(part, finer)
    np.copyto(texture[fine], new.texture,
              where=wanted[part].repeat(finer, 0).repeat(finer, 1)[..., None])
    return Keyframe(old.position, with_planes(depth, texture, rays, directions)[part],
                    texture[fine])


def _changed(old: Keyframe, new: Keyframe, part: tuple[slice, slice], inside: np.ndarray,
             rules: BakingRules) -> Keyframe | None:
    """Return the old keyframe with what differs in a part of it; None where nothing does."""
    finer = len(old.texture) // len(old.depth)
    fine = finer_slices(part, finer)
    before, after = old.depth[part], new.depth
    other = np.abs(after - before) > rules.one_surface * np.maximum(after, before)
    now, then = (cv2.resize(one, after.shape[::-1], interpolation=cv2.INTER_AREA)
                 for one in (new.texture, old.texture[fine]))
    other |= contradicted(contradiction(now.astype(np.float32), then.astype(np.float32), inside))
    other &= inside
    if not other.any():
        return None
    side = 2 * TAKEN + 1
    other = cv2.dilate(other.astype(np.uint8), np.ones((side, side), np.uint8)) > 0
    depth, texture = old.depth.copy(), old.texture.copy()
    depth[part][other] = after[other]
    other = other.repeat(finer, 0).repeat(finer, 1)
    texture[fine][other] = new.texture[other]
    return Keyframe(old.position, depth, texture)
