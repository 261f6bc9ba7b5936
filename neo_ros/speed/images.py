"""The images that a model is measured with: what its camera would see, as far as that is known."""
import math
from pathlib import Path

import cv2
from neo_ros.flat.demo_flat import build_demo_flat, DemoFlat, walking_paths
from neo_ros.geometry import CameraPose, Intrinsics, ViewExpansion
from neo_ros.runtime import read_model_card
import numpy as np

SEED = 0
PAPER_VIEW = ViewExpansion.to_size(Intrinsics.from_hfov(256, 256, np.pi / 2), 512, 512)
CAST = 128.0  # pixels a radian that are cast at most; finer textures lie between these
# The walks of the demo flat have 6 frames a second; so they have 30.
FINER = 5


def noise_image(view: Intrinsics) -> np.ndarray:
    """Return uint8 RGB (h, w, 3) of the camera's size, the same every time."""
    return np.random.default_rng(SEED).integers(0, 256, (view.height, view.width, 3), np.uint8)


def camera_images(model: Path, frames: int) -> np.ndarray:
    """
    Return uint8 RGB (N, h, w, 3) of the size that a model takes.

    For a model with a memory of the demo flat a walk through it at 30 Hz; else one noise image.
    """
    card = read_model_card(model)
    view = card.expansion.source
    if card.memory is None or card.scene_id != 'demo_flat':
        return noise_image(view)[None]
    return np.stack([cast_view(view, pose)[0] for pose in walk_at_30_hz(frames)])


def cast_view(camera: Intrinsics, pose: CameraPose, flat: DemoFlat | None = None
              ) -> tuple[np.ndarray, np.ndarray]:
    """
    Look at the demo flat: image uint8 RGB (h, w, 3), depth float32 (h, w), as `DemoFlat.render`.

    Of a large camera only so many rays are cast as its time is worth. flat: another one.
    """
    fewer = camera.scaled(min(1.0, CAST / camera.fx))
    image, depth = (flat or build_demo_flat()).render(fewer, pose)
    size = (camera.width, camera.height)
    return (cv2.resize(image, size, interpolation=cv2.INTER_LINEAR),
            cv2.resize(depth, size, interpolation=cv2.INTER_NEAREST))


def walk_at_30_hz(frames: int) -> list[CameraPose]:
    """Return `frames` poses of a robot that walks through the demo flat at 0.5 m/s."""
    poses = walking_paths(build_demo_flat(), 1, math.ceil(frames / FINER) + 1, SEED)[0]
    return [poses[index // FINER].interpolated(poses[index // FINER + 1], index % FINER / FINER)
            for index in range(frames)]
