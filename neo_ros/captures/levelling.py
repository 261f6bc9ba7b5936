"""Turn the world of a capture so that z points up, and give its lengths a unit."""
from dataclasses import replace
import math

from neo_ros.captures.capture import Capture
from neo_ros.geometry import CameraPose
from neo_ros.scenes.upright import estimate_up, rotation_between
import numpy as np

# A world whose estimated up is farther from +z than this was not levelled by anyone.
CLEARLY_TILTED = math.radians(30)


def level_world(capture: Capture) -> Capture:
    """
    Turn the world of a posed capture about its origin so that z points up.

    Only poses change, and up is known from now on.
    """
    poses = [frame.pose for frame in capture.frames if frame.pose is not None]
    T = np.eye(4)
    T[:3, :3] = rotation_between(estimate_up(poses), np.array([0.0, 0.0, 1.0]))
    return replace(capture, z_up=True, frames=tuple(
        replace(frame, pose=CameraPose(T @ pose.T_world_cam))
        for frame, pose in zip(capture.frames, poses)))


def stood_up_from_y(capture: Capture) -> Capture:
    """
    Turn a world whose y axis points up, as ARKit's does, so that z points up.

    Where the photos were held otherwise, someone has turned the world: it stays as it is.
    """
    poses = [frame.pose for frame in capture.frames if frame.pose is not None]
    if estimate_up(poses)[1] < math.cos(CLEARLY_TILTED):
        return capture
    T = np.array([[1.0, 0, 0, 0], [0, 0, -1, 0], [0, 1, 0, 0], [0, 0, 0, 1]])
    return replace(capture, z_up=True, frames=tuple(
        replace(frame, pose=CameraPose(T @ pose.T_world_cam))
        for frame, pose in zip(capture.frames, poses)))


def scaled(capture: Capture, factor: float) -> Capture:
    """Multiply all lengths of the world of a posed capture, which are metres then."""
    poses = [frame.pose for frame in capture.frames if frame.pose is not None]
    lengths = np.ones((4, 4))
    lengths[:3, 3] = factor
    return replace(capture, arbitrary_scale=False, frames=tuple(
        replace(frame, pose=CameraPose(lengths * pose.T_world_cam))
        for frame, pose in zip(capture.frames, poses)))
