"""
The demo flat as an ordinary robot records it: a bag to import, and one to widen.

    python -m neo_ros.benchmark.robot_drive BAG [--seconds 120] [--rate 2.5] [--seed 5]
    python -m neo_ros.benchmark.robot_drive BAG --model MODEL.onnx --seconds 30 --seed 6

640x480 at 69 degrees in YUYV through a lens with distortion, an exposure that follows the light, a
robot that starts and stops, odometry that drifts and a localisation that corrects it once a
second: see `flat/robot_camera.py`. With a model the bag holds the wide truth, too.
"""
import argparse
from collections.abc import Iterator
from functools import partial
import math
from pathlib import Path

import cv2
from neo_ros.bags.demo_bag import base_to_optical, RobotFrame, write_robot_bag
from neo_ros.flat.demo_flat import build_demo_flat
from neo_ros.flat.robot_camera import (
    AutoExposure, Drift, Drive, exposed, LENS, pinhole_around, poses_along, through_lens)
from neo_ros.flat.walks import DOORWAY, plan_walk_through, STEP
from neo_ros.geometry import CameraPose, Intrinsics
from neo_ros.geometry.lens import Lens
from neo_ros.machine.processes import map_in_processes
from neo_ros.messages import camera_info_fields, image_fields
from neo_ros.messages.stamps import NS_PER_S
from neo_ros.runtime import read_model_card
import numpy as np

START_NS = NS_PER_S
LOCATED_EVERY = 1.0  # seconds


def make_drive(path: Path, seconds: float, rate: float, seed: int, truth: Intrinsics | None = None,
               lens: Lens = LENS, workers: int = 2) -> int:
    """
    Cast a drive through the demo flat and write it as a bag; return the number of images.

    truth: the wide camera whose view is written beside the camera's, if any. Raises BagError
    where the bag exists or cannot be written, SceneError where no way is found.
    """
    flat, drive = build_demo_flat(), Drive()
    times = np.arange(0, seconds, 1 / rate)
    walkable = flat.walkable()
    walk = plan_walk_through(walkable, DOORWAY, math.ceil(drive.length(seconds) / STEP) + 2,
                             np.random.default_rng(seed))
    poses = poses_along(walk, drive.distances(times, seconds))
    return write_robot_bag(path, _frames(poses, times, lens, truth, walkable.camera_height,
                                         workers), walkable.camera_height)


def _frames(poses: list[CameraPose], times: np.ndarray, lens: Lens, truth: Intrinsics | None,
            height: float, workers: int) -> Iterator[RobotFrame]:
    T_optical_base = np.linalg.inv(base_to_optical(height))
    T_map_base = [pose.T_world_cam @ T_optical_base for pose in poses]
    T_odom_base = Drift().odometry(T_map_base)
    located = np.floor(times / LOCATED_EVERY).astype(int)
    exposure, info = AutoExposure(), _camera_info(lens)
    T_map_odom, known = np.eye(4), -1
    views = map_in_processes(partial(_views, lens, truth), [pose.T_world_cam for pose in poses],
                             workers)
    for index, (seen, wide) in enumerate(views):
        if located[index] != known:
            known = located[index]
            T_map_odom = T_map_base[index] @ np.linalg.inv(T_odom_base[index])
        print(f'{index + 1} of {len(poses)} images', end='\r', flush=True)
        gain = exposure.gain(seen, float(times[index]))
        yield RobotFrame(
            START_NS + round(float(times[index]) * NS_PER_S), _yuyv_fields(exposed(seen, gain)),
            info, T_map_odom, T_odom_base[index],
            None if wide is None else exposed(wide, gain))


def _views(lens: Lens, truth: Intrinsics | None, T_world_cam: np.ndarray
           ) -> tuple[np.ndarray, np.ndarray | None]:
    """Cast what the lens shows at a pose, and the wide view."""
    flat, pose, pinhole = build_demo_flat(), CameraPose(T_world_cam), pinhole_around(lens)
    return (through_lens(flat.render(pinhole, pose)[0], pinhole, lens),
            None if truth is None else flat.render(truth, pose)[0])


def _camera_info(lens: Lens) -> dict[str, object]:
    return {**camera_info_fields(lens.intrinsics), 'd': lens.coefficients}


def _yuyv_fields(image: np.ndarray) -> dict[str, object]:
    """Return the fields of an image message as a USB camera sends it."""
    packed = cv2.cvtColor(image, cv2.COLOR_RGB2YUV_YUY2)
    return {**image_fields(image), 'encoding': 'yuv422_yuy2', 'step': 2 * image.shape[1],
            'data': np.ascontiguousarray(packed).reshape(-1)}


def main() -> None:
    """Make the bag."""
    parser = argparse.ArgumentParser(description=__doc__,
                                     formatter_class=argparse.RawDescriptionHelpFormatter)
    parser.add_argument('bag', type=Path)
    parser.add_argument('--seconds', type=float, default=120.0)
    parser.add_argument('--rate', type=float, default=2.5, help='images a second')
    parser.add_argument('--seed', type=int, default=5, help='of the way')
    parser.add_argument('--model', type=Path, help='whose wide view is written as the truth')
    given = parser.parse_args()
    truth = None if given.model is None else read_model_card(given.model).expansion.target
    count = make_drive(given.bag, given.seconds, given.rate, given.seed, truth)
    print(f'{given.bag}: {count} images')


if __name__ == '__main__':
    main()
