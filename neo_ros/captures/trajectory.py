"""
Posed renders as Habitat and Replica tools write them: a folder of images and one traj.txt.

rgb/, results/, color/ or images/ with one image per line of traj.txt (16 numbers, 4x4 camera to
world, row by row, metres; image names in natural order, names with 'depth' left out), and one
JSON file with the camera: cam_params.json, camera.json or intrinsics.json, here or one folder
above: w, h, fx, fy, cx, cy, or w, h, hfov (degrees), at the top or below "camera". The corner of
the image is at 0, as COLMAP has it; a centre at (w - 1) / 2, (h - 1) / 2 counts from the middle of
the first pixel (NICE-SLAM's Replica) and is taken for the image's. Its key
"axes" says whether the camera looks along +z ("opencv", the default; NICE-SLAM's Replica) or
along -z ("opengl"; agent and sensor states of Habitat).

Depth is read where its unit is known: the camera file's "scale" says how many steps are a metre,
and NICE-SLAM's Replica has 6553.5. It is depth/NAME.png, or beside the image with 'depth' for
'frame' in its name.

Images in folders of their own (rgb/WALK/*.png) are walks: the lines go through all of them,
folders in natural order, and each has its path id.
"""
import json
import math
from pathlib import Path
from typing import Any

from neo_ros.captures.camera_file import read_camera_file
from neo_ros.captures.capture import Capture, CapturedFrame, DepthSource
from neo_ros.captures.pose_files import parse_matrix, pose_or_lost
from neo_ros.errors import SceneError
from neo_ros.geometry import Intrinsics
from neo_ros.geometry.lens import Lens
from neo_ros.machine.names import listed, natural_key
from neo_ros.pictures.photo import list_photos

TRAJECTORY_FILE = 'traj.txt'
IMAGE_FOLDERS = ('rgb', 'results', 'color', 'images')
# Steps a metre of NICE-SLAM's Replica, whose pictures lie in results/.
REPLICA_SCALE = 6553.5
CAMERA_FILES = ('cam_params.json', 'camera.json', 'intrinsics.json')


def read_trajectory(source: Path, camera_info: Path | None = None) -> Capture:
    """
    Read the images with their poses; lost poses (not finite) are counted and left out.

    camera_info: the calibration, where the folder has no camera file; poses have OpenCV axes then.
    """
    folder = next((source / name for name in IMAGE_FOLDERS if (source / name).is_dir()), None)
    if folder is None:
        raise SceneError(f'{source}: expected a folder {", ".join(IMAGE_FOLDERS)} beside '
                         f'{TRAJECTORY_FILE}')
    walks = [folder] if list_photos(folder) else sorted(
        (path for path in folder.iterdir() if path.is_dir()),
        key=lambda path: natural_key(path.name))
    photos = [(photo, path_id) for path_id, walk in enumerate(walks)
              for photo in list_photos(walk) if 'depth' not in photo.name]
    path = source / TRAJECTORY_FILE
    try:
        lines = [line for line in path.read_text().splitlines() if line.strip()]
    except (OSError, UnicodeDecodeError) as error:
        raise SceneError(f'{path}: cannot read: {error}') from error
    if len(lines) != len(photos) or not photos:
        raise SceneError(f'{path}: expected one line per image, got {len(lines)} lines and '
                         f'{len(photos)} images in {folder}')
    lens, opengl = (_camera(source) if camera_info is None
                    else (read_camera_file(camera_info), False))
    scale = _depth_scale(source, folder)
    frames, lost = [], []
    depths = 0
    for number, (line, (photo, path_id)) in enumerate(zip(lines, photos), start=1):
        name = photo.relative_to(folder).as_posix()
        pose = pose_or_lost(parse_matrix(line, f'{path}:{number}'), f'{path}:{number}', opengl)
        if pose is None:
            lost.append(name)
            continue
        depth = _depth_file(source, photo, folder)
        depths += depth is not None
        frames.append(CapturedFrame(
            f'images/{name}', pose, lens, path_id, file=photo,
            depth=None if depth is None or scale is None else DepthSource(1 / scale, depth)))
    if not frames:
        raise SceneError(f'{path}: none of the {len(lines)} poses is finite')
    notes = [f'{len(lost)} frames with a lost pose are left out: {listed(lost)}'] if lost else []
    if depths and scale is None:
        notes.append(f'{depths} depth maps are not read, as their unit is not known: write '
                     f'"scale", the steps of a metre, into one of {", ".join(CAMERA_FILES)}')
    return Capture(tuple(frames), tuple(notes))


def _depth_file(source: Path, photo: Path, folder: Path) -> Path | None:
    files = [source / 'depth' / photo.relative_to(folder).with_suffix('.png')]
    if 'frame' in photo.name:
        files.append(photo.with_name(photo.name.replace('frame', 'depth')).with_suffix('.png'))
    return next((file for file in files if file.is_file()), None)


def _depth_scale(source: Path, folder: Path) -> float | None:
    """Return how many steps of the depth are a metre, None where nobody says so."""
    file = _camera_file(source)
    values = {} if file is None else _camera_values(file)
    if 'scale' not in values:
        return REPLICA_SCALE if folder.name == 'results' else None
    scale = values['scale']
    if isinstance(scale, bool) or not isinstance(scale, (int, float)) or not scale > 0:
        raise SceneError(f'{file}: scale: expected the steps of the depth that are a metre, got '
                         f'{scale!r}')
    return float(scale)


def _camera_file(source: Path) -> Path | None:
    files = (folder / name for folder in (source, source.resolve().parent)
             for name in CAMERA_FILES)
    return next((file for file in files if file.is_file()), None)


def _camera_values(file: Path) -> dict[str, Any]:
    try:
        document = json.loads(file.read_text())
        return {**document, **document.get('camera', {})}
    except (OSError, TypeError, ValueError, AttributeError) as error:
        raise SceneError(f'{file}: expected a JSON object: {error}') from error


def _camera(source: Path) -> tuple[Lens, bool]:
    file = _camera_file(source)
    if file is None:
        raise SceneError(f'{source}: expected the camera in one of {", ".join(CAMERA_FILES)} '
                         'with w, h, fx, fy, cx, cy or w, h, hfov (degrees); or give a file '
                         'with the calibration: --camera-info FILE')
    values = _camera_values(file)
    try:
        width, height = int(values['w']), int(values['h'])
        if 'fx' in values:
            centre = values.get('cx', width / 2), values.get('cy', height / 2)
            if centre == ((width - 1) / 2, (height - 1) / 2):
                centre = width / 2, height / 2
            intrinsics = Intrinsics(width, height, values['fx'], values.get('fy', values['fx']),
                                    *centre)
        else:
            intrinsics = Intrinsics.from_hfov(width, height, math.radians(values['hfov']))
        axes = values.get('axes', 'opencv')
    except KeyError as error:
        raise SceneError(f'{file}: expected the key {error}') from error
    except (TypeError, ValueError, ArithmeticError) as error:
        raise SceneError(f'{file}: {error}') from error
    if axes not in ('opencv', 'opengl'):
        raise SceneError(f'{file}: axes: expected "opencv" or "opengl", got {axes!r}')
    return Lens(intrinsics), axes == 'opengl'
