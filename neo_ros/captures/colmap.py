"""
COLMAP models, binary and text: cameras.* and images.*; points are not needed.

COLMAP's cameras have OpenCV axes and pixel centres at +0.5, as here; its poses are world to
camera. Its world is neither in metres nor level unless someone aligned it.
"""
from collections.abc import Iterator, Sequence
from dataclasses import dataclass, replace
import os
from pathlib import Path
import struct
from typing import BinaryIO

from neo_ros.captures.capture import Capture, CapturedFrame, scene_name
from neo_ros.errors import GeometryError, NeoError, SceneError
from neo_ros.geometry import CameraPose, Intrinsics
from neo_ros.geometry.camera_pose import transform_from_quaternion
from neo_ros.geometry.lens import Lens
from neo_ros.machine.names import listed, natural_key
import numpy as np

IMAGE_FOLDERS = ('images', 'input', 'photos', 'rgb')
# (id, name, number of parameters) of all camera models, to step through the binary file.
_ALL_MODELS = (
    (0, 'SIMPLE_PINHOLE', 3), (1, 'PINHOLE', 4), (2, 'SIMPLE_RADIAL', 4), (3, 'RADIAL', 5),
    (4, 'OPENCV', 8), (5, 'OPENCV_FISHEYE', 8), (6, 'FULL_OPENCV', 12), (7, 'FOV', 5),
    (8, 'SIMPLE_RADIAL_FISHEYE', 4), (9, 'RADIAL_FISHEYE', 5), (10, 'THIN_PRISM_FISHEYE', 12))
_ONE_FOCAL_LENGTH = {'SIMPLE_PINHOLE', 'SIMPLE_RADIAL', 'RADIAL', 'SIMPLE_RADIAL_FISHEYE',
                     'RADIAL_FISHEYE'}
_UNDISTORT = 'undistort the images first: colmap image_undistorter'
_UNREADABLE = {'FOV', 'THIN_PRISM_FISHEYE'}


@dataclass(frozen=True)
class _ModelImage:
    name: str
    camera_id: int
    quaternion_wxyz: tuple[float, ...]
    translation: tuple[float, ...]


def find_model(source: Path) -> Path | None:
    """Return the first folder with cameras.bin or .txt in or below SOURCE, as COLMAP puts it."""
    return next(iter(_find_models(source)), None)


def _find_models(source: Path) -> list[Path]:
    """Return SOURCE or the folder below it that holds the model, or all its numbered ones."""
    for place in ('', 'sparse', 'colmap/sparse'):
        folder = source / place
        if _is_model(folder):
            return [folder]
        parts = sorted((path for path in folder.glob('[0-9]*')
                        if path.name.isdecimal() and _is_model(path)),
                       key=lambda path: int(path.name))
        if parts:
            return parts
    return []


def _is_model(folder: Path) -> bool:
    return any((folder / f'cameras{suffix}').is_file() and (folder / f'images{suffix}').is_file()
               for suffix in ('.bin', '.txt'))


def read_colmap(source: Path, images: Path | None = None, model: int | None = None) -> Capture:
    """
    Read a COLMAP project: the model in or below SOURCE, and its images.

    images: the folder with the images, instead of one beside the model. model: the number of one
    of several models; by default the one with the most images.
    """
    models = _find_models(source)
    if not models:
        raise SceneError(f'{source}: expected cameras.bin and images.bin (or .txt) here, in '
                         'sparse/ or in sparse/0/')
    counts = {path: len(_read_model(path)[1]) for path in models} if len(models) > 1 else {}
    chosen = max(models, key=lambda path: counts.get(path, 0))
    if model is not None:
        names = [path.name for path in models]
        if str(model) not in names:
            raise SceneError(f'--model: expected one of {", ".join(names)} in '
                             f'{models[0].parent}, got {model}')
        chosen = models[names.index(str(model))]
    notes: tuple[str, ...] = ()
    if len(models) > 1:
        others = ', '.join(f'{path.name} ({counts[path]})' for path in models if path != chosen)
        notes = (f'{chosen.parent} holds {len(models)} models: {chosen.name} is read, with '
                 f'{counts[chosen]} images; others by --model: {others}',)
    capture = read_colmap_model(chosen, images or _images_beside(source, chosen))
    return replace(capture, notes=capture.notes + notes)


def _images_beside(source: Path, model: Path) -> Path:
    model = Path(os.path.abspath(model))  # '.' has no parents.
    places = [folder / name for folder in (source, *model.parents[:2]) for name in IMAGE_FOLDERS]
    return next((place for place in places if place.is_dir()), source)


def read_colmap_model(model: Path, image_folder: Path) -> Capture:
    """
    Read the model of one folder; image names are relative to `image_folder`.

    Images that are missing are named in the notes and left out. Raises SceneError for damaged
    files, for camera models that cannot be made straight, and where no image exists.
    """
    cameras, images = _read_model(model)
    frames, missing, lost = [], [], []
    for image in sorted(images, key=lambda image: natural_key(image.name)):
        where = f'{model}: image {image.name}'
        lens = cameras.get(image.camera_id)
        if lens is None:
            raise SceneError(f'{where}: expected its camera {image.camera_id} in the model')
        if not (image_folder / image.name).is_file():
            missing.append(image.name)
            continue
        if not np.isfinite(image.quaternion_wxyz + image.translation).all():
            lost.append(image.name)
            continue
        w, x, y, z = image.quaternion_wxyz
        try:
            T_cam_world = transform_from_quaternion(
                np.array(image.translation), np.array([x, y, z, w]))
            pose = CameraPose(CameraPose(T_cam_world).inverse())
        except GeometryError as error:
            raise SceneError(f'{where}: {error}') from error
        file = image_folder / image.name
        frames.append(CapturedFrame(
            f'images/{scene_name(file, image_folder)}', pose, lens, file=file))
    if not frames and lost:
        raise SceneError(f'{model}: none of its {len(images)} images has a finite pose and a file '
                         f'in {image_folder}')
    if not frames:
        raise SceneError(f'{model}: none of its {len(images)} images is in {image_folder}: '
                         f'{listed(missing) or "the model is empty"}; say where they are: '
                         '--images DIR')
    notes = []
    if missing:
        notes.append(f'{len(missing)} images of the model are missing and left out: '
                     f'{listed(missing)}; --images DIR says where they are, if elsewhere')
    if lost:
        notes.append(f'{len(lost)} images have no finite pose and are left out: {listed(lost)}')
    return Capture(tuple(frames), tuple(notes))


def _lens(model: str, width: int, height: int, params: Sequence[float], where: str) -> Lens:
    if model in _UNREADABLE:
        raise SceneError(f'{where}: the camera model {model} is not supported; '
                         + _UNDISTORT)
    one = model in _ONE_FOCAL_LENGTH
    focal = (params[0], params[0]) if one else params[:2]
    centre, distortion = params[2 - one:4 - one], tuple(params[4 - one:])
    if distortion and one and 'FISHEYE' not in model:
        distortion = (*distortion, *(0.0,) * (4 - len(distortion)))  # and no p1, p2
    try:
        intrinsics = Intrinsics(width, height, *focal, *centre)
        return Lens(intrinsics, distortion, fisheye=model.endswith('FISHEYE'))
    except GeometryError as error:
        raise SceneError(f'{where}: {error}') from error


def _read_model(model: Path) -> tuple[dict[int, Lens], list[_ModelImage]]:
    return _read_binary(model) if (model / 'cameras.bin').is_file() else _read_text(model)


def _read_text(model: Path) -> tuple[dict[int, Lens], list[_ModelImage]]:
    cameras = {}
    for number, line in _lines(model / 'cameras.txt'):
        where = f'{model / "cameras.txt"}:{number}'
        try:
            camera_id, name, width, height, *words = line.split()
            count = {known: n for _, known, n in _ALL_MODELS}.get(name)
            if count is None:
                raise SceneError(f'{where}: unknown camera model {name!r}; {_UNDISTORT}')
            params = [float(word) for word in words]
            if len(params) != count:
                raise ValueError(f'{name} has {count} parameters, got {len(params)}')
            cameras[int(camera_id)] = _lens(name, int(width), int(height), params, where)
        except NeoError:
            raise
        except ValueError as error:
            raise SceneError(f'{where}: expected ID MODEL WIDTH HEIGHT PARAMS: {error}') from error
    images = []
    points_follow = False
    for number, line in _lines(model / 'images.txt', keep_empty=True):
        # Every image has a second line with its points, which may be empty; some writers leave
        # it out.
        if points_follow and _lists_points(line) or not line:
            points_follow = False
            continue
        points_follow = True
        words = line.split(maxsplit=9)
        try:
            numbers = tuple(float(word) for word in words[1:8])
            images.append(_ModelImage(words[9], int(words[8]), numbers[:4], numbers[4:]))
        except (ValueError, IndexError) as error:
            raise SceneError(f'{model / "images.txt"}:{number}: expected ID QW QX QY QZ TX TY TZ '
                             f'CAMERA NAME: {error}') from error
    return cameras, images


def _lists_points(line: str) -> bool:
    """Whether a line is empty or of X Y POINT3D_ID, and not of an image."""
    words = line.split()
    try:
        return len(words) % 3 == 0 and bool([float(word) for word in words] or not words)
    except ValueError:
        return False


def _lines(path: Path, keep_empty: bool = False) -> Iterator[tuple[int, str]]:
    try:
        lines = path.read_text().splitlines()
    except (OSError, UnicodeDecodeError) as error:
        raise SceneError(f'{path}: cannot read: {error}') from error
    for number, line in enumerate(lines, start=1):
        if not line.startswith('#') and (line.strip() or keep_empty):
            yield number, line.strip()


def _read_binary(model: Path) -> tuple[dict[int, Lens], list[_ModelImage]]:
    path = model / 'cameras.bin'
    try:
        with path.open('rb') as file:
            cameras = dict(_binary_cameras(file, path))
        path = model / 'images.bin'
        with path.open('rb') as file:
            return cameras, list(_binary_images(file))
    except (struct.error, UnicodeDecodeError, OverflowError) as error:
        raise SceneError(f'{path}: damaged or cut off: {error}') from error
    except OSError as error:
        raise SceneError(f'{path}: cannot read: {error.strerror}') from error


def _binary_cameras(file: BinaryIO, path: Path) -> Iterator[tuple[int, Lens]]:
    known = {number: (name, count) for number, name, count in _ALL_MODELS}
    for _ in range(_unpack(file, 'Q')[0]):
        camera_id, model_id, width, height = _unpack(file, 'IiQQ')
        if model_id not in known:
            raise SceneError(f'{path}: camera {camera_id}: unknown camera model {model_id}; '
                             + _UNDISTORT)
        name, count = known[model_id]
        yield camera_id, _lens(name, width, height, _unpack(file, f'{count}d'),
                               f'{path}: camera {camera_id}')


def _binary_images(file: BinaryIO) -> Iterator[_ModelImage]:
    for _ in range(_unpack(file, 'Q')[0]):
        _, *numbers, camera_id = _unpack(file, 'I7dI')
        name = bytearray()
        while (byte := file.read(1)) not in (b'\0', b''):
            name += byte
        # Points: x, y and the id of the 3D point.
        file.seek(_unpack(file, 'Q')[0] * struct.calcsize('<ddq'), 1)
        yield _ModelImage(name.decode(), camera_id, tuple(numbers[:4]), tuple(numbers[4:]))


def _unpack(file: BinaryIO, layout: str) -> tuple:
    size = struct.calcsize('<' + layout)
    return struct.unpack('<' + layout, file.read(size))
