"""What earlier updates of a run have changed, and so which of its photos are out of date."""
from dataclasses import dataclass
from pathlib import Path
import zipfile

from neo_ros.errors import SceneError
from neo_ros.field.voxel_field import VoxelField
from neo_ros.machine.files import whole_file
import numpy as np

_FILE = 'changes.npz'


@dataclass(frozen=True, eq=False)
class Past:
    """
    Middles of cells that updates changed, float32 (M, 3), world metres, and which did, int32 (M,).

    founders int32 (K,): photos of updates that a place was fitted to which the scene had not: they
    are to it what those of the training are to the rest.
    """

    points: np.ndarray
    updates: np.ndarray
    founders: np.ndarray

    @classmethod
    def read(cls, run: Path) -> 'Past':
        """Read that of a run; nothing, where none of it changed. Raises SceneError."""
        path = run / _FILE
        if not path.exists():
            return cls(np.empty((0, 3), np.float32), *np.empty((2, 0), np.int32))
        try:
            with np.load(path) as data:
                return cls(data['points'], data['updates'], data['founders'])
        except (OSError, ValueError, KeyError, EOFError, zipfile.BadZipFile) as error:
            raise SceneError(f'{path}: expected what earlier updates changed: {error}; update '
                             'the run that it was made of again') from error

    def write(self, run: Path) -> None:
        """Write what `read` reads."""
        with whole_file(run / _FILE) as path, path.open('wb') as file:
            np.savez_compressed(file, points=self.points, updates=self.updates,
                                founders=self.founders)

    def with_more(self, field: VoxelField, cells: np.ndarray, update: int,
                  founders: np.ndarray) -> 'Past':
        """Return this and what an update changed: cells bool (X, Y, Z) of the field."""
        points = field.world_points(np.argwhere(cells) + 0.5).astype(np.float32)
        return Past(np.concatenate([self.points, points]),
                    np.concatenate([self.updates, np.full(len(points), update, np.int32)]),
                    np.concatenate([self.founders, founders]).astype(np.int32))

    def dates(self, field: VoxelField) -> np.ndarray:
        """Return which update changed each cell last, int32 (X, Y, Z), 0 = none."""
        dates = np.zeros(field.shape, np.int32)
        np.maximum.at(dates, tuple(field.cells_at(self.points).T), self.updates)
        return dates
