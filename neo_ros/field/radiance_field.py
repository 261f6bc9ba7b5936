"""What every radiance field can do: `voxel_field`, `torch_field` and `mesh_field`."""
from collections.abc import Iterable
from typing import Protocol

from neo_ros.field.voxel_field import VoxelField
import numpy as np
import torch


class RadianceField(Protocol):
    """Density and colour of one scene, on the machine part that renders it."""

    @property
    def device(self) -> torch.device:
        """Where views that are cut out of its panoramas go."""

    @property
    def near(self) -> float:
        """Metres in front of a camera that are taken for empty."""

    @property
    def voxel(self) -> float:
        """Edge of a voxel in the inner box, metres."""

    def render(self, rays_o: np.ndarray, rays_d: np.ndarray, background: float) -> np.ndarray:
        """Render unit rays float32 (N, 3); returns float32 (N, 6), see `kernels.render_rays`."""

    def mark_seen(self, rays: Iterable[tuple[np.ndarray, np.ndarray]]) -> None:
        """Take for seen what photos' rays_o and rays_d (N, 3) reach, and nothing else."""

    def is_matter(self, points: np.ndarray) -> np.ndarray:
        """Tell which world points (..., 3) lie in cells that are not empty air: bool (...)."""


class FittedField(RadianceField, Protocol):
    """A field while it is fitted."""

    def update_occupancy(self) -> float:
        """Recompute where empty space is; returns the occupied share of all cells."""

    def home(self) -> VoxelField:
        """Return the field with its arrays in main memory, as they are now."""
