"""Bake keyframes anew where the scene has changed; elsewhere they stay as they are."""
from collections.abc import Callable

import cv2
from neo_ros.baking.keyframes import bake_keyframe, BakingRules, Photos
from neo_ros.field.radiance_field import RadianceField
from neo_ros.machine.progress import no_progress, Progress
from neo_ros.memory.contradiction import contradicted, contradiction
from neo_ros.memory.keyframe import Keyframe
from neo_ros.memory.scene_memory import SceneMemory
import numpy as np

# Pixels of the mesh that are baked around those whose rays meet what may have changed, and that
# are taken around those that did change.
AROUND, TAKEN = 4, 2
# Takes a position (3,), unit rays (h, w, 3) and how far they reach, metres (h, w), 0 = on and on.
Meets = Callable[[np.ndarray, np.ndarray, np.ndarray], np.ndarray]


def bake_changes(field: RadianceField, memory: SceneMemory, photos: Photos, seen: np.ndarray,
                 gains: np.ndarray, meets: Meets, progress: Progress = no_progress,
                 rules: BakingRules = BakingRules()) -> dict[int, Keyframe]:
    """
    Return the keyframes that show another scene now, by their number.

    photos: those that see what may have changed; seen, gains: see `seen_by_photos`; meets: tells
    which rays meet that. Pixels that did not change are the old ones.
    """
    changed = {}
    for index, old in enumerate(memory.each()):
        rays = memory.band.rays(*old.depth.shape)
        met = meets(old.position, rays, (1 + rules.one_surface) * old.depth)
        new = _changed(field, memory, photos, seen, gains, old, met, rules) if met.any() else None
        if new is not None:
            changed[index] = new
        progress(index + 1, len(memory.positions))
    return changed


def _changed(field: RadianceField, memory: SceneMemory, photos: Photos, seen: np.ndarray,
             gains: np.ndarray, old: Keyframe, met: np.ndarray, rules: BakingRules
             ) -> Keyframe | None:
    part = _box(met)
    finer = len(old.texture) // len(old.depth)
    fine = tuple(slice(finer * one.start, finer * one.stop) for one in part)
    new = bake_keyframe(field, photos, seen, gains, old.position, memory.band,
                        (*old.depth.shape, finer), rules, part)
    before, after = old.depth[part], new.depth
    other = np.abs(after - before) > rules.one_surface * np.maximum(after, before)
    now, then = (cv2.resize(one, after.shape[::-1], interpolation=cv2.INTER_AREA)
                 for one in (new.texture, old.texture[fine]))
    other |= contradicted(contradiction(
        now.astype(np.float32), then.astype(np.float32), met[part]))
    other &= met[part]
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
    return (slice(max(int(rows[0]) - AROUND, 0), int(rows[-1]) + 1 + AROUND),
            slice(max(int(columns[0]) - AROUND, 0), int(columns[-1]) + 1 + AROUND))
