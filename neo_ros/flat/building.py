"""
Buildings of furnished rooms along corridors, cast exactly at any pose and field of view.

Each piece is cast in its own frame, those that a camera sees the nearest first; what lies behind
what is nearer is never looked at. So a view takes as long in a large building as in a small one,
and equal rooms look equal bit by bit.
"""
from collections.abc import Sequence
from dataclasses import dataclass
from functools import cached_property, lru_cache
from pathlib import Path

import cv2
from neo_ros.errors import SceneError
from neo_ros.flat.building_plan import BuildingPlan, FLOOR_HEIGHT, place_pieces, Placed
from neo_ros.flat.building_rooms import Piece, Room
from neo_ros.flat.demo_flat import (
    centre_samples, DemoFlat, developed, outside_radiance, sample_spread, SAMPLES)
from neo_ros.flat.light import (
    bake_light, BRIGHTEST, chart_layout, LightMap, LightQuality, LightSources)
from neo_ros.flat.raycast import (
    camera_directions, cast_into, Hits, inverse_directions, leave_outside, unhidden)
from neo_ros.flat.shapes import Solids
from neo_ros.flat.walks import CAMERA_HEIGHT, CLEARANCE, obstacle_distance, RESOLUTION
from neo_ros.geometry import CameraPose, Intrinsics
from neo_ros.machine.files import whole_file
from neo_ros.machine.processes import map_in_processes
from neo_ros.machine.progress import no_progress, Progress
from neo_ros.scenes.walkable import WalkableMap
import numpy as np

# Coarser than the flat's: a room then takes some seconds, and its shadows are as soft as lamps
# and windows of this size make them anyway.
ROOM_LIGHT = LightQuality(texel=0.22, shadow_rays=24, bounce_rays=48, bounces=5)
OUTSIDE_AWAY = 22.0  # metres from the building to the end of the world
_UP_TO_FREE = 0.4  # metres around a piece within which its solids can block the floor


@dataclass(frozen=True, eq=False)
class Building:
    """Placed pieces, and what each kind of piece looks like; all views are deterministic."""

    plan: BuildingPlan
    placed: tuple[Placed, ...]
    insides: dict[Piece, DemoFlat]

    def render(self, intrinsics: Intrinsics, pose: CameraPose, samples: int = SAMPLES
               ) -> tuple[np.ndarray, np.ndarray]:
        """
        Look at the building through a pinhole camera, see `DemoFlat.render`.

        samples: rays per pixel and axis, an odd number.
        """
        directions = camera_directions(intrinsics, pose, samples)
        hits = self._cast(intrinsics, pose, directions)
        rays = directions.reshape(3, -1).T
        distance, solid = hits.distance.ravel(), hits.solid.ravel()
        radiance = np.empty((len(rays), 3), np.float32)
        outside = solid < 0
        radiance[outside] = outside_radiance(rays[outside])
        owner = np.searchsorted(self._first, solid, side='right') - 1
        owner[outside] = -1
        for index in np.unique(owner[~outside]).tolist():
            chosen, piece = np.flatnonzero(owner == index), self.placed[index]
            radiance[chosen] = self.insides[piece.piece].radiance(
                solid[chosen] - self._first[index],
                piece.to_own(pose.position).astype(np.float32),
                rays[chosen] * piece.turn.astype(np.float32), distance[chosen],
                sample_spread(intrinsics, samples))
        return (developed(radiance, intrinsics, samples),
                centre_samples(hits.distance, samples))

    def depth(self, intrinsics: Intrinsics, pose: CameraPose) -> np.ndarray:
        """Return the depth along the optical axis, float32 (H, W) metres."""
        return self._cast(intrinsics, pose, camera_directions(intrinsics, pose, 1)).distance

    def _cast(self, intrinsics: Intrinsics, pose: CameraPose, directions: np.ndarray) -> Hits:
        inverse = inverse_directions(directions)
        hits = leave_outside(tuple(pose.position.tolist()), inverse, self._outside)
        turn = np.array([-1, -1, 1], np.float32)[:, None, None]
        turned = (directions * turn, inverse * turn)
        samples = directions.shape[2] // intrinsics.width
        for _, index in unhidden(hits.distance, *self._bounds, intrinsics, pose, samples):
            placed = self.placed[index]
            own, own_inverse = turned if placed.turned else (directions, inverse)
            cast_into(hits, self.insides[placed.piece].solids, intrinsics, placed.pose_in(pose),
                      own, own_inverse, int(self._first[index]))
        return hits

    @cached_property
    def _first(self) -> np.ndarray:
        """Numbers (P,) of the first solid of each placed piece."""
        counts = [len(self.insides[placed.piece].solids) for placed in self.placed]
        return np.cumsum([0, *counts[:-1]]).astype(np.int32)

    @cached_property
    def _bounds(self) -> tuple[np.ndarray, np.ndarray]:
        """Corners (P, 3) of the boxes around the placed pieces."""
        corners = np.array([[placed.to_world(inside.lower.min(0)),
                             placed.to_world(inside.upper.max(0))] for placed in self.placed
                            for inside in [self.insides[placed.piece].solids]])
        return corners.min(1), corners.max(1)

    @cached_property
    def _outside(self) -> np.ndarray:
        lower, upper = self._bounds
        return np.stack([lower.min(0) - OUTSIDE_AWAY, upper.max(0) + OUTSIDE_AWAY])

    def walkable(self, floor: int = 0) -> WalkableMap:
        """Return the free floor of all rooms and corridors of a floor, in cells of 0.05 m."""
        return self._walkable[floor]

    @cached_property
    def _walkable(self) -> tuple[WalkableMap, ...]:
        return tuple(_free_floor(self, floor) for floor in range(self.plan.floors))

    def rooms(self, floor: int = 0) -> list[Placed]:
        """Return the rooms of a floor."""
        return [placed for placed in self.placed
                if placed.floor == floor and isinstance(placed.piece, Room)]


def build_building(plan: BuildingPlan, light_file: Path | None = None,
                   progress: Progress = no_progress, workers: int = 1) -> Building:
    """
    Furnish and light a building; light is baked once for each different piece.

    light_file  keeps the light, where given, so that it is baked once; SceneError where it cannot
    """
    placed = place_pieces(plan)
    pieces = list(dict.fromkeys(one.piece for one in placed))
    codes = _read_light(light_file, len(pieces))
    if codes is None:
        codes = []
        for baked in map_in_processes(_bake_codes, pieces, workers):
            codes.append(baked)
            progress(len(codes), len(pieces))
        if light_file is not None:
            _write_light(light_file, codes)
    insides = {}
    for piece, code in zip(pieces, codes):
        solids, _ = _built(piece)
        start, columns, rows = chart_layout(solids, ROOM_LIGHT.texel)
        if len(code) != int((columns * rows).sum()):
            raise SceneError(f'{light_file}: expected light of another building; delete it')
        values = (code.astype(np.float32) / 255) ** 2 * np.float32(BRIGHTEST)
        insides[piece] = DemoFlat(solids, LightMap(values, start, columns, rows))
    return Building(plan, tuple(placed), insides)


@lru_cache(maxsize=1)
def open_building(plan: BuildingPlan, light_file: Path) -> Building:
    """Return a building whose light lies in a file; a process builds it once."""
    return build_building(plan, light_file)


@lru_cache(maxsize=None)
def _built(piece: Piece) -> tuple[Solids, LightSources]:
    return piece.build()


def _bake_codes(piece: Piece) -> np.ndarray:
    solids, sources = _built(piece)
    values = bake_light(solids, sources, ROOM_LIGHT)
    return np.rint(np.sqrt(np.clip(values / BRIGHTEST, 0, 1)) * 255).astype(np.uint8)


def _read_light(path: Path | None, count: int) -> list[np.ndarray] | None:
    if path is None or not path.exists():
        return None
    with np.load(path) as file:
        return [file[name] for name in file.files] if len(file.files) == count else None


def _write_light(path: Path, codes: Sequence[np.ndarray]) -> None:
    try:
        with whole_file(path) as partial, partial.open('wb') as file:
            np.savez_compressed(file, *codes)
    except OSError as error:
        raise SceneError(f'{path}: cannot write: {error.strerror}') from error


def _free_floor(building: Building, floor: int) -> WalkableMap:
    """Keep the cells that keep CLEARANCE to all obstacles and hang together with the corridor."""
    lower, upper = building._bounds
    here = [index for index, placed in enumerate(building.placed) if placed.floor == floor]
    low = np.floor(lower[here, :2].min(0) / RESOLUTION) * RESOLUTION
    columns, rows = np.ceil((upper[here, :2].max(0) - low) / RESOLUTION).astype(int)
    away = np.full((rows, columns), np.inf)
    inside = np.zeros((rows, columns), bool)
    for index in here:
        placed = building.placed[index]
        first = np.maximum((lower[index, :2] - low - _UP_TO_FREE) / RESOLUTION, 0).astype(int)
        last = ((upper[index, :2] - low + _UP_TO_FREE) / RESOLUTION).astype(int) + 1
        part = (slice(first[1], min(last[1], rows)), slice(first[0], min(last[0], columns)))
        y, x = np.mgrid[part]
        xy = np.stack([x, y], -1) * RESOLUTION + low + RESOLUTION / 2
        local = (xy - placed.origin[:2]) * placed.turn[:2]
        solids = building.insides[placed.piece].solids
        found = obstacle_distance(solids, local.reshape(-1, 2)).reshape(xy.shape[:2])
        away[part] = np.minimum(away[part], found)
        inside[part] |= ((xy > lower[index, :2]) & (xy < upper[index, :2])).all(-1)
    margin = CLEARANCE + RESOLUTION * np.sqrt(0.5)
    _, labels = cv2.connectedComponents(((away > margin) & inside).astype(np.uint8),
                                        connectivity=4)
    sizes = np.bincount(labels.ravel())
    sizes[0] = 0
    return WalkableMap(RESOLUTION, (float(low[0]), float(low[1])), labels == sizes.argmax(),
                       FLOOR_HEIGHT * floor + CAMERA_HEIGHT, CLEARANCE)
