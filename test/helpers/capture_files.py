"""One small posed capture of the demo flat, written as every format that `neo import` reads."""
from collections.abc import Sequence
from dataclasses import dataclass
from functools import lru_cache
import json
import math
from pathlib import Path
import struct

import cv2
from neo_ros.bags import write_demo_bag
from neo_ros.flat.demo_flat import build_demo_flat
from neo_ros.geometry import CameraPose, Intrinsics, ViewExpansion
from neo_ros.geometry.camera_pose import quaternion_from_rotation
import numpy as np

# The camera of 7-Scenes at a tenth of its size: all formats can say this one.
CAMERA = Intrinsics(64, 48, 58.5, 58.5, 32.0, 24.0)
START_NS, STEP_NS = 1_700_000_000_000_000_000, 100_000_000


@dataclass(frozen=True, eq=False)
class Photos:
    """Pictures (N, H, W, 3) uint8 with their poses."""

    images: np.ndarray
    poses: tuple[CameraPose, ...]


@lru_cache(maxsize=None)
def demo_photos(count: int = 5, camera: Intrinsics = CAMERA) -> Photos:
    """Render a short walk that also tilts the camera."""
    flat = build_demo_flat()
    poses = []
    for i in range(count):
        T = CameraPose.from_planar(2.6 + 0.1 * i, 1.2, 1.5, 0.3 * i).T_world_cam.copy()
        tilt = 0.05 * i
        T[:3, :3] = T[:3, :3] @ np.array([
            [1, 0, 0], [0, math.cos(tilt), -math.sin(tilt)],
            [0, math.sin(tilt), math.cos(tilt)]])
        poses.append(CameraPose(T))
    return Photos(np.stack([flat.render(camera, pose)[0] for pose in poses]), tuple(poses))


def write_image(path: Path, image: np.ndarray) -> Path:
    """Write RGB uint8, uint16 or grayscale."""
    path.parent.mkdir(parents=True, exist_ok=True)
    assert cv2.imwrite(str(path), image[..., ::-1] if image.ndim == 3 else image)
    return path


def write_turned_jpeg(path: Path, image: np.ndarray, orientation: int) -> Path:
    """Write RGB uint8 as it is, with a tag (EXIF) that tells viewers to turn it."""
    jpeg = cv2.imencode('.jpg', image[..., ::-1])[1].tobytes()
    segment = b'Exif\0\0' + struct.pack('<2sHIHHHIHHI', b'II', 42, 8, 1, 0x112, 3, 1, orientation,
                                        0, 0)
    path.parent.mkdir(parents=True, exist_ok=True)
    path.write_bytes(jpeg[:2] + b'\xff\xe1' + struct.pack('>H', len(segment) + 2) + segment
                     + jpeg[2:])
    return path


def write_matrix(path: Path, matrix: np.ndarray) -> None:
    path.parent.mkdir(parents=True, exist_ok=True)
    np.savetxt(path, matrix, fmt='%.17g')


def write_transforms_capture(folder: Path, photos: Photos, **camera: object) -> Path:
    keys: dict[str, object] = {
        'camera_model': 'OPENCV', 'w': CAMERA.width, 'h': CAMERA.height, 'fl_x': CAMERA.fx,
        'fl_y': CAMERA.fy, 'cx': CAMERA.cx, 'cy': CAMERA.cy, 'k1': 0.0, 'k2': 0.0, 'p1': 0.0,
        'p2': 0.0, 'applied_transform': np.eye(4)[:3].tolist()}
    frames = []
    for index, (image, pose) in enumerate(zip(photos.images, photos.poses)):
        write_image(folder / f'images/{index}.png', image)
        frames.append({'file_path': f'images/{index}.png',
                       'transform_matrix': pose.to_opengl().tolist()})
    (folder / 'transforms.json').write_text(json.dumps({**keys, **camera, 'frames': frames}))
    return folder


def colmap_rows(photos: Photos) -> list[tuple[list[float], str]]:
    """Return QW QX QY QZ TX TY TZ and the name of every image."""
    rows = []
    for index, pose in enumerate(photos.poses):
        T_cam_world = pose.inverse()
        x, y, z, w = quaternion_from_rotation(T_cam_world[:3, :3])
        rows.append(([w, x, y, z, *T_cam_world[:3, 3]], f'{index}.png'))
    return rows


def write_colmap_images(folder: Path, photos: Photos) -> None:
    for index, image in enumerate(photos.images):
        write_image(folder / f'images/{index}.png', image)


def write_colmap_text(folder: Path, photos: Photos, model: str = 'PINHOLE',
                      params: Sequence[float] = (58.5, 58.5, 32, 24)) -> Path:
    write_colmap_images(folder, photos)
    place = folder / 'sparse' / '0'
    place.mkdir(parents=True)
    (place / 'cameras.txt').write_text(
        f'# comment\n7 {model} 64 48 {" ".join(map(str, params))}\n')
    # The second line of every image lists its points; the last image has none.
    (place / 'images.txt').write_text('# comment\n' + ''.join(
        f'{index + 1} {" ".join(map(repr, map(float, numbers)))} 7 {name}\n'
        + ('1.5 2.5 -1 3.5 4.5 12\n' if index < 2 else '\n')
        for index, (numbers, name) in enumerate(colmap_rows(photos))))
    return folder


def write_colmap_binary(folder: Path, photos: Photos) -> Path:
    write_colmap_images(folder, photos)
    place = folder / 'sparse'
    place.mkdir()
    (place / 'cameras.bin').write_bytes(
        struct.pack('<QIiQQ4d', 1, 7, 1, 64, 48, 58.5, 58.5, 32, 24))
    data = struct.pack('<Q', len(photos.poses))
    for index, (numbers, name) in enumerate(colmap_rows(photos)):
        data += struct.pack('<I7dI', index + 1, *numbers, 7) + name.encode() + b'\0'
        data += struct.pack('<Qddqddq', 2, 1.5, 2.5, -1, 3.5, 4.5, 12)
    (place / 'images.bin').write_bytes(data)
    return folder


def write_scannet(folder: Path, photos: Photos) -> Path:
    for index, (image, pose) in enumerate(zip(photos.images, photos.poses)):
        write_image(folder / f'color/{index}.png', image)
        write_matrix(folder / f'pose/{index}.txt', pose.T_world_cam)
    matrix = np.eye(4)
    matrix[:3, :3] = CAMERA.matrix
    write_matrix(folder / 'intrinsic/intrinsic_color.txt', matrix)
    return folder


def write_seven_scenes(folder: Path, photos: Photos) -> Path:
    for index, (image, pose) in enumerate(zip(photos.images, photos.poses)):
        stem = folder / f'seq-{1 + index // 3:02d}/frame-{index:06d}'
        write_image(stem.with_name(stem.name + '.color.png'), image)
        write_matrix(stem.with_name(stem.name + '.pose.txt'), pose.T_world_cam)
    return folder


def write_trajectory(folder: Path, photos: Photos, axes: str = 'opencv') -> Path:
    for index, image in enumerate(photos.images):
        write_image(folder / f'rgb/frame{index}.png', image)
        write_image(folder / f'rgb/depth{index}.png', image[..., 0])
    matrices = [pose.T_world_cam if axes == 'opencv' else pose.to_opengl()
                for pose in photos.poses]
    (folder / 'traj.txt').write_text(''.join(
        ' '.join(map(repr, map(float, matrix.ravel()))) + '\n' for matrix in matrices))
    (folder / 'camera.json').write_text(json.dumps({
        'camera': {'w': 64, 'h': 48, 'fx': 58.5, 'fy': 58.5, 'cx': 32, 'cy': 24},
        'axes': axes}))
    return folder


def write_bag(folder: Path, photos: Photos) -> Path:
    """Write the photos as the inner window of wide frames with a black border."""
    expansion = ViewExpansion.to_size(CAMERA, 80, 56)
    wide = np.zeros((len(photos.images), 56, 80, 3), np.uint8)
    wide[(slice(None), *expansion.observed)] = photos.images
    write_demo_bag(folder, ((START_NS + i * STEP_NS, wide[i], pose)
                            for i, pose in enumerate(photos.poses)), expansion)
    return folder
