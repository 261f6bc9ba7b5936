"""
A room to look at, and the volume renderer in plain torch, as slow and as simple as it gets.

Everything in float64, without empty-space skipping and without thresholds.
"""
import math
from typing import NamedTuple

from neo_ros.field.voxel_field import VoxelField
from neo_ros.geometry import CameraPose
import numpy as np
import torch

CENTRE = np.array([1.0, -0.5, 1.2])
WALLS = np.array([2.0, 1.6, 1.1])  # half extents of the room, metres


def room_field(voxels: int = 60_000, half_extent: np.ndarray = WALLS * 1.15,
               sh_degree: int = 0, walls: np.ndarray = WALLS) -> VoxelField:
    """Fill everything but a box-shaped room with matter in soft colours; its air is empty."""
    field = VoxelField.empty(voxels, CENTRE, half_extent, 0.2, sh_degree)
    points = field.world_points().reshape(-1, 3) - CENTRE
    depth = (np.abs(points) - walls).max(-1)  # metres inside the walls
    field.grid[:, 0] = np.clip(8 + 40 * depth / field.voxel, -8, 40)
    on_wall = np.clip(points, -walls, walls)
    for channel, waves in enumerate(([1.1, 0.7, 0.3], [0.2, 1.3, 0.9], [0.8, 0.1, 1.2])):
        field.grid[:, 1 + channel * field.terms] = 6 * np.sin(on_wall @ np.array(waves) + channel)
    return field


def standing(x: float = 0.0, y: float = 0.0, yaw: float = 0.0) -> CameraPose:
    """Place a camera in the room, relative to its centre."""
    return CameraPose.from_planar(CENTRE[0] + x, CENTRE[1] + y, CENTRE[2], yaw)


def random_rays(count: int, seed: int) -> tuple[np.ndarray, np.ndarray]:
    """Return origins in the middle of the room and unit directions, float32 (count, 3)."""
    random = np.random.default_rng(seed)
    origins = CENTRE + random.uniform(-0.6, 0.6, (count, 3))
    directions = random.normal(size=(count, 3))
    directions /= np.linalg.norm(directions, axis=1, keepdims=True)
    return origins.astype(np.float32), directions.astype(np.float32)


class PlainSamples(NamedTuple):
    """Samples of rays, torch float64: (R, S), colour (R, S, 3), light left behind (R,)."""

    weight: torch.Tensor
    alpha: torch.Tensor
    depth: torch.Tensor
    colour: torch.Tensor
    light: torch.Tensor


def plain_samples(field: VoxelField, grid: torch.Tensor, rays_o: np.ndarray,
                  rays_d: np.ndarray, jitter: np.ndarray) -> PlainSamples:
    """March rays (R, 3) through `grid`, a float64 tensor of the shape of field.grid."""
    points, depth, inside = _sample_points(field, rays_o, rays_d, jitter)
    where = torch.from_numpy(field.grid_position(points))[None, None].flip(-1)
    volume = grid.T.reshape(1, -1, *field.shape)
    values = torch.nn.functional.grid_sample(
        volume, where, mode='bilinear', padding_mode='border', align_corners=True)[0, :, 0]
    sigma = torch.nn.functional.softplus(values[0] + field.shift)
    alpha = (1 - torch.exp(-sigma * field.step)) * torch.from_numpy(inside)
    before = torch.cumprod(torch.cat([torch.ones_like(alpha[:, :1]), 1 - alpha], 1), 1)
    basis = plain_basis(torch.from_numpy(rays_d.astype(np.float64)), field.terms)
    coefficients = values[1:].unflatten(0, (3, field.terms))
    colour = torch.sigmoid(torch.einsum('ckrs,rk->rsc', coefficients, basis))
    return PlainSamples(alpha * before[:, :-1], alpha, torch.from_numpy(depth), colour,
                        before[:, -1])


def _sample_points(field: VoxelField, rays_o: np.ndarray, rays_d: np.ndarray,
                   jitter: np.ndarray) -> tuple[np.ndarray, np.ndarray, np.ndarray]:
    """Return points (R, S, 3), their distance (R, S), and whether they are near enough."""
    length = field.step * field.voxel
    t = field.near + jitter.astype(np.float64) * length
    points, depths, inside = [], [], []
    for _ in range(field.sample_limit):
        point = rays_o + t[:, None] * rays_d.astype(np.float64)
        norm = np.abs((point - field.centre) / field.half_extent).max(1)
        points.append(point)
        depths.append(t)
        inside.append(norm <= 1000)
        # As far as the ray takes to move as far through the grid as inside the box.
        little = 1e-6 * np.maximum(norm, 1)[:, None]
        moved = field.grid_position(point + little * rays_d) - field.grid_position(point)
        speed = np.linalg.norm(moved / little * field.half_extent * (1 + field.shell), axis=1)
        t = t + np.where(norm <= 1000, length / np.maximum(speed, 1e-9), 0)
    return np.stack(points, 1), np.stack(depths, 1), np.stack(inside, 1)


def plain_basis(directions: torch.Tensor, terms: int) -> torch.Tensor:
    """Real spherical harmonics of degree 0 or 1 of unit directions (R, 3): (R, terms)."""
    assert terms in (1, 4)
    x, y, z = directions.T
    linear = math.sqrt(3 / (4 * math.pi))
    constant = torch.full_like(x, math.sqrt(1 / (4 * math.pi)))
    return torch.stack([constant, -linear * y, linear * z, -linear * x][:terms], 1)
