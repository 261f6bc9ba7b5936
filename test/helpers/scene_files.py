"""Small captures on disk for tests: pictures, poses, transforms files."""
import math
from pathlib import Path

import cv2
from neo_ros.geometry import CameraPose, Intrinsics, ViewExpansion
from neo_ros.scenes.posed_images import PosedImages
from neo_ros.scenes.transforms_json import write_transforms
import numpy as np

CAMERA = Intrinsics(16, 12, 10.0, 11.0, 7.5, 6.5)


def picture(camera: Intrinsics, seed: int) -> np.ndarray:
    """Return uint8 RGB noise, coarse enough to survive being resized."""
    coarse = np.random.default_rng(seed).integers(0, 256, (3, 4, 3), np.uint8)
    return cv2.resize(coarse, (camera.width, camera.height))


def write_picture(path: Path, image: np.ndarray) -> None:
    path.parent.mkdir(parents=True, exist_ok=True)
    assert cv2.imwrite(str(path), image[..., ::-1])


def write_capture(folder: Path, count: int = 3, camera: Intrinsics = CAMERA,
                  name: str = 'transforms_train.json', images: str = 'images',
                  expansion: ViewExpansion | None = None, suffix: str = '.png') -> PosedImages:
    """Write `count` pictures and their transforms file; poses go round in a circle."""
    paths = tuple(folder / images / f'{index}{suffix}' for index in range(count))
    for index, path in enumerate(paths):
        write_picture(path, picture(camera, index))
    turn = 2 * math.pi / count
    poses = tuple(CameraPose.from_planar(math.cos(i * turn), math.sin(i * turn), 1.5, i * turn)
                  for i in range(count))
    capture = PosedImages(camera, paths, poses, tuple(i // 2 for i in range(count)))
    write_transforms(folder / name, capture, expansion)
    return capture
