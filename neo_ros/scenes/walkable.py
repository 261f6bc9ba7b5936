"""Where the robot's camera can be: a grid of free floor cells, and its JSON file."""
from dataclasses import dataclass
import json
import math
from pathlib import Path
from typing import Any

import cv2
from neo_ros.errors import SceneError
from neo_ros.machine.files import whole_file
import numpy as np


@dataclass(frozen=True, eq=False)
class WalkableMap:
    """
    Free floor for a camera that moves in a plane, in the scene's world (z up), metres.

    resolution     edge of a cell
    origin         (x, y) of the lower left corner of cells[0, 0]
    cells          bool (rows, columns); cells[j, i] covers x from origin[0] + i * resolution
                   and y from origin[1] + j * resolution
    camera_height  z of the camera
    clearance      distance that all points of a cell keep to geometry
    Raises SceneError for sizes that are not positive, and for maps without any free cell.
    """

    resolution: float
    origin: tuple[float, float]
    cells: np.ndarray
    camera_height: float
    clearance: float = 0.25

    def __post_init__(self) -> None:
        if not (math.isfinite(self.resolution) and self.resolution > 0):
            raise SceneError(f'resolution: expected metres > 0, got {self.resolution}')
        for name, value in (('origin[0]', self.origin[0]), ('origin[1]', self.origin[1]),
                            ('camera_height', self.camera_height),
                            ('clearance', self.clearance)):
            if not math.isfinite(value):
                raise SceneError(f'{name}: expected a finite number of metres, got {value}')
        if self.clearance < 0:
            raise SceneError(f'clearance: expected metres >= 0, got {self.clearance}')
        cells = np.array(self.cells, bool)
        if cells.ndim != 2 or not cells.any():
            raise SceneError(f'cells: expected a 2-D grid with at least one free cell, got shape '
                             f'{cells.shape} with {int(cells.sum())} free')
        cells.setflags(write=False)
        object.__setattr__(self, 'cells', cells)

    @property
    def area(self) -> float:
        """Free floor, square metres."""
        return float(self.cells.sum()) * self.resolution ** 2

    def contains(self, xy: np.ndarray) -> np.ndarray:
        """Tell which points (N, 2), metres, lie in free cells: bool (N,)."""
        index = np.floor((np.asarray(xy, np.float64) - self.origin) / self.resolution)
        rows, columns = self.cells.shape
        i, j = index[:, 0], index[:, 1]
        inside = (i >= 0) & (i < columns) & (j >= 0) & (j < rows)
        result = np.zeros(len(index), bool)
        result[inside] = self.cells[j[inside].astype(int), i[inside].astype(int)]
        return result

    def kept_off(self, radius: float) -> 'WalkableMap':
        """
        Return the cells whose centres keep `radius` metres off everything that is not free.

        What the map keeps off already, its clearance, counts. Raises SceneError when nothing is
        left.
        """
        missing = radius - self.clearance
        if missing <= 0:
            return self
        # From a cell's centre to the nearest edge of a cell that is not free.
        distance = cv2.distanceTransform(np.pad(self.cells, 1).astype(np.uint8), cv2.DIST_L2,
                                         cv2.DIST_MASK_PRECISE)[1:-1, 1:-1] - 0.5
        free = self.cells & (distance * self.resolution >= missing - 1e-6)
        if not free.any():
            raise SceneError(f'sampling.robot_radius: expected free floor for a robot of '
                             f'{radius} m, got none on a map of {self.area:.1f} m2; '
                             'choose a smaller radius')
        return WalkableMap(self.resolution, self.origin, free, self.camera_height, radius)

    def sample(self, rng: np.random.Generator, n: int) -> np.ndarray:
        """Draw n points uniformly from the free floor: (n, 2) metres."""
        centres = self.centres()
        offset = (rng.random((n, 2)) - 0.5) * self.resolution
        return centres[rng.integers(len(centres), size=n)] + offset

    def centres(self) -> np.ndarray:
        """Return the centres of all free cells, (M, 2) metres, row by row."""
        j, i = np.nonzero(self.cells)
        return np.stack([i + 0.5, j + 0.5], axis=1) * self.resolution + self.origin


def read_walkable(path: Path) -> WalkableMap:
    """Read a walkable.json; raises SceneError that names the field that is missing or wrong."""
    try:
        document = json.loads(Path(path).read_text())
    except FileNotFoundError as error:
        raise SceneError(f'{path}: no such file') from error
    except (OSError, ValueError) as error:
        raise SceneError(f'{path}: expected a JSON file: {error}') from error
    if not isinstance(document, dict):
        raise SceneError(f'{path}: expected a JSON object, got {type(document).__name__}')
    try:
        width, height = read_number(document, 'width'), read_number(document, 'height')
        cells = _read_rows(document['rows'], width, height)
        return WalkableMap(read_number(document, 'resolution'), _read_origin(document['origin']),
                           cells, read_number(document, 'camera_height'),
                           read_number({'clearance': 0.0} | document, 'clearance'))
    except KeyError as error:
        raise SceneError(f'{path}: expected the key {error}') from error
    except SceneError as error:
        raise SceneError(f'{path}: {error}') from error


def read_number(document: dict[str, Any], key: str) -> float:
    """Return the number under a key; raises SceneError that names the key, else KeyError."""
    try:
        return float(document[key])
    except (TypeError, ValueError, OverflowError) as error:
        raise SceneError(f'{key}: expected a number, got {document[key]!r:.60}') from error


def write_walkable(path: Path, walkable: WalkableMap) -> None:
    """Write a walkable.json; the file appears complete or not at all."""
    rows, columns = walkable.cells.shape
    document = {
        'resolution': walkable.resolution, 'origin': list(walkable.origin),
        'width': columns, 'height': rows, 'camera_height': walkable.camera_height,
        'clearance': walkable.clearance, 'area_m2': round(walkable.area, 2),
        'note': 'rows[j][i] is the cell with x in origin[0]+[i,i+1)*resolution and y in '
                'origin[1]+[j,j+1)*resolution; 1 = walkable',
        'rows': [''.join('1' if cell else '0' for cell in row) for row in walkable.cells]}
    try:
        with whole_file(path) as partial:
            partial.write_text(json.dumps(document, indent=0))
    except OSError as error:
        raise SceneError(f'{path}: cannot write: {error.strerror}; make its folder writable, or '
                         'make room') from error


def _read_origin(origin: Any) -> tuple[float, float]:
    try:
        x, y = (float(value) for value in origin)
    except (TypeError, ValueError, OverflowError) as error:
        raise SceneError(f'origin: expected [x, y], got {origin!r:.60}') from error
    return x, y


def _read_rows(rows: Any, width: float, height: float) -> np.ndarray:
    if not isinstance(rows, list) or len(rows) != height:
        found = len(rows) if isinstance(rows, list) else type(rows).__name__
        raise SceneError(f'rows: expected {height:.10g} strings as height says, got {found}')
    for j, row in enumerate(rows):
        if not isinstance(row, str) or len(row) != width or set(row) - {'0', '1'}:
            raise SceneError(f"rows[{j}]: expected {width:.10g} characters '0' or '1' as width "
                             f'says, got {row!r:.60}')
    return np.array([[cell == '1' for cell in row] for row in rows], bool)
