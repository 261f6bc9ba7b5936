"""
TUM RGB-D: rgb.txt and depth.txt (`stamp file`), groundtruth.txt (`stamp tx ty tz qx qy qz qw`).

Stamps are seconds, poses are camera to world with OpenCV axes in metres, in the order x y z w.
Images and poses have clocks of their own rate: a pose is interpolated between neighbours at most
half a second apart, else the nearest one within 20 ms is taken, as the nearest depth is; depth is
registered to the colour image, 5000 steps a metre. The folder holds no calibration:
the cameras of Freiburg are known by the folder's name, others come from `--camera-info`.
"""
from collections.abc import Sequence
from pathlib import Path
import re

from neo_ros.captures.camera_file import read_camera_file
from neo_ros.captures.capture import Capture, CapturedFrame, DepthSource, scene_name
from neo_ros.captures.stamped_poses import (
    check_paired, nanoseconds, nearest_within, pairing_notes, pose_at, read_rows, read_track)
from neo_ros.errors import SceneError
from neo_ros.geometry import CameraPose, Intrinsics
from neo_ros.geometry.lens import CENTRE, Lens
from neo_ros.pictures.photo import first_photo_size, list_photos

IMAGE_LIST, DEPTH_LIST, POSES = 'rgb.txt', 'depth.txt', 'groundtruth.txt'
# Metres of a step of its depth.
DEPTH_UNIT = 1 / 5000
_SECOND_NS = 1_000_000_000
_SIZE = 640, 480
# Of the data set's page, in pixels that are counted from 0: fx fy cx cy, k1 k2 p1 p2 k3.
_FREIBURG = {
    '1': ((517.3, 516.5, 318.6, 255.3), (0.2624, -0.9531, -0.0054, 0.0026, 1.1633)),
    '2': ((520.9, 521.0, 325.1, 249.7), (0.2312, -0.7849, -0.0033, -0.0001, 0.9172)),
    '3': ((535.4, 539.2, 320.1, 247.6), ()),
}


def is_tum(source: Path) -> bool:
    """Whether there are poses beside a list or a folder of images."""
    return (source / POSES).is_file() and (
        (source / IMAGE_LIST).is_file() or (source / 'rgb').is_dir())


def read_tum(source: Path, camera_info: Path | None = None) -> Capture:
    """
    Read the colour images with their poses; those without a file or a pose are counted.

    camera_info: the calibration, for folders whose name is of no camera that is known. Raises
    SceneError without a calibration and where no image has a pose.
    """
    listed_images = _listed(source, IMAGE_LIST, 'rgb')
    depths = _depths(source)
    files = [(stamp, source / name) for stamp, name in listed_images]
    present = [file for _, file in files if file.is_file()]
    if not present:
        raise SceneError(f'{source / IMAGE_LIST}: none of its {len(files)} images exists; the '
                         f'first one is {files[0][1] if files else "not listed"}')
    lens = _lens(source, present, camera_info)
    track, lost = read_track(source / POSES, _SECOND_NS, scalar_first=False)
    frames, missing, unpaired = [], [], []
    for stamp_ns, file in files:
        T = pose_at(track, stamp_ns)
        if not file.is_file():
            missing.append(file.name)
        elif T is None:
            unpaired.append(file.name)
        else:
            frames.append(CapturedFrame(f'images/{scene_name(file, source)}', CameraPose(T), lens,
                                        0, stamp_ns, file, nearest_within(depths, stamp_ns)))
    notes = pairing_notes(len(files), missing, unpaired, lost, source / POSES)
    check_paired(frames, notes, source)
    return Capture(tuple(frames), notes)


def _depths(source: Path) -> Sequence[tuple[int, DepthSource]]:
    """Return (stamp, depth) by rising stamp, of the files that are there."""
    return [(stamp, DepthSource(DEPTH_UNIT, source / name))
            for stamp, name in _listed(source, DEPTH_LIST, 'depth') if (source / name).is_file()]


def _listed(source: Path, list_file: str, folder: str) -> list[tuple[int, str]]:
    """Return (stamp, file) by rising stamp; without a list, the files' names are their stamps."""
    path = source / list_file
    if path.is_file():
        rows = [(nanoseconds(words[0], where, _SECOND_NS), words[1])
                for where, words in read_rows(path, 2, 'STAMP FILE')]
    else:
        rows = [(nanoseconds(photo.stem, f'{photo}: its name, as there is no {list_file}',
                             _SECOND_NS), f'{folder}/{photo.name}')
                for photo in list_photos(source / folder)]
    return sorted(rows)


def _lens(source: Path, present: list[Path], camera_info: Path | None) -> Lens:
    if camera_info is not None:
        return read_camera_file(camera_info)
    found = re.search(r'(?:freiburg|fr)_?([123])', source.resolve().name.lower())
    if found is None:
        raise SceneError(
            f'{source}: TUM RGB-D: expected a folder whose name has its camera (freiburg1, '
            'freiburg2 or freiburg3, as rgbd_dataset_freiburg1_desk): calibrations are not in the '
            'folder; rename it, or give a file with the calibration: --camera-info FILE')
    width, height = first_photo_size(present, source)
    if (width, height) != _SIZE:
        raise SceneError(f'{source}: expected 640x480 images of Freiburg {found[1]}, got '
                         f'{width}x{height}; give their calibration: --camera-info FILE')
    (fx, fy, cx, cy), distortion = _FREIBURG[found[1]]
    return Lens(Intrinsics(width, height, fx, fy, cx + CENTRE, cy + CENTRE), distortion)
