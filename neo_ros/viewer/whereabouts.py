"""Where the camera was in the last seconds, and where its last motion leads."""
from collections import deque
from collections.abc import Callable
from dataclasses import dataclass
import threading

from neo_ros.geometry import CameraPose
import numpy as np


@dataclass(frozen=True)
class WhereThresholds:
    """What is kept, and how a motion is continued."""

    # Images of the last seconds, a second apart: of so many the newest ones.
    kept: int = 8
    apart_s: float = 0.7
    # What is older says nothing of a place as it is now.
    recent_s: float = 10.0
    # The motion of so many seconds is continued, for so many at most. A faster one is a jump of
    # the tracking.
    motion_s: float = 0.8
    most_predicted_s: float = 2.0
    most_metres_per_s: float = 3.0


@dataclass(frozen=True, eq=False)
class Place:
    """
    Where the camera was when an image was taken.

    captured: seconds of the viewer's clock. read_image returns the wide image, uint8 RGB
    (H, W, 3), or None where it cannot be read.
    """

    pose: CameraPose
    captured: float
    read_image: Callable[[], np.ndarray | None] = lambda: None


class Whereabouts:
    """The places of one camera; sources put them in, viewers look; any thread may."""

    def __init__(self, thresholds: WhereThresholds = WhereThresholds()) -> None:
        self.thresholds = thresholds
        # How many ask where the camera is; without any, sources need not know.
        self.wanted = 0
        # While a bag is paused: the clock's time of the picture that is shown.
        self.stands: float | None = None
        self._busy = threading.Lock()
        self.forget()

    def forget(self) -> None:
        """Start anew: what comes next may be another time and place."""
        with self._busy:
            self._trail: deque[Place] = deque()
            self._kept: deque[Place] = deque(maxlen=self.thresholds.kept)

    def put(self, place: Place) -> None:
        """Add a place; where time runs back, those before are forgotten."""
        if (last := self.last) is not None and place.captured <= last.captured:
            self.forget()
        with self._busy:
            self._trail.append(place)
            while self._trail[0].captured < place.captured - self.thresholds.motion_s:
                self._trail.popleft()
            if not self._kept or (place.captured - self._kept[-1].captured
                                  >= self.thresholds.apart_s):
                self._kept.append(place)

    @property
    def last(self) -> Place | None:
        """The newest place."""
        with self._busy:
            return self._trail[-1] if self._trail else None

    def recent(self, now: float) -> list[Place]:
        """Return places of the last seconds, the newest first, without the very last one."""
        with self._busy:
            last = self._trail[-1] if self._trail else None
            return [place for place in reversed(self._kept) if place is not last
                    and now - place.captured < self.thresholds.recent_s]

    def predicted(self, now: float) -> np.ndarray | None:
        """Return where the last motion leads until `now`, (3,) metres; None: nowhere."""
        limits = self.thresholds
        with self._busy:
            if not self._trail:
                return None
            last, first = self._trail[-1], self._trail[0]
        ahead = min(max(now - last.captured, 0.0), limits.most_predicted_s)
        took = last.captured - first.captured
        moved = last.pose.position - first.pose.position
        if took < limits.motion_s / 4 or np.linalg.norm(moved) > limits.most_metres_per_s * took:
            return last.pose.position.copy()
        return np.asarray(last.pose.position + moved * (ahead / took))


class PoseJoiner:
    """
    Joins wide images and poses by their stamps, whichever comes first.

    Where the stamps of either run back, a recording was wound back: all before is forgotten.
    """

    def __init__(self, where: Whereabouts) -> None:
        self._where = where
        self._images: deque[tuple[int, float, Callable[[], np.ndarray | None]]] = deque(maxlen=8)
        self._poses: deque[tuple[int, CameraPose]] = deque(maxlen=8)

    def add_image(self, stamp_ns: int, captured: float,
                  read_image: Callable[[], np.ndarray | None]) -> None:
        """Take an image; captured and read_image as of a Place."""
        self._look_back(stamp_ns, [stamp for stamp, *_ in self._images])
        self._images.append((stamp_ns, captured, read_image))
        self._join(stamp_ns)

    def add_pose(self, stamp_ns: int, pose: CameraPose) -> None:
        """Take a pose."""
        self._look_back(stamp_ns, [stamp for stamp, _ in self._poses])
        self._poses.append((stamp_ns, pose))
        self._join(stamp_ns)

    def _look_back(self, stamp_ns: int, before: list[int]) -> None:
        if before and stamp_ns < before[-1]:
            self._images.clear()
            self._poses.clear()
            self._where.forget()

    def _join(self, stamp_ns: int) -> None:
        pose = next((pose for stamp, pose in self._poses if stamp == stamp_ns), None)
        image = next((image for image in self._images if image[0] == stamp_ns), None)
        if pose is not None and image is not None:
            self._where.put(Place(pose, *image[1:]))
