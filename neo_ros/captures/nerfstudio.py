"""
Captures as nerfstudio and instant-ngp describe them: one transforms.json.

Read are OPENCV and OPENCV_FISHEYE cameras with distortion, cameras per frame, focal lengths as
`camera_angle_x` and `camera_angle_y`, and image names without their ending or with backslashes.
`applied_transform` is not undone: it says how the world was turned, and the poses fit one another
as they are. Frames come in the natural order of their names: the file's is often that in which
they were registered. Depth (`depth_file_path`) is in millimetres, as nerfstudio takes it; masks
(`mask_path`) are black where pixels are left out.
"""
import json
import math
from pathlib import Path
from typing import Any

from neo_ros.captures.capture import (
    Capture, CapturedFrame, DepthSource, MaskSource, scene_name)
from neo_ros.captures.pose_files import pose_or_lost
from neo_ros.errors import SceneError
from neo_ros.geometry import Intrinsics
from neo_ros.geometry.lens import Lens
from neo_ros.machine.names import listed, natural_key
from neo_ros.pictures.photo import first_photo_size, PHOTO_SUFFIXES
from neo_ros.scenes.transforms_json import STRAIGHT_MODELS
import numpy as np

TRANSFORMS_FILE = 'transforms.json'
_FISHEYE = 'OPENCV_FISHEYE'
_MODELS = (*STRAIGHT_MODELS, _FISHEYE)


def read_transforms_capture(source: Path) -> Capture:
    """
    Read SOURCE/transforms.json, or the file itself.

    Listed images that are missing, and frames whose pose is not finite, are named in the notes
    and left out. Raises SceneError that names the frame for anything else that is wrong.
    """
    path = source / TRANSFORMS_FILE if source.is_dir() else source
    document = _read_document(path)
    entries = document['frames']
    frames, missing, lost = [], [], []
    no_depth: list[str] = []
    no_mask: list[str] = []
    files = [_image_file(path, index, entry) for index, entry in enumerate(entries)]
    present = [file for file in files if file is not None]
    if not present:
        raise SceneError(f'{path}: none of the {len(entries)} listed images exists; the first one '
                         f'is {path.parent / entries[0]["file_path"]}')
    size: tuple[int, int] | None = None
    names = [entry['file_path'] if file is None else scene_name(file, path.parent)
             for entry, file in zip(entries, files)]
    order = sorted(range(len(entries)), key=lambda index: natural_key(names[index]))
    for index in order:
        entry, file = entries[index], files[index]
        where = f'{path}: frames[{index}]'
        if file is None:
            missing.append(entry['file_path'])
            continue
        pose = pose_or_lost(_matrix(entry, where), where, opengl=True)
        if pose is None:
            lost.append(file.name)
            continue
        values = {**document, **entry}
        if not {'w', 'h'} <= values.keys():
            size = size or first_photo_size(present, path)
            values |= {'w': size[0], 'h': size[1]}
        frames.append(CapturedFrame(
            names[index], pose, read_lens_keys(values, where),
            _path_id(entry, where), file=file, depth=_depth(path, entry, where, no_depth),
            mask=_mask(path, entry, where, no_mask)))
    if not frames:
        raise SceneError(f'{path}: none of the {len(entries)} frames has a pose')
    notes = tuple(f'{len(found)} {words}: {listed(found)}' for found, words in (
        (missing, 'listed images are missing and left out'),
        (lost, 'frames have no finite pose and are left out'),
        (no_mask, 'listed masks are missing'),
        (no_depth, 'listed depth maps are missing')) if found)
    return Capture(tuple(frames), notes, z_up=document.get('z_up') is True,
                   arbitrary_scale=document.get('arbitrary_scale') is True)


def _read_document(path: Path) -> dict[str, Any]:
    """Read a transforms file that lists at least one frame."""
    try:
        document = json.loads(path.read_text('utf-8-sig'))
        entries = document['frames']
    except FileNotFoundError as error:
        raise SceneError(f'{path}: no such file') from error
    except (OSError, ValueError, KeyError, TypeError) as error:
        raise SceneError(f'{path}: expected a JSON object with "frames": {error!r}') from error
    if not isinstance(entries, list) or not entries:
        raise SceneError(f'{path}: frames: expected a list with at least one frame')
    return document


def _image_file(path: Path, index: int, entry: Any) -> Path | None:
    if not isinstance(entry, dict) or not isinstance(entry.get('file_path'), str):
        raise SceneError(f'{path}: frames[{index}]: expected an object with "file_path"')
    for name in (entry['file_path'], entry['file_path'].replace('\\', '/')):
        file = path.parent / name
        files = [file]
        if file.suffix.lower() not in PHOTO_SUFFIXES:
            files += [file.with_name(file.name + ending) for suffix in PHOTO_SUFFIXES
                      for ending in (suffix, suffix.upper())]
        for one in files:
            if one.is_file():
                return one
    return None


def _depth(path: Path, entry: dict[str, Any], where: str, missing: list[str]
           ) -> DepthSource | None:
    file = _listed_file(path, entry, 'depth_file_path', where, missing)
    return None if file is None else DepthSource(0.001, file)


def _mask(path: Path, entry: dict[str, Any], where: str, missing: list[str]) -> MaskSource | None:
    file = _listed_file(path, entry, 'mask_path', where, missing)
    return None if file is None else MaskSource(file)


def _listed_file(path: Path, entry: dict[str, Any], key: str, where: str, missing: list[str]
                 ) -> Path | None:
    name = entry.get(key)
    if name is None:
        return None
    if not isinstance(name, str):
        raise SceneError(f'{where}: {key}: expected the name of a file, got {name!r}')
    file = path.parent / name.replace('\\', '/')
    if not file.is_file():
        missing.append(name)
        return None
    return file


def _matrix(entry: dict[str, Any], where: str) -> np.ndarray:
    try:
        matrix = np.array(entry['transform_matrix'], np.float64)
    except KeyError as error:
        raise SceneError(f'{where}: expected the key {error}') from error
    except (TypeError, ValueError) as error:
        raise SceneError(f'{where}: transform_matrix: {error}') from error
    if matrix.shape not in ((3, 4), (4, 4)):
        raise SceneError(f'{where}: transform_matrix: expected 4x4, got {matrix.shape}')
    return matrix


def _path_id(entry: dict[str, Any], where: str) -> int:
    try:
        return int(entry.get('path_id', 0))
    except (TypeError, ValueError, OverflowError) as error:
        raise SceneError(f'{where}: path_id: {error}') from error


def _focal(values: dict[str, Any], axis: str, size: int) -> float | None:
    """Return fl_x or fl_y in pixels, from the angle where it is not there; None without both."""
    focal, angle = (_number(values, f'{key}_{axis}') for key in ('fl', 'camera_angle'))
    if focal is None and angle is not None:
        focal = size / 2 / math.tan(angle / 2)
    return focal


def _number(values: dict[str, Any], key: str) -> float | None:
    """Return a number, None where the key is missing or null."""
    try:
        return None if values.get(key) is None else float(values[key])
    except (TypeError, ValueError) as error:
        raise ValueError(f'{key}: expected a number, got {values[key]!r}') from error


def read_lens_keys(values: dict[str, Any], where: str) -> Lens:
    model = values.get('camera_model') or ''
    if model not in _MODELS:
        raise SceneError(f'{where}: camera_model: expected one of {", ".join(_MODELS[1:])}, '
                         f'got {model!r}')
    try:
        width, height = int(values['w']), int(values['h'])
        focal_x = _focal(values, 'x', width)
        if focal_x is None:
            raise SceneError(f'{where}: expected the key fl_x or camera_angle_x')
        focal_y, cx, cy = (_focal(values, 'y', height), _number(values, 'cx'),
                           _number(values, 'cy'))
        intrinsics = Intrinsics(width, height, focal_x, focal_x if focal_y is None else focal_y,
                                width / 2 if cx is None else cx, height / 2 if cy is None else cy)
        k1, k2, k3, k4, p1, p2 = (
            _number(values, key) or 0.0 for key in ('k1', 'k2', 'k3', 'k4', 'p1', 'p2'))
        if model == _FISHEYE or values.get('is_fisheye'):
            return Lens(intrinsics, (k1, k2, k3, k4), fisheye=True)
        if k4:
            # nerfstudio's r^8 term: OpenCV's fourth radial coefficient means something else.
            raise SceneError(f'{where}: k4: expected 0 for {model or "this camera"}, got {k4}')
        return Lens(intrinsics, (k1, k2, p1, p2, k3))
    except SceneError:
        raise
    except (TypeError, ValueError, ArithmeticError) as error:
        raise SceneError(f'{where}: camera: {error}') from error
