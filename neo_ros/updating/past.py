"""What earlier updates of a run have changed: which photos are out of date, and what was there."""
from dataclasses import dataclass
from pathlib import Path
import zipfile

from neo_ros.errors import SceneError
from neo_ros.field.grid_points import dilated
from neo_ros.field.voxel_field import VoxelField
from neo_ros.machine.files import whole_file
import numpy as np

_FILE = 'changes.npz'
_LOOKS = ('looks_points', 'looks_values', 'looks_until')
# Updates of which it is known what was there before: the file stays small, and an update asks
# its photos about each of them.
MOST_LOOKS = 32


@dataclass(frozen=True, eq=False)
class Looks:
    """
    What places of a field looked like before updates changed them.

    points float32 (L, 3): of the grid, world metres; values float32 (L, 1 + 3K): their rows, as
    they were before update `until`, int32 (L,), changed them.
    """

    points: np.ndarray
    values: np.ndarray
    until: np.ndarray

    @property
    def updates(self) -> list[int]:
        """The updates that changed something, the first one first."""
        return np.unique(self.until).tolist()

    def of(self, update: int, field: VoxelField) -> tuple[np.ndarray, np.ndarray]:
        """Return the points of a field, bool (X, Y, Z), that an update changed, and their rows."""
        chosen = np.flatnonzero(self.until == update)
        index = tuple(field.points_at(self.points[chosen]).T)
        points, where = np.zeros(field.shape, bool), np.zeros(field.shape, np.int64)
        points[index], where[index] = True, chosen
        return points, self.values[where[points]]

    def without(self, field: VoxelField, undone: np.ndarray) -> 'Looks':
        """Return this without what was turned back to: cells of undone int32 (X, Y, Z)."""
        kept, where = np.ones(len(self.until), bool), tuple(field.points_at(self.points).T)
        for update in np.unique(undone[undone > 0]):
            points = dilated(undone == update, 0)
            kept &= (self.until != update) | ~points[where]
        return Looks(self.points[kept], self.values[kept], self.until[kept])

    def with_more(self, before: VoxelField, after: VoxelField, cells: np.ndarray, update: int
                  ) -> 'Looks':
        """Return this and what an update changed in cells, bool (X, Y, Z); the oldest may go."""
        index = np.argwhere(dilated(cells, 0))
        then, now = (_rows(field, index) for field in (before, after))
        # Points outside of the inner box have no place of their own in a field that grows.
        places = before.world_points(index)
        kept = (then != now).any(1) & (
            np.abs(places - before.centre) <= before.half_extent).all(1)
        recent = self.until > update - MOST_LOOKS
        return Looks(
            np.concatenate([self.points[recent], places[kept].astype(np.float32)]),
            np.concatenate([self.values[recent].reshape(-1, then.shape[1]), then[kept]]),
            np.concatenate([self.until[recent], np.full(kept.sum(), update, np.int32)]))


NO_LOOKS = Looks(np.empty((0, 3), np.float32), np.empty((0, 0), np.float32),
                 np.empty(0, np.int32))


def _rows(field: VoxelField, index: np.ndarray) -> np.ndarray:
    """Return the rows of grid points (M, 3); air that is not kept is zeros."""
    rows = field.row_of[np.ravel_multi_index(tuple(index.T), field.shape)]
    found = np.zeros((len(rows), field.grid.shape[1]), np.float32)
    found[rows >= 0] = field.grid[rows[rows >= 0]]
    return found


@dataclass(frozen=True, eq=False)
class Past:
    """
    Middles of cells that updates changed, float32 (M, 3), world metres, and which did, int32 (M,).

    founders int32 (K,): photos of updates that a place was fitted to which the scene had not: they
    are to it what those of the training are to the rest. looks: what was there before.
    """

    points: np.ndarray
    updates: np.ndarray
    founders: np.ndarray
    looks: Looks = NO_LOOKS

    @classmethod
    def read(cls, run: Path) -> 'Past':
        """Read that of a run; nothing, where none of it changed. Raises SceneError."""
        path = run / _FILE
        if not path.exists():
            return cls(np.empty((0, 3), np.float32), *np.empty((2, 0), np.int32))
        try:
            with np.load(path) as data:
                # Earlier versions knew nothing of looks.
                looks = Looks(*(data[name] for name in _LOOKS)) if _LOOKS[0] in data else NO_LOOKS
                return cls(data['points'], data['updates'], data['founders'], looks)
        except (OSError, ValueError, KeyError, EOFError, zipfile.BadZipFile) as error:
            raise SceneError(f'{path}: expected what earlier updates changed: {error}; update '
                             'the run that it was made of again') from error

    def write(self, run: Path) -> None:
        """Write what `read` reads."""
        looks = dict(zip(_LOOKS, (self.looks.points, self.looks.values, self.looks.until)))
        with whole_file(run / _FILE) as path, path.open('wb') as file:
            np.savez_compressed(file, points=self.points, updates=self.updates,
                                founders=self.founders, allow_pickle=False, **looks)

    def with_more(self, before: VoxelField, after: VoxelField, cells: np.ndarray,
                  undone: np.ndarray, update: int, founders: np.ndarray) -> 'Past':
        """
        Return this and what an update changed, and turned back.

        cells bool (X, Y, Z) of the field: that it fitted anew; undone int32 (X, Y, Z): the first
        update that does not count any more in those that it turned back, else 0.
        """
        first = undone[tuple(after.cells_at(self.points).T)]
        counts = (first == 0) | (self.updates < first)
        points = after.world_points(np.argwhere(cells) + 0.5).astype(np.float32)
        return Past(
            np.concatenate([self.points[counts], points]),
            np.concatenate([self.updates[counts], np.full(len(points), update, np.int32)]),
            np.concatenate([self.founders, founders]).astype(np.int32),
            self.looks.without(after, undone).with_more(
                before, after, cells | (undone > 0), update))

    def dates(self, field: VoxelField) -> np.ndarray:
        """Return which update changed each cell last, int32 (X, Y, Z), 0 = none."""
        dates = np.zeros(field.shape, np.int32)
        np.maximum.at(dates, tuple(field.cells_at(self.points).T), self.updates)
        return dates
