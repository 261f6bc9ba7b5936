"""
The faults of a robot's depth camera, put into true depth.

Noise grows with the square of the distance (Nguyen, Izadi, Lovell 2012, axial noise of a
Kinect), steps are those of disparity in eighths of a pixel, there are holes at edges and beyond
the sensor's reach.
"""
from dataclasses import dataclass

import cv2
import numpy as np


@dataclass(frozen=True)
class DepthSensor:
    """A Kinect's model; metres."""

    least: float = 0.4
    most: float = 5.0
    # sigma = noise + noise_square * (z - least)^2
    noise: float = 0.0012
    noise_square: float = 0.0019
    # Two readings differ by z^2 times this: 1 / (8 * focal length in pixels * baseline).
    step_square: float = 1 / (8 * 580 * 0.075)
    # Neighbours whose depths differ by more than this share are an edge: no reading there.
    edge: float = 0.1

    def reading(self, depth: np.ndarray, random: np.random.Generator) -> np.ndarray:
        """
        Return what the sensor reads of true depth float32 (H, W), metres along the optical axis.

        NaN where it reads nothing; unknown depth (0 or NaN) stays unknown.
        """
        z = np.nan_to_num(depth.astype(np.float64), nan=0.0, posinf=0.0)
        noisy = z + random.standard_normal(z.shape) * (
            self.noise + self.noise_square * (z - self.least) ** 2)
        step = np.maximum(noisy ** 2 * self.step_square, 1e-6)
        read = np.rint(noisy / step) * step
        kernel = np.ones((3, 3), np.uint8)
        edge = cv2.dilate(z, kernel) - cv2.erode(z, kernel) > self.edge * z
        seen = (z >= self.least) & (z <= self.most) & ~edge
        return np.where(seen, read, np.nan).astype(np.float32)
