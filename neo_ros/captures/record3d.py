"""
Record3D: metadata.json with rgb/N.jpg and depth/N.exr (the export), or a .r3d, which is a zip.

The metadata has w, h, K (3x3, column by column), poses (qx qy qz qw x y z a frame: camera to
world, OpenGL axes, metres, ARKit's world with y up) and perhaps perFrameIntrinsicCoeffs (fx fy cx
cy a frame). In a .r3d, unpacked or not, it is the member `metadata`, and the images are
rgbd/N.jpg. Depth: see `record3d_depth`.
"""
from collections.abc import Container, Iterator, Sequence
from contextlib import contextmanager
from dataclasses import replace
import json
from pathlib import Path
from typing import Any
import zipfile

from neo_ros.captures.capture import (
    Capture, CapturedFrame, DepthSource, ImageStream, origin_of)
from neo_ros.captures.levelling import stood_up_from_y
from neo_ros.captures.record3d_depth import (
    advice_where_unread, depth_name, depth_stream, OpenFiles, ReadFile)
from neo_ros.errors import GeometryError, SceneError
from neo_ros.geometry import CameraPose, Intrinsics
from neo_ros.geometry.lens import Lens
from neo_ros.machine.names import listed, natural_key
from neo_ros.pictures.photo import decode_photo, list_photos
import numpy as np

SUFFIX = '.r3d'
# Metadata and the photos' folder: of the export, and of an unpacked .r3d.
_EXPORT, _RECORDING = ('metadata.json', 'rgb'), ('metadata', 'rgbd')


def find_record3d(source: Path) -> Path | None:
    """Return the folder with metadata that has poses, and photos: SOURCE or one below."""
    return next((folder for folder in (source, source / 'EXR_RGBD') if _layout(folder)), None)


def _layout(folder: Path) -> tuple[str, str] | None:
    return next(((name, photos) for name, photos in (_EXPORT, _RECORDING)
                 if (folder / photos).is_dir() and (folder / name).is_file()
                 and b'"poses"' in (folder / name).read_bytes()), None)


def read_record3d(source: Path) -> Capture:
    """
    Read the export's folder, the .r3d file or what is unpacked of it.

    Poses that are not finite, and images without a pose or poses without an image, are counted.
    Raises SceneError that names the key for metadata that say something else.
    """
    if source.is_file():
        return _read_archive(source)
    folder = find_record3d(source)
    layout = None if folder is None else _layout(folder)
    if folder is None or layout is None:
        raise SceneError(f'{source}: expected metadata.json beside rgb/, or metadata beside rgbd/')
    path = folder / layout[0]
    photos = list_photos(folder / layout[1])
    capture, kept = _capture(path.read_bytes(), str(path), [photo.name for photo in photos],
                             photos)
    if layout == _EXPORT:
        return _with_exr(capture, folder / 'depth')
    names = [f'{layout[1]}/{photos[index].name}' for index in kept]
    there = {f'{layout[1]}/{file.name}' for file in (folder / layout[1]).iterdir()}
    return _with_lzfse(capture, names, there, lambda: _unpacked(folder), path.read_bytes())


def _read_archive(source: Path) -> Capture:
    try:
        with zipfile.ZipFile(source) as archive:
            names = sorted((name for name in archive.namelist()
                            if name.startswith('rgbd/') and name.endswith(('.jpg', '.png'))),
                           key=natural_key)
            content = archive.read('metadata')
            members = set(archive.namelist())
    except (OSError, KeyError, zipfile.BadZipFile) as error:
        raise SceneError(f'{source}: expected a zip with the member metadata, as Record3D shares '
                         f'it: {error}') from error
    capture, kept = _capture(content, f'{source}: metadata',
                             [Path(name).name for name in names], None)
    kept_names = [names[index] for index in kept]
    capture = replace(capture, stream=_images(source, kept_names), origin=origin_of(source))
    return _with_lzfse(capture, kept_names, members, lambda: _packed(source), content)


def _with_exr(capture: Capture, folder: Path) -> Capture:
    """Give the frames the depth maps that lie in a folder, EXR in metres."""
    depths = [file if frame.file and (file := folder / f'{frame.file.stem}.exr').is_file() else
              None for frame in capture.frames]
    if not any(depths):
        return capture
    if advice := advice_where_unread('OpenEXR'):
        return replace(capture, notes=(*capture.notes, advice))
    return replace(capture, frames=tuple(
        replace(frame, depth=None if depth is None else DepthSource(1.0, depth))
        for frame, depth in zip(capture.frames, depths)))


def _with_lzfse(capture: Capture, images: Sequence[str], there: Container[str],
                open_files: OpenFiles, metadata: bytes) -> Capture:
    """Give the frames the depth maps that lie beside their images, LZFSE in metres."""
    having = [depth_name(image) in there for image in images]
    if not any(having):
        return capture
    if advice := advice_where_unread('lzfse'):
        return replace(capture, notes=(*capture.notes, advice))
    says = json.loads(metadata)
    size = (says.get('dw') or says['w'], says.get('dh') or says['h'])
    return replace(capture, depth_stream=depth_stream(open_files, images, size), frames=tuple(
        replace(frame, depth=DepthSource(1.0) if has else None)
        for frame, has in zip(capture.frames, having)))


@contextmanager
def _packed(source: Path) -> Iterator[ReadFile]:
    with zipfile.ZipFile(source) as archive:
        def read(name: str) -> bytes | None:
            try:
                return archive.read(name)
            except (KeyError, OSError, zipfile.BadZipFile):
                return None

        yield read


@contextmanager
def _unpacked(folder: Path) -> Iterator[ReadFile]:
    yield lambda name: (folder / name).read_bytes() if (folder / name).is_file() else None


def _images(source: Path, members: Sequence[str]) -> ImageStream:
    def read(indices: Sequence[int]) -> Iterator[tuple[int, np.ndarray | None]]:
        with _packed(source) as read_file:
            for index in indices:
                yield index, decode_photo(read_file(members[index]) or b'')

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
