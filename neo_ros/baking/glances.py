"""Glances: small pictures of the scene, by which a lost camera is searched for."""
from collections.abc import Iterable
import math

import cv2
from neo_ros.geometry import Band, Intrinsics
from neo_ros.memory.keyframe import Keyframe
from neo_ros.memory.scene_memory import Glances
from neo_ros.scenes.pose_sampling import PoseSampler, rotation_from_angles
import numpy as np

# Pixels across a glance; the search compares them.
GLANCE_WIDTH = 16
# Between two glances of a keyframe.
GLANCE_YAW_DEG = 15.0


def keyframe_glances(keyframes: list[Keyframe], band: Band, source: Intrinsics,
                     rotations: list[np.ndarray]) -> Glances:
    """Take small pictures at every keyframe with these rotations (3, 3), camera to world."""
    small = source.scaled(GLANCE_WIDTH / source.width)
    fine = small.scaled(4)
    pictures, poses = [], []
    for keyframe in keyframes:
        for rotation in rotations:
            T = np.eye(4)
            T[:3, :3], T[:3, 3] = rotation, keyframe.position
            where = band.pixels(fine.pixel_rays() @ rotation.T, *keyframe.texture.shape[:2])
            cut = cv2.remap(keyframe.texture, where[..., 0], where[..., 1], cv2.INTER_LINEAR,
                            borderMode=cv2.BORDER_WRAP)
            pictures.append(glance(cut, small))
            poses.append(T)
    return Glances(np.array(pictures, np.uint8).reshape(-1, small.height, small.width),
                   np.array(poses, float).reshape(-1, 4, 4))


def photo_glances(images: Iterable[np.ndarray], camera: Intrinsics, T_world_cam: np.ndarray,
                  source: Intrinsics) -> Glances:
    """Shrink N photos, uint8 (H, W, 3) of `camera`, each cut to the source view."""
    small = source.scaled(GLANCE_WIDTH / source.width)
    window = camera.window(source)
    return Glances(np.stack([glance(image[window], small) for image in images]), T_world_cam)


def glance_rotations(sampler: PoseSampler) -> list[np.ndarray]:
    """Return rotations (3, 3) all over the sampler's headings, with its mean tilt."""
    low, width = sampler.yaw_range
    (pitch, roll), _ = sampler.pitch_roll
    count = max(math.ceil(width / math.radians(GLANCE_YAW_DEG)), 1)
    return [rotation_from_angles(yaw, pitch, roll)
            for yaw in low + width * (np.arange(count) + 0.5) / count]


def glance(image: np.ndarray, small: Intrinsics) -> np.ndarray:
    """Shrink RGB uint8 to a grey uint8 picture of the size of `small`."""
    grey = cv2.cvtColor(image, cv2.COLOR_RGB2GRAY)
    return cv2.resize(grey, (small.width, small.height), interpolation=cv2.INTER_AREA)
