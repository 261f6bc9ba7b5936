"""Pieces of furniture of the demo flat, each in its own frame: x right, y back, z up, metres."""
import math

from neo_ros.flat.shapes import Material, paint, SolidBuilder
import numpy as np

BOOK_COLOURS = ('b23a2e', '1f4e79', 'd9a441', '2e6b4f', 'ece2cc', '5b3a6e', 'c96f3b', '20262e',
                '7fa3b5', '8c1f3f', 'a8b06a', 'e6c9a8', '3f7f8c', 'd95f5f', '46505e')
STEEL = paint('9aa0a6')
BRASS = paint('b08d4a')
BLACK = paint('15171a')
WHITE = paint('ecebe6')


def add_legs(b: SolidBuilder, width: float, depth: float, height: float, material: Material,
             radius: float = 0.022, inset: float = 0.06) -> None:
    """Put four round legs under a piece of the given size, centred on the origin."""
    for x in (inset - width / 2, width / 2 - inset):
        for y in (inset - depth / 2, depth / 2 - inset):
            b.frustum(x, y, (0, height), (radius * 0.75, radius), material)


def add_table(b: SolidBuilder, width: float, depth: float, height: float,
              top: Material, legs: Material, radius: float = 0.03) -> None:
    """Add a table, centred on the origin."""
    b.box((-width / 2, -depth / 2, height - 0.035), (width / 2, depth / 2, height), top)
    b.box((-width / 2 + 0.08, -depth / 2 + 0.08, height - 0.11),
          (width / 2 - 0.08, depth / 2 - 0.08, height - 0.035), legs)
    add_legs(b, width, depth, height - 0.036, legs, radius)


def add_chair(b: SolidBuilder, seat: Material, frame: Material) -> None:
    """Add a dining chair, centred on the origin; one sits looking to -y."""
    add_legs(b, 0.46, 0.46, 0.43, frame, 0.02, 0.05)
    b.box((-0.21, -0.21, 0.43), (0.21, 0.21, 0.475), seat)
    for x in (-0.19, 0.16):
        b.box((x, 0.175, 0.476), (x + 0.03, 0.205, 0.92), frame)
    b.box((-0.158, 0.18, 0.62), (0.158, 0.2, 0.71), seat)
    b.box((-0.158, 0.18, 0.77), (0.158, 0.2, 0.9), seat)


def add_sofa(b: SolidBuilder, width: float, cloth: Material, feet: Material,
             cushions: tuple[Material, ...]) -> None:
    """Add a sofa with its back at y = 0.9, centred on x = 0."""
    half = width / 2
    b.box((-half + 0.16, 0.02, 0.1), (half - 0.16, 0.7, 0.3), cloth)
    b.box((-half + 0.16, 0.66, 0.1), (half - 0.16, 0.9, 0.78), cloth)
    for side in (-1, 1):
        x = side * (half - 0.08)
        b.box((x - 0.08, 0, 0.1), (x + 0.08, 0.9, 0.56), cloth)
        b.ellipsoid((x, 0.45, 0.56), (0.095, 0.48, 0.05), cloth)
        for y in (0.08, 0.82):
            b.frustum(side * (half - 0.1), y, (0, 0.1), (0.02, 0.03), feet)
    seats = round((width - 0.32) / 0.7)
    step = (width - 0.32) / seats
    for i in range(seats):
        x = -half + 0.16 + i * step
        b.box((x + 0.008, 0, 0.301), (x + step - 0.008, 0.66, 0.43), cloth)
        b.ellipsoid((x + step / 2, 0.31, 0.43), (step / 2 - 0.03, 0.3, 0.035), cloth)
        b.box((x + 0.012, 0.53, 0.431), (x + step - 0.012, 0.659, 0.83), cloth)
        b.ellipsoid((x + step / 2, 0.535, 0.63), (step / 2 - 0.05, 0.05, 0.18), cloth)
    places = np.linspace(-half + 0.42, half - 0.42, len(cushions))
    for i, (x, cushion) in enumerate(zip(places, cushions)):
        b.ellipsoid((x, 0.4, 0.63), (0.23, 0.09, 0.21), cushion, 14 * (-1) ** i)


def add_armchair(b: SolidBuilder, cloth: Material, feet: Material, cushion: Material) -> None:
    """Add an armchair, centred on the origin, its back at +y."""
    add_legs(b, 0.72, 0.7, 0.16, feet, 0.025)
    b.box((-0.28, -0.36, 0.16), (0.28, 0.3, 0.42), cloth)
    b.ellipsoid((0, -0.06, 0.42), (0.27, 0.28, 0.05), cloth)
    b.box((-0.28, 0.2, 0.42), (0.28, 0.36, 0.92), cloth)
    b.ellipsoid((0, 0.2, 0.68), (0.25, 0.07, 0.24), cloth)
    for x in (-0.34, 0.34):
        b.box((x - 0.06, -0.36, 0.16), (x + 0.06, 0.36, 0.6), cloth)
        b.ellipsoid((x, 0, 0.6), (0.07, 0.37, 0.04), cloth)
    b.ellipsoid((0.02, 0.06, 0.6), (0.19, 0.08, 0.18), cushion)


def add_shelf(b: SolidBuilder, width: float, depth: float, levels: tuple[float, ...],
              wood: Material, seed: int) -> None:
    """Add a bookshelf, its back at y = depth, x from 0; levels are heights of the boards."""
    rng = np.random.default_rng(seed)
    height = levels[-1]
    b.box((0, 0, 0), (0.03, depth, height + 0.03), wood)
    b.box((width - 0.03, 0, 0), (width, depth, height + 0.03), wood)
    b.box((0.03, depth - 0.02, 0), (width - 0.03, depth, height + 0.03), wood)
    for level in levels:
        b.box((0.03, 0.005, level), (width - 0.03, depth - 0.02, level + 0.03), wood)
    for low, high in zip(levels, levels[1:]):
        _add_books(b, rng, (0.04, width - 0.04), (low + 0.031, high), depth)


def _add_books(b: SolidBuilder, rng: np.random.Generator, across: tuple[float, float],
               room: tuple[float, float], depth: float) -> None:
    x, end = across
    gap_at = rng.uniform(across[0] + 0.2, end - 0.3)
    while x < end - 0.03:
        if x > gap_at:
            kind, gap_at = rng.integers(3), math.inf
            if kind == 0:
                _add_vase(b, x + 0.09, depth * 0.45, room[0], rng)
            elif kind == 1:
                _add_pile(b, x, room[0], depth, rng)
            x += 0.2
            continue
        thick = rng.uniform(0.024, 0.055)
        tall = min(rng.uniform(0.19, 0.29), room[1] - room[0] - 0.02)
        code, accent = rng.choice(BOOK_COLOURS, 2, replace=False)
        b.box((x, rng.uniform(0.03, 0.07), room[0]),
              (min(x + thick, end) - 0.002, depth - 0.03, room[0] + tall),
              paint(code, 'book', accent))
        x += thick


def _add_vase(b: SolidBuilder, x: float, y: float, z: float, rng: np.random.Generator) -> None:
    material = paint(str(rng.choice(BOOK_COLOURS)))
    b.frustum(x, y, (z, z + 0.13), (0.045, 0.07), material)
    b.frustum(x, y, (z + 0.13, z + 0.2), (0.07, 0.03), material)


def _add_pile(b: SolidBuilder, x: float, z: float, depth: float,
              rng: np.random.Generator) -> None:
    for _ in range(3):
        thick = rng.uniform(0.025, 0.045)
        code, accent = rng.choice(BOOK_COLOURS, 2, replace=False)
        b.box((x + rng.uniform(0, 0.02), 0.04, z), (x + 0.19, depth - 0.04, z + thick - 0.001),
              paint(code, 'plain', accent))
        z += thick


def add_cabinet(b: SolidBuilder, width: float, depth: float, height: float, doors: int,
                body: Material, front: Material, plinth: float = 0.08) -> None:
    """Add a cupboard, sideboard or wardrobe: x from 0, its back at y = depth."""
    b.box((0.02, 0.04, 0), (width - 0.02, depth, plinth), BLACK)
    b.box((0, 0.02, plinth), (width, depth, height), body)
    step = width / doors
    for i in range(doors):
        b.box((i * step + 0.006, 0, plinth + 0.01),
              ((i + 1) * step - 0.006, 0.02, height - 0.02), front)
        x = (i + 1) * step - 0.05 if i % 2 == 0 else i * step + 0.05
        z = min(1.05, plinth + (height - plinth) / 2)
        b.box((x - 0.01, -0.025, z - 0.07), (x + 0.01, 0, z + 0.07), BRASS)


def add_drawers(b: SolidBuilder, width: float, depth: float, height: float, rows: int,
                body: Material, front: Material) -> None:
    """Add a chest of drawers: x from 0, its back at y = depth."""
    b.box((0, 0.02, 0), (width, depth, height), body)
    step = (height - 0.08) / rows
    for i in range(rows):
        z = 0.05 + i * step
        b.box((0.02, 0, z + 0.008), (width - 0.02, 0.02, z + step - 0.008), front)
        for x in (width * 0.25, width * 0.75):
            b.ellipsoid((x, -0.012, z + step / 2), (0.02, 0.02, 0.02), BRASS)


def add_bed(b: SolidBuilder, width: float, length: float, wood: Material, linen: Material,
            blanket: Material, pillow: Material) -> None:
    """Add a bed, head at y = length, centred on x = 0."""
    half = width / 2
    b.box((-half, 0.02, 0.12), (half, length, 0.3), wood)
    b.box((-half, length - 0.06, 0.3), (half, length, 1.02), wood)
    b.box((-half, 0, 0.12), (half, 0.05, 0.42), wood)
    for x in (-half + 0.06, half - 0.06):
        for y in (0.08, length - 0.08):
            b.frustum(x, y, (0, 0.12), (0.03, 0.03), wood)
    b.box((-half + 0.03, 0.06, 0.301), (half - 0.03, length - 0.06, 0.5), linen)
    b.box((-half + 0.005, 0.055, 0.34), (half - 0.005, length * 0.66, 0.545), blanket)
    b.box((-half + 0.004, length * 0.6, 0.36), (half - 0.004, length * 0.68, 0.565), linen)
    for x in (-half * 0.48, half * 0.48):
        b.ellipsoid((x, length - 0.3, 0.57), (half * 0.42, 0.21, 0.1), pillow)
    b.ellipsoid((0.05, length - 0.5, 0.61), (0.24, 0.1, 0.15), blanket)


def add_floor_lamp(b: SolidBuilder, shade: Material) -> None:
    """Add a standing lamp on the origin."""
    b.frustum(0, 0, (0, 0.03), (0.15, 0.14), BLACK)
    b.frustum(0, 0, (0.03, 1.45), (0.013, 0.013), BRASS)
    b.frustum(0, 0, (1.4, 1.7), (0.22, 0.15), shade)


def add_table_lamp(b: SolidBuilder, foot: Material, shade: Material) -> None:
    """Add a small lamp on the origin."""
    b.ellipsoid((0, 0, 0.1), (0.075, 0.075, 0.1), foot)
    b.frustum(0, 0, (0.19, 0.25), (0.012, 0.012), BRASS)
    b.frustum(0, 0, (0.24, 0.42), (0.14, 0.09), shade)


def add_plant(b: SolidBuilder, pot: Material, height: float, seed: int) -> None:
    """Add a potted plant on the origin."""
    rng = np.random.default_rng(seed)
    b.frustum(0, 0, (0, 0.34), (0.13, 0.19), pot)
    b.frustum(0, 0, (0.34, 0.345), (0.17, 0.17), paint('3a2a1e'))
    b.frustum(0, 0, (0.345, height * 0.7), (0.025, 0.015), paint('5e4630'))
    for i in range(26):
        turn = i * 2.399963  # golden angle: leaves spread evenly
        z = height * (0.42 + 0.55 * i / 25)
        out = 0.27 * math.sqrt(max(1 - (2 * i / 25 - 0.9) ** 2 / 1.5, 0.15))
        green = ('35702f', '2a5a2c', '4c8a3a', '5f9a45')[rng.integers(4)]
        b.ellipsoid((out * math.cos(turn), out * math.sin(turn), z),
                    (0.15, 0.065, 0.03 + 0.03 * rng.random()), paint(green, 'fabric', scale=0.06),
                    math.degrees(turn))


def add_picture(b: SolidBuilder, width: float, height: float, name: str,
                frame: Material) -> None:
    """Hang a framed picture, its back at y = 0, looking to -y, centred on the origin."""
    w, h = width / 2, height / 2
    b.box((-w, -0.025, -h), (w, 0, h), frame)
    b.box((-w + 0.025, -0.027, -h + 0.025), (w - 0.025, -0.025, h - 0.025), WHITE)
    margin = 0.05 if width < 0.7 else 0.035
    b.box((-w + margin, -0.03, -h + margin), (w - margin, -0.027, h - margin),
          Material('picture', (0.35, 0.3, 0.26), picture=name))


def add_curtain(b: SolidBuilder, width: float, top: float, cloth: Material) -> None:
    """Hang a curtain from x = 0 to width, its folds around y = 0."""
    folds = max(round(width / 0.075), 3)
    for i in range(folds):
        x = (i + 0.5) * width / folds
        b.frustum(x, 0.012 * (-1) ** i, (0.04, top), (0.046, 0.036), cloth)


def add_radiator(b: SolidBuilder, width: float, height: float) -> None:
    """Add a radiator from x = 0, its back at y = 0.09."""
    b.box((0, 0.03, 0.14), (width, 0.07, height), WHITE)
    count = round(width / 0.08)
    for i in range(count):
        x = i * width / count
        b.box((x + 0.012, 0, 0.12), (x + width / count - 0.012, 0.03, height + 0.01), WHITE)
