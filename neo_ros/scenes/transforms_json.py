"""
Read and write the scene format: nerfstudio / instant-ngp `transforms_*.json`.

Camera-to-world 4x4 matrices with OpenGL camera axes, metres, pixel centres at +0.5. One pinhole
camera for all: files of other cameras are for `transforms_capture`, which `neo import` uses.
"""
import json
import logging
from pathlib import Path
from typing import Any

from neo_ros.errors import SceneError
from neo_ros.geometry import CameraPose, Intrinsics, ViewExpansion
from neo_ros.machine.files import what_to_do, whole_file
from neo_ros.scenes.posed_images import PosedImages

logger = logging.getLogger(__name__)
# Values of `camera_model` that keep straight lines straight where all distortion is zero.
STRAIGHT_MODELS = ('', 'PINHOLE', 'SIMPLE_PINHOLE', 'OPENCV', 'SIMPLE_RADIAL', 'RADIAL')
_BENDING_KEYS = ('k1', 'k2', 'k3', 'k4', 'p1', 'p2', 'is_fisheye')
_CAMERA_KEYS = ('camera_model', 'w', 'h', 'fl_x', 'fl_y', 'cx', 'cy', 'camera_angle_x',
                *_BENDING_KEYS)


def read_transforms(path: Path) -> PosedImages:
    """
    Read one transforms file; image paths are relative to it.

    Listed files that are missing are named in a warning and skipped. Raises SceneError for
    files that are not such JSON, distorted cameras, several cameras, and poses that are no rigid
    transforms.
    """
    document = _read_json(path)
    intrinsics = _read_intrinsics(document, path)
    image_paths, poses, path_ids, missing = [], [], [], []
    depth_paths: list[Path | None] = []
    mask_paths: list[Path | None] = []
    frames = document.get('frames')
    if not isinstance(frames, list) or not frames:
        raise SceneError(f'{path}: frames: expected a list with at least one frame')
    for index, frame in enumerate(frames):
        try:
            image_path = path.parent / frame['file_path']
            pose = CameraPose.from_opengl(frame['transform_matrix'])
            path_id = int(frame.get('path_id', 0))
            depth = frame.get('depth_file_path')
            depth_path = None if depth is None else path.parent / depth
            mask = frame.get('mask_path')
            mask_path = None if mask is None else path.parent / mask
            _check_camera_of_frame(frame, document, path)
        except KeyError as error:
            raise SceneError(f'{path}: frames[{index}]: expected the key {error}') from error
        except (TypeError, ValueError, OverflowError) as error:
            raise SceneError(f'{path}: frames[{index}]: {error}') from error
        if not image_path.is_file():
            missing.append(frame['file_path'])
            continue
        for key, beside in (('depth_file_path', depth_path), ('mask_path', mask_path)):
            if beside is not None and not beside.is_file():
                raise SceneError(f'{path}: frames[{index}]: {key}: there is no file '
                                 f'{frame[key]}; copy it there, or leave the key out')
        image_paths.append(image_path)
        poses.append(pose)
        path_ids.append(path_id)
        depth_paths.append(depth_path)
        mask_paths.append(mask_path)
    if missing:
        logger.warning('%s: %d listed images are missing and skipped: %s',
                       path, len(missing), ', '.join(missing[:5]))
    if not image_paths:
        raise SceneError(f'{path}: none of the {len(frames)} listed images exists')
    return PosedImages(intrinsics, tuple(image_paths), tuple(poses), tuple(path_ids),
                       document.get('z_up') is True, document.get('arbitrary_scale') is True,
                       tuple(depth_paths) if any(depth_paths) else (),
                       tuple(mask_paths) if any(mask_paths) else ())


def read_input_crop(path: Path) -> ViewExpansion | None:
    """Return the expansion that a file of wide truth states as `input_crop`, if it does."""
    document = _read_json(path)
    crop = document.get('input_crop')
    if crop is None:
        return None
    try:
        return ViewExpansion.inside(_read_intrinsics(document, path), int(crop['x']),
                                    int(crop['y']), int(crop['w']), int(crop['h']))
    except (KeyError, TypeError, ValueError, OverflowError) as error:
        raise SceneError(
            f'{path}: input_crop: expected x, y, w, h in pixels: {error!r}') from error


def write_transforms(path: Path, images: PosedImages,
                     expansion: ViewExpansion | None = None) -> None:
    """
    Write a transforms file for images that lie in or below its folder.

    `expansion` marks wide truth: its source window is written as `input_crop`.
    """
    camera = images.intrinsics
    unit = 'units of arbitrary length' if images.arbitrary_scale else 'metres'
    document: dict[str, Any] = {
        'camera_model': 'PINHOLE', 'w': camera.width, 'h': camera.height,
        'fl_x': camera.fx, 'fl_y': camera.fy, 'cx': camera.cx, 'cy': camera.cy,
        'note': f'camera-to-world, OpenGL axes (+X right, +Y up, +Z back), {unit}'}
    if images.z_up:
        document['z_up'] = True
    if images.arbitrary_scale:
        document['arbitrary_scale'] = True
    if expansion is not None:
        document['input_crop'] = {
            'x': expansion.left, 'y': expansion.top,
            'w': expansion.source.width, 'h': expansion.source.height}
    document['frames'] = [
        {'file_path': image_path.relative_to(path.parent).as_posix(),
         'transform_matrix': pose.to_opengl().tolist(), 'path_id': path_id}
        for image_path, pose, path_id in zip(images.image_paths, images.poses, images.path_ids)]
    for key, beside in (('depth_file_path', images.depth_paths),
                        ('mask_path', images.mask_paths)):
        for frame, file in zip(document['frames'], beside):
            if file is not None:
                frame[key] = file.relative_to(path.parent).as_posix()
    try:
        with whole_file(path) as partial:
            partial.write_text(json.dumps(document))
    except OSError as error:
        raise SceneError(f'{path}: cannot write: {error.strerror}; '
                         + what_to_do(error, 'choose another scene folder')) from error


def _read_json(path: Path) -> dict[str, Any]:
    try:
        document = json.loads(path.read_text())
    except FileNotFoundError as error:
        raise SceneError(f'{path}: no such file') from error
    except (OSError, ValueError) as error:
        raise SceneError(f'{path}: expected a JSON file: {error}') from error
    if not isinstance(document, dict):
        raise SceneError(f'{path}: expected a JSON object, got {type(document).__name__}')
    return document


def _check_camera_of_frame(frame: dict[str, Any], document: dict[str, Any], path: Path) -> None:
    own = {key: frame[key] for key in _CAMERA_KEYS
           if key in frame and (frame[key] or 0) != (document.get(key) or 0)}
    if own:
        raise SceneError(
            f'expected the one camera of the file, got {own} of its own; {_advice(path)}')


def _read_intrinsics(document: dict[str, Any], path: Path) -> Intrinsics:
    bending = {key: document[key] for key in _BENDING_KEYS if document.get(key)}
    if (document.get('camera_model') or '') not in STRAIGHT_MODELS:
        bending['camera_model'] = document['camera_model']
    if bending:
        raise SceneError(f'{path}: expected an undistorted pinhole camera, got {bending}; '
                         f'{_advice(path)}')
    try:
        width, height = int(document['w']), int(document['h'])
        return Intrinsics(width, height, document['fl_x'],
                          document.get('fl_y', document['fl_x']),
                          document.get('cx', width / 2), document.get('cy', height / 2))
    except KeyError as error:
        raise SceneError(
            f'{path}: expected the key {error} (pixels); {_advice(path)}') from error
    except (TypeError, ValueError, OverflowError) as error:
        raise SceneError(f'{path}: intrinsics: {error}') from error


def _advice(path: Path) -> str:
    # The file itself: a folder with transforms_train.json would be taken for a scene again.
    return f'make a scene of it with: neo import {path} SCENE'
