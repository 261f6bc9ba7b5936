"""Checksums of what a training is made of: written again, the same scene has the same ones."""
from collections.abc import Iterable, Sequence
import hashlib
from pathlib import Path

from neo_ros.geometry import ViewExpansion
from neo_ros.scenes.posed_images import PosedImages
from neo_ros.scenes.walkable import WalkableMap


def list_digest(images: PosedImages, window: ViewExpansion | None = None) -> str:
    """
    Return the sha256 of a list of images; their pixels are not looked at.

    It counts names, poses to a micrometre, path ids, the camera, the names of depth maps and
    masks, and the source window of wide truth.
    """
    camera = images.intrinsics
    lines = [f'{camera.width} {camera.height} ' + _numbers(
        [camera.fx, camera.fy, camera.cx, camera.cy])]
    if window is not None:
        lines.append(f'{window.left} {window.top} {window.source.width} {window.source.height}')
    lines += [f'{path.name} {path_id} {_numbers(pose.T_world_cam[:3].ravel())}'
              for path, pose, path_id in zip(images.image_paths, images.poses, images.path_ids)]
    lines += [f'depth {path.name}' for path in images.depth_paths if path is not None]
    lines += [f'mask {path.name}' for path in images.mask_paths if path is not None]
    return _sha256('\n'.join(lines).encode())


def files_digest(paths: Iterable[Path]) -> str:
    """Return the sha256 of what lies in files, one after the other."""
    files = hashlib.sha256()
    for path in paths:
        with open(path, 'rb') as file:
            files.update(hashlib.file_digest(file, 'sha256').digest())
    return files.hexdigest()


def floors_digest(floors: Sequence[WalkableMap]) -> str:
    """Return the sha256 of the floor maps of all storeys; of one it is that of the map."""
    digests = [floor_digest(floor) for floor in floors]
    return digests[0] if len(digests) == 1 else _sha256(' '.join(digests).encode())


def floor_digest(floor: WalkableMap) -> str:
    """Return the sha256 of a floor map."""
    rows, columns = floor.cells.shape
    numbers = _numbers([floor.resolution, *floor.origin, floor.camera_height, floor.clearance])
    return _sha256(f'{rows} {columns} {numbers}\n'.encode() + floor.cells.tobytes())


def _sha256(content: bytes) -> str:
    return hashlib.sha256(content).hexdigest()


def _numbers(values: object) -> str:
    # Adding zero makes -0 one with 0.
    return ' '.join(f'{round(float(value), 6) + 0.0:.6f}' for value in values)  # type: ignore
