"""Where the camera may be, from others than its image: a prior, and what odometry measured."""
from bisect import bisect_left
from collections import deque
from itertools import islice
import threading
from time import monotonic
from typing import Any

from neo_ros.geometry import CameraPose
from neo_ros.messages.stamps import stamp_of
import numpy as np

# Odometry is kept for so many messages, and believed over a hole of so long.
KEPT, LONGEST_HOLE_NS = 400, 200_000_000
# A robot may be anywhere else after so long.
PRIOR_VALID_S = 10.0


def read_pose(pose: Any) -> CameraPose:
    """Return a `geometry_msgs/Pose`, in the axes of whatever it is the pose of; GeometryError."""
    at, turn = pose.position, pose.orientation
    return CameraPose.from_quaternion(np.array([at.x, at.y, at.z]),
                                      np.array([turn.x, turn.y, turn.z, turn.w]))


class PoseHints:
    """
    A prior that is used once, and the newest odometry; for a thread that gives and one that takes.

    All poses are of the camera's optical frame: of the prior in the scene, of odometry in any
    frame that does not jump.
    """

    def __init__(self) -> None:
        self._lock = threading.Lock()
        self._prior: tuple[CameraPose, float] | None = None  # And when it came.
        self._odometry: deque[tuple[int, CameraPose]] = deque(maxlen=KEPT)

    def set_prior(self, pose: CameraPose, came: float | None = None) -> None:
        """
        Keep a prior for the next image; it takes the place of one that still waits.

        came: when, by `time.monotonic`; default: now.
        """
        with self._lock:
            self._prior = pose, monotonic() if came is None else came

    def add_odometry(self, header: Any, pose: CameraPose) -> None:
        """
        Keep a pose that odometry has measured; time that runs back forgets all before.

        Of several with one stamp the last one counts.
        """
        stamp_ns = stamp_of(header)
        with self._lock:
            if self._odometry and stamp_ns < self._odometry[-1][0]:
                self._odometry.clear()
            elif self._odometry and stamp_ns == self._odometry[-1][0]:
                self._odometry.pop()
            self._odometry.append((stamp_ns, pose))

    def take_prior(self) -> CameraPose | None:
        """Return the prior, once; None for one that has waited for too long."""
        with self._lock:
            found, self._prior = self._prior, None
        return found[0] if found and monotonic() - found[1] <= PRIOR_VALID_S else None

    def motion(self, from_ns: int, to_ns: int) -> np.ndarray | None:
        """
        Return the camera's pose at one stamp in its axes at another, (4, 4), or None.

        None where odometry was silent around one of them.
        """
        with self._lock:
            before, after = self._at(from_ns), self._at(to_ns)
        if before is None or after is None:
            return None
        return before.inverse() @ after.T_world_cam

    def _at(self, stamp_ns: int) -> CameraPose | None:
        known = self._odometry
        index = bisect_left(known, stamp_ns, key=lambda entry: entry[0])
        if index == len(known):
            return self._beyond(stamp_ns)
        if index == 0:
            return known[0][1] if known[0][0] == stamp_ns else None
        (one_ns, one), (other_ns, other) = known[index - 1], known[index]
        if other_ns - one_ns > LONGEST_HOLE_NS:
            return None
        return one.interpolated(other, (stamp_ns - one_ns) / (other_ns - one_ns))

    def _beyond(self, stamp_ns: int) -> CameraPose | None:
        """
        Return where the camera is a little after the newest odometry, or None.

        Images are often newer: it moves on as it did over at least as long before. From a shorter
        time, as between two messages that came at once, noise would grow without bound.
        """
        if not self._odometry:
            return None
        newest_ns, newest = self._odometry[-1]
        ahead_ns, before_ns = stamp_ns - newest_ns, newest_ns
        if ahead_ns > LONGEST_HOLE_NS:
            return None
        for base_ns, base in islice(reversed(self._odometry), 1, None):
            if before_ns - base_ns > LONGEST_HOLE_NS:
                break
            before_ns, known_ns = base_ns, newest_ns - base_ns
            if known_ns >= ahead_ns:
                step = base.inverse() @ base.interpolated(newest, 1.0).T_world_cam
                onward = CameraPose.nearest(newest.T_world_cam @ step)
                return newest.interpolated(onward, ahead_ns / known_ns)
        return None
