"""Fewer, sharper frames from a video: the sharpest of every step of the camera."""
import math

from neo_ros.captures.capture import Capture
from neo_ros.errors import ConfigError, SceneError
from neo_ros.geometry import CameraPose
from neo_ros.geometry.camera_pose import rotation_angle
from neo_ros.machine.progress import no_progress, Progress
from neo_ros.pictures.sharpness import sharpness
import numpy as np


def select_frames(capture: Capture, distance: float | None, angle: float | None,
                  progress: Progress = no_progress) -> Capture:
    """
    Keep the sharpest frame of every step of `distance` metres or `angle` radians.

    A step ends where the camera is so far from where the step began, or with a new path. Frames
    that cannot be read are never kept. None switches a criterion off. Raises SceneError where no
    frame can be read.
    """
    for name, value in (('distance', distance), ('angle', angle)):
        if value is not None and not (math.isfinite(value) and value > 0):
            raise ConfigError(f'keyframe {name}: expected a number > 0, got {value}')
    poses = [frame.pose for frame in capture.frames if frame.pose is not None]
    steps = split_steps(poses, [frame.path_id for frame in capture.frames],
                        math.inf if distance is None else distance,
                        math.inf if angle is None else angle)
    scores = np.full(len(capture), -1.0)
    for done, (index, image) in enumerate(capture.images(range(len(capture))), start=1):
        if image is not None:
            scores[index] = sharpness(image)
        progress(done, len(capture))
    chosen = [max(step, key=lambda index: scores[index]) for step in steps]
    chosen = [index for index in chosen if scores[index] >= 0]
    if not chosen:
        raise SceneError(f'none of the {len(capture)} images can be read')
    return capture.subset(chosen, f'{len(chosen)} keyframes chosen of {len(capture)} frames, '
                                  'the sharpest of every step')


def split_steps(poses: list[CameraPose], path_ids: list[int], distance: float,
                angle: float) -> list[range]:
    """Return ranges of consecutive frames that lie within one step of their first one."""
    starts: list[int] = []
    for index, pose in enumerate(poses):
        if starts:
            first = poses[starts[-1]]
            turned = rotation_angle(
                first.T_world_cam[:3, :3].T @ pose.T_world_cam[:3, :3])
            moved = np.linalg.norm(pose.position - first.position)
            if (moved < distance and turned < angle
                    and path_ids[starts[-1]] == path_ids[index]):
                continue
        starts.append(index)
    return [range(start, end) for start, end in zip(starts, starts[1:] + [len(poses)])]
