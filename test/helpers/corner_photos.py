"""Photos around one place of the demo flat, close enough to be triangulated."""
from pathlib import Path

from neo_ros.evaluation.evaluate import TruthFrames
from neo_ros.flat.demo_flat import build_demo_flat
from neo_ros.geometry import CameraPose, Intrinsics, ViewExpansion
from neo_ros.scenes.posed_images import PosedImages
import numpy as np
from scene_files import write_picture

CAMERA = Intrinsics.from_hfov(96, 96, np.pi / 2)
EXPANSION = ViewExpansion.to_size(CAMERA, 192, 192)


def write_corner(folder: Path) -> tuple[PosedImages, TruthFrames]:
    """Write 15 photos, and one wide view from between them."""
    flat = build_demo_flat()
    places = flat.walkable().centres()
    x, y = places[np.argmin(((places - places.mean(0)) ** 2).sum(1))]
    poses = [CameraPose.from_planar(x + dx, y + dy, 1.5, yaw)
             for yaw in (-0.9, -0.45, 0.0, 0.45, 0.9)
             for dx, dy in ((0.0, 0.08), (0.08, -0.08), (-0.1, 0.0))]
    paths = [folder / f'train/{index:02d}.png' for index in range(len(poses))]
    for path, pose in zip(paths, poses):
        write_picture(path, flat.render(CAMERA, pose)[0])
    pose = CameraPose.from_planar(x + 0.03, y + 0.02, 1.5, 0.1)
    path = folder / 'test.png'
    write_picture(path, flat.render(EXPANSION.target, pose)[0])
    return (PosedImages(CAMERA, tuple(paths), tuple(poses), (0,) * len(poses)),
            TruthFrames(PosedImages(EXPANSION.target, (path,), (pose,), (0,)), EXPANSION))
