"""Bake keyframes anew where the scene has changed; elsewhere they stay as they are."""
from dataclasses import replace

import cv2
from neo_ros.baking.keyframes import bake_keyframe, BakingRules, Photos
from neo_ros.baking.plain_surfaces import (
    dominant_directions, hand_held, NO_DIRECTIONS, with_planes)
from neo_ros.field.voxel_field import VoxelField
from neo_ros.machine.evenly import evenly
from neo_ros.machine.progress import no_progress, Progress
from neo_ros.memory.contradiction import contradicted, contradiction
from neo_ros.memory.keyframe import Keyframe
from neo_ros.memory.scene_memory import SceneMemory
from neo_ros.updating.changed_space import ChangedSpace
import numpy as np

# Pixels of the mesh that are baked around those whose rays meet what has changed, and that are
# taken around those that did change.
AROUND, TAKEN = 4, 2
# That tell which way the walls face.
DIRECTION_KEYFRAMES = 24


def bake_changes(field: VoxelField, space: ChangedSpace, memory: SceneMemory, photos: Photos,
                 seen: np.ndarray, gains: np.ndarray, progress: Progress = no_progress,
                 rules: BakingRules = BakingRules()) -> dict[int, Keyframe]:
    """
    Return the keyframes that show another scene now, by their number.

    photos: those that see what has changed; seen, gains: as `bake_keyframe` takes them. Pixels
    whose surface was, and is, outside of the space are the old ones.
    """
    changed = {}
    directions = directions_of(memory)
    for index, old in enumerate(memory.each()):
        rays = memory.band.rays(*old.depth.shape)
        met = space.met_by(field, old.position, rays, (1 + rules.one_surface) * old.depth)
        if met.any():
            part = _box(met)
            finer = len(old.texture) // len(old.depth)
            new = bake_keyframe(field, photos, seen, gains, old.position, memory.band,
                                (*old.depth.shape, finer), rules, part=part)
            new = _with_planes(old, new, part, rays, directions)
            inside = [space.holds(field, (old.position + depth[..., None] * rays[part]).reshape(
                -1, 3)).reshape(depth.shape) for depth in (old.depth[part], new.depth)]
            found = _changed(old, new, part, inside[0] | inside[1], rules)
            if found is not None:
                changed[index] = found
        progress(index + 1, len(memory.positions))
    return changed


def directions_of(memory: SceneMemory) -> np.ndarray:
    """Return the directions that the surfaces of a scene face, see `dominant_directions`."""
    if hand_held(memory.positions):
        return NO_DIRECTIONS
    depths = [memory.keyframe(int(index)).depth
              for index in evenly(len(memory.positions), DIRECTION_KEYFRAMES)]
    rays = memory.band.rays(*depths[0].shape)
    return dominant_directions(depths, [rays] * len(depths))


def _with_planes(old: Keyframe, new: Keyframe, part: tuple[slice, slice], rays: np.ndarray,
                 directions: np.ndarray) -> Keyframe:
    """Return the new part with planes: their edges may lie outside of it, in the old keyframe."""
    finer = len(old.texture) // len(old.depth)
    depth, texture = old.depth.copy(), old.texture.copy()
    depth[part] = new.depth
    texture[tuple(slice(finer * one.start, finer * one.stop) for one in part)] = new.texture
    return replace(new, depth=with_planes(depth, texture, rays, directions)[part])


def _changed(old: Keyframe, new: Keyframe, part: tuple[slice, slice], inside: np.ndarray,
             rules: BakingRules) -> Keyframe | None:
    """Return the old keyframe with what differs in a part of it; None where nothing does."""
    finer = len(old.texture) // len(old.depth)
    fine = tuple(slice(finer * one.start, finer * one.stop) for one in part)
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


def _box(met: np.ndarray) -> tuple[slice, slice]:
    """Return rows and columns (slices) of the pixels that are marked, and of some around them."""
    rows, columns = (np.flatnonzero(met.any(axis)) for axis in (1, 0))
    return (slice(max(int(rows[0]) - AROUND, 0), min(int(rows[-1]) + 1 + AROUND, len(met))),
            slice(max(int(columns[0]) - AROUND, 0),
                  min(int(columns[-1]) + 1 + AROUND, met.shape[1])))
