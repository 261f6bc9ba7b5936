"""What has changed since the memory was made, put into its keyframes as they are decoded."""
from collections.abc import Mapping, Sequence
from dataclasses import replace
from functools import cached_property, lru_cache
from itertools import groupby, product
import math

import cv2
from neo_ros.geometry import Band, CameraPose, Intrinsics
from neo_ros.memory.change_kernels import (
    BLOCK, bound_blocks, carve, draw_patch, SAME, Seen, shows_any, Sphere, take_depths)
from neo_ros.memory.kernels import Pinhole
from neo_ros.memory.keyframe import code_of, depth_of
from neo_ros.memory.patch import PARTS, Patch
from neo_ros.memory.state_kernels import find_cells, keys_of
from neo_ros.memory.turn import Record, turned_by
import numpy as np

# Of a patch every so many-th pixel is looked at, to tell whether others have replaced it; it is if
# they have so large a share of these.
SAMPLED, REPLACED = 7, 0.95
# Metres: samples of what has changed lie as near in a view.
CELL = 0.15
# A view is looked at so wide, pixels, to find such things.
WIDTH = 64


class Changes:
    """
    Patches in the order in which they were seen; what is newer replaces what is older.

    Turns among the records tell which parts of them are shown; what is shown again is as new as
    its turn. hidden, again int64 (PARTS * patches,): for each part the number of the record that
    hid it, and that showed it again; -1: none. Never changed, so that several threads can decode:
    `with_more` makes others.
    """

    def __init__(self, records: Sequence[Record]) -> None:
        self.records = tuple(records)
        self.patches = tuple(one for one in records if isinstance(one, Patch))
        self.hidden, self.again = turned_by(records, len(self.patches))

    def with_more(self, records: Sequence[Record]) -> 'Changes':
        """Return these and later ones."""
        return Changes((*self.records, *records))

    @cached_property
    def cells(self) -> np.ndarray:
        """Numbers of the cells, CELL metres, that show what has changed or was before: rising."""
        shown = [samples.points[np.arange(len(hidden)), hidden.astype(int)][
            ~hidden | (samples.depths[:, 1] > 0)] for samples, hidden in (
            (patch.samples, parts[patch.samples.parts] >= 0) for patch, parts in zip(
                self.patches, self.hidden.reshape(-1, PARTS)))]
        # What lies at the border of a cell may be drawn in the next one.
        around = np.array(list(product((-CELL / 4, CELL / 4), repeat=3)), np.float32)
        return np.unique([cell_keys(np.concatenate(shown) + offset, CELL) for offset in around]
                         if shown else np.empty(0, np.int64))

    def shown_at(self, depth: np.ndarray, camera: Intrinsics, pose: CameraPose) -> np.ndarray:
        """
        Tell which pixels of a view show a thing that has more than one state.

        depth float32 (H, W), metres, 0 = unknown. Returns float32 (H, W), 1 there, 0 elsewhere.
        """
        rays = _view_rays(camera)
        small = cv2.resize(depth, rays.shape[1::-1], interpolation=cv2.INTER_NEAREST_EXACT)
        found = np.empty(small.shape, np.float32)
        T = pose.T_world_cam.astype(np.float32)
        find_cells(small, rays, np.ascontiguousarray(T[:3, :3]), np.ascontiguousarray(T[:3, 3]),
                   np.float32(CELL), self.cells, found)
        return cv2.resize(found, depth.shape[::-1], interpolation=cv2.INTER_LINEAR)

    @cached_property
    def layers(self) -> list[tuple[tuple[int, int], Patch, np.ndarray]]:
        """
        What is shown, the oldest first: patches, and which of their parts, bool (PARTS,).

        Before them what is the same for those that add to each other.
        """
        numbers = [number for number, one in enumerate(self.records) if isinstance(one, Patch)]
        found = []
        for number, patch, hidden, again in zip(
                numbers, self.patches, self.hidden.reshape(-1, PARTS),
                self.again.reshape(-1, PARTS)):
            for turn in np.unique(again[hidden < 0]).tolist():
                found.append((max(turn, number), (turn, patch.batch), patch,
                              (hidden < 0) & (again == turn)))
        found.sort(key=lambda layer: layer[0])
        return [layer[1:] for layer in found]

    def reaches(self, position: np.ndarray, band: Band, coded: np.ndarray) -> bool:
        """
        Tell whether `put_into` may change a keyframe, coded uint16 (h, w), at position (3,).

        Patches are asked by their samples: what lies between two is hardly elsewhere.
        """
        depth = depth_of(coded)
        sphere = _sphere(band, np.empty((0, 0, 3), np.uint8), depth)
        if shows_any(self._shown_points - position.astype(np.float32), sphere):
            return True
        rays, blocks = _rays(band, *coded.shape), _blocks(depth)
        bound_blocks(rays, depth, blocks)
        return any(carve(rays, depth, blocks, *_seen_from(patch, shown, position))
                   for _, patch, shown in self.layers)

    @cached_property
    def _shown_points(self) -> np.ndarray:
        """Samples, (N, 3) world metres, of what patches saw, as far as it is shown."""
        return np.concatenate([np.empty((0, 3), np.float32), *(
            patch.samples.points[shown[patch.samples.parts], 0]
            for _, patch, shown in self.layers)])

    def put_into(self, position: np.ndarray, band: Band, reduced: int, texture: np.ndarray,
                 coded: np.ndarray) -> tuple[np.ndarray, np.ndarray]:
        """
        Return texture, made so many times smaller, and depth of a keyframe, changed.

        position (3,) world metres; texture uint8 RGB (n h, n w, 3), which is written to; coded
        uint16 (h, w), as `keyframe.code_of` makes it.
        """
        if texture.shape[0] % coded.shape[0] or texture.shape[1] % coded.shape[1]:
            return texture, coded  # Whoever decodes it says so.
        depth = depth_of(coded)
        rays = _rays(band, *coded.shape)
        finer = len(texture) // len(coded)
        sphere = _sphere(band, texture, np.repeat(np.repeat(depth, finer, 0), finer, 1))
        blocks = _blocks(depth)
        for _, batch in groupby(self.layers, lambda layer: layer[0]):
            seen = [_seen_from(patch, parts, position) for _, patch, parts in batch]
            bound_blocks(rays, depth, blocks)
            if sum(carve(rays, depth, blocks, *one) for one in seen):
                sphere.surface[np.repeat(np.repeat(depth == 0, finer, 0), finer, 1)] = 0
            # Only what was seen in one go is compared: newer is better than sharper.
            sphere.quality[:] = 0
            for one in seen:
                draw_patch(*one, sphere)
            take_depths(sphere, depth)
        if reduced > 1:
            size = (texture.shape[1] // reduced, texture.shape[0] // reduced)
            texture = cv2.resize(texture, size, interpolation=cv2.INTER_AREA)
        return texture, code_of(depth)


def without_replaced(records: Sequence[Record]) -> list[Record]:
    """
    Leave out patches of which later visits have seen nearly all: they show what is there now.

    What one turn has hidden is compared alike, as it is shown again together. What is left keeps
    its order, and turns where it was turned: it is shown as before.
    """
    changes = Changes(records)
    states = changes.hidden.reshape(-1, PARTS)
    # The newest last: of what is shown, and of what each turn hid.
    order = {-1: [layer[1:] for layer in changes.layers]} | {
        turn: [(patch, parts == turn) for patch, parts in zip(changes.patches, states)
               if (parts == turn).any()] for turn in np.unique(states[states >= 0]).tolist()}
    places = {(state, patch): place for state, seen in order.items()
              for place, (patch, _) in enumerate(seen)}
    balls = {patch: _ball(patch) for patch in changes.patches}
    kept = np.array([any(
        _is_open(patch, parts == state, order[state][places[state, patch] + 1:], balls)
        for state in np.unique(parts).tolist())
        for patch, parts in zip(changes.patches, states)], bool)
    left = np.repeat(kept, PARTS)
    hidden, again = changes.hidden[left], changes.again[left]
    found, patches = list[Record](), iter(kept)
    for number, record in enumerate(records):
        if isinstance(record, Patch):
            found += [record] * bool(next(patches))
            continue
        # What it showed again was hidden before: first that, and then both.
        shown = (again == number) & (hidden < 0)
        found += [replace(record, parts=np.flatnonzero(turned).astype(np.uint32))
                  for turned in (shown | (hidden == number), shown) if turned.any()]
    return found


def _is_open(patch: Patch, parts: np.ndarray, newer: Sequence[tuple[Patch, np.ndarray]],
             balls: Mapping[Patch, tuple[list[float], float]]) -> bool:
    """Tell whether a patch, bool (PARTS,) of its parts, shows what newer ones have not seen."""
    _, depth, part = patch.pictures
    rows, columns = np.nonzero((depth > 0) & parts[part])
    rows, columns = rows[::SAMPLED], columns[::SAMPLED]
    camera = patch.camera
    local = np.stack([(columns + 0.5 - camera.cx) / camera.fx,
                      (rows + 0.5 - camera.cy) / camera.fy, np.ones(len(rows))], -1)
    local *= depth[rows, columns][:, None]
    points = local @ patch.pose.T_world_cam[:3, :3].T + patch.pose.position
    count, (middle, radius) = len(points), balls[patch]
    for later, shown in newer:
        there, reach = balls[later]
        if later.batch != patch.batch and math.dist(middle, there) < radius + reach \
                and len(points):
            points = points[~_reaches(later, shown, points)]
    return len(points) > count * (1 - REPLACED)


def _ball(patch: Patch) -> tuple[list[float], float]:
    """Return middle and radius, metres, of a ball around what a patch sees, or sees through."""
    camera, farthest = patch.camera, patch.pictures.depth.max() * (1 + SAME)
    corners = np.array([((u - camera.cx) / camera.fx, (v - camera.cy) / camera.fy, 1)
                        for u in (0, camera.width) for v in (0, camera.height)])
    seen = np.concatenate([np.zeros((1, 3)), farthest * corners])
    middle = (seen.min(0) + seen.max(0)) / 2
    return ((patch.pose.T_world_cam[:3, :3] @ middle + patch.pose.position).tolist(),
            float(np.linalg.norm(seen - middle, axis=1).max()))


def _reaches(patch: Patch, shown: np.ndarray, points: np.ndarray) -> np.ndarray:
    """Tell which world points (N, 3) shown parts, bool (PARTS,), see, or see through."""
    local = (points - patch.pose.position) @ patch.pose.T_world_cam[:3, :3]
    ahead = local[:, 2] > 0
    pixels = np.full((len(points), 2), -1.0)
    pixels[ahead] = patch.camera.project(local[ahead])
    inside = ahead & (pixels >= 0).all(1) & (pixels < (patch.camera.width,
                                                       patch.camera.height)).all(1)
    found = np.zeros(len(points), bool)
    columns, rows = pixels[inside].astype(int).T
    _, depth, parts = patch.pictures
    there = depth[rows, columns] * shown[parts[rows, columns]]
    found[inside] = (there > 0) & (local[inside, 2] < there * (1 + SAME))
    return found


def cell_keys(points: np.ndarray, cell: float) -> np.ndarray:
    """Return the numbers of the cells that points float32 (N, 3) lie in, int64 (N,)."""
    keys = np.empty(len(points), np.int64)
    keys_of(points, np.float32(cell), keys)
    return keys


def _sphere(band: Band, texture: np.ndarray, surface: np.ndarray) -> Sphere:
    return Sphere(texture, surface, np.zeros(texture.shape[:2], np.float32),
                  np.float32(band.top), np.float32(band.low),
                  np.float32(band.top - band.bottom), np.float32(band.width), band.wraps)


def _blocks(depth: np.ndarray) -> np.ndarray:
    return np.empty((*(-(-size // BLOCK) for size in depth.shape), 4), np.float32)


def _seen_from(patch: Patch, shown: np.ndarray, position: np.ndarray) -> tuple[Seen, Pinhole]:
    image, depth, parts = patch.pictures
    if not shown.all():
        depth = depth * shown[parts]
    T, camera = patch.pose.inverse(), patch.camera
    return (Seen(image, depth, np.ascontiguousarray(T[:3, :3], np.float32),
                 (T[:3, :3] @ position + T[:3, 3]).astype(np.float32)),
            Pinhole(*map(np.float32, (camera.fx, camera.fy, camera.cx, camera.cy))))


@lru_cache(maxsize=4)
def _rays(band: Band, rows: int, columns: int) -> np.ndarray:
    return band.rays(rows, columns)


@lru_cache(maxsize=4)
def _view_rays(camera: Intrinsics) -> np.ndarray:
    return camera.scaled(min(1.0, WIDTH / camera.width)).pixel_rays().astype(np.float32)
