"""
Many wide views from one position: render a panorama once, then cut every view out of it.

The paper renders 72 yaws at each grid point; all of them share their rays. A panorama a little
finer than the views costs as much as a few of them and yields any number.
"""
from dataclasses import dataclass

import cv2
from neo_ros.field.radiance_field import RadianceField
from neo_ros.field.rendering import render_rays, to_uint8
from neo_ros.geometry import Band, Intrinsics
import numpy as np

# A view's pixels are coarsest in its middle; up to so many panorama pixels are spent on one there.
MOST_DENSE = 2.0
# Radians around the sampled headings, which are not quite the extreme ones.
MARGIN = 0.05
# A surface within so many voxels of where rays begin is one that the camera stands in.
BLOCKED_VOXELS = 3


@dataclass(frozen=True, eq=False)
class Panorama:
    """
    What is seen from `position` (3,) in a band of the sphere.

    image: RGBA uint8 (H, W, 4); A is coverage, 255 = seen by a training camera.
    opacity: its mean, in [0, 1]. blocked: share of the rays that end right in front of the lens.
    """

    position: np.ndarray
    image: np.ndarray
    band: Band
    opacity: float = 1.0
    blocked: float = 0.0

    def cut_view(self, view: Intrinsics, R_world_cam: np.ndarray) -> np.ndarray:
        """
        Return RGBA uint8 (H, W, 4) of the view with that rotation (OpenCV camera axes).

        Outside the band nothing is covered: A is 0 there.
        """
        # One point a pixel: four of them averaged take three times as long, and are no nearer to
        # what the field shows (living_room: 46.0 instead of 46.6 dB).
        rays = view.pixel_rays() @ R_world_cam.T.astype(np.float32)
        height, width = self.image.shape[:2]
        columns, rows = np.moveaxis(self.band.pixels(rays, height, width), -1, 0)
        cut = cv2.remap(self.image, columns, np.clip(rows, 0, height - 1), cv2.INTER_LINEAR,
                        borderMode=cv2.BORDER_WRAP)
        cut[(rows < -1) | (rows > height) | (columns < -1), 3] = 0
        return cut


def render_panorama(field: RadianceField, position: np.ndarray, view: Intrinsics,
                    band: Band) -> Panorama:
    """Render a band of the sphere around a position for views like `view`."""
    rendering = render_rays(field, position, band.rays(*panorama_size(view, band)))
    image = np.dstack([rendering.image, rendering.coverage])
    near = rendering.depth < field.near + BLOCKED_VOXELS * field.voxel
    return Panorama(np.asarray(position), to_uint8(image), band, float(rendering.opacity.mean()),
                    float((near & (rendering.opacity > 0.5)).mean()))


def panorama_size(view: Intrinsics, band: Band) -> tuple[int, int]:
    """Return height and width, pixels, of a panorama for views like `view`."""
    # At the rim a perspective view has 1 / cos^2 as many pixels per radian as in its middle.
    density = min(1 / np.cos(max(view.hfov, view.vfov) / 2) ** 2, MOST_DENSE)
    return (max(int((band.top - band.bottom) * view.fy * density), 2),
            int(band.width * view.fx * density))


def view_band(view: Intrinsics, rotations: np.ndarray, yaw_range: tuple[float, float]) -> Band:
    """
    Find the band that views with these camera-to-world rotations (N, 3, 3) need.

    yaw_range is the (low, width) that their headings lie in, radians.
    """
    rays = view.pixel_rays()
    border = np.concatenate([rays[0], rays[-1], rays[:, 0], rays[:, -1]])
    border /= np.linalg.norm(border, axis=-1, keepdims=True)
    world = np.einsum('nij,bj->nbi', rotations, border)
    rise = np.arcsin(np.clip(world[..., 2], -1, 1))
    # The border does not show it when a pole lies inside the image.
    up = _in_image(view, rotations[:, 2, :])
    down = _in_image(view, -rotations[:, 2, :])
    top = np.pi / 2 if up else float(rise.max())
    bottom = -np.pi / 2 if down else float(rise.min())
    heading = np.arctan2(rotations[:, 1, 2], rotations[:, 0, 2])[:, None]
    aside = np.arctan2(world[..., 1], world[..., 0]) - heading
    reach = float(np.abs(np.angle(np.exp(1j * aside))).max()) + MARGIN
    width = yaw_range[1] + 2 * reach
    if up or down or width >= 2 * np.pi:
        return Band(top, bottom)
    return Band(top, bottom, yaw_range[0] - reach, width)


def _in_image(view: Intrinsics, directions: np.ndarray) -> bool:
    """Tell whether any of the directions (N, 3), camera axes, shows in the image."""
    pixels = view.project(directions)
    return bool(((pixels >= 0) & (pixels <= [view.width, view.height])).all(axis=-1).any())
