"""The plan of the demo flat: a living room with a dining corner, and a bedroom with a desk."""
from functools import lru_cache

from neo_ros.flat import furniture as furniture
from neo_ros.flat.shapes import Material, paint, SolidBuilder, Solids
from neo_ros.flat.shell import add_ceiling_lamp, add_wall, add_window, CEILING, TRIM

LIVING = ((0.0, 0.0), (6.0, 4.2))
BEDROOM = ((6.14, 0.6), (10.0, 4.2))
DOOR = (2.1, 3.0)  # opening in y of the wall between the rooms
DOOR_TOP = 2.05
# (axis of the wall's normal, its coordinate, from, to, sill, top, side of the room)
WINDOWS = ((0, 0.0, 1.0, 3.1, 0.85, 2.25, 1), (1, 0.0, 3.85, 5.15, 0.9, 2.2, 1),
           (1, 0.6, 8.0, 9.3, 0.95, 2.2, 1))
# Round ceiling lamps: x, y, radius
LAMPS = ((2.6, 2.3, 0.26), (4.5, 1.2, 0.2), (8.0, 2.4, 0.24))
THICK = 0.07

OAK = paint('b98a58', 'wood', '8d6238', 0.12)
WALNUT = paint('6b4630', 'wood', '452b1c', 0.1)
BIRCH = paint('d8bd93', 'wood', 'bf9d6e', 0.14)
SHADE = paint('fff0d2', emission=1.1)


@lru_cache(maxsize=1)
def demo_solids() -> Solids:
    """Return all solids of the flat, metres."""
    b = SolidBuilder()
    _add_shell(b)
    _add_living(b)
    _add_dining(b)
    _add_bedroom(b)
    _add_study(b)
    return b.build()


def _add_shell(b: SolidBuilder) -> None:
    cream, sage = paint('e6dcc6', 'plaster'), paint('93a58a', 'plaster')
    ochre, blue = paint('cf9f62', 'plaster'), paint('a9bccb', 'stripes', 'bccbd6', 0.16)
    navy = paint('5d7794', 'damask', '7088a3', 0.24)
    ceiling = paint('f2f0ea', 'plaster')
    (x0, y0), (x1, y1) = LIVING
    b.box((x0 - 0.2, y0 - 0.2, -0.1), (x1 + THICK, y1 + 0.2, 0),
          paint('b08050', 'planks', '8a5c36', 0.14))
    b.box((x0 - 0.2, y0 - 0.2, CEILING), (x1 + THICK, y1 + 0.2, CEILING + 0.1), ceiling)
    door = [(*DOOR, 0.0, DOOR_TOP)]
    windows = [[(w[2], w[3], w[4], w[5])] for w in WINDOWS]
    add_wall(b, 0, x0 - 0.16, x0, (y0 - 0.16, y1 + 0.16), windows[0], cream)
    add_wall(b, 0, x1, x1 + THICK, (y0, y1), door, ochre)
    add_wall(b, 1, y0 - 0.16, y0, (x0, x1 + THICK), windows[1], cream)
    add_wall(b, 1, y1, y1 + 0.16, (x0, x1 + THICK), [], sage)
    _add_skirting(b, LIVING, paint('f0ede6'), door_on_high_x=True)
    (x0, y0), (x1, y1) = BEDROOM
    b.box((x0 - THICK, y0 - 0.2, -0.1), (x1 + 0.2, y1 + 0.2, 0),
          paint('b5654a', 'tiles', 'd9c4a5', 0.3))
    b.box((x0 - THICK, y0 - 0.2, CEILING), (x1 + 0.2, y1 + 0.2, CEILING + 0.1), ceiling)
    add_wall(b, 0, x0 - THICK, x0, (y0 - 0.16, y1), door, blue)
    add_wall(b, 0, x1, x1 + 0.16, (y0 - 0.16, y1 + 0.16), [], navy)
    add_wall(b, 1, y0 - 0.16, y0, (x0, x1), windows[2], blue)
    add_wall(b, 1, y1, y1 + 0.16, (x0, x1), [], blue)
    _add_skirting(b, BEDROOM, paint('f4f2ee'), door_on_high_x=False)
    _add_door_frame(b)
    for window in WINDOWS:
        add_window(b, *window)
    for x, y, radius in LAMPS:
        add_ceiling_lamp(b, x, y, radius)


def _add_skirting(b: SolidBuilder, room: tuple, material: Material,
                  door_on_high_x: bool) -> None:
    (x0, y0), (x1, y1) = room
    t, h = 0.015, 0.09
    b.box((x0, y0, 0), (x1, y0 + t, h), material)
    b.box((x0, y1 - t, 0), (x1, y1, h), material)
    for x, has_door in ((x0, not door_on_high_x), (x1 - t, door_on_high_x)):
        spans = [(y0, DOOR[0] - 0.08), (DOOR[1] + 0.08, y1)] if has_door else [(y0, y1)]
        for start, end in spans:
            b.box((x, start + t, 0), (x + t, end - t, h), material)


def _add_door_frame(b: SolidBuilder) -> None:
    x0, x1 = LIVING[1][0], BEDROOM[0][0]
    y0, y1 = DOOR
    t = 0.025
    b.box((x0 - 0.005, y0, 0), (x1 + 0.005, y0 + t, DOOR_TOP), TRIM)
    b.box((x0 - 0.005, y1 - t, 0), (x1 + 0.005, y1, DOOR_TOP), TRIM)
    b.box((x0 - 0.005, y0, DOOR_TOP - t), (x1 + 0.005, y1, DOOR_TOP), TRIM)
    b.box((x0, y0 + t, 0), (x1, y1 - t, 0.008), WALNUT_SILL)
    for low, high in ((x0 - 0.018, x0), (x1, x1 + 0.018)):
        b.box((low, y0 - 0.075, 0), (high, y0 + 0.005, DOOR_TOP + 0.075), TRIM)
        b.box((low, y1 - 0.005, 0), (high, y1 + 0.075, DOOR_TOP + 0.075), TRIM)
        b.box((low, y0 + 0.005, DOOR_TOP - 0.005), (high, y1 - 0.005, DOOR_TOP + 0.075), TRIM)


WALNUT_SILL = paint('5a3d2a', 'wood', '452b1c', 0.1)


def _add_living(b: SolidBuilder) -> None:
    teal = paint('2c6a73', 'fabric', scale=0.05)
    mustard, coral = paint('d9a12f', 'fabric', scale=0.05), paint('c95d45', 'fabric', scale=0.05)
    furniture.add_sofa(b.at(2.2, 3.25), 2.2, teal, WALNUT,
                       (mustard, paint('e8dfcf', 'fabric', scale=0.05), coral))
    b.box((0.95, 1.65, 0), (3.45, 3.2, 0.012), Material('picture', (0.4, 0.25, 0.2),
                                                        picture='rug_living'))
    table = b.at(2.2, 2.3, z=0.012)
    furniture.add_table(table, 1.1, 0.6, 0.42, WALNUT, WALNUT)
    table.box((-0.35, -0.16, 0.42), (-0.08, 0.04, 0.445), paint('ece2cc', 'plain'))
    table.box((-0.33, -0.14, 0.445), (-0.1, 0.03, 0.465), paint('b23a2e'))
    table.frustum(0.25, 0.05, (0.42, 0.5), (0.06, 0.13), paint('3f7f8c'))
    for dx, dy, code in ((0.22, 0.06, 'd98a2b'), (0.29, 0.08, '7fa33a'), (0.25, 0.0, 'c9402f')):
        table.ellipsoid((dx, dy, 0.51), (0.04, 0.04, 0.04), paint(code))
    for x, name in ((1.42, 'abstract_a'), (2.2, 'landscape_a'), (2.98, 'abstract_b')):
        wide = 0.86 if name == 'landscape_a' else 0.5
        furniture.add_picture(b.at(x, 4.2, z=1.58), wide, 0.62, name, WALNUT)
    furniture.add_floor_lamp(b.at(0.55, 3.8), SHADE)
    furniture.add_armchair(b.at(0.75, 3.0, 60), paint('b5533c', 'fabric', scale=0.05), WALNUT,
                           paint('e5d9bd', 'stripes', '3a5f7a', 0.08))
    furniture.add_shelf(b.at(4.35, 3.9), 1.3, 0.3, (0.06, 0.42, 0.78, 1.12, 1.46, 1.8, 2.1),
                        OAK, 7)
    _add_media_wall(b)
    furniture.add_plant(b.at(0.42, 0.42), paint('d8d4c8'), 1.55, 3)
    cloth = paint('c8b48c', 'fabric', scale=0.05)
    furniture.add_curtain(b.at(0.1, 0.62, 90), 0.42, 2.42, cloth)
    furniture.add_curtain(b.at(0.1, 3.06, 90), 0.42, 2.42, cloth)
    b.box((0.07, 0.55, 2.42), (0.12, 3.55, 2.45), furniture.BRASS)
    furniture.add_radiator(b.at(0.1, 1.35, 90), 1.4, 0.66)


def _add_media_wall(b: SolidBuilder) -> None:
    side = b.at(2.75, 0.42, 180)
    furniture.add_cabinet(side, 1.9, 0.42, 0.52, 4, BIRCH, paint('f0eee8', 'plain'))
    tv = b.at(1.8, 0.14, 180)
    tv.box((-0.2, -0.1, 0.52), (0.2, 0.1, 0.535), furniture.BLACK)
    tv.box((-0.05, -0.02, 0.535), (0.05, 0.02, 0.65), furniture.BLACK)
    tv.box((-0.56, -0.02, 0.62), (0.56, 0.02, 1.28), furniture.BLACK)
    tv.box((-0.54, -0.023, 0.645), (0.54, -0.02, 1.262),
           Material('picture', (0.1, 0.15, 0.2), emission=0.25, picture='screen'))
    furniture.add_table_lamp(b.at(2.55, 0.2, z=0.52), paint('3f7f8c'), SHADE)
    b.frustum(1.0, 0.2, (0.52, 0.72), (0.05, 0.08), paint('e6e2d6'))
    b.ellipsoid((1.0, 0.2, 0.84), (0.12, 0.12, 0.13), paint('6f9a4a', 'fabric', scale=0.06))
    furniture.add_picture(b.at(1.8, 0.0, 180, z=1.78), 1.0, 0.5, 'landscape_b', furniture.BLACK)
    furniture.add_picture(b.at(3.25, 0.0, 180, z=1.55), 0.5, 0.7, 'portrait_a', furniture.BRASS)


def _add_dining(b: SolidBuilder) -> None:
    furniture.add_table(b.at(4.55, 1.15), 1.3, 0.75, 0.75, OAK, OAK, 0.04)
    seats = (('f0ede6', 4.2, 1.62, 0), ('3a6ea5', 4.88, 1.66, 8),
             ('d9a12f', 4.2, 0.66, 180), ('f0ede6', 4.9, 0.62, 175))
    for code, x, y, turn in seats:
        furniture.add_chair(b.at(x, y, turn), paint(code), WALNUT if code[0] == 'f' else OAK)
    b.frustum(4.55, 1.15, (0.75, 0.95), (0.04, 0.06), paint('9fc4cf'))
    for i, code in enumerate(('d4473f', 'e9c04a', 'd97aa0', 'e8e4dc', 'd4473f', 'e9c04a')):
        dx, dy = ((0.0, 0.05), (0.05, 0.02), (-0.05, 0.02), (0.03, -0.05), (-0.03, -0.05),
                  (0.0, 0.0))[i]
        b.ellipsoid((4.55 + dx, 1.15 + dy, 1.04 + 0.05 * (i % 3)), (0.045, 0.045, 0.04),
                    paint(code))
    b.ellipsoid((4.55, 1.15, 0.99), (0.08, 0.08, 0.06), paint('4c8a3a', 'fabric', scale=0.06))
    for x, y in ((4.2, 1.32), (4.9, 1.32), (4.2, 0.98), (4.9, 0.98)):
        b.frustum(x, y, (0.75, 0.762), (0.08, 0.12), paint('f4f2ec'))
    cloth = paint('9c4a3c', 'fabric', scale=0.05)
    furniture.add_curtain(b.at(3.5, 0.1), 0.36, 2.38, cloth)
    furniture.add_curtain(b.at(5.12, 0.1), 0.36, 2.38, cloth)
    b.box((3.4, 0.08, 2.38), (5.56, 0.11, 2.41), furniture.BLACK)
    furniture.add_cabinet(b.at(6.0, 1.75, -90).at(0, -0.38), 1.1, 0.38, 0.9, 2,
                          paint('3d5a50'), paint('466a5e'))
    furniture.add_picture(b.at(6.0, 1.2, -90, z=1.55), 0.8, 0.6, 'abstract_c', furniture.WHITE)
    b.frustum(5.8, 1.5, (0.9, 1.16), (0.06, 0.035), paint('c96f3b'))
    b.frustum(5.82, 0.85, (0.9, 0.98), (0.07, 0.15), paint('ece2cc'))
    furniture.add_picture(b.at(6.0, 3.6, -90, z=1.6), 0.6, 0.8, 'portrait_b', OAK)
    furniture.add_plant(b.at(5.68, 3.35), paint('b5654a'), 1.0, 5)


def _add_bedroom(b: SolidBuilder) -> None:
    furniture.add_bed(b.at(7.98, 3.38, -90), 1.5, 2.0, WALNUT, paint('f1ede4', 'fabric'),
                      paint('a8323a', 'stripes', 'd98f6a', 0.22), paint('f6f3ec', 'fabric'))
    b.box((6.95, 2.2, 0), (8.75, 3.3, 0.012),
          Material('picture', (0.35, 0.33, 0.3), picture='rug_bedroom'))
    furniture.add_drawers(b.at(10.0, 2.55, -90).at(0, -0.4), 0.42, 0.4, 0.52, 2, BIRCH, BIRCH)
    furniture.add_table_lamp(b.at(9.8, 2.34, z=0.52), paint('d9a12f'), SHADE)
    furniture.add_picture(b.at(10.0, 3.4, -90, z=1.62), 1.1, 0.7, 'landscape_c', BIRCH)
    furniture.add_picture(b.at(8.95, 4.2, z=1.6), 0.5, 0.5, 'abstract_d', furniture.BLACK)
    furniture.add_drawers(b.at(6.5, 3.8), 1.0, 0.4, 0.82, 3, paint('e9e4d8'),
                          paint('f3efe6'))
    b.frustum(6.7, 4.0, (0.82, 1.06), (0.06, 0.04), paint('5b3a6e'))
    b.box((6.9, 3.93, 0.82), (7.3, 4.1, 0.9), paint('c9b189', 'fabric', scale=0.03))
    furniture.add_picture(b.at(7.0, 4.2, z=1.55), 0.55, 0.75, 'portrait_c', BIRCH)


def _add_study(b: SolidBuilder) -> None:
    furniture.add_cabinet(b.at(6.14, 0.66, 90).at(0, -0.6), 1.3, 0.6, 2.15, 3,
                          paint('e9e6de'), paint('f2f0ea', 'panel', 'dcd8cc'))
    desk = b.at(8.65, 0.95)
    furniture.add_table(desk, 1.4, 0.65, 0.74, BIRCH, furniture.WHITE, 0.025)
    desk.box((-0.12, -0.22, 0.74), (0.12, -0.06, 0.75), furniture.BLACK)
    desk.box((-0.02, -0.17, 0.75), (0.02, -0.14, 0.86), furniture.STEEL)
    desk.box((-0.3, -0.15, 0.84), (0.3, -0.12, 1.2), furniture.BLACK)
    desk.box((-0.285, -0.12, 0.855), (0.285, -0.118, 1.185),
             Material('picture', (0.1, 0.15, 0.2), emission=0.3, picture='desktop'))
    desk.box((-0.22, 0.05, 0.74), (0.2, 0.19, 0.755), paint('33373d'))
    furniture.add_table_lamp(desk.at(-0.55, -0.12, z=0.74), paint('b23a2e'), SHADE)
    desk.frustum(0.55, -0.1, (0.74, 0.84), (0.04, 0.04), paint('d9a12f'))
    chair = b.at(8.6, 1.55, -12)
    for turn in range(5):
        foot = chair.at(0, 0, 72 * turn)
        foot.box((0, -0.02, 0.05), (0.28, 0.02, 0.08), furniture.BLACK)
    chair.frustum(0, 0, (0.08, 0.42), (0.03, 0.03), furniture.STEEL)
    green = paint('4f7f5a', 'fabric', scale=0.05)
    chair.box((-0.23, -0.23, 0.42), (0.23, 0.23, 0.48), green)
    chair.ellipsoid((0, 0, 0.48), (0.22, 0.22, 0.035), green)
    chair.box((-0.03, 0.22, 0.48), (0.03, 0.25, 0.66), furniture.BLACK)
    chair.ellipsoid((0, 0.23, 0.82), (0.22, 0.045, 0.22), green)
    shelf = b.at(10.0, 1.95, -90).at(0, -0.26)
    furniture.add_shelf(shelf, 0.75, 0.26, (0.06, 0.42, 0.78, 1.12, 1.46, 1.8), BIRCH, 21)
    furniture.add_picture(b.at(7.4, 0.6, 180, z=1.55), 0.6, 0.8, 'abstract_e', WALNUT)
    cloth = paint('6b7f9c', 'fabric', scale=0.05)
    furniture.add_curtain(b.at(7.76, 0.68), 0.3, 2.38, cloth)
    furniture.add_curtain(b.at(9.24, 0.68), 0.3, 2.38, cloth)
    b.box((7.7, 0.66, 2.38), (9.6, 0.69, 2.41), furniture.STEEL)
