"""Poses over time: tracks that are interpolated, and the tree of frames that /tf describes."""
from array import array
from bisect import bisect_left
from collections.abc import Iterable, Sequence
from dataclasses import dataclass, field
import math
from typing import Any

from neo_ros.geometry import CameraPose
from neo_ros.geometry.camera_pose import (
    is_quaternion, rotation_angle, transform_from_quaternion)
from neo_ros.messages.stamps import NS_PER_S, stamp_of
import numpy as np

# Between two poses farther apart nobody knows how the camera moved, unless it stood still.
MAX_GAP_NS = NS_PER_S // 2
STILL_M, STILL_RAD = 0.02, 0.02
# An image may be stamped a little before the first pose or after the last one.
MAX_BEYOND_NS = NS_PER_S // 50
_LAST_NS = (1 << 63) - 1


class PoseTrack:
    """The poses of one frame in another over time; they may come in any order."""

    def __init__(self) -> None:
        # Long bags hold millions: 64 bytes each, and matrices only of those that are asked for.
        self._stamps, self._numbers = array('q'), array('d')
        self._first_ns = 0
        self._sorted = True
        self._moves: bool | None = None

    def __len__(self) -> int:
        self._sort()
        return len(self._stamps)

    def add(self, stamp_ns: int, pose: Sequence[float]) -> None:
        """Add x, y, z and the quaternion x, y, z, w; a later pose of a stamp replaces it."""
        # Damaged stamps may be any numbers.
        stamp_ns = max(-_LAST_NS, min(stamp_ns, _LAST_NS))
        if not self._stamps:
            self._first_ns = stamp_ns
        elif stamp_ns <= self._stamps[-1]:
            self._sorted = False
        self._numbers.extend(pose)
        self._stamps.append(stamp_ns)
        self._moves = None

    @property
    def first(self) -> np.ndarray:
        """The transform (4, 4) that came first."""
        return self._transform(self._place(self._first_ns))

    @property
    def moves(self) -> bool:
        """Whether the frame was ever elsewhere than at first; many mounts are told repeatedly."""
        if self._moves is None:
            self._moves = len(self) > 0 and any(
                not _still(self.first, self._transform(place)) for place in self._not_near())
        return self._moves

    def at(self, stamp_ns: int) -> np.ndarray | None:
        """
        Return the transform at a time; None where it is not known.

        Linear in the position and on the sphere in the rotation, between poses at most half a
        second apart or of a body that stood still.
        """
        if not self._stamps:
            return None
        place = self._place(stamp_ns)
        if place in (0, len(self._stamps)):
            nearest = min(place, len(self._stamps) - 1)
            near = abs(self._stamps[nearest] - stamp_ns) <= MAX_BEYOND_NS
            return self._transform(nearest) if near else None
        before, after = self._stamps[place - 1], self._stamps[place]
        T1 = self._transform(place)
        if after == stamp_ns:
            return T1
        T0 = self._transform(place - 1)
        if after - before > MAX_GAP_NS and not _still(T0, T1):
            return None
        fraction = (stamp_ns - before) / (after - before)
        return CameraPose(T0).interpolated(CameraPose(T1), fraction).T_world_cam

    def neighbours(self, stamp_ns: int) -> list[int]:
        """Return the stamps of the poses right before a time and at or after it, if there."""
        place = self._place(stamp_ns)
        return list(self._stamps[max(place - 1, 0):place + 1])

    def gap_ns(self, stamp_ns: int) -> int:
        """Return how far the poses around a time are apart if that is too far, else 0."""
        place = self._place(stamp_ns)
        if place in (0, len(self._stamps)) or self.at(stamp_ns) is not None:
            return 0
        return self._stamps[place] - self._stamps[place - 1]

    def _place(self, stamp_ns: int) -> int:
        self._sort()
        return bisect_left(self._stamps, stamp_ns)

    def _transform(self, place: int) -> np.ndarray:
        return _transform(self._numbers[7 * place:7 * place + 7])

    def _sort(self) -> None:
        if self._sorted:
            return
        stamps = np.array(self._stamps)
        order = np.argsort(stamps, kind='stable')
        # The last one of each stamp.
        order = order[np.append(np.diff(stamps[order]) != 0, True)]
        self._numbers = array('d', np.array(self._numbers).reshape(-1, 7)[order].tobytes())
        self._stamps = array('q', stamps[order].tobytes())
        self._sorted = True

    def _not_near(self) -> Sequence[int]:
        """Return the places of the poses that are not so near the first one that it is sure."""
        poses = np.array(self._numbers).reshape(-1, 7)
        first = poses[self._place(self._first_ns)]
        with np.errstate(all='ignore'):  # What is too large for this is not near.
            quaternions = poses[:, 3:] / np.linalg.norm(poses[:, 3:], axis=1, keepdims=True)
            cosines = np.abs(quaternions @ (first[3:] / np.linalg.norm(first[3:])))
            moved = np.linalg.norm(poses[:, :3] - first[:3], axis=1)
        # The cosine is that of half the turn.
        near = (moved < STILL_M / 2) & (cosines > math.cos(STILL_RAD / 4))
        return np.flatnonzero(~near).tolist()


# What a transform is called, and what it is: one that changes or one that stays.
Step = tuple[str, PoseTrack | np.ndarray]


@dataclass
class TransformTree:
    """
    Frames and their parents, from tf2_msgs/TFMessage.

    parents  the first parent of every frame
    rivals   another one, of frames that have two: their transforms are of no use
    held     frames whose transform holds until the next one comes, as Foxglove's do
    invalid  counts what was no pose
    """

    parents: dict[str, str] = field(default_factory=dict)
    rivals: dict[str, str] = field(default_factory=dict)
    static: dict[str, np.ndarray] = field(default_factory=dict)
    moving: dict[str, PoseTrack] = field(default_factory=dict)
    held: set[str] = field(default_factory=set)
    invalid: int = 0

    def add(self, message: Any, is_static: bool, held: bool = False) -> None:
        """Take the transforms of one message."""
        for entry in message.transforms:
            parent = frame_name(entry.header.frame_id)
            child = frame_name(entry.child_frame_id)
            if self.parents.setdefault(child, parent) != parent:
                self.rivals[child] = parent
            pose = read_pose(entry.transform.translation, entry.transform.rotation)
            if pose is None:
                self.invalid += 1
            elif is_static:
                self.static[child] = _transform(pose)
            else:
                self.moving.setdefault(child, PoseTrack()).add(stamp_of(entry.header), pose)
                self.held |= {child} if held else set()

    def mount(self, frame: str, parent: str, T_parent_frame: np.ndarray) -> None:
        """Fix a frame (4, 4) to a parent, whatever was said of it before."""
        self.rivals.pop(frame, None)
        self.moving.pop(frame, None)
        self.parents[frame], self.static[frame] = parent, T_parent_frame

    def ancestors(self, frame: str) -> tuple[list[str], str]:
        """Return the frame and all frames above it, and what is wrong if not up to the root."""
        chain = [frame]
        while (parent := self.parents.get(chain[-1])) is not None:
            if chain[-1] in self.rivals:
                return chain, (f'expected one parent of the frame {chain[-1]!r}, got {parent!r} '
                               f'and {self.rivals[chain[-1]]!r}')
            if parent in chain:
                return chain, f'the frames {" -> ".join([*chain, parent])} form a loop'
            chain.append(parent)
        return chain, ''

    def moving_apart(self, chain: list[str]) -> list[str]:
        """Return the frames that move in another tree than a chain's, the topmost first."""
        found = []
        for frame, track in self.moving.items():
            above, fault = self.ancestors(frame)
            if above[-1] != chain[-1] and not fault and track.moves:
                found.append((len(above), frame))
        return [frame for _, frame in sorted(found)]

    def moves(self, frames: Iterable[str]) -> bool:
        """Whether one of the frames moves in its parent."""
        return any(frame in self.moving and self.moving[frame].moves for frame in frames)

    def steps(self, chain: list[str]) -> list[Step]:
        """Return the transforms of a chain of ancestors, from its first frame to its last."""
        return [(f'{frame} in {parent}', self._step(frame))
                for frame, parent in zip(chain, chain[1:])]

    def _step(self, frame: str) -> PoseTrack | np.ndarray:
        track = self.moving.get(frame)
        if track is None:
            return self.static.get(frame, PoseTrack())
        still = frame in self.held and not track.moves
        return track.first if still else track


@dataclass(frozen=True)
class PoseSource:
    """Where a camera was: the product of `steps`, from the camera up to the world."""

    steps: list[Step]

    def at(self, stamp_ns: int) -> np.ndarray | None:
        """Return T_world_cam at a time; None where it is not known."""
        T_world_cam = np.eye(4)
        for _, step in self.steps:
            T = step.at(stamp_ns) if isinstance(step, PoseTrack) else step
            if T is None:
                return None
            T_world_cam = T @ T_world_cam
        return T_world_cam

    def gaps(self, stamps: Sequence[int]) -> str:
        """Say which transforms come too rarely at these times; empty where none does."""
        found = []
        for name, step in self.steps:
            gaps = [gap for stamp_ns in stamps if isinstance(step, PoseTrack)
                    and (gap := step.gap_ns(stamp_ns))]
            if gaps:
                found.append(f'{len(gaps)} lie between poses of {name} that are up to '
                             f'{max(gaps) / NS_PER_S:.2f} s apart')
        return ', '.join(found) + (
            f'; at most {MAX_GAP_NS / NS_PER_S:g} s are interpolated' if found else '')


def read_pose(position: Any, orientation: Any) -> Sequence[float] | None:
    """Return ROS vectors as x, y, z and the quaternion x, y, z, w; None if they are no pose."""
    pose = (position.x, position.y, position.z,
            orientation.x, orientation.y, orientation.z, orientation.w)
    return pose if all(map(math.isfinite, pose[:3])) and is_quaternion(pose[3:]) else None


def frame_name(frame_id: str) -> str:
    """Return a frame id without the leading slash of ROS 1."""
    return frame_id.lstrip('/')


def _transform(pose: Sequence[float]) -> np.ndarray:
    return transform_from_quaternion(np.array(pose[:3]), np.array(pose[3:]))


def _still(T0: np.ndarray, T1: np.ndarray) -> bool:
    moved = np.linalg.norm(T0[:3, 3] - T1[:3, 3])
    turned = rotation_angle(T0[:3, :3].T @ T1[:3, :3])
    return bool(moved <= STILL_M and turned <= STILL_RAD)
