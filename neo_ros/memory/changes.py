"""What has changed since the memory was made, put into its keyframes as they are decoded."""
from collections.abc import Sequence
from functools import lru_cache
from itertools import groupby

import cv2
from neo_ros.geometry import Band
from neo_ros.memory.change_kernels import (
    BLOCK, bound_blocks, carve, draw_patch, SAME, Seen, Sphere, take_depths)
from neo_ros.memory.kernels import Pinhole
from neo_ros.memory.keyframe import code_of, depth_of
from neo_ros.memory.patch import Patch
import numpy as np

# Of a patch every so many-th pixel is looked at, to tell whether others have replaced it; it is if
# they have so large a share of these.
SAMPLED, REPLACED = 7, 0.95


class Changes:
    """
    Patches in the order in which they were seen; what is newer replaces what is older.

    Never changed, so that several threads can decode: `with_more` makes others.
    """

    def __init__(self, patches: Sequence[Patch]) -> None:
        self.patches = tuple(patches)

    def with_more(self, patches: Sequence[Patch]) -> 'Changes':
        """Return these and later ones."""
        return Changes((*self.patches, *patches))

    def put_into(self, position: np.ndarray, band: Band, reduced: int, texture: np.ndarray,
                 coded: np.ndarray) -> tuple[np.ndarray, np.ndarray]:
        """
        Return texture, made so many times smaller, and depth of a keyframe, changed.

        position (3,) world metres; texture uint8 RGB (n h, n w, 3), which is written to; coded
        uint16 (h, w), as `keyframe.code_of` makes it.
        """
        if texture.shape[0] % coded.shape[0] or texture.shape[1] % coded.shape[1]:
            return texture, coded  # Whoever decodes it says so.
        depth = depth_of(coded)
        rays = _rays(band, *coded.shape)
        finer = len(texture) // len(coded)
        sphere = Sphere(texture, np.zeros(texture.shape[:2], np.float32),
                        np.zeros(texture.shape[:2], np.float32), np.float32(band.top),
                        np.float32(band.low), np.float32(band.top - band.bottom),
                        np.float32(band.width), band.wraps)
        _spread(depth, finer, sphere.surface)
        blocks = np.empty((*(-(-size // BLOCK) for size in depth.shape), 4), np.float32)
        for _, batch in groupby(self.patches, lambda patch: patch.batch):
            seen = [_seen_from(patch, position) for patch in batch]
            bound_blocks(rays, depth, blocks)
            if sum(carve(rays, depth, blocks, *one) for one in seen):
                sphere.surface[np.repeat(np.repeat(depth == 0, finer, 0), finer, 1)] = 0
            # Only what was seen in one go is compared: newer is better than sharper.
            sphere.quality[:] = 0
            for one in seen:
                draw_patch(*one, sphere)
            take_depths(sphere, depth)
        if reduced > 1:
            size = (texture.shape[1] // reduced, texture.shape[0] // reduced)
            texture = cv2.resize(texture, size, interpolation=cv2.INTER_AREA)
        return texture, code_of(depth)


def without_replaced(patches: Sequence[Patch]) -> list[Patch]:
    """
    Leave out patches of which later visits have seen nearly all: they show what is there now.

    What is left keeps its order.
    """
    kept: list[Patch] = []
    for index, patch in enumerate(patches):
        depth = patch.pictures[1]
        rows, columns = np.nonzero(depth > 0)
        rows, columns = rows[::SAMPLED], columns[::SAMPLED]
        camera = patch.camera
        local = np.stack([(columns + 0.5 - camera.cx) / camera.fx,
                          (rows + 0.5 - camera.cy) / camera.fy, np.ones(len(rows))], -1)
        local *= depth[rows, columns][:, None]
        points = local @ patch.pose.T_world_cam[:3, :3].T + patch.pose.position
        open_points = np.ones(len(points), bool)
        for later in patches[index + 1:]:
            if later.batch != patch.batch and open_points.any():
                open_points[open_points] = ~_reaches(later, points[open_points])
        if open_points.mean() > 1 - REPLACED:
            kept.append(patch)
    return kept


def _reaches(patch: Patch, points: np.ndarray) -> np.ndarray:
    """Tell which world points (N, 3) a patch sees, or sees through."""
    local = (points - patch.pose.position) @ patch.pose.T_world_cam[:3, :3]
    ahead = local[:, 2] > 0
    pixels = np.full((len(points), 2), -1.0)
    pixels[ahead] = patch.camera.project(local[ahead])
    inside = ahead & (pixels >= 0).all(1) & (pixels < (patch.camera.width,
                                                       patch.camera.height)).all(1)
    found = np.zeros(len(points), bool)
    columns, rows = pixels[inside].astype(int).T
    there = patch.pictures[1][rows, columns]
    found[inside] = (there > 0) & (local[inside, 2] < there * (1 + SAME))
    return found


def _spread(depth: np.ndarray, finer: int, surface: np.ndarray) -> None:
    surface[:] = np.repeat(np.repeat(depth, finer, 0), finer, 1)


def _seen_from(patch: Patch, position: np.ndarray) -> tuple[Seen, Pinhole]:
    image, depth = patch.pictures
    T, camera = patch.pose.inverse(), patch.camera
    return (Seen(image, depth, np.ascontiguousarray(T[:3, :3], np.float32),
                 (T[:3, :3] @ position + T[:3, 3]).astype(np.float32)),
            Pinhole(*map(np.float32, (camera.fx, camera.fy, camera.cx, camera.cy))))


@lru_cache(maxsize=4)
def _rays(band: Band, rows: int, columns: int) -> np.ndarray:
    return band.rays(rows, columns)
