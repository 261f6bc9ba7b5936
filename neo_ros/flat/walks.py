"""Where the camera goes in the demo flat: free floor, training poses, and smooth walks."""
from functools import lru_cache
import heapq
import math
from typing import NamedTuple

import cv2
from neo_ros.errors import SceneError
from neo_ros.flat.rooms import BEDROOM, DOOR, LIVING
from neo_ros.flat.shapes import FRUSTUM, Solids
from neo_ros.geometry import CameraPose
from neo_ros.scenes.walkable import WalkableMap
import numpy as np

RESOLUTION, CLEARANCE, CAMERA_HEIGHT = 0.05, 0.25, 1.5
OBSTACLE_HEIGHTS = (0.1, 1.7)  # what lies flatter or hangs higher is no obstacle
STEP = 0.08  # metres a frame: 0.5 m/s at about 6 Hz
LOOK_AROUND = math.radians(18)


class Doorway(NamedTuple):
    """The middle of a door, metres, and the axis that one walks along to go through it."""

    x: float
    y: float
    axis: int


DOORWAY = Doorway((LIVING[1][0] + BEDROOM[0][0]) / 2, sum(DOOR) / 2, 0)


@lru_cache(maxsize=2)
def free_floor(solids: Solids) -> WalkableMap:
    """Return the free floor; every point of its cells keeps CLEARANCE to all obstacles."""
    origin = LIVING[0]
    columns = round((BEDROOM[1][0] - origin[0]) / RESOLUTION)
    rows = round((BEDROOM[1][1] - origin[1]) / RESOLUTION)
    x = origin[0] + (np.arange(columns) + 0.5) * RESOLUTION
    y = origin[1] + (np.arange(rows) + 0.5) * RESOLUTION
    centres = np.stack(np.meshgrid(x, y), axis=-1).reshape(-1, 2)
    margin = CLEARANCE + RESOLUTION * math.sqrt(0.5)
    free = (obstacle_distance(solids, centres) > margin).reshape(rows, columns)
    free = connected(free, (int((DOORWAY[1] - origin[1]) / RESOLUTION),
                            int((DOORWAY[0] - origin[0]) / RESOLUTION)))
    return WalkableMap(RESOLUTION, origin, free, CAMERA_HEIGHT, CLEARANCE)


def obstacle_distance(solids: Solids, xy: np.ndarray) -> np.ndarray:
    """Return the distance in the plane from points (M, 2) to the nearest obstacle; 0 inside."""
    low, high = OBSTACLE_HEIGHTS
    nearest = np.full(len(xy), np.inf)
    for index in np.flatnonzero((solids.lower[:, 2] < high) & (solids.upper[:, 2] > low)):
        offset = xy - solids.centre[index, :2]
        half = solids.half[index]
        if solids.kind[index] == FRUSTUM:
            distance = np.hypot(*offset.T) - max(half[0], half[1])
        else:  # ellipsoids count as the boxes around them
            cos, sin = math.cos(solids.yaw[index]), math.sin(solids.yaw[index])
            local = np.stack([cos * offset[:, 0] + sin * offset[:, 1],
                              cos * offset[:, 1] - sin * offset[:, 0]], axis=1)
            distance = np.linalg.norm(np.maximum(np.abs(local) - half[:2], 0), axis=1)
        nearest = np.minimum(nearest, np.maximum(distance, 0))
    return nearest


def planar_poses(walkable: WalkableMap, n: int, seed: int) -> list[CameraPose]:
    """Draw n poses as the paper does: free floor and heading uniform, height fixed, level."""
    rng = np.random.default_rng(seed)
    places = walkable.sample(rng, n)
    yaws = rng.uniform(-math.pi, math.pi, n)
    return [CameraPose.from_planar(x, y, walkable.camera_height, yaw)
            for (x, y), yaw in zip(places.tolist(), yaws.tolist())]


def plan_walks(walkable: WalkableMap, n_paths: int, n_frames: int,
               seed: int) -> list[list[CameraPose]]:
    """Plan smooth walks over the free floor; the first one goes through the doorway."""
    rng = np.random.default_rng([seed, 1])
    return [_plan_walk(walkable, DOORWAY if path_id == 0 else None, n_frames, rng,
                       f'walk {path_id}') for path_id in range(n_paths)]


def plan_walk_through(walkable: WalkableMap, door: Doorway, n_frames: int,
                      rng: np.random.Generator) -> list[CameraPose]:
    """Plan a smooth walk through one door; SceneError where there is no way."""
    return _plan_walk(walkable, door, n_frames, rng, f'door at {door.x:.1f}, {door.y:.1f}')


def _plan_walk(walkable: WalkableMap, door: Doorway | None, n_frames: int,
               rng: np.random.Generator, what: str) -> list[CameraPose]:
    for _ in range(50):
        places = _spaced(_plan_track(walkable, rng, STEP * n_frames, door), n_frames)
        if walkable.contains(places).all():
            return level_walk(walkable, places, rng)
    raise SceneError(f'{what}: found no way of {n_frames} frames in 50 tries')


def level_walk(walkable: WalkableMap, places: np.ndarray, rng: np.random.Generator
               ) -> list[CameraPose]:
    """Return poses at places (M, 2), looking ahead and a little around."""
    return [CameraPose.from_planar(x, y, walkable.camera_height, yaw) for (x, y), yaw
            in zip(places.tolist(), _headings(places, rng).tolist())]


def _plan_track(walkable: WalkableMap, rng: np.random.Generator, length: float,
                door: Doorway | None) -> np.ndarray:
    """Join shortest ways between random cells until they are long enough, and smooth them."""
    cells = np.argwhere(walkable.cells)
    if door is not None:  # start and goal about half a walk from the doorway, either side
        from_door = np.hypot(*(walkable.centres() - door[:2]).T)
        near = np.abs(from_door - min(length / 2 + 0.35, 1.7)) < 0.15
        through = walkable.centres()[:, door.axis] - door[door.axis]
        ends = [cells[near & (through < 0)], cells[near & (through > 0)]]
        at, goal = (tuple(side[rng.integers(len(side))].tolist()) for side in ends)
        way = _shortest_way(walkable, at, goal)
    else:  # of some ways the one whose length fits best, so that walks seldom turn back
        picks = rng.integers(len(cells), size=(8, 2))
        ways = [_shortest_way(walkable, tuple(cells[a].tolist()), tuple(cells[b].tolist()))
                for a, b in picks]
        spare = [len(way) * walkable.resolution - length - 0.5 for way in ways]
        way = ways[int(np.argmin([more if more >= 0 else -9 * more for more in spare]))]
    while len(way) * walkable.resolution < length + 0.5:
        goal = tuple(cells[rng.integers(len(cells))].tolist())
        leg = _shortest_way(walkable, way[-1], goal)
        if len(leg) * walkable.resolution > 0.8:
            way += leg[1:]
    track = np.array(way, float)[:, ::-1] + 0.5
    track = track * walkable.resolution + walkable.origin
    for _ in range(150):
        smoother = track.copy()
        smoother[1:-1] = (track[:-2] + 2 * track[1:-1] + track[2:]) / 4
        track = np.where(walkable.contains(smoother)[:, None], smoother, track)
    return track


def _shortest_way(walkable: WalkableMap, start: tuple[int, int],
                  goal: tuple[int, int]) -> list[tuple[int, int]]:
    """Dijkstra over free cells; cells near obstacles cost more, so that walks keep away."""
    cost = _cell_costs(walkable)
    moves = [(j, i, math.hypot(j, i)) for j in (-1, 0, 1) for i in (-1, 0, 1) if j or i]
    best, parent = {start: 0.0}, {}
    queue = [(0.0, start)]
    while queue:
        so_far, cell = heapq.heappop(queue)
        if cell == goal:
            break
        if so_far > best[cell]:
            continue
        for dj, di, length in moves:
            following = (cell[0] + dj, cell[1] + di)
            if not math.isfinite(cost.get(following, math.inf)):
                continue
            total = so_far + length * cost[following]
            if total < best.get(following, math.inf):
                best[following], parent[following] = total, cell
                heapq.heappush(queue, (total, following))
    way = [goal]
    while way[-1] != start:
        way.append(parent[way[-1]])
    return way[::-1]


@lru_cache(maxsize=2)
def _cell_costs(walkable: WalkableMap) -> dict[tuple[int, int], float]:
    depth = np.zeros(walkable.cells.shape, int)
    left = walkable.cells
    while left.any():
        depth += left
        padded = np.pad(left, 1)
        left = (left & padded[:-2, 1:-1] & padded[2:, 1:-1] & padded[1:-1, :-2]
                & padded[1:-1, 2:])
    return {(int(j), int(i)): 1 + 3.0 / float(depth[j, i]) ** 2
            for j, i in np.argwhere(walkable.cells)}


def _spaced(track: np.ndarray, n_frames: int) -> np.ndarray:
    along = np.concatenate([[0], np.cumsum(np.hypot(*np.diff(track, axis=0).T))])
    wanted = np.arange(n_frames) * STEP
    # Smoothing shortens a track; a short one is walked a little slower, to its end.
    wanted *= min(1.0, along[-1] / max(wanted[-1], 1e-9))
    return np.stack([np.interp(wanted, along, track[:, axis]) for axis in range(2)], axis=1)


def _headings(places: np.ndarray, rng: np.random.Generator) -> np.ndarray:
    """Look where the walk goes, evened out over half a metre, with a slow look to the sides."""
    if len(places) < 2:
        return rng.uniform(-math.pi, math.pi, len(places))
    way = np.diff(places, axis=0, append=2 * places[-1:] - places[-2:-1])
    yaw = np.unwrap(np.arctan2(way[:, 1], way[:, 0]))
    window = np.exp(-0.5 * (np.arange(-8, 9) / 3.5) ** 2)
    padded = np.pad(yaw, 8, mode='edge')
    yaw = np.convolve(padded, window / window.sum(), mode='valid')
    phase, period = rng.uniform(0, 2 * math.pi), rng.uniform(28, 45)
    return yaw + LOOK_AROUND * np.sin(2 * math.pi * np.arange(len(yaw)) / period + phase)


def connected(free: np.ndarray, start: tuple[int, int]) -> np.ndarray:
    """Keep the free cells, bool (rows, columns), that can be reached from one of them."""
    _, labels = cv2.connectedComponents(free.astype(np.uint8), connectivity=4)
    return free & (labels == labels[start])
