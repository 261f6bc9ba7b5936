"""
EuRoC and other ASL data sets: mav0/cam0 with its calibration, and poses of the body.

cam0/data.csv (`stamp [ns], file`), cam0/data/, cam0/sensor.yaml (T_BS: camera to body, 4x4;
resolution, intrinsics fu fv cu cv, radial-tangential or equidistant distortion) and
state_groundtruth_estimate0/data.csv (`stamp [ns], x y z, qw qx qy qz, ...`: sensor to world,
metres, z up), else vicon0 or mocap0. Cameras have OpenCV axes; pixels are counted from 0. The
sensor that was tracked may have a T_BS of its own.
"""
from pathlib import Path
from typing import Any

from neo_ros.captures.camera_file import read_camera_file
from neo_ros.captures.capture import Capture, CapturedFrame
from neo_ros.captures.stamped_poses import (
    check_paired, nanoseconds, pairing_notes, pose_at, read_rows, read_track)
from neo_ros.errors import GeometryError, SceneError
from neo_ros.geometry import CameraPose, Intrinsics
from neo_ros.geometry.lens import CENTRE, Lens
from neo_ros.machine.names import listed
import numpy as np
import yaml

_CAMERA = 'cam0'
# Full poses, the best first; a laser tracker (leica0) gives positions alone.
_TRACKERS = ('state_groundtruth_estimate0', 'vicon0', 'mocap0', 'gt0')
_BENT = {'radial-tangential': False, 'radtan': False, 'plumb_bob': False, 'equidistant': True,
         'equi': True, 'none': False}


def find_euroc(source: Path) -> Path | None:
    """Return the folder with cam0/data.csv: SOURCE/mav0 or SOURCE."""
    return next((folder for folder in (source / 'mav0', source)
                 if (folder / _CAMERA / 'data.csv').is_file()), None)


def read_euroc(source: Path, camera_info: Path | None = None) -> Capture:
    """
    Read the images of cam0 with their poses; those without a file or a pose are counted.

    camera_info: the calibration, instead of the one in sensor.yaml. Raises SceneError where
    calibration or poses are not there.
    """
    folder = find_euroc(source)
    if folder is None:
        raise SceneError(f'{source}: expected mav0/cam0/data.csv')
    tracker = next((folder / name for name in _TRACKERS
                    if (folder / name / 'data.csv').is_file()), None)
    if tracker is None:
        raise SceneError(f'{folder}: expected poses in one of '
                         f'{", ".join(f"{name}/data.csv" for name in _TRACKERS)}; to compute '
                         f'others: neo import {folder / _CAMERA / "data"} SCENE --format photos')
    sensor = _read_sensor(folder / _CAMERA / 'sensor.yaml')
    where = f'{folder / _CAMERA / "sensor.yaml"}'
    lens = _lens(sensor, where) if camera_info is None else read_camera_file(camera_info)
    T_body_cam = _T_BS(sensor, where)
    own = tracker / 'sensor.yaml'
    T_sensor_body = np.linalg.inv(_T_BS(_read_sensor(own), str(own))) if own.is_file() else (
        np.eye(4))
    track, lost = read_track(tracker / 'data.csv', 1, scalar_first=True)
    frames, missing, unpaired, total = [], [], [], 0
    for line, words in read_rows(folder / _CAMERA / 'data.csv', 2, 'STAMP,FILE'):
        total += 1
        stamp_ns, file = nanoseconds(words[0], line), folder / _CAMERA / 'data' / words[1]
        T = pose_at(track, stamp_ns)
        if not file.is_file():
            missing.append(words[1])
        elif T is None:
            unpaired.append(words[1])
        else:
            frames.append(CapturedFrame(
                f'images/{words[1]}', CameraPose.nearest(T @ T_sensor_body @ T_body_cam), lens,
                0, stamp_ns, file))
    notes = pairing_notes(total, missing, unpaired, lost, tracker / 'data.csv')
    check_paired(frames, notes, source)
    others = sorted(path.name for path in folder.glob('cam*') if path.name != _CAMERA)
    if others:
        notes = (*notes, f'{listed(others)}: not read, only {_CAMERA} is')
    return Capture(tuple(sorted(frames, key=lambda frame: frame.stamp_ns or 0)), notes, z_up=True)


def _read_sensor(path: Path) -> dict[str, Any]:
    try:
        # OpenCV's first line is no YAML.
        lines = [line for line in path.read_text().splitlines() if not line.startswith('%')]
        content = yaml.safe_load('\n'.join(lines))
    except (OSError, UnicodeDecodeError, yaml.YAMLError) as error:
        raise SceneError(f'{path}: expected the sensor, T_BS and intrinsics, as YAML: {error}'
                         ) from error
    if not isinstance(content, dict):
        raise SceneError(f'{path}: expected keys, got {type(content).__name__}')
    return content


def _T_BS(sensor: dict[str, Any], where: str) -> np.ndarray:
    """Return the sensor's frame in the body (4, 4)."""
    try:
        T = np.array(sensor['T_BS']['data'], np.float64).reshape(4, 4)
        return CameraPose.nearest(T).T_world_cam
    except (KeyError, TypeError, ValueError, GeometryError) as error:
        raise SceneError(f'{where}: T_BS: expected data with 16 numbers, a rigid transform: '
                         f'{error}') from error


def _lens(sensor: dict[str, Any], where: str) -> Lens:
    try:
        width, height = (int(value) for value in sensor['resolution'])
        fu, fv, cu, cv = (float(value) for value in sensor['intrinsics'])
        model = str(sensor.get('distortion_model', 'none')).lower()
        distortion = tuple(float(value) for value in sensor.get('distortion_coefficients') or ())
    except (KeyError, TypeError, ValueError) as error:
        raise SceneError(f'{where}: expected resolution, intrinsics (fu, fv, cu, cv), '
                         f'distortion_model and distortion_coefficients: {error!r}') from error
    if model not in _BENT or str(sensor.get('camera_model', 'pinhole')) != 'pinhole':
        raise SceneError(
            f'{where}: expected a pinhole camera, {", ".join(_BENT)}, got '
            f'{sensor.get("camera_model", "pinhole")} and {model}; give another calibration: '
            '--camera-info FILE')
    try:
        return Lens(Intrinsics(width, height, fu, fv, cu + CENTRE, cv + CENTRE), distortion,
                    fisheye=_BENT[model])
    except GeometryError as error:
        raise SceneError(f'{where}: {error}') from error
