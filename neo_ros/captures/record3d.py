"""
Record3D: metadata.json with rgb/N.jpg (the export), or a .r3d file, which is a zip.

The metadata has w, h, K (3x3, column by column), poses (qx qy qz qw x y z a frame: camera to
world, OpenGL axes, metres, ARKit's world with y up) and perhaps perFrameIntrinsicCoeffs (fx fy cx
cy a frame). In a .r3d it is the member `metadata`, and the images are rgbd/N.jpg.
"""
from collections.abc import Iterator, Sequence
import json
from pathlib import Path
from typing import Any
import zipfile

from neo_ros.captures.capture import Capture, CapturedFrame, ImageStream, origin_of
from neo_ros.captures.levelling import stood_up_from_y
from neo_ros.errors import GeometryError, SceneError
from neo_ros.geometry import CameraPose, Intrinsics
from neo_ros.geometry.lens import Lens
from neo_ros.machine.names import listed, natural_key
from neo_ros.pictures.photo import decode_photo, list_photos
import numpy as np

SUFFIX = '.r3d'
_METADATA = 'metadata.json'


def find_record3d(source: Path) -> Path | None:
    """Return the folder with metadata.json that has poses, and rgb/: SOURCE or one below."""
    for folder in (source, source / 'EXR_RGBD'):
        path = folder / _METADATA
        if (folder / 'rgb').is_dir() and path.is_file() and b'"poses"' in path.read_bytes():
            return folder
    return None


def read_record3d(source: Path) -> Capture:
    """
    Read the export's folder or the .r3d file.

    Poses that are not finite, and images without a pose or poses without an image, are counted.
    Raises SceneError that names the key for metadata that say something else.
    """
    if source.is_file():
        return _read_archive(source)
    folder = find_record3d(source)
    if folder is None:
        raise SceneError(f'{source}: expected {_METADATA} beside rgb/')
    path = folder / _METADATA
    try:
        content = path.read_bytes()
    except OSError as error:
        raise SceneError(f'{path}: cannot read: {error.strerror}') from error
    photos = list_photos(folder / 'rgb')
    capture, _ = _capture(content, str(path), [photo.name for photo in photos], photos)
    return capture


def _read_archive(source: Path) -> Capture:
    try:
        with zipfile.ZipFile(source) as archive:
            names = sorted((name for name in archive.namelist()
                            if name.startswith('rgbd/') and name.endswith(('.jpg', '.png'))),
                           key=natural_key)
            content = archive.read('metadata')
    except (OSError, KeyError, zipfile.BadZipFile) as error:
        raise SceneError(f'{source}: expected a zip with the member metadata, as Record3D shares '
                         f'it: {error}') from error
    capture, kept = _capture(content, f'{source}: metadata',
                             [Path(name).name for name in names], None)
    return Capture(capture.frames, capture.notes,
                   _stream(source, [names[index] for index in kept]), origin_of(source),
                   capture.z_up)


def _stream(source: Path, members: Sequence[str]) -> ImageStream:
    def read(indices: Sequence[int]) -> Iterator[tuple[int, np.ndarray | None]]:
        with zipfile.ZipFile(source) as archive:
            for index in indices:
                try:
                    data = archive.read(members[index])
                except (OSError, zipfile.BadZipFile):
                    data = b''
                yield index, decode_photo(data)

    return read


def _capture(content: bytes, where: str, names: Sequence[str], files: Sequence[Path] | None
             ) -> tuple[Capture, list[int]]:
    """Return the capture and which of the images it keeps; their numbers are the poses'."""
    metadata = _parse(content, where)
    poses = _numbers(metadata, 'poses', 7, where)
    each = _numbers(metadata, 'perFrameIntrinsicCoeffs', 4, where) if (
        metadata.get('perFrameIntrinsicCoeffs')) else None
    if each is not None and len(each) != len(poses):
        raise SceneError(f'{where}: perFrameIntrinsicCoeffs: expected {len(poses)} as there are '
                         f'poses, got {len(each)}')
    shared = _shared_camera(metadata, where)
    frames, kept, lost, without = [], [], [], []
    for index, name in enumerate(names):
        stem = Path(name).stem
        number = int(stem) if stem.isdecimal() else index
        if number >= len(poses):
            without.append(name)
        elif not np.isfinite(poses[number]).all():
            lost.append(name)
        else:
            pose = _pose(poses[number], f'{where}: poses[{number}]')
            lens = shared if each is None else _lens(
                metadata, each[number], f'{where}: perFrameIntrinsicCoeffs[{number}]')
            kept.append(index)
            frames.append(CapturedFrame(f'images/{name}', pose, lens,
                                        file=None if files is None else files[index]))
    notes = [f'{len(group)} images {what}: {listed(group)}' for group, what in (
        (without, 'have no pose and are left out'),
        (lost, 'have no finite pose and are left out')) if group]
    unused = len(poses) - len(names) + len(without)
    if unused > 0:
        notes.append(f'{unused} poses have no image and are left out')
    if not frames:
        raise SceneError(f'{where}: none of the {len(names)} images has one of the {len(poses)} '
                         'poses')
    notes.append('depth maps are not read')
    return stood_up_from_y(Capture(tuple(frames), tuple(notes))), kept


def _parse(content: bytes, where: str) -> dict[str, Any]:
    try:
        metadata = json.loads(content)
    except ValueError as error:
        raise SceneError(f'{where}: expected JSON: {error}') from error
    if not isinstance(metadata, dict) or not {'poses', 'K', 'w', 'h'} <= metadata.keys():
        found = ', '.join(metadata) if isinstance(metadata, dict) else type(metadata).__name__
        raise SceneError(f'{where}: expected the keys w, h, K and poses of Record3D, got {found}')
    return metadata


def _numbers(metadata: dict[str, Any], key: str, columns: int, where: str) -> np.ndarray:
    try:
        values = np.array(metadata[key], np.float64)
    except (TypeError, ValueError) as error:
        raise SceneError(f'{where}: {key}: {error}') from error
    if values.ndim != 2 or values.shape[1] != columns:
        raise SceneError(f'{where}: {key}: expected {columns} numbers a frame, '
                         f'got the shape {values.shape}')
    return values


def _shared_camera(metadata: dict[str, Any], where: str) -> Lens:
    try:
        K = np.array(metadata['K'], np.float64).reshape(3, 3).T
    except (TypeError, ValueError) as error:
        raise SceneError(f'{where}: K: expected 9 numbers, column by column: {error}') from error
    return _lens(metadata, [K[0, 0], K[1, 1], K[0, 2], K[1, 2]], f'{where}: K')


def _lens(metadata: dict[str, Any], numbers: Sequence[float] | np.ndarray, where: str) -> Lens:
    try:
        return Lens(Intrinsics(int(metadata['w']), int(metadata['h']), *map(float, numbers)))
    except (TypeError, ValueError, GeometryError) as error:
        raise SceneError(f'{where}: {error}') from error


def _pose(numbers: np.ndarray, where: str) -> CameraPose:
    try:
        return CameraPose.from_opengl(
            CameraPose.from_quaternion(numbers[4:], numbers[:4]).T_world_cam)
    except GeometryError as error:
        raise SceneError(f'{where}: {error}') from error
