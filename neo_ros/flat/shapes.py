"""The solid shapes the demo flat is built from: boxes, vertical cone frusta, ellipsoids."""
from collections.abc import Sequence
from dataclasses import dataclass
from functools import cached_property
import math

import numpy as np

BOX, FRUSTUM, ELLIPSOID = 0, 1, 2
FACES = 6  # charts a solid may have: box -x +x -y +y -z +z; frustum side, bottom, top


@dataclass(frozen=True)
class Material:
    """
    What a solid looks like.

    kind      a pattern of demo_textures
    colour    linear RGB reflectance in [0, 1], also the mean that bounces light
    accent    second colour of the pattern
    scale     metres, the size of the pattern
    emission  added light; 1 is a white wall in full light
    picture   name of a bitmap of demo_pictures, for the kind 'picture'
    """

    kind: str
    colour: tuple[float, float, float]
    accent: tuple[float, float, float] = (0.0, 0.0, 0.0)
    scale: float = 1.0
    emission: float = 0.0
    picture: str = ''


def srgb(code: str) -> tuple[float, float, float]:
    """Turn 'rrggbb' into linear RGB in [0, 1]."""
    values = [int(code[i:i + 2], 16) / 255 for i in (0, 2, 4)]
    red, green, blue = (
        v / 12.92 if v <= 0.04045 else ((v + 0.055) / 1.055) ** 2.4 for v in values)
    return red, green, blue


def paint(code: str, kind: str = 'plain', accent: str = '000000', scale: float = 1.0,
          emission: float = 0.0) -> Material:
    """Make a Material from sRGB codes 'rrggbb'."""
    return Material(kind, srgb(code), srgb(accent), scale, emission)


@dataclass(frozen=True, eq=False)
class Solids:
    """
    N solids as arrays; lengths in metres, world z up.

    kind (N,) int; centre (N, 3); yaw (N,) radians about z;
    half (N, 3): half extents of a box, radii of an ellipsoid, and (bottom radius, top radius,
    half height) of a frustum; materials N of them.
    """

    kind: np.ndarray
    centre: np.ndarray
    half: np.ndarray
    yaw: np.ndarray
    materials: tuple[Material, ...]

    def __len__(self) -> int:
        return len(self.kind)

    @cached_property
    def reach(self) -> np.ndarray:
        """Half extents (N, 3) of the axis-aligned bounding boxes."""
        cos, sin = np.abs(np.cos(self.yaw)), np.abs(np.sin(self.yaw))
        reach = self.half.copy()
        reach[:, 0] = cos * self.half[:, 0] + sin * self.half[:, 1]
        reach[:, 1] = sin * self.half[:, 0] + cos * self.half[:, 1]
        frustum = self.kind == FRUSTUM
        reach[frustum, :2] = self.half[frustum, :2].max(axis=1, keepdims=True)
        return reach

    @property
    def lower(self) -> np.ndarray:
        """Lower corners (N, 3) of the axis-aligned bounding boxes."""
        return self.centre - self.reach

    @property
    def upper(self) -> np.ndarray:
        """Upper corners (N, 3) of the axis-aligned bounding boxes."""
        return self.centre + self.reach


class SolidBuilder:
    """Collect solids; `at` gives a builder whose coordinates are those of a piece of furniture."""

    def __init__(self) -> None:
        self._rows: list[tuple[int, tuple[float, ...], tuple[float, ...], float, Material]] = []
        self._x = self._y = self._z = self._yaw = 0.0

    def at(self, x: float, y: float, yaw_deg: float = 0.0, z: float = 0.0) -> 'SolidBuilder':
        """Return a builder of the same flat with its origin moved and turned."""
        child = SolidBuilder()
        child._rows = self._rows
        child._x, child._y = self._world(x, y)
        child._z = self._z + z
        child._yaw = self._yaw + math.radians(yaw_deg)
        return child

    def box(self, lower: Sequence[float], upper: Sequence[float], material: Material) -> None:
        """Add a box from its two corners."""
        half = [(b - a) / 2 for a, b in zip(lower, upper)]
        x, y = self._world((lower[0] + upper[0]) / 2, (lower[1] + upper[1]) / 2)
        quarters = self._yaw / (math.pi / 2)
        yaw = self._yaw
        if abs(quarters - round(quarters)) < 1e-9:  # stay exactly axis-aligned
            yaw = 0.0
            if round(quarters) % 2:
                half[0], half[1] = half[1], half[0]
        centre = (x, y, self._z + (lower[2] + upper[2]) / 2)
        self._rows.append((BOX, centre, tuple(half), yaw, material))

    def frustum(self, x: float, y: float, z: tuple[float, float], radius: tuple[float, float],
                material: Material) -> None:
        """Add a vertical cone frustum; z and radius are (bottom, top)."""
        centre = (*self._world(x, y), self._z + (z[0] + z[1]) / 2)
        half = (radius[0], radius[1], (z[1] - z[0]) / 2)
        self._rows.append((FRUSTUM, centre, half, 0.0, material))

    def ellipsoid(self, centre: Sequence[float], radii: Sequence[float],
                  material: Material, yaw_deg: float = 0.0) -> None:
        """Add an ellipsoid with its own turn about z."""
        x, y = self._world(centre[0], centre[1])
        self._rows.append((ELLIPSOID, (x, y, self._z + centre[2]), tuple(radii),
                           self._yaw + math.radians(yaw_deg), material))

    def build(self) -> Solids:
        """Return everything added so far."""
        kinds, centres, halves, yaws, materials = zip(*self._rows)
        return Solids(np.array(kinds), np.array(centres), np.array(halves), np.array(yaws),
                      tuple(materials))

    def _world(self, x: float, y: float) -> tuple[float, float]:
        cos, sin = math.cos(self._yaw), math.sin(self._yaw)
        return self._x + cos * x - sin * y, self._y + sin * x + cos * y
