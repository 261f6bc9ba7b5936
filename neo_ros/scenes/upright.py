"""Which way is up: turn the world of a scene so that z points up."""
from dataclasses import replace
import logging
import math
from pathlib import Path

from neo_ros.geometry import CameraPose
from neo_ros.geometry.camera_pose import rotation_from_vector
from neo_ros.scenes.posed_images import PosedImages
from neo_ros.scenes.scene import read_scene, Scene
import numpy as np

logger = logging.getLogger(__name__)
# Trainings say so beyond this: RedKitchen, held by hand, leans by 2 degrees, any 50 photos of it
# in a row by 14 at most.
MOST_LEAN = math.radians(15)


def estimate_up(poses: list[CameraPose]) -> np.ndarray:
    """
    Estimate the direction up in the world from how cameras were held, (3,) unit vector.

    People hold cameras level from left to right while they look up, down and around: up is the
    direction that is most nearly at right angles to all the image rows. Where the cameras hardly
    turn, rows say too little, and up is the mean of the images' up.
    """
    mean_up = -np.mean([pose.T_world_cam[:3, 1] for pose in poses], axis=0)
    directions, level = _image_rows(poses)
    up = directions[:, 0] if level[1] else mean_up
    if up @ mean_up < 0:
        up = -up
    norm = float(np.linalg.norm(up))
    return up / norm if norm > 1e-9 else np.array([0.0, 0.0, 1.0])


def _image_rows(poses: list[CameraPose]) -> tuple[np.ndarray, np.ndarray]:
    """Return the main directions of image rows, columns (3, 3), and which lie level: bool (3,)."""
    rows = np.stack([pose.T_world_cam[:3, 0] for pose in poses])
    spread, directions = np.linalg.eigh(rows.T @ rows / len(rows))
    return directions, spread > 0.05 + 2 * spread[0]


def lean(poses: list[CameraPose], axis: np.ndarray) -> float:
    """
    Return how far an axis (3,) is at least from what the image rows allow for up, radians.

    Where the cameras hardly turn, looking down is no lean.
    """
    directions, level = _image_rows(poses)
    return math.asin(min(1.0, float(np.linalg.norm(axis @ directions[:, level]))))


def tilt(poses: list[CameraPose]) -> float:
    """Return the angle between the estimated up and the world's z axis, radians."""
    return math.acos(float(np.clip(estimate_up(poses)[2], -1, 1)))


def read_upright_scene(folder: Path) -> Scene:
    """Read a scene folder with z up, as trainings do; see `read_scene` and `stood_up`."""
    return stood_up(read_scene(folder))


def stood_up(scene: Scene) -> Scene:
    """
    Turn a scene whose world has another axis up so that z is up; by quarter turns only.

    The axis nearest to the estimated up is taken, and the log says so, and where even that is far
    from it. A scene with a floor map, or whose file says `z_up`, has z up by definition and stays
    as it is.
    """
    if _upright(scene):
        return scene
    axis = axis_up(scene)
    angle = lean(list(scene.train.poses), axis)
    if angle > MOST_LEAN:
        logger.warning(
            '%s: the photos were held %.0f degrees from %s, which is taken for up: training views '
            'will lean; import it again with --level, or write "z_up": true into '
            'transforms_train.json if z does point up', scene.name, math.degrees(angle),
            axis_name(axis))
    if axis[2] == 1:
        return scene
    logger.warning(
        '%s: the photos were held with %s up: the world is turned so that z points up; if it '
        'did already, write "z_up": true into transforms_train.json', scene.name, axis_name(axis))
    T = np.eye(4)
    T[:3, :3] = rotation_between(axis, np.array([0.0, 0.0, 1.0])).round()

    def turned(images: PosedImages) -> PosedImages:
        return replace(images, poses=tuple(
            CameraPose(T @ pose.T_world_cam) for pose in images.poses))

    return replace(scene, train=turned(scene.train),
                   test=None if scene.test is None else turned(scene.test), turn=T[:3, :3])


def axis_up(scene: Scene) -> np.ndarray:
    """Return the axis (3,) of the world that points up, by definition or as `stood_up` says."""
    if _upright(scene):
        return np.array([0.0, 0.0, 1.0])
    up = estimate_up(list(scene.train.poses))
    nearest = int(np.abs(up).argmax())
    return np.eye(3)[nearest] * np.sign(up[nearest])


def _upright(scene: Scene) -> bool:
    return scene.walkable is not None or scene.train.z_up


def axis_name(axis: np.ndarray) -> str:
    """Return the name of an axis (3,), such as '-y'."""
    nearest = int(np.abs(axis).argmax())
    return ('-' if axis[nearest] < 0 else '+') + 'xyz'[nearest]


def rotation_between(a: np.ndarray, b: np.ndarray) -> np.ndarray:
    """Return the smallest rotation (3, 3) that turns the unit vector a to b."""
    axis = np.cross(a, b)
    sine = float(np.linalg.norm(axis))
    angle = math.atan2(sine, float(a @ b))
    if sine < 1e-9:
        if angle < 1:
            return np.eye(3)
        axis = np.cross(a, [1.0, 0, 0] if abs(a[0]) < 0.9 else [0, 1.0, 0])
        sine = float(np.linalg.norm(axis))
    return rotation_from_vector(axis / sine * angle)
