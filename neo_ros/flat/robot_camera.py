"""
An ordinary camera on an ordinary robot in the demo flat.

Its lens bends straight lines, its exposure follows the light, the robot starts, stops and goes on,
and its odometry drifts until it is located anew.
"""
from collections.abc import Sequence
from dataclasses import dataclass
import math

import cv2
from neo_ros.flat.walks import STEP
from neo_ros.geometry import CameraPose, Intrinsics
from neo_ros.geometry.camera_pose import rotation_from_vector, rotation_vector
from neo_ros.geometry.lens import CENTRE, Lens
import numpy as np

# 640x480 at 69 degrees, as a depth camera's colour stream; a lens with some barrel distortion.
LENS = Lens(Intrinsics.from_hfov(640, 480, math.radians(69)),
            (-0.09, 0.03, 0.0006, -0.0004, 0.0))


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
        wanted = self.TARGET / max(float(_linear(image).mean()), 1e-3)
        if self._last is None:
            gain = wanted
        else:
            before, at = self._last
            gain = before + (wanted - before) * (1 - math.exp((at - seconds) / self.SECONDS))
        self._last = gain, seconds
        return gain


def exposed(image: np.ndarray, gain: float) -> np.ndarray:
    """Return an image, RGB uint8 (H, W, 3), with so much more light; what is too bright clips."""
    linear = np.clip(_linear(np.arange(256)) * gain, 0, 1)
    curve = np.where(linear <= 0.0031308, linear * 12.92, 1.055 * linear ** (1 / 2.4) - 0.055)
    return cv2.LUT(image, np.rint(255 * curve).astype(np.uint8))


def pinhole_around(lens: Lens) -> Intrinsics:
    """Return the pinhole camera, of the same focal length, that sees all that a lens sees."""
    camera = lens.intrinsics
    points = lens.straighten(_pixels(camera))
    low, high = points.min(0) * (camera.fx, camera.fy), points.max(0) * (camera.fx, camera.fy)
    left, top = (np.ceil(-low) + 2).tolist()
    right, bottom = (np.ceil(high) + 2).tolist()
    return Intrinsics(int(left + right), int(top + bottom), camera.fx, camera.fy, left, top)


def through_lens(image: np.ndarray, pinhole: Intrinsics, lens: Lens) -> np.ndarray:
    """Return what a lens makes of the view of `pinhole_around`, uint8 (H, W, 3)."""
    camera = lens.intrinsics
    points = lens.straighten(_pixels(camera))
    where = points * (pinhole.fx, pinhole.fy) + (pinhole.cx - CENTRE, pinhole.cy - CENTRE)
    columns, rows = where.astype(np.float32).T.reshape(2, camera.height, camera.width)
    return cv2.remap(image, np.ascontiguousarray(columns), np.ascontiguousarray(rows),
                     cv2.INTER_CUBIC)


def _pixels(camera: Intrinsics) -> np.ndarray:
    """Return the centres of all pixels, row by row, float64 (N, 2)."""
    x, y = np.meshgrid(np.arange(camera.width) + CENTRE, np.arange(camera.height) + CENTRE)
    return np.stack([x.ravel(), y.ravel()], 1)


def _linear(image: np.ndarray) -> np.ndarray:
    """Return how much light sRGB values of 0 ... 255 stand for, 0 ... 1."""
    value = np.asarray(image) / 255
    return np.where(value <= 0.04045, value / 12.92, ((value + 0.055) / 1.055) ** 2.4)
