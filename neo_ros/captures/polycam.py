"""
Polycam's raw data: keyframes/images/N.jpg with keyframes/cameras/N.json.

corrected_images/ with corrected_cameras/, which Polycam aligned once more, come first. A camera is
t_00 ... t_23 (the upper three rows of a 4x4, camera to world, OpenGL axes, metres, ARKit's world
with y up), fx fy cx cy, width and height; recent corrected cameras lack the last two. depth/N.png
is in millimetres, smaller than the image and of the same view; confidence/N.png is 0 where it is
not to be trusted. Along the border of a corrected image a few pixels may be black.
"""
from dataclasses import replace
import json
from pathlib import Path
from typing import Any

from neo_ros.captures.capture import Capture, CapturedFrame, DepthSource
from neo_ros.captures.levelling import stood_up_from_y
from neo_ros.captures.pose_files import pose_or_lost
from neo_ros.errors import GeometryError, SceneError
from neo_ros.geometry import Intrinsics
from neo_ros.geometry.lens import Lens
from neo_ros.machine.names import listed
from neo_ros.pictures.photo import list_photos, photo_size
import numpy as np

_KINDS = ('corrected_', '')
# Pixels along the border of a corrected image that may be black: as many as nerfstudio crops.
_RIM = 15


def find_keyframes(source: Path) -> Path | None:
    """Return the folder with images and cameras: SOURCE/keyframes or SOURCE."""
    return next((folder for folder in (source / 'keyframes', source) for kind in _KINDS
                 if (folder / f'{kind}images').is_dir() and (folder / f'{kind}cameras').is_dir()),
                None)


def read_polycam(source: Path) -> Capture:
    """Read the keyframes; images without a camera and cameras without an image are counted."""
    folder = find_keyframes(source)
    if folder is None:
        raise SceneError(f'{source}: expected keyframes/images and keyframes/cameras, or '
                         'keyframes/corrected_images and keyframes/corrected_cameras; export raw '
                         'data in Polycam, in its developer mode')
    kind = next(kind for kind in _KINDS if (folder / f'{kind}images').is_dir()
                and (folder / f'{kind}cameras').is_dir())
    images, cameras = folder / f'{kind}images', folder / f'{kind}cameras'
    rim = _RIM if kind else 0
    photos = list_photos(images)
    files = {path.stem: path for path in cameras.glob('*.json')
             if not path.name.startswith('.')}  # macOS adds a ._0.json to 0.json.
    frames, lost, without, unreadable = [], [], [], []
    for photo in photos:
        file = files.pop(photo.stem, None)
        if file is None:
            without.append(photo.name)
            continue
        camera = _read(file)
        pose = pose_or_lost(_matrix(camera, file), str(file), opengl=True)
        if pose is None:
            lost.append(photo.name)
            continue
        lens = _lens(camera, file, photo, folder / 'cameras' / file.name)
        if lens is None:
            unreadable.append(photo.name)
            continue
        frames.append(CapturedFrame(f'images/{photo.name}', pose, replace(lens, rim=rim),
                                    file=photo, depth=_depth(folder, photo.stem)))
    notes = [f'{len(names)} {what}: {listed(names)}' for names, what in (
        (without, f'images have no file in {cameras.name}/ and are left out'),
        (lost, 'images have no finite pose and are left out'),
        (unreadable, 'images cannot be read and are left out'),
        (sorted(path.name for path in files.values()),
         f'cameras have no image in {images.name}/ and are left out')) if names]
    if not frames:
        raise SceneError(f'{images}: none of its {len(photos)} images has a pose: '
                         f'{"; ".join(notes) or "the folder is empty"}')
    if rim:
        notes.append(f'{rim} pixels along the border of {images.name}/ are left out: '
                     'they may be black')
    return stood_up_from_y(Capture(tuple(frames), tuple(notes)))


def _depth(folder: Path, stem: str) -> DepthSource | None:
    depth, confidence = (folder / name / f'{stem}.png' for name in ('depth', 'confidence'))
    return DepthSource(0.001, depth, confidence=confidence if confidence.is_file() else None
                       ) if depth.is_file() else None


def _read(file: Path) -> dict[str, Any]:
    try:
        content = json.loads(file.read_text())
    except (OSError, ValueError) as error:
        raise SceneError(f'{file}: expected a JSON object: {error}') from error
    if not isinstance(content, dict):
        raise SceneError(f'{file}: expected a JSON object, got {type(content).__name__}')
    return content


def _matrix(camera: dict[str, Any], file: Path) -> np.ndarray:
    try:
        return np.array([[float(camera[f't_{row}{column}']) for column in range(4)]
                         for row in range(3)])
    except KeyError as error:
        raise SceneError(f'{file}: expected the key {error}') from error
    except (TypeError, ValueError) as error:
        raise SceneError(f'{file}: t_00 ... t_23: {error}') from error


def _lens(camera: dict[str, Any], file: Path, photo: Path, uncorrected: Path) -> Lens | None:
    """Return the lens; where no file says its size the photo has it, None if it is unreadable."""
    keys = ('width', 'height')
    if not camera.keys() >= {*keys}:
        others = _read(uncorrected) if uncorrected.is_file() else {}
        size = [others[key] for key in keys] if others.keys() >= {*keys} else photo_size(photo)
        if size is None:
            return None
        camera = {**camera, **dict(zip(keys, size))}
    try:
        return Lens(Intrinsics(int(camera['width']), int(camera['height']),
                               *(float(camera[key]) for key in ('fx', 'fy', 'cx', 'cy'))))
    except KeyError as error:
        raise SceneError(f'{file}: expected the key {error}') from error
    except (TypeError, ValueError, GeometryError) as error:
        raise SceneError(f'{file}: width, height, fx, fy, cx, cy: {error}') from error
