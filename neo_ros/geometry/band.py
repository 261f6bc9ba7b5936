"""Bands of the sphere around a point: what panoramas show."""
from dataclasses import dataclass
import math

import numpy as np


@dataclass(frozen=True)
class Band:
    """
    The part of the sphere that a panorama covers, radians; world z is up.

    Elevations run from `top` down to `bottom`, azimuths over `width`, at most 2 pi, from `low`
    counter-clockwise. An image's rows go down and its columns clockwise, as they are seen.
    """

    top: float
    bottom: float
    low: float = -math.pi
    width: float = 2 * math.pi

    @property
    def wraps(self) -> bool:
        """Whether an image's last column is a neighbour of its first."""
        return self.width >= 2 * math.pi

    def rays(self, height: int, width: int) -> np.ndarray:
        """Return the unit directions, world frame, of an image's pixels: float32 (H, W, 3)."""
        azimuth = self.low + self.width * (1 - (np.arange(width) + 0.5) / width)
        rise = self.top - (np.arange(height)[:, None] + 0.5) / height * (self.top - self.bottom)
        return np.stack([np.cos(rise) * np.cos(azimuth), np.cos(rise) * np.sin(azimuth),
                         np.broadcast_to(np.sin(rise), (height, width))], -1).astype(np.float32)

    def pixels(self, rays: np.ndarray, height: int, width: int) -> np.ndarray:
        """
        Return where directions (..., 3), of any length, lie in an image: float32 (..., 2).

        Column and row, pixel centres at whole numbers; columns run on to the left of an image
        that does not wrap (-1 and less) for directions outside its azimuths.
        """
        turns = (np.arctan2(rays[..., 1], rays[..., 0]) - self.low) / (2 * np.pi)
        azimuth = 2 * np.pi * (turns - np.floor(turns))  # np.mod is slow.
        rise = np.arctan2(rays[..., 2], np.hypot(rays[..., 0], rays[..., 1]))
        return np.stack([(1 - azimuth / self.width) * width - 0.5,
                         (self.top - rise) / (self.top - self.bottom) * height - 0.5],
                        axis=-1).astype(np.float32)
