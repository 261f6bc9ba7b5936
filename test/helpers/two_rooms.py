"""Two rooms with a door between them, painted so that every spot looks like no other."""
from pathlib import Path

import cv2
from neo_ros.geometry import CameraPose, Intrinsics, ViewExpansion
from neo_ros.scenes.posed_images import PosedImages
from neo_ros.scenes.transforms_json import write_transforms
from neo_ros.scenes.walkable import WalkableMap, write_walkable
import numpy as np

HEIGHT = 1.3  # of the camera, metres
SOURCE = Intrinsics.from_hfov(80, 80, np.pi / 2)
WIDE = ViewExpansion.to_size(SOURCE, 160, 160)
FIRST = np.array([[0.0, 0.0, 0.0], [3.6, 3.2, 2.4]])
DOORWAY = np.array([[3.6, 1.1, 0.0], [3.7, 2.1, 2.1]])
SECOND = np.array([[3.7, 0.2, 0.0], [7.0, 3.4, 2.4]])
_PAINT = np.random.default_rng(5).uniform(0, 255, (2, 64, 64, 64, 3)).astype(np.float32)
SPOTS = (0.7, 0.25)  # metres


def cast(origin: np.ndarray, rays: np.ndarray, closed: bool
         ) -> tuple[np.ndarray, np.ndarray]:
    """Return colours uint8 (..., 3) and distances (...) along unit rays from within a room."""
    rays_d = rays.reshape(-1, 3)
    here = np.broadcast_to(origin, rays_d.shape).copy()
    rooms = [FIRST, DOORWAY, SECOND]
    room = np.full(len(rays_d), 0 if origin[0] < 3.6 else 1 if origin[0] < 3.7 else 2)
    way = np.zeros(len(rays_d))
    going = np.ones(len(rays_d), bool)
    for _ in range(3):
        low, high = (np.stack([one[end] for one in rooms])[room] for end in (0, 1))
        with np.errstate(divide='ignore', invalid='ignore'):
            ends = np.where(rays_d > 0, (high - here) / rays_d, (low - here) / rays_d)
        ends[~np.isfinite(ends)] = np.inf
        axis, step = ends.argmin(1), np.where(going, ends.min(1), 0)
        here += step[:, None] * rays_d
        way += step
        through = ((here[:, 1:] > DOORWAY[0, 1:]) & (here[:, 1:] < DOORWAY[1, 1:])).all(1)
        forth = rays_d[:, 0] > 0
        going &= (axis == 0) & through & ~((room == 0) & ~forth) & ~((room == 2) & forth)
        if closed:  # The leaf hangs on the side of the first room.
            going &= ~((room == 0) & forth) & ~((room == 1) & ~forth)
        room = np.where(going, room + np.where(forth, 1, -1), room)
    return (paint(here).reshape(rays.shape), way.reshape(rays.shape[:-1]))


def paint(points: np.ndarray) -> np.ndarray:
    """Return the colours, uint8 (N, 3), of points (N, 3): spots of two sizes."""
    colour = np.zeros(points.shape, np.float32)
    for spots, size in zip(_PAINT, SPOTS):
        place = points / size
        index = np.floor(place).astype(int)
        part = (place - index)[..., None]
        for corner in np.ndindex(2, 2, 2):
            weight = np.prod([part[:, k] if corner[k] else 1 - part[:, k] for k in range(3)], 0)
            colour += 0.5 * weight * spots[tuple(((index + corner) % 64).T)]
    return np.clip(128 + 1.8 * (colour - 128), 0, 255).astype(np.uint8)


def look(pose: CameraPose, camera: Intrinsics, closed: bool) -> np.ndarray:
    """Return the image, uint8 (H, W, 3), that a camera takes."""
    rays = camera.scaled(2).pixel_rays() @ pose.T_world_cam[:3, :3].T
    image, _ = cast(pose.position, rays / np.linalg.norm(rays, axis=-1, keepdims=True), closed)
    return cv2.resize(image, (camera.width, camera.height), interpolation=cv2.INTER_AREA)


def poses_in_first(count: int) -> list[CameraPose]:
    """Return level poses all over the first room."""
    random = np.random.default_rng(1)
    places = random.uniform((0.4, 0.4, -np.pi), (3.2, 2.8, np.pi), (count, 3))
    return [CameraPose.from_planar(x, y, HEIGHT, yaw) for x, y, yaw in places.tolist()]


def drive_through_door() -> list[CameraPose]:
    """Return poses of a drive: towards the door, through it, around the second room."""
    way = np.array([[1.0, 1.5, 0.1], [2.6, 1.6, 0.0], [3.65, 1.6, 0.0], [4.4, 1.5, -0.3],
                    [5.2, 1.0, 0.2], [6.0, 1.2, 1.0], [6.2, 2.0, 2.0], [5.6, 2.6, 3.0],
                    [4.8, 2.4, 3.9], [4.6, 1.8, 4.9], [5.2, 1.5, 6.0]])
    length = np.r_[0, np.cumsum(np.linalg.norm(np.diff(way[:, :2], axis=0), axis=1))]
    at = np.arange(0, length[-1], 0.12)
    x, y, yaw = (np.interp(at, length, one) for one in way.T)
    return [CameraPose.from_planar(*place) for place in zip(
        x.tolist(), y.tolist(), [HEIGHT] * len(at), yaw.tolist())]


def write_first_room(folder: Path, count: int = 120) -> None:
    """Write the scene folder of the first room, its door closed."""
    (folder / 'train').mkdir(parents=True)
    taken = poses_in_first(count)
    paths = [folder / 'train' / f'{number:03d}.png' for number in range(count)]
    for path, pose in zip(paths, taken):
        cv2.imwrite(str(path), look(pose, SOURCE, closed=True)[..., ::-1])
    write_transforms(folder / 'transforms_train.json', PosedImages(
        SOURCE, tuple(paths), tuple(taken), (0,) * count, z_up=True))
    cells = np.zeros((32, 36), bool)
    cells[3:29, 3:33] = True
    write_walkable(folder / 'walkable.json', WalkableMap(0.1, (0.0, 0.0), cells, HEIGHT, 0.25))


def write_door_drive(path: Path) -> None:
    """Write a bag of the drive."""
    from neo_ros.bags import write_demo_bag
    write_demo_bag(path, ((10 ** 9 + number * 10 ** 8, look(pose, WIDE.target, False), pose)
                          for number, pose in enumerate(drive_through_door())), WIDE)
