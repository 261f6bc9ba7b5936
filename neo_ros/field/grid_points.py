"""The points of a grid: where they lie, and which of them a sparse field keeps."""
from collections.abc import Sequence
import math

import numpy as np


def lattice_box(low: np.ndarray, high: np.ndarray, edge: float | np.ndarray,
                origin: float | np.ndarray, shell: float
                ) -> tuple[np.ndarray, np.ndarray, np.ndarray, np.ndarray]:
    """
    Return the grid with points at origin + n edge, metres, whose inner box holds low to high (3,).

    These are, (3,) each: the number of its first point, its cells, and centre and half extent of
    the inner box.
    """
    cells = np.ceil((high - low) * (1 + shell) / edge + 2 + shell).astype(int)
    half_extent = cells * edge / (2 * (1 + shell))
    first = np.floor((low - shell * half_extent - origin) / edge).astype(int)
    return first, cells, origin + first * edge + (1 + shell) * half_extent, half_extent


def dilated(cells: np.ndarray, around: int) -> np.ndarray:
    """Mark the corners of cells (X, Y, Z) and of so many `around` them: bool (X, Y, Z)."""
    from scipy.ndimage import maximum_filter
    # A cell stands at its lowest corner: the window begins one further below than it ends above.
    size = 2 * around + 2
    return maximum_filter(cells.view(np.uint8), size, mode='constant').view(np.bool_)


def cells_around(points: np.ndarray) -> np.ndarray:
    """Mark the cells that have one of these points (X, Y, Z) for a corner: bool (X, Y, Z)."""
    from scipy.ndimage import maximum_filter
    cells = maximum_filter(points.view(np.uint8), 2, mode='constant', origin=-1).view(np.bool_)
    cells[-1], cells[:, -1], cells[:, :, -1] = False, False, False  # There are no cells.
    return cells


def cells_apart(cells: np.ndarray) -> np.ndarray:
    """
    Return how far cells are from those that are marked, bool (X, Y, Z): uint8 (X, Y, Z), 0 there.

    As many cells along the axis where it is most, or less: it is found between blocks of 2 x 2 x 2
    cells, in an eighth of the time. Where none is marked it is 255.
    """
    from scipy.ndimage import distance_transform_cdt
    if not cells.any():
        return np.full(cells.shape, 255, np.uint8)
    padded = np.pad(cells, [(0, size % 2) for size in cells.shape])
    x, y, z = (size // 2 for size in padded.shape)
    blocks = padded.reshape(x, 2, y, 2, z, 2).any(axis=(1, 3, 5))
    distance = np.clip(2 * distance_transform_cdt(~blocks, 'chessboard') - 1, 1, 255)
    apart = distance.astype(np.uint8).repeat(2, 0).repeat(2, 1).repeat(2, 2)
    apart[padded] = 0
    # Rays take it flat, photo by photo: it would be copied each time.
    return np.ascontiguousarray(apart[tuple(slice(size) for size in cells.shape)])


def numbered(kept: np.ndarray) -> np.ndarray:
    """Return `row_of` of a field that keeps these points."""
    flat = kept.ravel()
    return np.where(flat, np.cumsum(flat, dtype=np.int32) - 1, -1)


def packed(row_of: np.ndarray) -> np.ndarray:
    """Return which points are kept, a bit each."""
    return np.packbits(row_of >= 0)


def unpacked(kept: np.ndarray, shape: Sequence[int]) -> np.ndarray:
    """Return `row_of` of what `packed` made."""
    return numbered(np.unpackbits(kept, count=math.prod(shape)).view(np.bool_))
