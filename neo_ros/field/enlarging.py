"""A fitted field in a larger grid, and what another field shows where it had nothing."""
import math

from neo_ros.errors import SceneError
from neo_ros.field.grid_points import dilated, lattice_box, numbered
from neo_ros.field.voxel_field import AIR_KEPT, VoxelField
import numpy as np

# Grid points that a larger field may have, or so many times as many as it had: a point takes 6
# bytes though it is air.
MOST_POINTS, MOST_TIMES = 100_000_000, 4
_CELLS_AT_ONCE = 1 << 20


def enlarged(field: VoxelField, low: np.ndarray, high: np.ndarray) -> VoxelField:
    """
    Return the field with an inner box that holds the corners low and high (3,), metres, too.

    Points of the inner box keep place and bits; what lay outside of it is interpolated in the new
    grid. Raises SceneError where the box would have too many points.
    """
    old_low, old_high = field.centre - field.half_extent, field.centre + field.half_extent
    low, high = np.minimum(low, old_low), np.maximum(high, old_high)
    if (low == old_low).all() and (high == old_high).all():
        return field
    edges = 2 * field.half_extent * (1 + field.shell) / (np.array(field.shape) - 1)
    corner = field.centre - (1 + field.shell) * field.half_extent
    moves = (low < old_low) | (high > old_high)
    same = np.zeros(3, int), np.array(field.shape) - 1, field.centre, field.half_extent
    first, cells, centre, half = (
        np.where(moves, new, old) for new, old in zip(
            lattice_box(low, high, edges, corner, field.shell), same))
    shape = (cells + 1).tolist()
    most = max(MOST_POINTS, MOST_TIMES * math.prod(field.shape))
    if math.prod(shape) > most:
        raise SceneError(f'field: expected a place that is at most {most} grid points large, with '
                         f'what the field has, got {math.prod(shape)}; train anew, with larger '
                         'voxels')
    size = (shape[0], shape[1], shape[2])
    result = VoxelField(field.grid, size, centre, half, field.shell, field.step, field.near,
                        field.initial_alpha, np.full(math.prod(size), -1, np.int32))
    _take_points(result, field, -first)
    result.seen = seen_at(field, result, np.ones(result.shape, bool)).ravel().view(np.uint8)
    result.update_occupancy()
    return result


def _take_points(result: VoxelField, field: VoxelField, at: np.ndarray) -> None:
    """Fill the larger grid, in which the point 0, 0, 0 of the old one would be number `at`."""
    dense = field.with_air()
    inside, place = [], []
    for size, start in zip(field.shape, at):
        index = np.flatnonzero(np.abs(2 * np.arange(size) / (size - 1) - 1)
                               * (1 + field.shell) <= 1)
        inside.append(index)
        place.append(index + start)
    outside = np.ones(result.shape, bool)
    outside[np.ix_(*place)] = False
    raw = np.zeros(result.shape, np.float32)
    raw[np.ix_(*place)] = dense.grid[:, 0].reshape(field.shape)[np.ix_(*inside)]
    raw[outside] = dense.values_at(result, outside, 1)[:, 0]
    result.row_of = np.arange(raw.size, dtype=np.int32)
    outside &= dilated(result.occupied(raw.reshape(-1, 1)).reshape(result.shape), AIR_KEPT)
    kept = outside.copy()
    kept[np.ix_(*place)] = (field.row_of >= 0).reshape(field.shape)[np.ix_(*inside)]
    row_of, old = numbered(kept), np.full(result.shape, -1, np.int32)
    old[np.ix_(*place)] = field.row_of.reshape(field.shape)[np.ix_(*inside)]
    grid = np.zeros((int(kept.sum()), field.grid.shape[1]), np.float32)
    same = old.ravel() >= 0
    grid[row_of[same]] = field.grid[old.ravel()[same]]
    if outside.any():
        grid[row_of[outside.ravel()]] = dense.values_at(result, outside, grid.shape[1])
    result.grid, result.row_of = grid, row_of


def seen_at(one: VoxelField, other: VoxelField, cells: np.ndarray) -> np.ndarray:
    """Tell of cells (X, Y, Z) of another field which a field's photos reach: bool (X, Y, Z)."""
    found = np.zeros(other.shape, bool)
    seen = one.seen.view(bool).reshape(one.shape)
    index = np.argwhere(cells)
    for start in range(0, len(index), _CELLS_AT_ONCE):  # Positions are float64.
        part = index[start:start + _CELLS_AT_ONCE]
        found[tuple(part.T)] = seen[tuple(one.cells_at(other.world_points(part + 0.5)).T)]
    return found


def filled(field: VoxelField, other: VoxelField, cells: np.ndarray
           ) -> tuple[VoxelField, np.ndarray]:
    """
    Return the field with another's surfaces in cells bool (X, Y, Z), and which points are new.

    Points that it has stay as they are; the new ones, bool (X, Y, Z), are those of surfaces and
    `AIR_KEPT` cells of air around them.
    """
    dense = other.with_air()
    points = dilated(cells, 0) & (field.row_of < 0).reshape(field.shape)
    raw = np.zeros(field.shape, np.float32)
    raw[points] = dense.values_at(field, points, 1)[:, 0]
    whole = VoxelField(raw.reshape(-1, 1), field.shape, field.centre, field.half_extent,
                       field.shell, field.step, field.near, field.initial_alpha)
    points &= dilated(whole.matter, AIR_KEPT)
    result = field.keeping((field.row_of >= 0) | points.ravel())
    result.grid[result.row_of[points.ravel()]] = dense.values_at(
        field, points, field.grid.shape[1])
    result.update_occupancy()
    return result, points
