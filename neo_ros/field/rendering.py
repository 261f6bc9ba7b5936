"""Render rays and views from a radiance field."""
from typing import NamedTuple

from neo_ros.field.radiance_field import RadianceField
from neo_ros.geometry import CameraPose, Intrinsics
import numpy as np

# What is left of a ray that meets nothing.
BACKGROUND = 0.5


class Rendering(NamedTuple):
    """
    What the field shows along a set of rays (any leading shape).

    image     RGB float32 (..., 3) in [0, 1]
    depth     metres along the ray, float32 (...)
    opacity   float32 (...) in [0, 1]
    coverage  float32 (...) in [0, 1]: opacity from cells that a training camera saw
    """

    image: np.ndarray
    depth: np.ndarray
    opacity: np.ndarray
    coverage: np.ndarray


def render_rays(field: RadianceField, rays_o: np.ndarray, rays_d: np.ndarray) -> Rendering:
    """Render rays with origins (..., 3) in metres and unit directions (..., 3)."""
    lead = rays_d.shape[:-1]
    origins = np.ascontiguousarray(np.broadcast_to(rays_o, rays_d.shape).reshape(-1, 3),
                                   np.float32)
    directions = np.ascontiguousarray(rays_d.reshape(-1, 3), np.float32)
    out = field.render(origins, directions, BACKGROUND)
    return Rendering(out[:, :3].reshape(*lead, 3), out[:, 3].reshape(lead),
                     out[:, 4].reshape(lead), out[:, 5].reshape(lead))


def world_rays(intrinsics: Intrinsics, pose: CameraPose) -> tuple[np.ndarray, np.ndarray]:
    """Return origin (3,) and unit directions (H, W, 3), world frame, float32."""
    directions = intrinsics.pixel_rays() @ pose.T_world_cam[:3, :3].T.astype(np.float32)
    directions /= np.linalg.norm(directions, axis=-1, keepdims=True)
    return pose.position.astype(np.float32), directions


def render_view(field: RadianceField, intrinsics: Intrinsics, pose: CameraPose,
                supersample: int = 2) -> Rendering:
    """Render a view; each pixel is the mean of `supersample` squared rays."""
    rendering = render_rays(field, *world_rays(intrinsics.scaled(supersample), pose))
    return Rendering(*(box_filtered(layer, supersample) for layer in rendering))


def box_filtered(image: np.ndarray, factor: int) -> np.ndarray:
    """Average blocks of factor x factor pixels of (H, W) or (H, W, C)."""
    if factor == 1:
        return image
    height, width = image.shape[0] // factor, image.shape[1] // factor
    blocks = image.reshape(height, factor, width, factor, *image.shape[2:])
    return blocks.mean(axis=(1, 3), dtype=np.float32)


def to_uint8(image: np.ndarray) -> np.ndarray:
    """Convert float [0, 1] to uint8, rounded."""
    return np.clip(image * 255 + 0.5, 0, 255).astype(np.uint8)
