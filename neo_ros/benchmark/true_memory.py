"""A building's memory, made of its exact depth and colours: what a perfect field would give."""
from dataclasses import dataclass
import math

import cv2
from neo_ros.baking.glances import keyframe_glances, photo_glances
from neo_ros.baking.keyframes import BakingRules, keyframe_positions, keyframe_size, Photos
from neo_ros.baking.twin_search import find_twins
from neo_ros.field.panorama import view_band
from neo_ros.flat.building import Building
from neo_ros.flat.building_routes import mapping_poses
from neo_ros.geometry import Band, CameraPose, Intrinsics, ViewExpansion
from neo_ros.memory.keyframe import compress, Keyframe
from neo_ros.memory.landmarks import Landmarks, magnification
from neo_ros.memory.local_features import find_features
from neo_ros.memory.scene_memory import Glances, SceneMemory
from neo_ros.scenes.pose_sampling import PoseSampler, rotation_from_angles, SamplingConfig
import numpy as np

# The six faces of a cube around a camera: yaw and pitch, radians.
FACES = ((0.0, 0.0), (math.pi / 2, 0.0), (math.pi, 0.0), (-math.pi / 2, 0.0),
         (0.0, math.pi / 2), (0.0, -math.pi / 2))


@dataclass(frozen=True)
class TrueMemoryRules:
    """How a building is remembered; metres."""

    distance: float = 0.7        # from any place to a keyframe: coarser than a scene's, for time
    landmark_grid: float = 0.04  # features of photos within one cube are one landmark


def true_memory(building: Building, expansion: ViewExpansion,
                rules: TrueMemoryRules = TrueMemoryRules()) -> SceneMemory:
    """Remember all floors of a building, with glances and landmarks."""
    plan = building.plan
    poses = [pose for floor in range(plan.floors) for pose in mapping_poses(building, floor)]
    yaws = np.arange(24) * math.pi / 12
    headings = [rotation_from_angles(yaw, 0.0, 0.0) for yaw in yaws]
    band = view_band(expansion.target, np.stack(headings), (-math.pi, 2 * math.pi))
    no_photos = Photos(np.zeros((0, 1, 1, 3), np.uint8), expansion.source, np.zeros((0, 4, 4)))
    samplers = [PoseSampler.for_walkable(building.walkable(floor), SamplingConfig(interval=0.1))
                for floor in range(plan.floors)]
    positions = np.concatenate([keyframe_positions(sampler, no_photos, rules.distance)
                                for sampler in samplers])
    images, landmarks = _look(building, poses, expansion.source, rules.landmark_grid)
    textures, depths, glances = [], [], [photo_glances(
        images, expansion.source, np.stack([pose.T_world_cam for pose in poses]),
        expansion.source)]
    for position in positions:
        keyframe = _keyframe(building, position, band, expansion.target.fx)
        texture, depth = compress(keyframe)
        textures.append(texture)
        depths.append(depth)
        glances.append(keyframe_glances([keyframe], band, expansion.source, headings))
    memory = SceneMemory(
        positions, band, textures, depths,
        Glances(np.concatenate([part.pictures for part in glances]),
                np.concatenate([part.T_world_cam for part in glances])), landmarks)
    memory.twins = find_twins(memory, expansion)
    return memory


def _keyframe(building: Building, position: np.ndarray, band: Band, focal: float) -> Keyframe:
    height, width, finer = keyframe_size(band, focal, BakingRules())
    density = width * finer / band.width
    size = int(2 * density) + 2
    face = Intrinsics(size, size, density, density, size / 2, size / 2)
    rays = band.rays(height * finer, width * finer)
    texture = np.zeros(rays.shape, np.uint8)
    depth = np.zeros((height, width), np.float32)
    mesh = band.rays(height, width)
    for yaw, pitch in FACES:
        T = np.eye(4)
        T[:3, :3], T[:3, 3] = rotation_from_angles(yaw, pitch, 0.0), position
        image, z = building.render(face, CameraPose(T), samples=1)
        inverse = (1 / z).astype(np.float32)  # Linear across a plane.
        for target, directions in ((texture, rays), (depth, mesh)):
            own = directions @ T[:3, :3].astype(np.float32)
            seen = own[..., 2] >= np.abs(own[..., :2]).max(-1) - 1e-6
            own = own[seen] / own[seen][:, 2:]
            u, v = (density * own[:, axis] + size / 2 - 0.5 for axis in (0, 1))
            if target is texture:
                texture[seen] = _sampled(image, u, v, cv2.INTER_LINEAR)
                continue
            nearest = _sampled(inverse, u, v, cv2.INTER_NEAREST)
            smooth = _sampled(inverse, u, v, cv2.INTER_LINEAR)
            one_surface = np.abs(smooth - nearest) < 0.05 * nearest
            depth[seen] = np.linalg.norm(own, axis=1) / np.where(one_surface, smooth, nearest)
    return Keyframe(position, depth, texture)


def _sampled(image: np.ndarray, u: np.ndarray, v: np.ndarray, how: int) -> np.ndarray:
    """Look images up at M points; remap takes pictures, not lists."""
    padded = -len(u) % 1024
    across, down = (np.pad(one.astype(np.float32), (0, padded)).reshape(-1, 1024)
                    for one in (u, v))
    found = cv2.remap(image, across, down, how, borderMode=cv2.BORDER_REPLICATE)
    return found.reshape(-1, *image.shape[2:])[:len(u)]


def _look(building: Building, poses: list[CameraPose], camera: Intrinsics, grid: float
          ) -> tuple[list[np.ndarray], Landmarks | None]:
    """Take photos, and put their features where the exact depth says that they are."""
    images, points, descriptors = [], [], []
    for pose in poses:
        image, depth = building.render(camera, pose)
        images.append(image)
        features = find_features(image, magnification(camera))
        pixels = np.clip(features.points.astype(int), 0, (camera.width - 1, camera.height - 1))
        z = depth[pixels[:, 1], pixels[:, 0]]
        own = np.stack([(features.points[:, 0] - camera.cx) / camera.fx,
                        (features.points[:, 1] - camera.cy) / camera.fy, np.ones(len(z))], 1)
        points.append(pose.position + (own * z[:, None]) @ pose.T_world_cam[:3, :3].T)
        descriptors.append(features.descriptors)
    places = np.concatenate(points)
    _, point_of, counts = np.unique(np.floor(places / grid).astype(np.int64), axis=0,
                                    return_inverse=True, return_counts=True)
    point_of = point_of.reshape(-1)
    means = np.stack([np.bincount(point_of, places[:, axis]) for axis in range(3)], 1)
    return images, Landmarks.from_observations(means / counts[:, None], point_of,
                                               np.concatenate(descriptors))
