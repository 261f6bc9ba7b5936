"""
A floor cut into tiles that are fitted one by one, and the field that they make together.

Every tile has voxels as fine as a single room's. They lie on one lattice, so that joining the
fields of all tiles blurs nothing: a view through a door shows both tiles as they were fitted.
Mega-NeRF (Turki et al., CVPR 2022) cuts space likewise, and shows a part the rays that cross it.
"""
from collections.abc import Sequence
from dataclasses import dataclass, replace
from itertools import combinations
import math
from pathlib import Path

from neo_ros.field.config import FieldConfig
from neo_ros.field.enlarging import seen_at
from neo_ros.field.grid_points import dilated, numbered
from neo_ros.field.voxel_field import AIR_KEPT, multiply_colours, VoxelField
from neo_ros.geometry import Intrinsics
from neo_ros.scenes.storeys import storey_borders
import numpy as np


@dataclass(frozen=True)
class TileRules:
    """How a floor is cut; metres."""

    most: float = 6.0     # that photos of a tile stand apart, where `field.tile` says nothing
    gap: float = 0.3      # around a border within which the fewest photos stand
    step: float = 0.05    # from border to border that is tried
    overlap: float = 0.5  # around a tile that its voxels cover: rays through it end there, mostly
    reach: float = 1.3    # around a tile, from where photos still look into it
    height: float = 3.0   # of a storey, to say how fine voxels are: what is higher has more
    below_floor: float = 0.15  # where a storey begins: within the ceiling of the one below


@dataclass(frozen=True)
class Tile:
    """A box of the world, low <= x < high, metres; infinite where no other tile is beyond."""

    low: tuple[float, ...]
    high: tuple[float, ...]

    def holds(self, points: np.ndarray, around: float = 0.0) -> np.ndarray:
        """Tell which points (..., 3) lie in it, or so many metres around: bool (...)."""
        return ((points >= np.array(self.low) - around)
                & (points < np.array(self.high) + around)).all(-1)

    def is_crossed(self, origin: np.ndarray, rays_d: np.ndarray, around: float) -> np.ndarray:
        """Tell which rays (..., 3) from an origin (3,) come that near: bool (...)."""
        rays_d = np.where(rays_d == 0, 1e-12, rays_d)
        ends = np.stack([(np.array(self.low) - around - origin) / rays_d,
                         (np.array(self.high) + around - origin) / rays_d])
        return ends.max(0).min(-1) >= np.maximum(ends.min(0).max(-1), 0)


EVERYWHERE = Tile((-math.inf,) * 3, (math.inf,) * 3)


def cut_floor(positions: np.ndarray, most: float, rules: TileRules = TileRules(),
              held_out: Sequence[int] = ()) -> list[Tile]:
    """
    Cut the world so that photos of a tile, at positions (N, 3), stand at most so far apart.

    It is cut between storeys, and where the fewest photos stand: in walls, mostly.
    Storeys less than two tiles wide are one. A tile of photos that are all held out would have
    nothing to be fitted to: its neighbour has its part of the world.
    """
    kept = np.ones(len(positions), bool)
    kept[list(held_out)] = False
    tiles = []
    for storey in _storeys(positions, kept):
        wide = np.ptp(positions[storey.holds(positions), :2], axis=0).max() >= 2 * most
        tiles += _cut(storey, positions, kept, most, rules) if wide else [storey]
    return tiles


def _storeys(positions: np.ndarray, kept: np.ndarray) -> list[Tile]:
    heights = positions[kept, 2]
    borders = [-math.inf]
    for border in storey_borders(positions[:, 2]):
        if ((heights >= borders[-1]) & (heights < border)).any() and (heights >= border).any():
            borders.append(border)
    return [Tile((-math.inf, -math.inf, low), (math.inf, math.inf, high))
            for low, high in zip(borders, [*borders[1:], math.inf])]


def _cut(tile: Tile, positions: np.ndarray, kept: np.ndarray, most: float, rules: TileRules
         ) -> list[Tile]:
    border = _narrow_place(positions[tile.holds(positions)], most, rules)
    if border is None:
        return [tile]
    axis, place = border
    parts = [replace(tile, **{end: (*ends[:axis], place, *ends[axis + 1:])})
             for end, ends in (('high', tile.high), ('low', tile.low))]
    for part in parts:
        inside = part.holds(positions)
        if not kept[inside].any():
            return _cut(tile, positions[~inside], kept[~inside], most, rules)
    return [one for part in parts for one in _cut(part, positions, kept, most, rules)]


def _narrow_place(positions: np.ndarray, most: float, rules: TileRules
                  ) -> tuple[int, float] | None:
    """
    Return where to cut, along x (0) or y (1); None where it is small enough.

    In a wall, mostly: there stand the fewest photos for each metre of the border.
    """
    extent, found = np.ptp(positions[:, :2], axis=0), list[tuple[float, float, int, float]]()
    for axis in np.flatnonzero(extent > most).tolist():
        along = positions[:, axis]
        places = np.arange(along.min() + most / 2, along.max() - most / 2, rules.step)
        if not len(places):  # It is larger by a rounding.
            continue
        near = (np.abs(along[:, None] - places) < rules.gap).sum(0)
        off = np.abs(places - (along.min() + along.max()) / 2)
        best = min(range(len(places)), key=lambda i: (near[i], off[i]))
        found.append((near[best] / max(extent[1 - axis], most), -extent[axis], axis,
                      float(places[best])))
    return min(found)[2:] if found else None


def tile_edge(config: FieldConfig, most: float, rules: TileRules = TileRules()) -> float:
    """Return the edge of a tile's voxels, metres: its largest box has `config.voxels`."""
    across = most + 2 * rules.overlap
    return (across ** 2 * rules.height * (1 + config.shell) ** 3 / config.voxels) ** (1 / 3)


def photos_of(tile: Tile, T_world_cam: np.ndarray, camera: Intrinsics,
              rules: TileRules = TileRules()) -> tuple[list[int], np.ndarray]:
    """
    Return which photos (N, 4, 4) a tile is fitted to, and which of their pixels bool (P, H, W).

    Those that were taken in it, with all of their pixels, and what those around it see of it.
    """
    inside = tile.holds(T_world_cam[:, :3, 3])
    near = tile.holds(T_world_cam[:, :3, 3], rules.reach)
    rays, chosen, pixels = camera.pixel_rays(), [], []
    for index in np.flatnonzero(near).tolist():
        T = T_world_cam[index]
        own = np.ones((camera.height, camera.width), bool) if inside[index] else (
            tile.is_crossed(T[:3, 3], rays @ T[:3, :3].T, rules.overlap))
        if own.any():
            chosen.append(index)
            pixels.append(own)
    return chosen, np.stack(pixels)


def brightness(gains: Sequence[tuple[np.ndarray, np.ndarray]]) -> np.ndarray | None:
    """
    Return factors of the colours of tiles, (T, 3), that make one as bright as the other.

    gains: of each tile its photos, int (P,), and the logarithms of their gains (P, 3). Their mean
    is the tile's own; photos that two tiles share tell by how much these differ. Returns None
    where none do.
    """
    pairs, apart = [], []
    for one, other in combinations(range(len(gains)), 2):
        _, here, there = np.intersect1d(gains[one][0], gains[other][0], return_indices=True)
        if len(here):
            row = np.zeros(len(gains))
            row[one], row[other] = 1, -1
            # Many photos tell more than a few.
            pairs.append(row * math.sqrt(len(here)))
            apart.append(math.sqrt(len(here)) * np.median(
                gains[one][1][here] - gains[other][1][there], axis=0))
    if not np.any(apart):
        return None
    return np.exp(np.linalg.lstsq(np.stack(pairs), np.stack(apart), rcond=None)[0])


def joined(tiles: Sequence[Tile], paths: Sequence[Path], factors: np.ndarray | None = None
           ) -> VoxelField:
    """
    Return the field of all tiles, from the files of theirs; each is read when it is its turn.

    The fields must be on one lattice, see `VoxelField.on_lattice`. What lies outside of all boxes
    is as the tile has it in whose part of the world it is. factors (T, 3): of its colours.
    """
    result = _common_grid(tiles, paths)
    owner = np.zeros(result.shape, np.int16)
    for plane in range(result.shape[0]):
        points = result.world_points(np.moveaxis(np.indices((1, *result.shape[1:])), 0, -1)
                                     + [plane, 0, 0])[0]
        for number, tile in enumerate(tiles):
            owner[plane][tile.holds(points)] = number
    raw, seen = np.zeros(result.shape, np.float32), np.zeros(result.shape, bool)
    for number, path in enumerate(paths):
        field, mine = VoxelField.load(path), owner == number
        seen |= seen_at(field, result, mine)
        raw[mine] = field.with_air().values_at(result, mine, 1)[:, 0]
    kept = dilated(result.occupied(raw.reshape(-1, 1)).reshape(result.shape), AIR_KEPT)
    result.row_of = numbered(kept)
    result.grid = np.zeros((int(kept.sum()), result.grid.shape[1]), np.float32)
    for number, path in enumerate(paths):
        mine = (owner == number) & kept
        values = VoxelField.load(path).with_air().values_at(result, mine, result.grid.shape[1])
        if factors is not None:
            multiply_colours(values, factors[number])
        result.grid[result.row_of[mine.ravel()]] = values
    result.seen = seen.ravel().view(np.uint8)
    result.update_occupancy()
    return result


def _common_grid(tiles: Sequence[Tile], paths: Sequence[Path]) -> VoxelField:
    """Lay the tiles' lattice over what their fine voxels cover of their parts of the world."""
    low, high, near = np.full(3, np.inf), np.full(3, -np.inf), math.inf
    for tile, path in zip(tiles, paths):
        field = VoxelField.load(path)
        low = np.minimum(low, np.maximum(field.centre - field.half_extent, tile.low))
        high = np.maximum(high, np.minimum(field.centre + field.half_extent, tile.high))
        near = min(near, field.near)
    return VoxelField.on_lattice(
        low, high, field.voxel, field.shell, math.isqrt(field.terms) - 1, step=field.step,
        near=near, initial_alpha=field.initial_alpha)
