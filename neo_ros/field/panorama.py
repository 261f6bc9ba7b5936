"""
Many wide views from one position: render a panorama once, then cut every view out of it.

The paper renders 72 yaws at each grid point; all of them share their rays. A panorama with
`DENSITY` times the views' resolution costs as much as a few views and yields any number.
"""
from dataclasses import dataclass

import cv2
from neo_ros.field.rendering import render_rays, to_uint8
from neo_ros.field.voxel_field import RadianceField
from neo_ros.geometry import Intrinsics
import numpy as np

# Panorama pixels per view pixel in the middle of the view, where a view is coarsest.
DENSITY = 2.0
SUPERSAMPLE = 2


@dataclass(frozen=True, eq=False)
class Panorama:
    """
    What is seen from `position`, over all azimuths and a band of elevations.

    image      RGBA uint8 (H, W, 4): A is coverage, 255 = seen by a training camera
    elevation  (top, bottom) radians above the horizon (world z is up)
    """

    position: np.ndarray
    image: np.ndarray
    elevation: tuple[float, float]

    def cut_view(self, view: Intrinsics, R_world_cam: np.ndarray) -> np.ndarray:
        """
        Return RGBA uint8 (H, W, 4) of the view with that rotation (OpenCV camera axes).

        Above and below the panorama's band of elevations nothing is covered: A is 0 there.
        """
        fine = view.scaled(SUPERSAMPLE)
        rays = fine.pixel_rays() @ R_world_cam.T.astype(np.float32)
        height, width = self.image.shape[:2]
        azimuth = np.arctan2(rays[..., 1], rays[..., 0])
        elevation = np.arctan2(rays[..., 2], np.hypot(rays[..., 0], rays[..., 1]))
        top, bottom = self.elevation
        columns = (azimuth / (2 * np.pi) + 0.5) * width - 0.5
        rows = (top - elevation) / (top - bottom) * height - 0.5
        cut = cv2.remap(self.image, columns.astype(np.float32),
                        np.clip(rows, 0, height - 1).astype(np.float32),
                        cv2.INTER_LINEAR, borderMode=cv2.BORDER_WRAP)
        cut[(rows < -1) | (rows > height), 3] = 0
        return cv2.resize(cut, (view.width, view.height), interpolation=cv2.INTER_AREA)


def render_panorama(field: RadianceField, position: np.ndarray, view: Intrinsics,
                    elevation: tuple[float, float]) -> Panorama:
    """Render all azimuths between two elevations (top, bottom), radians, for views like `view`."""
    top, bottom = elevation
    width = int(2 * np.pi * view.fx * DENSITY)
    height = max(int((top - bottom) * view.fy * DENSITY), 2)
    azimuth = ((np.arange(width) + 0.5) / width - 0.5) * 2 * np.pi
    rise = top - (np.arange(height)[:, None] + 0.5) / height * (top - bottom)
    rays = np.stack([np.cos(rise) * np.cos(azimuth), np.cos(rise) * np.sin(azimuth),
                     np.broadcast_to(np.sin(rise), (height, width))], axis=-1)
    rendering = render_rays(field, position, rays.astype(np.float32))
    image = np.dstack([rendering.image, rendering.coverage])
    return Panorama(np.asarray(position), to_uint8(image), elevation)


def elevation_band(view: Intrinsics, rotations: np.ndarray) -> tuple[float, float]:
    """Return (top, bottom) elevations, radians, that views with these rotations (N, 3, 3) need."""
    rays = view.pixel_rays()
    border = np.concatenate([rays[0], rays[-1], rays[:, 0], rays[:, -1]])
    border /= np.linalg.norm(border, axis=-1, keepdims=True)
    rise = np.arcsin(np.clip(border @ rotations[:, 2, :].T, -1, 1))
    top, bottom = float(rise.max()), float(rise.min())
    # The border does not show it when a pole lies inside the image.
    if _any_inside(view, rotations[:, 2, :]):
        top = np.pi / 2
    if _any_inside(view, -rotations[:, 2, :]):
        bottom = -np.pi / 2
    return top, bottom


def _any_inside(view: Intrinsics, directions: np.ndarray) -> bool:
    """Tell whether a view shows any of these directions (N, 3) in its camera's axes."""
    pixels = view.project(directions)
    return bool(((pixels > 0) & (pixels < [view.width, view.height])).all(-1).any())
