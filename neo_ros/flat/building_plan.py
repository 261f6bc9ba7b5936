"""Where a building's rooms are, and which of them are alike."""
from dataclasses import dataclass
import math

from neo_ros.errors import SceneError
from neo_ros.flat.building_rooms import (
    ACROSS, Corridor, Hall, picture_slot, Piece, Room, slots, Stairwell, WING)
from neo_ros.flat.furnishing import DEPTH, KINDS, WIDTH
from neo_ros.geometry import CameraPose
import numpy as np

FLOOR_HEIGHT = 3.0
ROOMS_ALONG = 10  # on one side of a corridor, at most
MOST_ROOMS, MOST_FLOORS = 250, 20


@dataclass(frozen=True)
class BuildingPlan:
    """
    A building; all that is in it follows from these.

    rooms        on each floor
    twins        pairs of rooms of a floor that are equal in everything inside
    own_picture  each twin has one picture of its own
    alike        share of things, colours and pictures that all rooms have in common
    equal_floors  all floors are equal
    """

    floors: int = 1
    rooms: int = 12
    seed: int = 0
    twins: int = 0
    own_picture: bool = False
    alike: float = 0.0
    equal_floors: bool = False

    def __post_init__(self) -> None:
        for name, low, high in (('floors', 1, MOST_FLOORS), ('rooms', 1, MOST_ROOMS),
                                ('twins', 0, len(_twins(self)))):
            if not low <= getattr(self, name) <= high:
                raise SceneError(f'{name}: expected {low} to {high}, got {getattr(self, name)}')
        if not 0 <= self.alike <= 1:
            raise SceneError(f'alike: expected a share from 0 to 1, got {self.alike}')

    @property
    def area(self) -> float:
        """Square metres of all floors, walls included."""
        return sum(_floor_area(placed.piece) for placed in place_pieces(self))


@dataclass(frozen=True)
class Placed:
    """
    A piece of a building: where its frame's origin is, and whether it is turned by half.

    number  of a room on its floor, else None
    """

    piece: Piece
    origin: tuple[float, float, float]
    turned: bool
    floor: int
    number: int | None = None

    def to_own(self, xyz: np.ndarray) -> np.ndarray:
        """Take points (..., 3) of the world into the piece's frame."""
        return (xyz - self.origin) * self.turn

    def to_world(self, xyz: np.ndarray) -> np.ndarray:
        """Take points (..., 3) of the piece's frame into the world."""
        return xyz * self.turn + self.origin

    @property
    def turn(self) -> np.ndarray:
        """What multiplies directions (..., 3), either way."""
        return np.array([-1.0, -1.0, 1.0] if self.turned else [1.0, 1.0, 1.0])

    def pose_in(self, pose: CameraPose) -> CameraPose:
        """Take a camera's pose into the piece's frame."""
        T = pose.T_world_cam.copy()
        T[:3, :3] *= self.turn[:, None]
        T[:3, 3] = self.to_own(T[:3, 3])
        return CameraPose(T)


def place_pieces(plan: BuildingPlan) -> list[Placed]:
    """Lay out wings of a corridor with rooms on both sides; more than one have a hall."""
    placed: list[Placed] = []
    along = min(math.ceil(plan.rooms / 2), ROOMS_ALONG)
    wings = math.ceil(plan.rooms / (2 * along))
    for floor in range(plan.floors):
        z = FLOOR_HEIGHT * floor
        rooms = _rooms(plan, floor, along, wings)
        for number, room in enumerate(rooms):
            wing, column, north = _slot(number, along)
            x, y = WIDTH * column, WING * wing + DEPTH
            origin = (x, y + ACROSS, z) if north else (x + WIDTH, y, z)
            placed.append(Placed(room, origin, not north, floor, number))
        for wing in range(wings):
            placed += _corridor(plan, floor, wing, along, wings)
    return placed


def _slot(number: int, along: int) -> tuple[int, int, bool]:
    wing, place = divmod(number, 2 * along)
    return wing, place // 2, place % 2 == 1


def _rooms(plan: BuildingPlan, floor: int, along: int, wings: int) -> list[Room]:
    own_floor = 0 if plan.equal_floors else floor
    random = np.random.default_rng([plan.seed, 103, own_floor])
    kinds = sorted(KINDS)
    common = kinds[np.random.default_rng([plan.seed, 104]).integers(len(kinds))]
    rooms = []
    for number in range(plan.rooms):
        own = 1 + own_floor * plan.rooms + number
        kind = kinds[random.integers(len(kinds))]
        kind = common if plan.alike > 0 else kind
        shared = random.random(slots(kind)) < plan.alike
        wing, _, north = _slot(number, along)
        window = wing == (wings - 1 if north else 0)
        rooms.append(Room(plan.seed, kind, window, tuple(np.where(shared, 0, own).tolist())))
    for first, second in _twins(plan)[:plan.twins]:
        owners = list(rooms[first].owners)
        if plan.own_picture:
            owners[picture_slot(rooms[first].kind)] = 1 + own_floor * plan.rooms + second
        rooms[second] = Room(plan.seed, rooms[first].kind, rooms[first].window, tuple(owners))
    return rooms


def _twins(plan: BuildingPlan) -> list[tuple[int, int]]:
    """Pair rooms of one side of one corridor, so that they have the same windows; all pairs."""
    along = min(math.ceil(plan.rooms / 2), ROOMS_ALONG)
    sides: dict[tuple[int, bool], list[int]] = {}
    for number in range(plan.rooms):
        wing, _, north = _slot(number, along)
        sides.setdefault((wing, north), []).append(number)
    return [pair for side in sides.values()
            for pair in zip(side, side[len(side) // 2 + len(side) % 2:])]


def _corridor(plan: BuildingPlan, floor: int, wing: int, along: int, wings: int
              ) -> list[Placed]:
    own_floor = 0 if plan.equal_floors else floor
    y, z = WING * wing + DEPTH, FLOOR_HEIGHT * floor
    placed, first = [], 2 * along * wing
    columns = math.ceil(min(plan.rooms - first, 2 * along) / 2)
    stairs = wing == 0
    for column in range(columns):
        numbers = (first + 2 * column, first + 2 * column + 1)
        signs = tuple((f'{own_floor}{number:02d}' if plan.alike < 1 else '00')
                      if number < plan.rooms else '' for number in numbers)
        ends = (column == 0 and wings == 1, column == columns - 1 and not stairs)
        owner = 0 if plan.alike == 1 else 1 + own_floor * plan.rooms + numbers[0]
        placed.append(Placed(Corridor(plan.seed, owner, (signs[0], signs[1]), ends),
                             (WIDTH * column, y, z), False, floor))
    if stairs:
        placed.append(Placed(Stairwell(plan.seed, own_floor), (WIDTH * columns, y, z), False,
                             floor))
    if wings > 1:
        hall = Hall(plan.seed, 1 + own_floor * wings + wing, (wing == 0, wing == wings - 1))
        placed.append(Placed(hall, (-ACROSS, WING * wing, z), False, floor))
    return placed


def _floor_area(piece: Piece) -> float:
    if isinstance(piece, Room):
        return WIDTH * DEPTH
    return ACROSS * (WING if isinstance(piece, Hall) else WIDTH)
