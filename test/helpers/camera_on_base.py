"""A bag of a camera on a robot's base, with poses in several ways."""
from typing import Any

from camera_bags import CameraBag
from neo_ros.geometry import CameraPose, Intrinsics
from neo_ros.geometry.camera_pose import T_BODY_OPTICAL
import numpy as np

CAMERA = Intrinsics(32, 24, 30.0, 31.0, 16.5, 12.0)
START, STEP = 1_700_000_000_000_000_000, 100_000_000
RAW, RAW_INFO = '/cam/image_raw', '/cam/camera_info'
# The camera sits ahead of and above the body, turned to the left.
T_BASE_OPTICAL = CameraPose.from_planar(0.2, 0.1, 0.7, 0.5).T_world_cam
COUNT = 4
IMAGES = np.random.default_rng(1).integers(0, 256, (COUNT, 24, 32, 3), np.uint8)


def base_pose(time: float) -> np.ndarray:
    """Where the body is after `time` steps: it drives and turns evenly."""
    T = CameraPose.from_planar(0.3 * time, -0.1 * time, 0, 0.2 * time).T_world_cam
    return T @ np.linalg.inv(T_BODY_OPTICAL)


def camera_poses() -> list[np.ndarray]:
    return [base_pose(i) @ T_BASE_OPTICAL for i in range(COUNT)]


def add_camera(bag: CameraBag, topic: str = RAW, info: str | None = RAW_INFO,
               compressed: bool = False, order: Any = range(COUNT), **changes: Any) -> None:
    for i in order:
        bag.image(topic, START + i * STEP, IMAGES[i], compressed=compressed)
        if info is not None:
            bag.info(info, START + i * STEP, CAMERA, **changes)


def add_mount(bag: CameraBag) -> None:
    bag.tf('/tf_static', START, 'base_link', 'link', T_BASE_OPTICAL
           @ np.linalg.inv(T_BODY_OPTICAL))
    bag.tf('/tf_static', START, 'link', 'optical', T_BODY_OPTICAL)


def add_tf(bag: CameraBag) -> None:
    # Between the images, and the later half first.
    for time in (1.5, 2.5, 3.5, -0.5, 0.5):
        bag.tf('/tf', START + int(time * STEP), 'odom', 'base_link', base_pose(time))
    # A map that stands still needs no more than two messages.
    for time in (-100, 100):
        bag.tf('/tf', START + time * STEP, 'map', 'odom', np.eye(4))


def add_odometry(bag: CameraBag) -> None:
    for time in (-0.5, 0.5, 1.5, 2.5, 3.5):
        bag.odometry('/odom', START + int(time * STEP), 'base_link', base_pose(time))


def add_poses(bag: CameraBag) -> None:
    for time in (-0.5, 0.5, 1.5, 2.5, 3.5):
        bag.pose('/pose', START + int(time * STEP), base_pose(time))


def no_way_from_tf(bag: CameraBag) -> None:
    add_camera(bag)
    add_tf(bag)
    bag.tf('/tf_static', START, 'cam', 'optical', np.eye(4))


def two_parents(bag: CameraBag) -> None:
    add_camera(bag)
    add_tf(bag)
    add_mount(bag)
    bag.tf('/tf', START, 'world', 'base_link', np.eye(4))


def two_parents_beside_odometry(bag: CameraBag) -> None:
    two_parents(bag)
    add_odometry(bag)
