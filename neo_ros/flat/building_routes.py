"""Where cameras go in a building: a mapping robot's stops, and test walks through doors."""
from dataclasses import replace
import math

from neo_ros.errors import SceneError
from neo_ros.flat.building import Building
from neo_ros.flat.building_plan import Placed
from neo_ros.flat.building_rooms import Corridor, DOOR
from neo_ros.flat.walks import connected, Doorway, plan_walk_through
from neo_ros.geometry import CameraPose
from neo_ros.machine.evenly import evenly
from neo_ros.scenes.walkable import WalkableMap
import numpy as np

APART = 0.5  # metres between the stops of a mapping robot
VIEWS = 4  # photos at a stop, evenly around
WALKS = 8  # through doors, over all floors; at least one on each
_TURN = math.pi / VIEWS * 0.618034  # from stop to stop, so that together they look everywhere
_AROUND = 2.5  # metres around a door that a walk through it may use


def mapping_poses(building: Building, floor: int) -> list[CameraPose]:
    """
    Return the poses of all photos that a mapping robot takes of a floor.

    It drives along the corridors and into the rooms, and stops every APART metres: no free place
    is farther from a stop. At each it takes VIEWS level photos of 90 degrees.
    """
    walkable = building.walkable(floor)
    stops: list[np.ndarray] = []
    for placed in building.placed:
        if placed.floor == floor:
            stops += _stops(_part(walkable, *_bounds(building, placed)))
    return [CameraPose.from_planar(x, y, walkable.camera_height,
                                   _TURN * number + 2 * math.pi * view / VIEWS)
            for number, (x, y) in enumerate(stops) for view in range(VIEWS)]


def door_walks(building: Building, floor: int, n_frames: int, seed: int
               ) -> list[list[CameraPose]]:
    """Plan walks through doors all over a floor; SceneError where none is passable."""
    walkable, walks = building.walkable(floor), []
    wanted = max(WALKS // building.plan.floors, 1)
    rooms = building.rooms(floor)
    for number in evenly(len(rooms), wanted):
        door = doorway(rooms[number])
        near = _part(walkable, np.array(door[:2]) - _AROUND, np.array(door[:2]) + _AROUND)
        if near is not None and near.contains(np.array([door[:2]])).all():
            walks.append(plan_walk_through(
                _joined_to(near, door), door, n_frames,
                np.random.default_rng([seed, 105, floor, number])))
    if not walks:
        raise SceneError(f'floor {floor}: expected a door that a robot can pass, got none; '
                         'choose another seed')
    return walks


def corridor_drive(building: Building, floor: int, apart: float) -> list[CameraPose]:
    """Return the poses of a drive down the middle of a floor's first corridor, so far apart."""
    walkable = building.walkable(floor)
    pieces = np.stack([_bounds(building, placed) for placed in building.placed
                       if placed.floor == floor and isinstance(placed.piece, Corridor)])
    low, high = pieces[0]
    y = (low[1] + high[1]) / 2
    pieces = pieces[(pieces[:, 0, 1] < y) & (y < pieces[:, 1, 1])]
    along = np.arange(pieces[:, 0, 0].min(), pieces[:, 1, 0].max(), apart)
    places = np.stack([along, np.full(len(along), y)], 1)
    return [CameraPose.from_planar(x, y, walkable.camera_height, 0.0)
            for x, y in places[walkable.contains(places)].tolist()]


def doorway(room: Placed) -> Doorway:
    """Return the door of a room, in the world."""
    x, y, _ = room.to_world(np.array([sum(DOOR) / 2, 0.0, 0.0])).tolist()
    return Doorway(x, y, 1)


def _bounds(building: Building, placed: Placed) -> tuple[np.ndarray, np.ndarray]:
    solids = building.insides[placed.piece].solids
    ends = np.stack([placed.to_world(solids.lower.min(0)), placed.to_world(solids.upper.max(0))])
    return ends.min(0)[:2], ends.max(0)[:2]


def _part(walkable: WalkableMap, low: np.ndarray, high: np.ndarray) -> WalkableMap | None:
    """Cut a part out of a map; None where nothing is free."""
    rows, columns = walkable.cells.shape
    first = np.clip(((low - walkable.origin) / walkable.resolution).astype(int), 0,
                    (columns, rows))
    last = np.clip(((high - walkable.origin) / walkable.resolution).astype(int) + 1, 0,
                   (columns, rows))
    cells = walkable.cells[first[1]:last[1], first[0]:last[0]]
    if not cells.any():
        return None
    x, y = (first * walkable.resolution + walkable.origin).tolist()
    return WalkableMap(walkable.resolution, (x, y), cells, walkable.camera_height,
                       walkable.clearance)


def _joined_to(part: WalkableMap, door: Doorway) -> WalkableMap:
    """Keep what can be reached from a door without leaving the part."""
    column, row = ((np.array(door[:2]) - part.origin) / part.resolution).astype(int)
    return replace(part, cells=connected(part.cells, (row, column)))


def _stops(part: WalkableMap | None) -> list[np.ndarray]:
    """Choose places (2,) so that none on the map is farther from one, in the order of a drive."""
    if part is None:
        return []
    centres = part.centres()
    chosen = [int(np.linalg.norm(centres - centres.mean(0), axis=1).argmin())]
    away = np.linalg.norm(centres - centres[chosen[0]], axis=1)
    while away.max() > APART:
        chosen.append(int(away.argmax()))
        away = np.minimum(away, np.linalg.norm(centres - centres[chosen[-1]], axis=1))
    left, order = centres[chosen], list[np.ndarray]()
    at = left[0]
    while len(left):
        nearest = int(np.linalg.norm(left - at, axis=1).argmin())
        at = left[nearest]
        order.append(at)
        left = np.delete(left, nearest, axis=0)
    return order
