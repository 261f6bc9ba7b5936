"""
Rooms of a building: what stands in an office, a meeting room, a lounge or a guest room.

A room is 4.2 x 4.0 m from wall centre to wall centre, in its own frame: x right, y into the room,
the door in the wall y = 0. Every thing in it is drawn from a seed of its own, so that two rooms
can share some of them, or all.
"""
from collections.abc import Callable

from neo_ros.flat import furniture
from neo_ros.flat.furniture import BLACK, BRASS, STEEL, WHITE
from neo_ros.flat.shapes import Material, paint, SolidBuilder
from neo_ros.flat.shell import TRIM
import numpy as np

WIDTH, DEPTH = 4.2, 4.0
HALF_WALL = 0.06
EAST, NORTH = WIDTH - HALF_WALL, DEPTH - HALF_WALL
WOODS = (('b98a58', '8d6238'), ('6b4630', '452b1c'), ('d8bd93', 'bf9d6e'), ('8a5a3a', '5e3a22'))
CLOTHS = ('2c6a73', 'b5533c', '4f7f5a', '6b7f9c', 'd9a12f', '7a2f4a', '3a5f7a', '8a8f6a',
          'c8b48c', '5b3a6e', '9c4a3c', '46505e')
WALLS = ('e6dcc6', '93a58a', 'cf9f62', 'a9bccb', 'd8c3b8', 'c9cfa8', 'b8a9c4', 'e8e2d2', '8fb0a8')
Random = np.random.Generator
Thing = Callable[[SolidBuilder, Random], None]


def against(b: SolidBuilder, side: str, centre: float) -> SolidBuilder:
    """Return a builder whose y = 0 is a wall, its room at -y, its x = 0 `centre` along it."""
    x, y, turn = {'north': (centre, NORTH, 0.0), 'east': (EAST, centre, -90.0),
                  'south': (centre, HALF_WALL, 180.0), 'west': (HALF_WALL, centre, 90.0)}[side]
    return b.at(x, y, turn)


def wood(random: Random) -> Material:
    """Choose a wood."""
    dark, light = WOODS[random.integers(len(WOODS))]
    return paint(dark, 'wood', light, 0.12)


def cloth(random: Random, scale: float = 0.05) -> Material:
    """Choose a fabric."""
    return paint(CLOTHS[random.integers(len(CLOTHS))], 'fabric', scale=scale)


def colour(random: Random) -> Material:
    """Choose a plain colour."""
    return paint(str(random.choice(furniture.BOOK_COLOURS)))


def wall_paint(random: Random) -> Material:
    """Choose what is on the walls."""
    code = WALLS[random.integers(len(WALLS))]
    other = WALLS[random.integers(len(WALLS))]
    kind = ('plaster', 'plaster', 'stripes', 'damask')[random.integers(4)]
    return paint(code, kind, other, {'stripes': 0.16, 'damask': 0.24}.get(kind, 1.0))


def floor_paint(random: Random) -> Material:
    """Choose what one walks on."""
    dark, light = WOODS[random.integers(len(WOODS))]
    return (paint(dark, 'planks', light, 0.14), paint('b5654a', 'tiles', 'd9c4a5', 0.3),
            paint('8a9aa0', 'tiles', 'c9cfd0', 0.4), cloth(random, 0.08))[random.integers(4)]


def picture(side: str, centre: float) -> Thing:
    """Hang a picture that no other seed has."""
    def add(b: SolidBuilder, random: Random) -> None:
        wide, high = random.uniform(0.45, 0.95), random.uniform(0.5, 0.75)
        furniture.add_picture(
            against(b, side, centre + random.uniform(-0.12, 0.12)).at(0, 0, z=1.58), wide, high,
            f'canvas_{random.integers(1 << 30)}', wood(random))
    return add


def plant(x: float, y: float) -> Thing:
    """Put a plant into a corner."""
    def add(b: SolidBuilder, random: Random) -> None:
        furniture.add_plant(b.at(x, y), colour(random), random.uniform(0.9, 1.6),
                            int(random.integers(1 << 30)))
    return add


def shelf(side: str, centre: float) -> Thing:
    """Put a shelf full of books against a wall."""
    def add(b: SolidBuilder, random: Random) -> None:
        wide = random.uniform(0.8, 1.3)
        levels = (0.06, 0.42, 0.78, 1.12, 1.46, 1.8)[:random.integers(4, 7)]
        furniture.add_shelf(against(b, side, centre).at(-wide / 2, -0.3), wide, 0.3, levels,
                            wood(random), int(random.integers(1 << 30)))
    return add


def cabinet(side: str, centre: float) -> Thing:
    """Put a cupboard or a chest of drawers against a wall, something on it."""
    def add(b: SolidBuilder, random: Random) -> None:
        wide, high = random.uniform(0.8, 1.2), random.uniform(0.7, 1.0)
        place = against(b, side, centre).at(-wide / 2, -0.42)
        if random.integers(2):
            furniture.add_cabinet(place, wide, 0.42, high, 2, wood(random), colour(random))
        else:
            furniture.add_drawers(place, wide, 0.42, high, 3, wood(random), colour(random))
        place.frustum(wide * 0.3, 0.2, (high, high + random.uniform(0.15, 0.3)), (0.05, 0.09),
                      colour(random))
        if random.integers(2):
            furniture.add_table_lamp(place.at(wide * 0.7, 0.2, z=high), colour(random),
                                     paint('fff0d2', emission=1.1))
    return add


def rug(b: SolidBuilder, random: Random) -> None:
    """Lay a rug into the middle."""
    name = ('rug_living', 'rug_bedroom')[random.integers(2)]
    x, y = random.uniform(1.1, 1.4), random.uniform(1.3, 1.5)
    b.box((x, y, 0), (x + random.uniform(1.4, 1.9), y + random.uniform(0.9, 1.2), 0.012),
          Material('picture', (0.38, 0.3, 0.27), picture=name))


def radiator(b: SolidBuilder, random: Random) -> None:
    """Hang a radiator under where the window is, or would be."""
    furniture.add_radiator(b.at(random.uniform(1.3, 1.5), NORTH - 0.09), 1.2, 0.62)


def desk(side: str, centre: float) -> Thing:
    """Put a desk with screen, keyboard and chair against a wall."""
    def add(b: SolidBuilder, random: Random) -> None:
        wide = random.uniform(1.2, 1.5)
        place = against(b, side, centre).at(random.uniform(-0.1, 0.1), -0.36)
        furniture.add_table(place, wide, 0.68, 0.74, wood(random), WHITE, 0.025)
        place.box((-0.02, 0.1, 0.74), (0.02, 0.13, 0.86), STEEL)
        place.box((-0.3, 0.12, 0.84), (0.3, 0.15, 1.2), BLACK)
        place.box((-0.285, 0.118, 0.855), (0.285, 0.12, 1.185), Material(
            'picture', (0.1, 0.15, 0.2), emission=0.3,
            picture=('desktop', 'screen')[random.integers(2)]))
        place.box((-0.22, -0.2, 0.74), (0.2, -0.06, 0.755), paint('33373d'))
        place.frustum(0.5, 0.05, (0.74, 0.84), (0.04, 0.04), colour(random))
        place.box((-0.6, -0.2, 0.74), (-0.35, 0.1, 0.74 + random.uniform(0.02, 0.08)),
                  colour(random))
        _office_chair(place.at(random.uniform(-0.1, 0.1), -0.55, 180 + random.uniform(-35, 35)),
                      cloth(random))
    return add


def _office_chair(b: SolidBuilder, fabric: Material) -> None:
    for turn in range(5):
        b.at(0, 0, 72 * turn).box((0, -0.02, 0.05), (0.28, 0.02, 0.08), BLACK)
    b.frustum(0, 0, (0.08, 0.42), (0.03, 0.03), STEEL)
    b.box((-0.23, -0.23, 0.42), (0.23, 0.23, 0.48), fabric)
    b.box((-0.03, 0.22, 0.48), (0.03, 0.25, 0.66), BLACK)
    b.ellipsoid((0, 0.23, 0.82), (0.22, 0.045, 0.22), fabric)


def meeting_table(b: SolidBuilder, random: Random) -> None:
    """Put a table with four chairs into the room."""
    place = b.at(2.75, 2.45, random.uniform(-4, 4))
    furniture.add_table(place, 1.1, 1.5, 0.75, wood(random), STEEL, 0.035)
    seat, frame = colour(random), wood(random)
    for x, turn in ((-0.75, 90.0), (0.75, -90.0)):
        for y in (-0.38, 0.38):
            furniture.add_chair(place.at(x, y, turn + random.uniform(-12, 12)), seat, frame)
    for _ in range(4):
        place.box((-0.3, -0.4, 0.75), (-0.09, -0.11, 0.755), WHITE)
    place.frustum(0.1, random.uniform(-0.3, 0.3), (0.75, 0.95), (0.04, 0.06), colour(random))


def board(b: SolidBuilder, random: Random) -> None:
    """Hang a large screen onto the east wall."""
    place = against(b, 'east', 2.2).at(0, 0, z=1.45)
    place.box((-0.8, -0.05, -0.45), (0.8, 0, 0.45), BLACK)
    place.box((-0.77, -0.053, -0.42), (0.77, -0.05, 0.42), Material(
        'picture', (0.1, 0.15, 0.2), emission=0.25,
        picture=('desktop', 'screen')[random.integers(2)]))


def sofa(b: SolidBuilder, random: Random) -> None:
    """Put a sofa under the window wall and a low table before it."""
    place = b.at(2.3 + random.uniform(-0.1, 0.1), NORTH - 1.05)
    furniture.add_sofa(place, 2.1, cloth(random), wood(random),
                       tuple(cloth(random) for _ in range(3)))
    table = place.at(random.uniform(-0.2, 0.2), -0.55, z=0.012)
    furniture.add_table(table, 0.9, 0.5, 0.42, wood(random), wood(random))
    table.frustum(0.2, 0.05, (0.42, 0.5), (0.06, 0.13), colour(random))
    table.box((-0.3, -0.14, 0.42), (-0.08, 0.03, 0.45), colour(random))


def armchair(b: SolidBuilder, random: Random) -> None:
    """Put an armchair beside the way in."""
    furniture.add_armchair(b.at(3.45, 1.15, 180 + random.uniform(20, 50)), cloth(random),
                           wood(random), cloth(random))


def floor_lamp(b: SolidBuilder, random: Random) -> None:
    """Put a lamp into the corner beside the sofa."""
    furniture.add_floor_lamp(b.at(0.45, 3.55), paint('fff0d2', emission=random.uniform(0.8, 1.2)))


def bed(b: SolidBuilder, random: Random) -> None:
    """Put a bed with its head against the east wall."""
    furniture.add_bed(b.at(EAST - 2.02, 2.75, -90), 1.4, 2.0, wood(random),
                      paint('f1ede4', 'fabric'), paint(
                          CLOTHS[random.integers(len(CLOTHS))], 'stripes',
                          CLOTHS[random.integers(len(CLOTHS))], 0.22),
                      paint('f6f3ec', 'fabric'))


def wardrobe(b: SolidBuilder, random: Random) -> None:
    """Put a wardrobe against the west wall."""
    furniture.add_cabinet(against(b, 'west', 3.1).at(-0.65, -0.55), 1.3, 0.55, 2.1, 3,
                          wood(random), paint('f2f0ea', 'panel', 'dcd8cc'))


def curtains(b: SolidBuilder, random: Random) -> None:
    """Hang curtains beside the window."""
    fabric = cloth(random)
    for x in (0.95, 2.9):
        furniture.add_curtain(b.at(x, NORTH - 0.1), 0.36, 2.4, fabric)
    b.box((0.9, NORTH - 0.12, 2.4), (3.3, NORTH - 0.09, 2.43), (BRASS, STEEL, TRIM)[
        random.integers(3)])


KINDS: dict[str, tuple[Thing, ...]] = {
    'office': (desk('east', 2.7), desk('west', 2.9), shelf('south', 3.1), cabinet('east', 1.25),
               plant(0.4, 3.55), plant(3.75, 3.6), rug),
    'meeting': (meeting_table, board, cabinet('west', 2.3), shelf('south', 3.2),
                plant(0.42, 3.5), radiator),
    'lounge': (sofa, armchair, shelf('west', 2.9), floor_lamp, rug, cabinet('east', 2.2)),
    'guest room': (bed, wardrobe, cabinet('south', 3.2), rug, radiator)}
# What every room has; a picture comes first: twins may differ in it alone.
PICTURES: tuple[Thing, ...] = (picture('west', 1.7), picture('east', 2.6), picture('south', 2.5),
                               picture('north', 2.1), picture('west', 3.0))
