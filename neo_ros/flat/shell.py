"""Walls with openings, and windows: what rooms of the demo flat and of buildings are made of."""
from neo_ros.flat.shapes import Material, paint, SolidBuilder

CEILING = 2.6
TRIM = paint('efece4')


def add_wall(b: SolidBuilder, axis: int, low: float, high: float, span: tuple[float, float],
             openings: list[tuple[float, float, float, float]], material: Material) -> None:
    """
    Build a wall from `low` to `high` across `axis`, along `span`.

    openings: from and to along the wall, sill and top, metres.
    """
    def piece(start: float, end: float, bottom: float, top: float) -> None:
        if axis == 0:
            b.box((low, start, bottom), (high, end, top), material)
        else:
            b.box((start, low, bottom), (end, high, top), material)
    at = span[0]
    for start, end, sill, top in openings:
        piece(at, start, 0, CEILING)
        if sill > 0:
            piece(start, end, 0, sill)
        piece(start, end, top, CEILING)
        at = end
    piece(at, span[1], 0, CEILING)


def add_window(b: SolidBuilder, axis: int, wall: float, start: float, end: float,
               sill: float, top: float, _side: int) -> None:
    """Frame, mullion and sill of a window; all windows lie in low-x or low-y walls."""
    def bar(u0: float, u1: float, v0: float, v1: float, depth: tuple[float, float]) -> None:
        low, high = wall + depth[0], wall + depth[1]
        if axis == 0:
            b.box((low, u0, v0), (high, u1, v1), TRIM)
        else:
            b.box((u0, low, v0), (u1, high, v1), TRIM)
    w, depth = 0.055, (-0.1, -0.05)
    bar(start, end, sill, sill + w, depth)
    bar(start, end, top - w, top, depth)
    bar(start, start + w, sill, top, depth)
    bar(end - w, end, sill, top, depth)
    middle = (start + end) / 2
    bar(middle - w / 2, middle + w / 2, sill, top, depth)
    upper = top - (top - sill) * 0.27
    bar(start, end, upper - w / 3, upper + w / 3, (-0.095, -0.055))
    bar(start - 0.06, end + 0.06, sill - 0.03, sill + 0.001, (-0.1, 0.13))


def add_ceiling_lamp(b: SolidBuilder, x: float, y: float, radius: float) -> None:
    """Hang a round lamp under the ceiling."""
    b.frustum(x, y, (CEILING - 0.02, CEILING - 0.001), (radius * 0.5, radius * 0.5), TRIM)
    b.ellipsoid((x, y, CEILING - 0.07), (radius, radius, 0.06), paint('fff6e4', emission=2.2))
