"""Turn the world of a capture so that z points up, and give its lengths a unit."""
from dataclasses import replace
import math

from neo_ros.captures.capture import Capture
from neo_ros.geometry import CameraPose
from neo_ros.geometry.camera_pose import rotation_from_vector
from neo_ros.scenes.upright import estimate_up, rotation_between
import numpy as np

# A world whose estimated up is farther from +z than this was not levelled by anyone.
CLEARLY_TILTED = math.radians(30)
# Photos on their side point up as well as upright ones of another world, or nearly: then what the
# format says of up counts. Where cameras looked half around, the wrong ones come to 0.7 at most.
NEARLY_AS_WELL = 0.75


def level_world(capture: Capture) -> Capture:
    """
    Turn the world of a posed capture about its origin so that z points up.

    Only poses change, and up is known from now on.
    """
    poses = [frame.pose for frame in capture.frames if frame.pose is not None]
    T = np.eye(4)
    T[:3, :3] = rotation_between(estimate_up(held_poses(capture)), np.array([0.0, 0.0, 1.0]))
    return replace(capture, z_up=True, frames=tuple(
        replace(frame, pose=CameraPose(T @ pose.T_world_cam))
        for frame, pose in zip(capture.frames, poses)))


def stood_up_from_y(capture: Capture) -> Capture:
    """
    Turn a world whose y axis points up, as ARKit's does, so that z points up.

    ARKit stores photos as its sensor lies, so those of a phone that was held upright lie on their
    side. Where the photos were held otherwise, someone has turned the world: it stays as it is.
    """
    poses = [frame.pose for frame in capture.frames if frame.pose is not None]
    turns = _turns_with_y_up(poses)
    if turns is None:
        return capture
    note = '' if not turns else (
        f'the photos {"are upside down" if turns == 2 else "lie on their side"}, as the phone was '
        'held; y is taken for up, as ARKit has it. Views to train with will be held like the '
        'photos: for a camera that is upright, hold the phone across when you record')
    T = np.array([[1.0, 0, 0, 0], [0, 0, -1, 0], [0, 1, 0, 0], [0, 0, 0, 1]])
    return replace(
        capture, z_up=True, quarter_turns=turns, notes=capture.notes + ((note,) if note else ()),
        frames=tuple(replace(frame, pose=CameraPose(T @ pose.T_world_cam))
                     for frame, pose in zip(capture.frames, poses)))


def held_poses(capture: Capture) -> list[CameraPose]:
    """Return the poses of a posed capture as if its photos had been stored upright."""
    return _turned([frame.pose for frame in capture.frames if frame.pose is not None],
                   capture.quarter_turns)


def _turns_with_y_up(poses: list[CameraPose]) -> int | None:
    """Return by how many quarter turns the photos are upright if y is up; None: by none."""
    held = [_turned(poses, turns) for turns in range(4)]
    ups = [estimate_up(one) for one in held]
    upright = [-float(np.mean([pose.T_world_cam[:3, 1] for pose in one], axis=0) @ up)
               for one, up in zip(held, ups)]
    with_y = [turns for turns, up in enumerate(ups) if up[1] >= math.cos(CLEARLY_TILTED)]
    best = max(with_y, key=lambda turns: upright[turns], default=None)
    if best is None or 0 not in with_y and upright[best] < NEARLY_AS_WELL * upright[0]:
        return None
    return best


def _turned(poses: list[CameraPose], quarter_turns: int) -> list[CameraPose]:
    T = np.eye(4)
    T[:3, :3] = rotation_from_vector(np.array([0.0, 0.0, quarter_turns * math.pi / 2])).round()
    return [CameraPose(pose.T_world_cam @ T) for pose in poses]


def scaled(capture: Capture, factor: float) -> Capture:
    """Multiply all lengths of the world of a posed capture, which are metres then."""
    poses = [frame.pose for frame in capture.frames if frame.pose is not None]
    lengths = np.ones((4, 4))
    lengths[:3, 3] = factor
    return replace(capture, arbitrary_scale=False, frames=tuple(
        replace(frame, pose=CameraPose(lengths * pose.T_world_cam))
        for frame, pose in zip(capture.frames, poses)))
