"""
How exactly a pose is known, from what it was found by.

All covariances are float64 (6, 6) in REP-103's order: x, y, z in metres, then rotations about x,
y, z in radians.
"""
from dataclasses import dataclass

from neo_ros.geometry import CameraPose, Intrinsics
from neo_ros.memory.alignment_kernels import equations_in_place, GuideLevel, PhotoLevel
from neo_ros.memory.kernels import Pinhole
from neo_ros.memory.landmarks import Location
import numpy as np


@dataclass(frozen=True)
class CovarianceThresholds:
    """What the covariances are multiplied by, as errors of neighbours are not independent."""

    # So that 95 % of 960 poses of 24 walks through the demo flat lie within what is stated, with
    # the least volume.
    aligned_position: float = 25.0
    aligned_rotation: float = 51.0
    # Hardly any of these poses came from landmarks alone: so that the median is right.
    located: float = 40.0
    # Of grey values, squared: no camera has less noise, but drawn images are free of it.
    least_variance: float = 1e-8
    # Metres that no image makes up for: the scene's own surfaces are not known better.
    floor: float = 0.0019


def aligned_covariance(photo: PhotoLevel, guide: GuideLevel, camera: Intrinsics, scale: float,
                       thresholds: CovarianceThresholds = CovarianceThresholds()) -> np.ndarray:
    """
    Return the covariance of a pose that alignment found, in the camera's own axes.

    photo and guide of the camera at that pose, in one exposure; scale of the residuals' weights.
    """
    H = np.empty((8, 8))
    pinhole = Pinhole(camera.fx, camera.fy, camera.cx, camera.cy)
    variance = max(equations_in_place(photo, guide, pinhole, scale, H), thresholds.least_variance)
    # As if all were known to a metre, a radian, or the whole range of grey: of what the image says
    # nothing, such as the way along stripes, that is left. Gain and bias are free, so they take
    # their part.
    covariance = variance * np.linalg.inv(H + variance * np.eye(8))[:6, :6]
    factor = np.sqrt(np.repeat([thresholds.aligned_position, thresholds.aligned_rotation], 3))
    return covariance * np.outer(factor, factor)


def located_covariance(location: Location,
                       thresholds: CovarianceThresholds = CovarianceThresholds()) -> np.ndarray:
    """Return the covariance of the pose that landmarks gave, in the camera's own axes."""
    pose, camera = location.pose, location.camera
    x, y, z = ((location.points - pose.position) @ pose.T_world_cam[:3, :3]).T
    zero = np.zeros_like(z)
    du = np.stack([camera.fx / z, zero, -camera.fx * x / z ** 2], 1)
    dv = np.stack([zero, camera.fy / z, -camera.fy * y / z ** 2], 1)
    point = np.stack([x, y, z], 1)
    # Where a camera moves and turns, points move and turn the other way.
    J = np.concatenate([np.hstack([-side, np.cross(side, point)]) for side in (du, dv)])
    pixels = np.stack([camera.fx * x / z + camera.cx, camera.fy * y / z + camera.cy], 1)
    squared = ((pixels - location.pixels) ** 2).sum(1).mean()
    variance = max(squared, location.thresholds.least_variance) / 2
    # Of what few landmarks say nothing, such as a turn about the line that they lie on, a metre or
    # a radian is left, as in `aligned_covariance`.
    values, vectors = np.linalg.eigh(J.T @ J)
    return thresholds.located * variance * (vectors / np.maximum(values, variance)) @ vectors.T


def with_floor(covariance: np.ndarray, thresholds: CovarianceThresholds = CovarianceThresholds()
               ) -> np.ndarray:
    """Add to the variances of a position what is never known better."""
    return covariance + np.diag(np.repeat([thresholds.floor ** 2, 0.0], 3))


def in_world(covariance: np.ndarray, pose: CameraPose) -> np.ndarray:
    """Turn a covariance in the camera's axes into one in the world's."""
    turn = np.zeros((6, 6))
    turn[:3, :3] = turn[3:, 3:] = pose.T_world_cam[:3, :3]
    return turn @ covariance @ turn.T
