"""
The voxel grid of density and colour in a contracted world, and how compiled kernels render it.

In the line of DirectVoxGO (Sun et al., CVPR 2022): raw density is interpolated first and
activated after, so that surfaces may lie between voxels. Colour is spherical harmonics instead
of an MLP: on a CPU that is what makes the field fit in minutes.
"""
from collections.abc import Iterable
from dataclasses import dataclass, field, replace
import math
from pathlib import Path
from typing import Any, ClassVar

from neo_ros.errors import SceneError
from neo_ros.field import kernels
from neo_ros.field.field_file import check_shapes, write_field
from neo_ros.field.grid_points import (
    cells_apart, dilated, lattice_box, numbered, packed, unpacked)
import numpy as np
import torch

# A cell whose corners all have less opacity a step counts as empty air.
OCCUPIED_ALPHA = 3e-2
# Cells of air around matter whose points a sparse field keeps: surfaces move while it is fitted.
AIR_KEPT = 1
# The first spherical harmonic, the same in all directions.
BAND_0 = 0.28209479
# A colour of 0 or 1 has no finite coefficient.
DARKEST = 0.01


@dataclass
class VoxelField:
    """
    Density and colour of one scene, a `RadianceField` on the CPU.

    grid    float32 (V, 1 + 3K): raw density, then K coefficients for R, G and B
    shape   (X, Y, Z) grid points
    centre, half_extent  of the inner box, world metres, (3,) each
    shell   thickness of the contracted outside, relative to the half extent; 0 = none
    step    ray step in voxels
    near    metres in front of a camera that are taken for empty
    row_of  int32 (X * Y * Z,): the row of each grid point in `grid`, -1 for air that is not kept
    searched  bool (X, Y, Z): cells that rays sample even if they are air; None: no cell
    """

    grid: np.ndarray
    shape: tuple[int, int, int]
    centre: np.ndarray
    half_extent: np.ndarray
    shell: float
    step: float = 0.5
    near: float = 0.1
    initial_alpha: float = 1e-4
    row_of: Any = None
    searched: np.ndarray | None = None
    skip: np.ndarray = field(init=False)
    seen: np.ndarray = field(init=False)
    device: ClassVar = torch.device('cpu')

    def __post_init__(self) -> None:
        points = math.prod(self.shape)
        if self.row_of is None:
            self.row_of = np.arange(points, dtype=np.int32)
        self.skip = np.zeros(points, np.uint8)
        self.seen = np.ones(points, np.uint8)

    @classmethod
    def empty(cls, voxels: int, centre: np.ndarray, half_extent: np.ndarray, shell: float,
              sh_degree: int, **settings: Any) -> 'VoxelField':
        """Lay about `voxels` cubic voxels over the box; colour starts mid-grey."""
        extent = 2 * np.asarray(half_extent, np.float64) * (1 + shell)
        edge = (extent.prod() / voxels) ** (1 / 3)
        shape = tuple(max(int(round(length / edge)) + 1, 8) for length in extent)
        grid = np.zeros((math.prod(shape), 1 + 3 * (sh_degree + 1) ** 2), np.float32)
        return cls(grid, shape, np.asarray(centre, np.float64),  # type: ignore[arg-type]
                   np.asarray(half_extent, np.float64), shell, **settings)

    @classmethod
    def on_lattice(cls, low: np.ndarray, high: np.ndarray, edge: float, shell: float,
                   sh_degree: int, **settings: Any) -> 'VoxelField':
        """
        Lay voxels of this edge, metres, over a box from low to high (3,), or a little more.

        Their corners are multiples of the edge: two such fields have their points in common.
        """
        _, cells, centre, half_extent = lattice_box(low, high, edge, 0.0, shell)
        shape = tuple((cells + 1).tolist())
        grid = np.zeros((math.prod(shape), 1 + 3 * (sh_degree + 1) ** 2), np.float32)
        return cls(grid, shape, centre, half_extent, shell, **settings)

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

    def resampled(self, voxels: int, centre: np.ndarray, half_extent: np.ndarray,
                  sparse: bool = False) -> 'VoxelField':
        """Return the field on about `voxels` grid points over another inner box."""
        return self.onto(VoxelField.empty(
            voxels, centre, half_extent, self.shell, math.isqrt(self.terms) - 1,
            step=self.step, near=self.near, initial_alpha=self.initial_alpha), sparse)

    def onto(self, result: 'VoxelField', sparse: bool = False) -> 'VoxelField':
        """
        Bring the field to the grid of another one (trilinear), and return that.

        A sparse one keeps the points of occupied cells and of those `AIR_KEPT` cells around.
        Every point of this field must be kept.
        """
        kept = np.ones(result.shape, np.bool_)
        if sparse:
            raw = self.values_at(result, kept, 1)
            kept = dilated(result.occupied(raw).reshape(result.shape), AIR_KEPT)
            kept |= not kept.any()  # A field that is empty still is searched everywhere.
        result.row_of = numbered(kept)
        result.grid = self.values_at(result, kept, self.grid.shape[1])
        return result

    def values_at(self, other: 'VoxelField', kept: np.ndarray, columns: int) -> np.ndarray:
        """Interpolate the first columns of the grid at points `kept` (X, Y, Z) of another."""
        volume = torch.from_numpy(self.grid[:, :columns].T.reshape(1, columns, *self.shape))
        values = []
        for plane in range(other.shape[0]):  # One by one: positions are float64.
            index = np.stack(np.nonzero(kept[plane:plane + 1]), -1) + [plane, 0, 0]
            # grid_sample names the last axis first.
            where = self.grid_position(other.world_points(index))[:, ::-1].astype(np.float32)
            values.append(torch.nn.functional.grid_sample(
                volume, torch.from_numpy(where)[None, None, None], mode='bilinear',
                padding_mode='border', align_corners=True)[0, :, 0, 0])
        return torch.cat(values, 1).T.contiguous().numpy()

    def world_points(self, index: np.ndarray | None = None) -> np.ndarray:
        """
        World positions of grid points, float64 (..., 3); the inverse contraction.

        index (..., 3) names some of them; without it they are all, (X, Y, Z, 3).
        """
        if index is None:
            index = np.moveaxis(np.indices(self.shape), 0, -1)
        points = (2 * index / (np.array(self.shape) - 1) - 1) * (1 + self.shell)
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

    def of_seen_cells(self) -> 'VoxelField':
        """Return the field without the points that are a corner of no seen cell."""
        result = self.keeping(
            (self.row_of >= 0) & dilated(self.seen.reshape(self.shape), 0).ravel())
        result.update_occupancy()
        return result

    def keeping(self, points: np.ndarray) -> 'VoxelField':
        """Return the field of just these points, bool (X * Y * Z,): air where it had none."""
        row_of = numbered(points)
        grid = np.zeros((int(points.sum()), self.grid.shape[1]), np.float32)
        both = points & (self.row_of >= 0)
        grid[row_of[both]] = self.grid[self.row_of[both]]
        result = replace(self, grid=grid, row_of=row_of)
        result.seen = self.seen.copy()
        return result

    def with_air(self) -> 'VoxelField':
        """Return the field with all of its points."""
        return self.keeping(np.ones(len(self.row_of), np.bool_))

    @property
    def matter(self) -> np.ndarray:
        """Tell which cells are not empty air, bool (X, Y, Z), even among those `searched`."""
        return self.occupied(self.grid).reshape(self.shape)

    def cells_at(self, points: np.ndarray) -> np.ndarray:
        """Return the cells that world points (..., 3) lie in, or the nearest: int (..., 3)."""
        return np.clip(self._place(points).astype(int), 0, np.array(self.shape) - 2)

    def points_at(self, points: np.ndarray) -> np.ndarray:
        """Return the grid points that are nearest to world points (..., 3): int (..., 3)."""
        return np.clip(np.rint(self._place(points)).astype(int), 0, np.array(self.shape) - 1)

    def _place(self, points: np.ndarray) -> np.ndarray:
        """Return where world points (..., 3) lie, counted in grid points."""
        return (self.grid_position(np.asarray(points)) + 1) / 2 * (np.array(self.shape) - 1)

    def is_matter(self, points: np.ndarray) -> np.ndarray:
        """Tell which world points (..., 3) lie in cells that are not empty air: bool (...)."""
        x, y, z = np.moveaxis(self.cells_at(points), -1, 0)
        return self.skip[(x * self.shape[1] + y) * self.shape[2] + z] == 0

    def update_occupancy(self) -> float:
        """
        Recompute the empty-space distances; returns the occupied share of all cells.

        A field that is empty still, early in a fit, is searched everywhere; a sparse one, which
        has no rows for that, nowhere.
        """
        occupied = self.occupied(self.grid)
        if not occupied.any():
            self.skip[:] = len(self.grid) < len(self.row_of)
            return 0.0
        if self.searched is not None:
            occupied |= self.searched.ravel()
        self.skip = cells_apart(occupied.reshape(self.shape)).ravel()
        return float(occupied.mean())

    def occupied(self, grid: np.ndarray) -> np.ndarray:
        """Tell which cells of the grid are not air: bool (X * Y * Z,)."""
        occupied = np.zeros(len(self.row_of), np.bool_)
        kernels.mark_occupied(grid, self.row_of, np.array(self.shape), self.step, self.shift,
                              OCCUPIED_ALPHA, occupied)
        return occupied

    @property
    def arrays(self) -> kernels.FieldArrays:
        """What the kernels take."""
        return kernels.FieldArrays(
            self.grid, self.row_of, np.array(self.shape), self.skip, self.seen, self.box,
            self.step, self.near, self.shift, self.terms, self.sample_limit)

    def render(self, rays_o: np.ndarray, rays_d: np.ndarray, background: float) -> np.ndarray:
        """Render unit rays float32 (N, 3); returns float32 (N, 6), see `kernels.render_rays`."""
        out = np.empty((len(rays_o), 6), np.float32)
        kernels.render_rays(rays_o, rays_d, self.arrays, background, out)
        return out

    def mark_seen(self, rays: Iterable[tuple[np.ndarray, np.ndarray]]) -> None:
        """Take for seen what photos' rays_o and rays_d (N, 3) reach, and nothing else."""
        self.seen = np.zeros(len(self.row_of), np.uint8)
        for rays_o, rays_d in rays:
            kernels.mark_seen(rays_o, rays_d, self.arrays, self.seen)

    def home(self) -> 'VoxelField':
        """Return the field itself."""
        return self

    def save(self, path: Path) -> None:
        """Write the field as .npz, see `write_field`."""
        write_field(path, grid=self.grid, kept=packed(self.row_of), shape=self.shape,
                    centre=self.centre, half_extent=self.half_extent,
                    seen=np.packbits(self.seen),
                    settings=[self.shell, self.step, self.near, self.initial_alpha])

    @classmethod
    def load(cls, path: Path) -> 'VoxelField':
        """Read what `save` wrote; SceneError for other files."""
        try:
            with np.load(path) as data:
                arrays = dict(data)
            check_shapes(arrays)
            shape = tuple(int(n) for n in arrays['shape'])
            shell, step, near, initial_alpha = (float(value) for value in arrays['settings'])
            result = cls(arrays['grid'], shape, arrays['centre'],  # type: ignore[arg-type]
                         arrays['half_extent'], shell, step, near, initial_alpha,
                         unpacked(arrays['kept'], shape))
            result.seen = np.unpackbits(arrays['seen'], count=math.prod(shape))
        except OSError as error:
            raise SceneError(f'{path}: expected a radiance field: {error}') from error
        except Exception as error:  # Of a damaged file numpy and zipfile raise many types.
            raise SceneError(f'{path}: expected a radiance field: {error}; delete it to fit the '
                             'field again') from error
        result.update_occupancy()
        return result


def multiply_colours(grid: np.ndarray, factor: np.ndarray) -> None:
    """
    Multiply the colours of rows of a grid (V, 1 + 3K) by a factor (3,), in place.

    What differs with the direction stays as it is; nothing gets brighter than 1 - DARKEST.
    """
    mean = grid[:, 1::grid.shape[1] // 3]
    colour = np.clip(factor / (1 + np.exp(-BAND_0 * mean)), DARKEST, 1 - DARKEST)
    mean[:] = np.log(colour / (1 - colour)) / BAND_0
