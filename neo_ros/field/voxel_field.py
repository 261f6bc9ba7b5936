"""
The radiance field: a dense voxel grid of density and colour in a contracted world.

In the line of DirectVoxGO (Sun et al., CVPR 2022): raw density is interpolated first and
activated after, so that surfaces may lie between voxels. Colour is spherical harmonics instead
of an MLP: on a CPU that is what makes the field fit in minutes.
"""
from dataclasses import dataclass, field
import math
from pathlib import Path
from typing import Any
from zipfile import BadZipFile

from neo_ros.errors import SceneError
from neo_ros.field import kernels
from neo_ros.paths import whole_file
import numpy as np
import torch

# A cell whose corners all have less opacity a step counts as empty air.
OCCUPIED_ALPHA = 3e-2


@dataclass
class RadianceField:
    """
    Density and colour of one scene.

    grid    float32 (X * Y * Z, 1 + 3K): raw density, then K coefficients for R, G and B
    shape   (X, Y, Z) grid points
    centre, half_extent  of the inner box, world metres, (3,) each
    shell   thickness of the contracted outside, relative to the half extent; 0 = none
    step    ray step in voxels
    near    metres in front of a camera that are taken for empty
    device  what computes: cpu (compiled kernels), cuda, or torch (what cuda does, on the CPU)
    """

    grid: np.ndarray
    shape: tuple[int, int, int]
    centre: np.ndarray
    half_extent: np.ndarray
    shell: float
    step: float = 0.5
    near: float = 0.1
    initial_alpha: float = 1e-4
    skip: np.ndarray = field(init=False)
    seen: np.ndarray = field(init=False)
    device: str = field(init=False, default='cpu')
    mirror: Any = field(init=False, default=None, repr=False, compare=False)

    def __post_init__(self) -> None:
        self.skip = np.zeros(len(self.grid), np.uint8)
        self.seen = np.ones(len(self.grid), np.uint8)

    @classmethod
    def empty(cls, voxels: int, centre: np.ndarray, half_extent: np.ndarray, shell: float,
              sh_degree: int, **settings: Any) -> 'RadianceField':
        """Lay about `voxels` cubic voxels over the box; colour starts mid-grey."""
        extent = 2 * np.asarray(half_extent, np.float64) * (1 + shell)
        edge = (extent.prod() / voxels) ** (1 / 3)
        shape = tuple(max(int(round(length / edge)) + 1, 8) for length in extent)
        grid = np.zeros((math.prod(shape), 1 + 3 * (sh_degree + 1) ** 2), np.float32)
        return cls(grid, shape, np.asarray(centre, np.float64),  # type: ignore[arg-type]
                   np.asarray(half_extent, np.float64), shell, **settings)

    @property
    def terms(self) -> int:
        """Spherical-harmonic coefficients per colour channel: 1, 4 or 9."""
        return (self.grid.shape[1] - 1) // 3

    @property
    def shift(self) -> float:
        """Offset of raw density at which zero means `initial_alpha` a voxel."""
        return math.log(1 / (1 - self.initial_alpha) - 1)

    @property
    def voxel(self) -> float:
        """Edge of a voxel in the inner box, metres."""
        edges = 2 * self.half_extent * (1 + self.shell) / (np.array(self.shape) - 1)
        return float(edges.min())

    @property
    def box(self) -> np.ndarray:
        """What the kernels need of the geometry, float64 (8,)."""
        return np.array([*self.centre, *self.half_extent, self.shell, self.voxel])

    @property
    def sample_limit(self) -> int:
        """Largest number of samples a ray can need."""
        return int(sum(self.shape) / self.step)

    def resampled(self, voxels: int, centre: np.ndarray,
                  half_extent: np.ndarray) -> 'RadianceField':
        """Return the field on about `voxels` voxels over another inner box (trilinear)."""
        result = RadianceField.empty(
            voxels, centre, half_extent, self.shell, math.isqrt(self.terms) - 1,
            step=self.step, near=self.near, initial_alpha=self.initial_alpha)
        result.device = self.device
        self.pull()
        where = self.grid_position(result.world_points()).astype(np.float32)
        volume = torch.from_numpy(self.grid).T.reshape(1, -1, *self.shape)
        # grid_sample names the last axis first.
        sampled = torch.nn.functional.grid_sample(
            volume, torch.from_numpy(where[..., ::-1].copy())[None], mode='bilinear',
            padding_mode='border', align_corners=True)
        result.grid = sampled[0].flatten(1).T.contiguous().numpy()
        return result

    def world_points(self) -> np.ndarray:
        """World positions of all grid points, float64 (X, Y, Z, 3); the inverse contraction."""
        axes = [np.linspace(-1, 1, size) * (1 + self.shell) for size in self.shape]
        points = np.stack(np.meshgrid(*axes, indexing='ij'), axis=-1)
        norm = np.abs(points).max(-1, keepdims=True)
        # The outermost points lie at infinity; a large number does for them.
        far = self.shell / np.maximum(1 + self.shell - norm, max(1e-2 * self.shell, 1e-9))
        points = np.where(norm > 1, points / np.maximum(norm, 1e-9) * far, points)
        return points * self.half_extent + self.centre

    def grid_position(self, points: np.ndarray) -> np.ndarray:
        """Contract world points (..., 3) to grid coordinates in [-1, 1]."""
        position = (points - self.centre) / self.half_extent
        norm = np.maximum(np.abs(position).max(-1, keepdims=True), 1e-9)
        squeezed = position / norm * (1 + self.shell - self.shell / norm)
        return np.where(norm > 1, squeezed, position) / (1 + self.shell)

    def is_matter(self, points: np.ndarray) -> np.ndarray:
        """Tell which world points (..., 3) lie in cells that are not empty air: bool (...)."""
        size = np.array(self.shape)
        place = (self.grid_position(np.asarray(points)) + 1) / 2 * (size - 1)
        x, y, z = np.moveaxis(np.clip(place.astype(int), 0, size - 2), -1, 0)
        return self.skip[(x * size[1] + y) * size[2] + z] == 0

    def update_occupancy(self) -> float:
        """
        Recompute the empty-space distances; returns the occupied share of all cells.

        A field that is empty still, early in a fit, is searched everywhere.
        """
        if self.device != 'cpu':
            from neo_ros.field.torch_field import on_device
            mirror = on_device(self)
            share = mirror.update_occupancy()
            self.skip = mirror.skip.cpu().numpy()
            mirror.source = (self.grid, self.skip, self.seen)
            return share
        from scipy.ndimage import distance_transform_cdt
        occupied = np.zeros(len(self.grid), np.bool_)
        kernels.mark_occupied(self.grid, np.array(self.shape), self.step, self.shift,
                              OCCUPIED_ALPHA, occupied)
        if not occupied.any():
            self.skip[:] = 0
            return 0.0
        distance = distance_transform_cdt(~occupied.reshape(self.shape), 'chessboard')
        self.skip = np.minimum(distance, 255).astype(np.uint8).ravel()
        return float(occupied.mean())

    def pull(self) -> None:
        """Bring home what a fit on the device has changed."""
        if self.mirror is not None:
            np.copyto(self.grid, self.mirror.grid.cpu().numpy())

    def save(self, path: Path) -> None:
        """Write the field as .npz; a kill or a full disk in between leaves the old file whole."""
        try:
            with whole_file(path) as partial, partial.open('wb') as file:
                np.savez(file, grid=self.grid, shape=self.shape, centre=self.centre,
                         half_extent=self.half_extent, seen=self.seen,
                         settings=[self.shell, self.step, self.near, self.initial_alpha])
        except OSError as error:
            raise SceneError(f'{path}: cannot write the field: {error.strerror}') from error

    @classmethod
    def load(cls, path: Path, device: str = 'cpu') -> 'RadianceField':
        """Read what `save` wrote, to be rendered on a device; SceneError for other files."""
        try:
            with np.load(path) as data:
                shell, step, near, initial_alpha = data['settings']
                result = cls(data['grid'], tuple(int(n) for n in data['shape']),  # type: ignore
                             data['centre'], data['half_extent'], float(shell), float(step),
                             float(near), float(initial_alpha))
                result.seen = data['seen']
        except (OSError, ValueError, KeyError, EOFError, BadZipFile) as error:
            raise SceneError(f'{path}: expected a radiance field: {error}') from error
        result.device = device
        result.update_occupancy()
        return result
