"""What a building is put together from: rooms, pieces of a corridor, a stairwell, a hall."""
from dataclasses import dataclass

from neo_ros.flat import furniture
from neo_ros.flat.furnishing import (
    DEPTH, floor_paint, HALF_WALL, KINDS, NORTH, PICTURES, wall_paint, WIDTH)
from neo_ros.flat.light import LightSources
from neo_ros.flat.shapes import Material, paint, SolidBuilder, Solids
from neo_ros.flat.shell import add_ceiling_lamp, add_wall, add_window, CEILING, TRIM
import numpy as np

ACROSS = 1.8  # width of a corridor between wall centres
WING = 2 * DEPTH + ACROSS  # two rows of rooms and their corridor
DOOR, DOOR_TOP = (0.8, 1.7), 2.05  # of a room, along its wall y = 0
WINDOW = (1.35, 2.85, 0.9, 2.2)  # from, to, sill, top
OUTER = 0.16  # metres that an outer wall is thick
# The door of a room on the other side of the corridor, which is turned by half.
TURNED_DOOR = (WIDTH - DOOR[1], WIDTH - DOOR[0])
STEP_RISE, STEP_RUN, STEPS = 0.17, 0.28, 8


@dataclass(frozen=True)
class Room:
    """
    A furnished room. Two that are equal look the same from everywhere inside.

    owners  for the walls, the floor, each thing and each picture: whose seed it is drawn from
    """

    seed: int
    kind: str
    window: bool
    owners: tuple[int, ...]

    def build(self) -> tuple[Solids, LightSources]:
        """Return all solids in the room's own frame, and its lamps and windows."""
        b = SolidBuilder()
        randoms = [np.random.default_rng([self.seed, slot, owner])
                   for slot, owner in enumerate(self.owners)]
        walls = wall_paint(randoms[0])
        _add_floor_and_ceiling(b, WIDTH, DEPTH, floor_paint(randoms[1]))
        _add_side_walls(b, DEPTH, walls)
        add_wall(b, 1, 0, HALF_WALL, (0, WIDTH), [(*DOOR, 0.0, DOOR_TOP)], walls)
        _add_door_frame(b, DOOR)
        windows: tuple = ()
        if self.window:
            wall = b.at(WIDTH, NORTH, 180)
            start, end, sill, top = WINDOW
            opening = (WIDTH - end, WIDTH - start, sill, top)
            add_wall(wall, 1, -OUTER, 0, (0, WIDTH), [opening], walls)
            add_window(wall, 1, 0.0, *opening, 1)
            windows = ((1, NORTH, start, end, sill, top, -1),)
        else:
            b.box((0, NORTH, 0), (WIDTH, DEPTH, CEILING), walls)
        things = KINDS[self.kind]
        for thing, random in zip((*things, *PICTURES), randoms[2:]):
            if not (self.window and thing is PICTURES[NORTH_PICTURE]):
                thing(b, random)
        return _lit(b, windows, (1.35, 2.0, 0.25), (2.9, 2.0, 0.25))


# Where the window is, if there is one.
NORTH_PICTURE = 3


def slots(kind: str) -> int:
    """Return how many owners a room of this kind has."""
    return 2 + len(KINDS[kind]) + len(PICTURES)


def picture_slot(kind: str) -> int:
    """Return the slot of a room's first picture."""
    return 2 + len(KINDS[kind])


@dataclass(frozen=True)
class Corridor:
    """
    A piece of a corridor, as long as a room is wide: x along it, rooms on both sides.

    doors  signs beside the doors to the south and to the north, '' = no door there
    ends   walls with a window close the west and the east end
    """

    seed: int
    owner: int
    doors: tuple[str, str]
    ends: tuple[bool, bool]

    def build(self) -> tuple[Solids, LightSources]:
        """Return all solids in the piece's own frame, and its lamps and windows."""
        b = SolidBuilder()
        walls, floor = _common(self.seed)
        random = np.random.default_rng([self.seed, 101, self.owner])
        _add_floor_and_ceiling(b, WIDTH, ACROSS, floor)
        for y, door, sign in ((0.0, TURNED_DOOR, self.doors[0]),
                              (ACROSS - HALF_WALL, DOOR, self.doors[1])):
            openings = [(*door, 0.0, DOOR_TOP)] if sign else []
            add_wall(b, 1, y, y + HALF_WALL, (0, WIDTH), openings, walls)
        north, south = b.at(0, ACROSS - HALF_WALL), b.at(WIDTH, HALF_WALL, 180)
        for wall, sign, outer in ((north, self.doors[1], b.at(WIDTH, ACROSS, 180)),
                                  (south, self.doors[0], b)):
            if sign:
                _add_door_frame(outer, TURNED_DOOR)
                _add_sign(wall.at(DOOR[1] + 0.22, 0, z=1.55), sign)
            furniture.add_picture(
                wall.at(3.0 + random.uniform(-0.2, 0.2), 0, z=1.55), random.uniform(0.6, 1.0),
                random.uniform(0.5, 0.8), f'canvas_{random.integers(1 << 30)}', TRIM)
        if random.integers(2):
            furniture.add_plant(south.at(0.25, -0.22), paint('d8d4c8'),
                                random.uniform(0.9, 1.3), int(random.integers(1 << 30)))
        windows = _close_ends(b, walls, self.ends)
        return _lit(b, windows, (1.05, ACROSS / 2, 0.3), (3.15, ACROSS / 2, 0.3))


@dataclass(frozen=True)
class Stairwell:
    """The end of a corridor: stairs up to a half landing, open to the west."""

    seed: int
    floor: int

    def build(self) -> tuple[Solids, LightSources]:
        """Return all solids in the stairwell's own frame, and its lamps and windows."""
        b = SolidBuilder()
        walls, _ = _common(self.seed)
        _add_floor_and_ceiling(b, WIDTH, ACROSS, paint('9aa0a6', 'tiles', 'c9cfd0', 0.3))
        for y in (0.0, ACROSS - HALF_WALL):
            b.box((0, y, 0), (WIDTH, y + HALF_WALL, CEILING), walls)
        stone, start = paint('b8b2a6', 'plaster'), 1.3
        for step in range(STEPS):
            x = start + step * STEP_RUN
            b.box((x, HALF_WALL, 0), (x + STEP_RUN, ACROSS - HALF_WALL, (step + 1) * STEP_RISE),
                  stone)
        b.box((start + STEPS * STEP_RUN, HALF_WALL, 0),
              (WIDTH, ACROSS - HALF_WALL, STEPS * STEP_RISE), stone)
        furniture.add_picture(b.at(0.75, ACROSS - HALF_WALL, z=1.6), 0.6, 0.6,
                              f'sign_F{self.floor}', TRIM)
        windows = _close_ends(b, walls, (False, True))
        return _lit(b, windows, (0.8, ACROSS / 2, 0.3))


@dataclass(frozen=True)
class Hall:
    """A piece of the hall that joins the corridors of several wings, to the west of them."""

    seed: int
    owner: int
    ends: tuple[bool, bool]  # walls close the south and the north end

    def build(self) -> tuple[Solids, LightSources]:
        """Return all solids in the piece's own frame, and its lamps and windows."""
        b = SolidBuilder()
        walls, floor = _common(self.seed)
        random = np.random.default_rng([self.seed, 102, self.owner])
        _add_floor_and_ceiling(b, ACROSS, WING, floor)
        opening = (DEPTH - 0.1, DEPTH + ACROSS + 0.1, 0.9, 2.3)
        add_wall(b, 0, HALF_WALL - OUTER, HALF_WALL, (0, WING), [opening], walls)
        add_window(b, 0, HALF_WALL, *opening, 1)
        add_wall(b, 0, ACROSS - HALF_WALL, ACROSS, (0, WING), [
            (DEPTH + HALF_WALL, DEPTH + ACROSS - HALF_WALL, 0.0, 2.5)], walls)
        for y, closed in ((0.0, self.ends[0]), (WING - HALF_WALL, self.ends[1])):
            if closed:
                b.box((0, y, 0), (ACROSS, y + HALF_WALL, CEILING), walls)
        for y in (1.2, 2.8, 7.0, 8.6):
            side = (b.at(ACROSS - HALF_WALL, y, -90) if random.integers(2)
                    else b.at(HALF_WALL, y, 90))
            furniture.add_picture(side.at(0, 0, z=1.55), random.uniform(0.6, 1.1),
                                  random.uniform(0.5, 0.8),
                                  f'canvas_{random.integers(1 << 30)}', TRIM)
        windows = ((0, HALF_WALL, *opening, 1),)
        return _lit(b, windows, (ACROSS / 2, 1.8, 0.3), (ACROSS / 2, 8.0, 0.3))


Piece = Room | Corridor | Stairwell | Hall


def _common(seed: int) -> tuple[Material, Material]:
    """Return what all walls and floors between the rooms are painted with."""
    random = np.random.default_rng([seed, 100])
    return wall_paint(random), floor_paint(random)


def _add_floor_and_ceiling(b: SolidBuilder, x: float, y: float, floor: Material) -> None:
    b.box((0, 0, -0.1), (x, y, 0), floor)
    b.box((0, 0, CEILING), (x, y, CEILING + 0.1), paint('f2f0ea', 'plaster'))


def _add_side_walls(b: SolidBuilder, depth: float, walls: Material) -> None:
    for x in (0.0, WIDTH - HALF_WALL):
        b.box((x, 0, 0), (x + HALF_WALL, depth, CEILING), walls)


def _add_door_frame(b: SolidBuilder, door: tuple[float, float]) -> None:
    """Line an opening through a wall from y = 0 to HALF_WALL; the other half has its own."""
    (start, end), t, high = door, 0.025, HALF_WALL + 0.015
    b.box((start - 0.05, 0, 0), (start + t, high, DOOR_TOP + 0.05), TRIM)
    b.box((end - t, 0, 0), (end + 0.05, high, DOOR_TOP + 0.05), TRIM)
    b.box((start + t, 0, DOOR_TOP - t), (end - t, high, DOOR_TOP + 0.05), TRIM)


def _add_sign(b: SolidBuilder, text: str) -> None:
    b.box((-0.13, -0.012, -0.065), (0.13, 0, 0.065), furniture.STEEL)
    b.box((-0.12, -0.014, -0.06), (0.12, -0.012, 0.06),
          Material('picture', (0.8, 0.8, 0.8), picture=f'sign_{text}'))


def _close_ends(b: SolidBuilder, walls: Material, ends: tuple[bool, bool]) -> tuple:
    windows = []
    for closed, wall, axis_at, side in ((ends[0], b, 0.0, 1),
                                        (ends[1], b.at(WIDTH, ACROSS, 180), WIDTH, -1)):
        if closed:
            opening = (0.4, ACROSS - 0.4, 0.9, 2.2)
            add_wall(wall, 0, -OUTER, 0, (0, ACROSS), [opening], walls)
            add_window(wall, 0, 0.0, *opening, 1)
            windows.append((0, axis_at, *opening, side))
    return tuple(windows)


def _lit(b: SolidBuilder, windows: tuple, *lamps: tuple[float, float, float]
         ) -> tuple[Solids, LightSources]:
    for lamp in lamps:
        add_ceiling_lamp(b, *lamp)
    return b.build(), LightSources(windows, lamps)
