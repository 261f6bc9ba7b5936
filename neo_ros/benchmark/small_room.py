"""
A room whose every view is known exactly, and in which somebody moves a post.

A box with painted walls, cast by numpy: a training of it takes half a minute.
"""
from pathlib import Path

import cv2
from neo_ros.geometry import CameraPose, Intrinsics, ViewExpansion
from neo_ros.scenes.posed_images import PosedImages
from neo_ros.scenes.transforms_json import write_transforms
import numpy as np

Place = tuple[float, float]
LOW, HIGH = np.array([0.0, 0.0, 0.0]), np.array([5.0, 4.0, 2.6])
HEIGHT = 1.4  # of the camera, metres
SOURCE = Intrinsics.from_hfov(64, 64, np.pi / 2)
WIDE = ViewExpansion.to_size(SOURCE, 128, 128)
BEFORE, AFTER = (3.6, 2.8), (3.4, 1.2)  # where the post stands, metres
HALF = 0.22


def cast(origin: np.ndarray, rays: np.ndarray) -> tuple[np.ndarray, np.ndarray]:
    """Return colours, float (..., 3) in 0 ... 255, and distances (...) along unit rays."""
    with np.errstate(divide='ignore', invalid='ignore'):
        walls = np.where(rays > 0, (HIGH - origin) / rays, (LOW - origin) / rays)
    walls[~np.isfinite(walls)] = np.inf
    depth = walls.min(-1)
    x, y, z = np.moveaxis(origin + rays * depth[..., None], -1, 0)
    side = walls.argmin(-1)
    # Waves of several lengths: no two parts of the room look alike.
    colour = np.stack([
        130 + 60 * np.sin(2.3 * x + 1.1 * y + side) + 40 * np.sin(5.1 * y - 4 * z),
        120 + 70 * np.sin(1.7 * y - 2.9 * z + 2 * side) + 30 * np.sin(6 * x + y),
        110 + 60 * np.sin(3.1 * z + 1.3 * x - side) + 40 * np.sin(4.4 * x - 3 * y)], -1)
    return np.clip(colour, 0, 255), depth


def cast_with_post(origin: np.ndarray, rays: np.ndarray, post: Place
                   ) -> tuple[np.ndarray, np.ndarray, np.ndarray]:
    """Return colours uint8 (..., 3), distances (...) along unit rays, and where the post is."""
    colour, depth = cast(origin, rays)
    corners = np.array([[post[0] - HALF, post[1] - HALF, 0], [post[0] + HALF, post[1] + HALF, 2]])
    with np.errstate(divide='ignore', invalid='ignore'):
        ends = np.sort(((corners - origin).reshape(2, *[1] * (rays.ndim - 1), 3)) / rays, axis=0)
    near, far = ends[0].max(-1), ends[1].min(-1)
    there = (near > 0) & (near < far) & (near < depth)
    z = origin[2] + np.where(there, near, 0) * rays[..., 2]
    stripes = np.where(np.sin(9 * z) > 0, 250.0, 20.0)
    painted = np.stack([stripes, 40 + 0 * stripes, 270 - stripes], -1)
    return (np.rint(np.where(there[..., None], painted, colour)).astype(np.uint8),
            np.where(there, near, depth), there)


def look(pose: CameraPose, camera: Intrinsics, post: Place
         ) -> tuple[np.ndarray, np.ndarray, np.ndarray]:
    """Return image, uint8 (H, W, 3), z in metres (H, W), and where the post is: bool (H, W)."""
    rays = camera.pixel_rays() @ pose.T_world_cam[:3, :3].T
    length = np.linalg.norm(rays, axis=-1)
    image, depth, there = cast_with_post(pose.position, rays / length[..., None], post)
    return image, depth / length, there


def poses(count: int, seed: int) -> list[CameraPose]:
    """Return level poses all over the room, a metre from where the post is or will be."""
    random, found = np.random.default_rng(seed), list[CameraPose]()
    while len(found) < count:
        xy = random.uniform((0.6, 0.6), HIGH[:2] - 0.6)
        if min(np.linalg.norm(xy - place) for place in (BEFORE, AFTER)) > 0.9:
            found.append(CameraPose.from_planar(xy[0], xy[1], HEIGHT,
                                                random.uniform(-np.pi, np.pi)))
    return found


def drive(count: int = 60) -> list[CameraPose]:
    """Return poses on an arc around both places that see them."""
    angles = np.linspace(np.radians(100), np.radians(260), count)
    found = []
    for angle in angles:
        x, y = np.array([3.5, 2.0]) + np.array([2.3, 1.5]) * [np.cos(angle), np.sin(angle)]
        found.append(CameraPose.from_planar(x, y, HEIGHT, np.arctan2(2.0 - y, 3.5 - x)))
    return found


def write_room(folder: Path, count: int = 90) -> None:
    """Write the scene folder of the room as it was."""
    (folder / 'train').mkdir(parents=True)
    taken = poses(count, 1)
    paths = [folder / 'train' / f'{number:03d}.png' for number in range(count)]
    for path, pose in zip(paths, taken):
        cv2.imwrite(str(path), look(pose, SOURCE, BEFORE)[0][..., ::-1])
    write_transforms(folder / 'transforms_train.json', PosedImages(
        SOURCE, tuple(paths), tuple(taken), (0,) * count, z_up=True))


def write_drive(path: Path, post: Place) -> None:
    """Write a bag of the drive."""
    from neo_ros.bags import write_demo_bag  # Who only looks at the room starts in half the time.
    write_demo_bag(path, ((10 ** 9 + number * 10 ** 8, look(pose, WIDE.target, post)[0], pose)
                          for number, pose in enumerate(drive())), WIDE)
