"""
An ordinary camera on an ordinary robot in the demo flat.

Its lens bends straight lines, its exposure follows the light, the robot starts, stops and goes on,
and its odometry drifts until it is located anew.
"""
from collections.abc import Sequence
from dataclasses import dataclass
from functools import lru_cache
import math

import cv2
from neo_ros.flat.demo_flat import encoded
from neo_ros.flat.shapes import srgb
from neo_ros.flat.walks import STEP
from neo_ros.geometry import CameraPose, Intrinsics
from neo_ros.geometry.camera_pose import rotation_from_vector, rotation_vector
from neo_ros.geometry.lens import CENTRE, Lens
import numpy as np

# 640x480 at 69 degrees, as a depth camera's colour stream; a lens with some barrel distortion.
LENS = Lens(Intrinsics.from_hfov(640, 480, math.radians(69)),
            (-0.09, 0.03, 0.0006, -0.0004, 0.0))

# How much light sRGB values stand for, 0 ... 1.
LINEAR = np.array([srgb(f'{value:02x}' * 3)[0] for value in range(256)], np.float32)


@dataclass(frozen=True)
class Drive:
    """How a robot drives: metres a second, seconds of standing still, and to reach its speed."""

    speed: float = 0.4
    stands: float = 1.0       # at the start, in the middle and at the end
    speeds_up: float = 1.0

    def length(self, seconds: float) -> float:
        """Return how many metres are driven in so many seconds."""
        return float(self.distances(np.arange(0, seconds, 0.01), seconds)[-1])

    def distances(self, times: np.ndarray, seconds: float) -> np.ndarray:
        """Return how far the robot has come, metres (N,), at times (N,) of so many seconds."""
        fine = np.arange(0, seconds + 0.01, 0.01)
        from_stop = np.minimum(np.minimum(fine, seconds - fine),
                               np.abs(fine - seconds / 2)) - self.stands
        speed = self.speed * np.clip(from_stop / self.speeds_up, 0, 1)
        return np.interp(times, fine, np.cumsum(speed) * 0.01)


def poses_along(walk: Sequence[CameraPose], distances: np.ndarray) -> list[CameraPose]:
    """Return the poses at distances (N,), metres, along a walk of steps of `walks.STEP`."""
    places = np.clip(distances / STEP, 0, len(walk) - 1 - 1e-9)
    return [walk[int(place)].interpolated(walk[int(place) + 1], place - int(place))
            for place in places.tolist()]


@dataclass(frozen=True)
class Drift:
    """What odometry gets wrong: shares of way and turn, and a turn for each metre, radians."""

    way: float = 0.015
    turn: float = 0.02
    bends: float = 0.01

    def odometry(self, T_map_base: Sequence[np.ndarray]) -> list[np.ndarray]:
        """Return T_odom_base (4, 4) for each of the true poses; the first one is the origin."""
        found = [np.eye(4)]
        for before, now in zip(T_map_base, T_map_base[1:]):
            step = np.linalg.inv(before) @ now
            length = float(np.linalg.norm(step[:3, 3]))
            turned = (1 + self.turn) * rotation_vector(step[:3, :3])
            wrong = np.eye(4)
            wrong[:3, :3] = rotation_from_vector(turned + [0, 0, self.bends * length])
            wrong[:3, 3] = (1 + self.way) * step[:3, 3]
            found.append(found[-1] @ wrong)
        return found


class AutoExposure:
    """A gain that follows the light: see `gain`."""

    TARGET = 0.18     # mean of the linear image
    SECONDS = 0.4     # in which two thirds of a difference are made good

    def __init__(self) -> None:
        self._last: tuple[float, float] | None = None

    def gain(self, image: np.ndarray, seconds: float) -> float:
        """Return the gain of an image, RGB uint8 (H, W, 3), taken at that time."""
        wanted = self.TARGET / max(float(LINEAR[image].mean()), 1e-3)
        if self._last is None:
            gain = wanted
        else:
            before, at = self._last
            gain = before + (wanted - before) * (1 - math.exp((at - seconds) / self.SECONDS))
        self._last = gain, seconds
        return gain


def exposed(image: np.ndarray, gain: float) -> np.ndarray:
    """Return an image, RGB uint8 (H, W, 3), with so much more light; what is too bright clips."""
    return cv2.LUT(image, encoded(np.clip(LINEAR * np.float32(gain), 0, 1)))


def pinhole_around(lens: Lens) -> Intrinsics:
    """Return the pinhole camera, of the same focal length, that sees all that a lens sees."""
    camera = lens.intrinsics
    points = _straight(lens)
    low, high = points.min(0) * (camera.fx, camera.fy), points.max(0) * (camera.fx, camera.fy)
    left, top = (np.ceil(-low) + 2).tolist()
    right, bottom = (np.ceil(high) + 2).tolist()
    return Intrinsics(int(left + right), int(top + bottom), camera.fx, camera.fy, left, top)


def through_lens(image: np.ndarray, pinhole: Intrinsics, lens: Lens) -> np.ndarray:
    """Return what a lens makes of the view of `pinhole_around`, uint8 (H, W, 3)."""
    camera = lens.intrinsics
    where = _straight(lens) * (pinhole.fx, pinhole.fy) + (pinhole.cx - CENTRE, pinhole.cy - CENTRE)
    columns, rows = where.astype(np.float32).T.reshape(2, camera.height, camera.width)
    return cv2.remap(image, np.ascontiguousarray(columns), np.ascontiguousarray(rows),
                     cv2.INTER_CUBIC)


@lru_cache(maxsize=1)
def _straight(lens: Lens) -> np.ndarray:
    """Return where a lens sees its pixels, row by row, float64 (N, 2) on the z = 1 plane."""
    camera = lens.intrinsics
    x, y = np.meshgrid(np.arange(camera.width) + CENTRE, np.arange(camera.height) + CENTRE)
    return lens.straighten(np.stack([x.ravel(), y.ravel()], 1))
