"""At which places of a scene there are landmarks that look like the features of an image."""
from collections.abc import Iterator
from dataclasses import dataclass
from itertools import product

from neo_ros.memory.inverted_index import InvertedIndex
import numpy as np

# RootSIFT has length 1, and hardly a component above a half: coded in bytes, in so many steps.
STEPS = 512
# Cells from the origin, at most: three of them are one number of 64 bits.
_FAR = (1 << 20) - 2


@dataclass(frozen=True)
class PlaceThresholds:
    """Where the landmarks that look like an image stand close enough together to be a place."""

    # Lists of the index that a feature is looked for in, and landmarks that it may be like.
    lists: int = 8
    alike: int = 16
    # A landmark may be the one a feature shows if its descriptor is nearly as near as the nearest
    # one: equal rooms have equal landmarks.
    as_near: float = 0.9
    # A place is a cube of three cells along each side, metres. Those with less than this share of
    # the features of the best one do not count; at most so many are looked at.
    cell: float = 2.0
    least_share: float = 0.3
    most: int = 4
    # Around a pose so many landmarks are tried at most, in tiles of so many metres.
    tried: int = 20_000
    tile: float = 4.0


class PlaceFinder:
    """Landmarks float32 (P, 3), world metres, by where they are and how they look (P, 128)."""

    def __init__(self, points: np.ndarray, descriptors: np.ndarray,
                 thresholds: PlaceThresholds) -> None:
        self._limits = thresholds
        self._cells = np.clip(np.floor(points / thresholds.cell), -_FAR, _FAR).astype(np.int64)
        self._index = InvertedIndex(descriptors)
        tiles, tile_of = np.unique(np.clip(np.floor(points / thresholds.tile), -_FAR, _FAR),
                                   axis=0, return_inverse=True)
        self._centres = thresholds.tile * (tiles + 0.5)
        self._in_tiles = np.argsort(tile_of.reshape(-1), kind='stable')
        self._ends = np.cumsum(np.bincount(tile_of.reshape(-1)))

    def near(self, position: np.ndarray) -> np.ndarray:
        """Return the numbers of the landmarks around a position, (N,), in ascending order."""
        if len(self._in_tiles) <= self._limits.tried:
            return np.arange(len(self._in_tiles))
        away = np.linalg.norm(self._centres - position, axis=1)
        order = np.argsort(away, kind='stable')
        sizes = np.diff(self._ends, prepend=0)
        few = order[:max(int((np.cumsum(sizes[order]) <= self._limits.tried).sum()), 1)]
        return np.sort(np.concatenate(
            [self._in_tiles[self._ends[tile] - sizes[tile]:self._ends[tile]] for tile in few]))

    def find(self, descriptors: np.ndarray) -> Iterator[tuple[np.ndarray, np.ndarray]]:
        """
        Yield pairs of the landmarks (K,) at a place and of features (K,) that may show them.

        descriptors float32 (N, 128) of the features, of length 1. The places with the most
        features come first, and of each place what is most alike.
        """
        if not len(descriptors):
            return
        limits = self._limits
        found, likeness = self._index.nearest(coded(descriptors), limits.lists, limits.alike)
        off = np.maximum(STEPS ** 2 - likeness, 1)  # Half the squared distance.
        near = (found >= 0) & (limits.as_near ** 2 * off <= off[:, :1])
        feature, rank = np.nonzero(near)
        order = np.argsort(off[feature, rank], kind='stable')
        feature, landmark = feature[order], found[feature, rank][order]
        cells, cell_of = np.unique(self._cells[landmark], axis=0, return_inverse=True)
        share = 1 / np.maximum(near.sum(1), 1)
        votes = np.bincount(cell_of.reshape(-1), share[feature])
        for cell in _best(cells, _around(cells, votes), limits):
            here = (np.abs(self._cells[landmark] - cell) <= 1).all(1)
            yield landmark[here], feature[here]


def coded(descriptors: np.ndarray) -> np.ndarray:
    """Return RootSIFT descriptors, float32 (N, 128) of length 1, as bytes: times STEPS."""
    return np.minimum(np.rint(STEPS * descriptors), 255).astype(np.uint8)


def _around(cells: np.ndarray, votes: np.ndarray) -> np.ndarray:
    """Sum the votes of cells int64 (C, 3), in ascending order, and of those around each."""
    numbers, sums = _number(cells), np.zeros(len(votes))
    for step in product((-1, 0, 1), repeat=3):
        wanted = _number(cells + step)
        at = np.minimum(np.searchsorted(numbers, wanted), len(numbers) - 1)
        sums += np.where(numbers[at] == wanted, votes[at], 0)
    return sums


def _number(cells: np.ndarray) -> np.ndarray:
    x, y, z = (cells + _FAR + 2).T
    return np.asarray((x << 42) | (y << 21) | z)


def _best(cells: np.ndarray, votes: np.ndarray, limits: PlaceThresholds) -> Iterator[np.ndarray]:
    """Yield the cells with the most votes around them that are not beside one another."""
    left = votes.copy()
    for _ in range(limits.most):
        best = int(left.argmax())
        if not left[best] > limits.least_share * votes.max():
            return
        yield cells[best]
        left[(np.abs(cells - cells[best]) <= 1).all(1)] = 0
