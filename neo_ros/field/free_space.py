"""Where a robot could go without a floor map: what the photos looked through, and were at."""
from dataclasses import dataclass

import cv2
from neo_ros.field.radiance_field import RadianceField
from neo_ros.field.rendering import render_rays, world_rays
from neo_ros.machine.evenly import evenly
from neo_ros.scenes.pose_sampling import SamplingConfig
from neo_ros.scenes.posed_images import PosedImages
from neo_ros.scenes.walkable import WalkableMap
import numpy as np


@dataclass(frozen=True)
class FreeFloorRules:
    """How the floor is mapped; metres."""

    resolution: float = 0.05   # edge of a cell
    reach: float = 3.0         # around the photos that the map covers
    most_photos: int = 300     # that are looked through, evenly chosen
    rays_across: int = 48      # of each of them
    slab: float = 0.15         # above and below the camera's height that were looked through
    step: float = 0.15         # above the floor that a robot passes over
    thick: float = 3.0         # voxels above it that are its own: coarse ones blur it upwards


def find_free_floor(field: RadianceField, photos: PosedImages,
                    config: SamplingConfig, rules: FreeFloorRules = FreeFloorRules()
                    ) -> WalkableMap:
    """
    Map the floor over which a camera at one height would be in free space.

    A cell is free if the photos looked through it at that height and the field has no matter in
    it, from a step above the floor to a little above the camera; or if a photo was taken there.
    Within a robot's radius of a photo, matter counts at the camera's height only, and not at all
    where the field has some at the photo's own place. A cell must hang together with such a place.
    The floor is what lies below the photos.
    """
    positions = photos.T_world_cam[:, :3, 3]
    height = (float(np.median(positions[:, 2])) if config.camera_height is None
              else config.camera_height)
    low = positions[:, :2].min(0) - rules.reach
    size = np.ceil((positions[:, :2].max(0) + rules.reach - low) / rules.resolution).astype(int)
    stood = np.zeros(size[::-1], bool)
    index = ((positions[:, :2] - low) / rules.resolution).astype(int)
    stood[index[:, 1], index[:, 0]] = True
    above = max(rules.step, rules.thick * field.voxel)
    bottom = min(_floor_height(field, positions) + above, height - rules.slab)
    free = _looked_through(field, photos, low, size, height, rules) & ~_matter(
        field, low, size, bottom, height + rules.slab, rules.resolution)
    matter = _matter(field, low, size, height - rules.slab, height + rules.slab, rules.resolution)
    # A field that has matter where a photo was taken is wrong all around it.
    free |= (_around(stood, config.robot_radius, rules.resolution) & ~matter
             | _around(stood & matter, config.robot_radius, rules.resolution))
    _, labels = cv2.connectedComponents(free.astype(np.uint8), connectivity=4)
    reached = np.isin(labels, np.unique(labels[stood])) & free
    return WalkableMap(rules.resolution, (float(low[0]), float(low[1])), reached, height,
                       clearance=0.0)


def _around(cells: np.ndarray, radius: float, resolution: float) -> np.ndarray:
    """Mark what lies within a radius, metres, of cells: bool (rows, columns)."""
    if not cells.any():
        return cells
    distance = cv2.distanceTransform((~cells).astype(np.uint8), cv2.DIST_L2,
                                     cv2.DIST_MASK_PRECISE)
    return distance * resolution <= radius + resolution


def _looked_through(field: RadianceField, photos: PosedImages, low: np.ndarray,
                    size: np.ndarray, height: float, rules: FreeFloorRules) -> np.ndarray:
    """Tell which cells a ray of a photo passed at this height: bool (rows, columns)."""
    passed = np.zeros(size[::-1], bool)
    camera = photos.intrinsics.scaled(rules.rays_across / photos.intrinsics.width)
    for pose in (photos.poses[index] for index in evenly(len(photos), rules.most_photos)):
        origin, directions = world_rays(camera, pose)
        directions = directions.reshape(-1, 3)
        rendering = render_rays(field, origin, directions)
        # Up to a little before the surface; rays that met none say nothing of where air ends.
        reach = np.where(rendering.opacity > 0.5, rendering.depth - 2 * rules.resolution, 0)
        reach = np.minimum(reach, _on_map(directions, origin[2] - height, size, rules))
        steps = np.arange(0, max(reach.max(), rules.resolution), rules.resolution)
        rise = origin[2] + steps * directions[:, 2:] - height
        ray, step = np.nonzero((steps < reach[:, None]) & (np.abs(rise) < rules.slab))
        points = origin[:2] + steps[step, None] * directions[ray, :2]
        index = np.floor((points - low) / rules.resolution).astype(int)
        index = index[((index >= 0) & (index < size)).all(-1)]
        passed[index[:, 1], index[:, 0]] = True
    return passed


def _on_map(directions: np.ndarray, above: float, size: np.ndarray, rules: FreeFloorRules
            ) -> np.ndarray:
    """
    Return metres along unit rays (N, 3) from which on they are off the map or its height: (N,).

    They begin on the map, so far above its height. Rays into the sky reach kilometres.
    """
    across = np.linalg.norm(size + 1) * rules.resolution
    flat = np.maximum(np.linalg.norm(directions[:, :2], axis=1), 1e-9)
    steep = np.maximum(np.abs(directions[:, 2]), 1e-9)
    return np.minimum(across / flat,
                      (abs(above) + rules.slab) / steep + rules.resolution)


def _floor_height(field: RadianceField, positions: np.ndarray) -> float:
    """Return z of what lies below the photos, median; the photos' own z where nothing does."""
    down = np.broadcast_to(np.array([0, 0, -1], np.float32), positions.shape)
    rendering = render_rays(field, positions, down)
    met = rendering.opacity > 0.5
    return float(np.median((positions[:, 2] - rendering.depth)[met])) if met.any() else float(
        np.median(positions[:, 2]))


def _matter(field: RadianceField, low: np.ndarray, size: np.ndarray, bottom: float,
            top: float, resolution: float) -> np.ndarray:
    """Tell over which cells the field has matter between two heights: bool (rows, columns)."""
    i, j = np.meshgrid(np.arange(size[0]), np.arange(size[1]))
    found = np.zeros(size[::-1], bool)
    for z in np.arange(bottom, top + resolution, resolution):
        points = np.stack([low[0] + (i + 0.5) * resolution, low[1] + (j + 0.5) * resolution,
                           np.full(i.shape, z)], axis=-1)
        found |= field.is_matter(points)
    return found
