"""Depth beside the small posed capture of `capture_files`, as every format keeps it."""
from functools import lru_cache
import json
from pathlib import Path
import zipfile

from capture_files import (
    CAMERA, demo_photos, Photos, write_image, write_matrix, write_scannet, write_seven_scenes,
    write_trajectory, write_transforms_capture)
from neo_ros.flat.demo_flat import build_demo_flat
import numpy as np
from phone_files import stamp, write_polycam, write_r3d, write_record3d, write_tum


@lru_cache(maxsize=None)
def true_depth() -> np.ndarray:
    """Return the depth of `demo_photos`: float64 (N, 48, 64) whole millimetres, in metres."""
    flat = build_demo_flat()
    depths = np.stack([flat.render(CAMERA, pose)[1] for pose in demo_photos().poses])
    # Nothing is known at the top, and 16 bits hold no more than 10 m in Replica's steps.
    depths[:, :4], depths[depths > 9] = 0, 0
    return np.rint(depths * 1000.0) / 1000


def steps(depth: np.ndarray, of_a_metre: float = 1000) -> np.ndarray:
    return np.rint(depth * of_a_metre).astype(np.uint16)


def write_tum_depth(folder: Path, photos: Photos) -> Path:
    """Write depth that is stamped 5 ms after the images, and one map of another time."""
    write_tum(folder, photos)
    lines = []
    for index, depth in enumerate(true_depth()):
        late = f'{(stamp(index) + 5_000_000) / 1e9:.6f}'
        write_image(folder / f'depth/{late}.png', steps(depth, 5000))
        lines.append(f'{late} depth/{late}.png')
    (folder / 'depth.txt').write_text('\n'.join(['# depth', '1.0 depth/none.png', *lines]))
    return folder


def write_seven_scenes_depth(folder: Path, photos: Photos) -> Path:
    write_seven_scenes(folder, photos)
    for index, depth in enumerate(true_depth()):
        write_image(folder / f'seq-{1 + index // 3:02d}/frame-{index:06d}.depth.png',
                    np.where(depth > 0, steps(depth), 65535).astype(np.uint16))
    return folder


def write_scannet_depth(folder: Path, photos: Photos) -> Path:
    """Write depth of half the size, with the camera that it says it has."""
    write_scannet(folder, photos)
    for index, depth in enumerate(true_depth()):
        write_image(folder / f'depth/{index}.png', steps(depth)[::2, ::2])
    matrix = np.eye(4)
    matrix[:3, :3] = CAMERA.scaled(0.5).matrix
    write_matrix(folder / 'intrinsic/intrinsic_depth.txt', matrix)
    return folder


def write_polycam_depth(folder: Path, photos: Photos, kind: str = '') -> Path:
    """Write depth of half the size that is everywhere, not to be trusted where it is unknown."""
    write_polycam(folder, photos, kind)
    for index, depth in enumerate(true_depth()):
        small = steps(depth)[::2, ::2]
        write_image(folder / f'keyframes/depth/{100 + index}.png', np.maximum(small, 50))
        write_image(folder / f'keyframes/confidence/{100 + index}.png',
                    np.where(small > 0, 127, 0).astype(np.uint8))
    return folder


def write_record3d_depth(folder: Path, photos: Photos) -> Path:
    """Write depth of half the size as EXR, metres in its red channel, not a number = unknown."""
    import OpenEXR
    write_record3d(folder, photos)
    (folder / 'depth').mkdir()
    for index, depth in enumerate(true_depth()):
        metres = np.where(depth > 0, depth, np.nan).astype(np.float32)[::2, ::2].copy()
        OpenEXR.File({'compression': OpenEXR.ZIP_COMPRESSION, 'type': OpenEXR.scanlineimage},
                     {'R': metres}).write(str(folder / f'depth/{index}.exr'))
    return folder


def write_r3d_depth(folder: Path, photos: Photos) -> Path:
    """Write depth of half the size that is everywhere, of no confidence where it is unknown."""
    import lzfse
    source = write_r3d(folder, photos)
    with zipfile.ZipFile(source, 'a') as archive:
        for index, depth in enumerate(true_depth().astype(np.float32)[:, ::2, ::2]):
            trust = 2 * (depth > 0).astype(np.uint8)
            archive.writestr(f'rgbd/{index}.depth', lzfse.compress(
                np.maximum(depth, 0.05).tobytes()))
            archive.writestr(f'rgbd/{index}.conf', lzfse.compress(trust.tobytes()))
    return source


def write_unpacked_r3d_depth(folder: Path, photos: Photos) -> Path:
    with zipfile.ZipFile(write_r3d_depth(folder, photos)) as archive:
        archive.extractall(folder / 'walk')
    return folder / 'walk'


def write_transforms_depth(folder: Path, photos: Photos, **camera: object) -> Path:
    write_transforms_capture(folder, photos, **camera)
    document = json.loads((folder / 'transforms.json').read_text())
    for index, (frame, depth) in enumerate(zip(document['frames'], true_depth())):
        frame['depth_file_path'] = f'depths/{index}.png'
        write_image(folder / f'depths/{index}.png', steps(depth))
    (folder / 'transforms.json').write_text(json.dumps(document))
    return folder


def write_replica_depth(folder: Path, photos: Photos) -> Path:
    write_trajectory(folder, photos)
    (folder / 'rgb').rename(folder / 'results')
    for index, depth in enumerate(true_depth()):
        write_image(folder / f'results/depth{index}.png', steps(depth, 6553.5))
    return folder


def write_scaled_depth(folder: Path, photos: Photos) -> Path:
    """Write depth in a folder of its own, whose scale stands in the camera file."""
    write_trajectory(folder, photos)
    for index, depth in enumerate(true_depth()):
        (folder / f'rgb/depth{index}.png').unlink()
        write_image(folder / f'depth/frame{index}.png', steps(depth, 2000))
    file = folder / 'camera.json'
    camera = json.loads(file.read_text())
    camera['camera']['scale'] = 2000
    file.write_text(json.dumps(camera))
    return folder
