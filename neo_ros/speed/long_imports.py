"""
Minutes and memory of `neo import`, of many photos and of long bags.

    python -m neo_ros.speed.long_imports WORK

Makes the captures in the folder WORK, each in two sizes, imports them in processes of their own,
and takes both away again. Memory is flat where the larger one takes no more of it. Writes
results/imports.json.
"""
from collections.abc import Callable, Sequence
import json
import math
from pathlib import Path
import shutil
import subprocess
import sys
import time
from typing import Any

import cv2
from neo_ros.bags.writing import BagWriter
from neo_ros.geometry import CameraPose, Intrinsics
from neo_ros.geometry.camera_pose import quaternion_from_rotation
from neo_ros.machine.result_rows import ResultRows
from neo_ros.messages import camera_info_fields
import numpy as np

RESULTS = Path('results/imports.json')
PHOTOS, SECONDS = (1000, 10_000), (360, 3600)
RATE_HZ = 30
PHOTO = Intrinsics.from_hfov(320, 240, math.radians(69))
FRAME = Intrinsics.from_hfov(160, 120, math.radians(69))
PICTURES = 16        # that the captures are made of, in turn
SPEED_M_S = 0.3      # of the robot that records the bag; half a metre is a turn of 10 degrees
KEYFRAMES = ('--keyframe-distance', '0.1', '--keyframe-angle', '10')


def pictures(camera: Intrinsics) -> list[bytes]:
    """Return JPEGs of smooth patterns."""
    random = np.random.default_rng(0)
    return [cv2.imencode('.jpg', cv2.resize(
        random.integers(0, 256, (12, 16, 3)).astype(np.uint8), (camera.width, camera.height),
        interpolation=cv2.INTER_CUBIC))[1].tobytes() for _ in range(PICTURES)]


def pose_after(metres: float) -> CameraPose:
    """Return where a robot is that drives circles of 3 m, each beside the last."""
    angle = metres / 3
    middle = 2 * (angle // (2 * math.pi))
    return CameraPose.from_planar(middle + 3 * math.cos(angle), 3 * math.sin(angle), 1.5,
                                  angle + math.pi / 2)


def write_transforms(folder: Path, count: int) -> None:
    """Write photos 0.1 m apart as nerfstudio has them."""
    frames = []
    for index, name in enumerate(_write_photos(folder / 'images', count)):
        frames.append({'file_path': f'images/{name}',
                       'transform_matrix': pose_after(0.1 * index).to_opengl().tolist()})
    (folder / 'transforms.json').write_text(json.dumps({
        'w': PHOTO.width, 'h': PHOTO.height, 'fl_x': PHOTO.fx, 'fl_y': PHOTO.fy,
        'cx': PHOTO.cx, 'cy': PHOTO.cy, 'frames': frames}))


def write_colmap(folder: Path, count: int) -> None:
    """Write the same as a model of COLMAP in text."""
    lines = []
    for index, name in enumerate(_write_photos(folder / 'images', count)):
        T = np.linalg.inv(pose_after(0.1 * index).T_world_cam)
        x, y, z, w = quaternion_from_rotation(T[:3, :3])
        words = ' '.join(f'{value:.9f}' for value in (w, x, y, z, *T[:3, 3]))
        lines += [f'{index + 1} {words} 1 {name}', '']
    model = folder / 'sparse/0'
    model.mkdir(parents=True)
    (model / 'images.txt').write_text('\n'.join(lines) + '\n')
    (model / 'cameras.txt').write_text(
        f'1 PINHOLE {PHOTO.width} {PHOTO.height} {PHOTO.fx} {PHOTO.fy} {PHOTO.cx} {PHOTO.cy}\n')


def _write_photos(folder: Path, count: int) -> list[str]:
    folder.mkdir(parents=True)
    shown = pictures(PHOTO)
    names = [f'{index:05d}.jpg' for index in range(count)]
    for index, name in enumerate(names):
        (folder / name).write_bytes(shown[index % PICTURES])
    return names


def write_bag(folder: Path, seconds: int) -> None:
    """Write a bag with JPEGs and PoseStamped at 30 Hz."""
    shown = [np.frombuffer(data, np.uint8) for data in pictures(FRAME)]
    with BagWriter(folder) as bag:
        types = bag.typestore.types
        image, info, pose = (bag.add_topic(name, msgtype) for name, msgtype in (
            ('/camera/image_raw/compressed', 'sensor_msgs/msg/CompressedImage'),
            ('/camera/camera_info', 'sensor_msgs/msg/CameraInfo'),
            ('/pose', 'geometry_msgs/msg/PoseStamped')))

        def make(msgtype: str, **fields: Any) -> Any:
            return types[msgtype](**fields)

        def header(frame_id: str) -> Any:
            return make('std_msgs/msg/Header', frame_id=frame_id, stamp=make(
                'builtin_interfaces/msg/Time', sec=stamp_ns // 10**9, nanosec=stamp_ns % 10**9))

        for index in range(seconds * RATE_HZ):
            stamp_ns = 10**18 + index * 10**9 // RATE_HZ
            T = pose_after(SPEED_M_S * index / RATE_HZ).T_world_cam
            if index % RATE_HZ == 0:
                roi = make('sensor_msgs/msg/RegionOfInterest', x_offset=0, y_offset=0, height=0,
                           width=0, do_rectify=False)
                bag.write(info, stamp_ns, make(
                    info.msgtype, header=header('camera'), binning_x=0, binning_y=0, roi=roi,
                    **camera_info_fields(FRAME)))
            x, y, z = map(float, T[:3, 3])
            qx, qy, qz, qw = map(float, quaternion_from_rotation(T[:3, :3]))
            bag.write(pose, stamp_ns, make(pose.msgtype, header=header('map'), pose=make(
                'geometry_msgs/msg/Pose', position=make('geometry_msgs/msg/Point', x=x, y=y, z=z),
                orientation=make('geometry_msgs/msg/Quaternion', x=qx, y=qy, z=qz, w=qw))))
            bag.write(image, stamp_ns, make(image.msgtype, header=header('camera'), format='jpeg',
                                            data=shown[index % PICTURES]))


CAPTURES: tuple[tuple[str, Callable[[Path, int], None], Sequence[int], Sequence[str]], ...] = (
    ('photos, transforms.json', write_transforms, PHOTOS, ()),
    ('photos, COLMAP', write_colmap, PHOTOS, ()),
    ('bag, 30 Hz', write_bag, SECONDS, KEYFRAMES))


def measure_import(source: Path, scene: Path, options: Sequence[str] = ()) -> dict[str, Any]:
    """
    Import in a process of its own; returns minutes, cpu_minutes, peak_mb, photos and `remaining`.

    remaining: how often it said how long it would still take.
    """
    # Linux counts what the process had before it became this program as its ru_maxrss.
    program = ('import re, time; from neo_ros.cli.main import main\n'
               'try: main()\n'
               'finally:\n'
               ' peak = re.search(r"VmHWM:\\s+(\\d+)", open("/proc/self/status").read())\n'
               ' print("used", peak[1], time.process_time())')
    started = time.monotonic()
    result = subprocess.run([sys.executable, '-c', program, 'import', str(source), str(scene),
                             *options], capture_output=True, text=True)
    minutes = (time.monotonic() - started) / 60
    if result.returncode:
        raise RuntimeError(f'neo import {source}: {result.stdout}{result.stderr}')
    kilobytes, seconds = result.stdout.split('used ')[-1].split()
    frames = json.loads((scene / 'transforms_train.json').read_text())['frames']
    return {'minutes': minutes, 'cpu_minutes': float(seconds) / 60,
            'peak_mb': int(kilobytes) / 1e3, 'photos': len(frames),
            'remaining': (result.stdout + result.stderr).count('min left')}


def main() -> None:
    """Measure what WORK's file of results lacks."""
    if len(sys.argv) != 2:
        sys.exit('usage: python -m neo_ros.speed.long_imports WORK')
    work = Path(sys.argv[1])
    results = ResultRows(RESULTS)
    for name, write, sizes, options in CAPTURES:
        for size in sizes:
            frames = size * RATE_HZ if write is write_bag else size
            key = {'capture': name, 'frames': frames}
            if results.find(key) is not None:
                continue
            shutil.rmtree(work, ignore_errors=True)
            write(work / 'source', size)
            print(results.add({**key, **measure_import(
                work / 'source', work / 'scene', options)}), flush=True)
    shutil.rmtree(work, ignore_errors=True)


if __name__ == '__main__':
    main()
