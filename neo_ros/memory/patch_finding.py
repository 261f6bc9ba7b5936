"""What images show of changes that others confirm: surfaces that came, or left."""
from collections.abc import Sequence
from dataclasses import dataclass

import cv2
from neo_ros.geometry import Intrinsics
from neo_ros.memory.change_kernels import SAME
from neo_ros.memory.contradiction import contradicted, ContradictionThresholds
from neo_ros.memory.patch import EVERY, PARTS, Patch
from neo_ros.memory.scene_light import log_ratio, steadiness, SURE
from neo_ros.memory.states import parts_of, StateThresholds
from neo_ros.memory.stereo import confirm, find_depth, Shot, StereoThresholds
import numpy as np


@dataclass(frozen=True)
class PatchThresholds:
    """What of an image becomes a patch."""

    # Pixels that a part of a patch has at least.
    least_pixels: int = 12
    # Samples that tell what was there before, which a part has at least.
    least_samples: int = 2
    # Another light changes the logarithms of all channels alike, to so much.
    hue: float = 0.35
    # Others confirm it: less is asked of one image.
    contradiction: ContradictionThresholds = ContradictionThresholds(seed=20.0)
    stereo: StereoThresholds = StereoThresholds()
    states: StateThresholds = StateThresholds()


def find_patches(shots: Sequence[Shot], new: int, camera: Intrinsics, rays: np.ndarray,
                 batch: int, known: dict[Shot, np.ndarray],
                 thresholds: PatchThresholds = PatchThresholds()) -> list[Patch]:
    """
    Return what the last `new` images show of changes that others confirm, the oldest first.

    known: depths of earlier images; what is found now is added, what is not asked for taken out.
    """
    limits = thresholds.stereo
    for shot in set(known).difference(shots):
        del known[shot]
    for index, shot in enumerate(shots):
        if shot not in known:
            depth, error = find_depth(shots, index, camera, rays, limits)
            known[shot] = np.where(error < limits.most_error, depth, 0)
    stacked = np.stack([known[shot] for shot in shots])
    patches = []
    for index in range(len(shots) - new, len(shots)):
        depth = confirm(shots, index, stacked, camera, rays, limits)
        depth[_as_before(shots[index], known[shots[index]], thresholds)] = 0
        if (depth > 0).sum() < thresholds.least_pixels:
            continue
        rows, columns = (np.flatnonzero(depth.any(axis)) for axis in (1, 0))
        top, left = int(rows[0]), int(columns[0])
        height, width = int(rows[-1]) + 1 - top, int(columns[-1]) + 1 - left
        part = (slice(top, top + height), slice(left, left + width))
        shot = shots[index]
        there, before = depth[part], shot.depth[part]
        parts = _parts(shot, depth, rays, thresholds)[part]
        # What could never turn back would pierce whatever is put there later.
        told = ((there > 0) & (before > 0))[::EVERY, ::EVERY]
        samples = np.bincount(parts[::EVERY, ::EVERY][told], minlength=PARTS)
        samples[PARTS - 1] = 0
        there = np.where(samples[parts] < thresholds.least_samples, 0, there)
        if not there.any():
            continue
        image, shown = (np.clip(one[part] + 0.5, 0, 255).astype(np.uint8)
                        for one in (shot.image, shot.shown))
        patches.append(Patch.of(
            shot.pose, camera.cropped(left, top, width, height), image, there,
            shot.stamp_ns, batch, (shown, before), parts))
    return patches


def _parts(shot: Shot, depth: np.ndarray, rays: np.ndarray, thresholds: PatchThresholds
           ) -> np.ndarray:
    """Tell what belongs together of what came or left, seen at depth (h, w): uint8 (h, w)."""
    nearer = np.where(shot.depth > 0, np.minimum(depth, shot.depth), depth)
    where, T = depth > 0, shot.pose.T_world_cam
    points = (rays[where] * nearer[where][:, None]) @ T[:3, :3].T + T[:3, 3]
    parts = np.zeros(depth.shape, np.uint8)
    parts[where] = parts_of(points, thresholds.least_pixels, thresholds.states)
    return parts


def _as_before(shot: Shot, depth: np.ndarray, thresholds: PatchThresholds) -> np.ndarray:
    """
    Tell where a shot shows a surface of before, at the same depth (h, w): bool (h, w).

    In another light, as the sun on a floor: as much brighter as its neighbours. Or as it was: a
    shelf that the memory shows blurred contradicts it a little, and who walks by contradicts it
    more. It is painted anew where it contradicts that much itself.
    """
    known = (shot.depth > 0) & (depth > 0)
    same = known & (np.abs(depth - shot.depth) < SAME * shot.depth)
    limits = thresholds.contradiction
    square = (limits.around, limits.around)
    ratio = log_ratio(shot.image, shot.shown)
    lit = (steadiness(ratio, shot.depth > 0) > SURE) & (
        np.ptp(cv2.blur(ratio, square), axis=-1) < thresholds.hue)
    # Scores are means: those beside something else are of it, too.
    other = cv2.dilate((shot.contradicted & ~same).view(np.uint8), np.ones(square, np.uint8)) > 0
    return same & (lit | ~contradicted(np.where(same & ~other, shot.score, 0), limits))
