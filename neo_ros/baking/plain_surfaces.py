"""
How far away plain surfaces are: planes through their edges.

On a plain wall or ceiling no photo tells one depth from another: a field leaves it some voxels too
far away, up to 20 cm, and all of it alike. Where something is drawn, at corners, frames and
furniture, it is right. So what is plain and flat becomes the plane, of its own direction, that
most of the edges in it and around it lie on.
"""
from collections.abc import Iterable
from dataclasses import dataclass
import math
from typing import NamedTuple

import cv2
from neo_ros.baking.band_rendering import block_centres, mesh_depth
from neo_ros.machine.evenly import evenly
import numpy as np


@dataclass(frozen=True)
class PlaneRules:
    """What was chosen by measuring, and holds for all scenes."""

    drawn: float = 10.0           # grey levels from pixel to pixel; less tells nothing of depth
    leap: float = 0.1             # depths of neighbours that differ by more are of two surfaces
    reach: int = 3                # pixels, to the neighbours that tell a surface's direction
    facing: float = 0.7           # cosine of a surface's direction and that of its plane
    one_direction: float = 0.97   # cosine of directions that are one
    least_share: float = 0.02     # of all that is flat, for a direction to be one of the scene
    most_directions: int = 6
    tried: int = 400              # directions, for the densest of them
    least_area: int = 60          # pixels of a surface
    around: int = 6               # pixels around a surface that tell of its plane, or lie on it
    nearer: float = 0.3           # metres by which a plane may be nearer than its surface was
    farther: float = 0.1          # or farther
    in_front: float = 0.08        # what leaps nearer by more than this share stands before it
    spread: float = 0.02          # metres, of edges that lie on one plane
    least_edges: int = 20         # pixels, and
    least_edge_share: float = 0.3  # of the edges around a surface, that lie on its plane


# Metres: cameras of a robot are at one height, of storeys this far apart.
SAME_HEIGHT, STOREY = 0.02, 1.5
NO_DIRECTIONS = np.zeros((0, 3), np.float32)


class _Picture(NamedTuple):
    """A depth map and what is seen of it; arrays (h, w) and (h, w, 3)."""

    depth: np.ndarray
    rays: np.ndarray
    gradient: np.ndarray  # its magnitude, grey levels a pixel
    leaps: np.ndarray
    normals: np.ndarray  # towards the camera; 0 where there is none


def hand_held(positions: np.ndarray) -> bool:
    """
    Tell whether keyframes (K, 3) stand at several heights, as those of a hand-held camera do.

    A robot's stand at one height on each storey. Planes were measured to do harm where a camera is
    hand-held: see docs/decisions/0013.
    """
    heights = np.sort(positions[:, 2])
    storeys = np.split(heights, np.flatnonzero(np.diff(heights) > STOREY) + 1)
    return any(np.ptp(storey) > SAME_HEIGHT for storey in storeys)


def dominant_directions(depths: Iterable[np.ndarray], rays: Iterable[np.ndarray],
                        rules: PlaneRules = PlaneRules()) -> np.ndarray:
    """
    Return the directions that surfaces of a scene face, unit vectors (K, 3), the commonest first.

    depths (h, w): metres along unit rays (h, w, 3), world axes, 0 = unknown. A direction and its
    opposite are one.
    """
    found = []
    for depth, seen_along in zip(depths, rays):
        normals = _normals(depth, seen_along, rules)
        found.append(normals[(normals != 0).any(-1)])
    left = np.concatenate(found) if found else np.zeros((0, 3))
    every, directions = len(left), list[np.ndarray]()
    while len(directions) < rules.most_directions and len(left) > rules.least_share * every:
        # The densest of some directions; then the mean of those near it.
        tried = left[evenly(len(left), rules.tried)]
        direction = tried[(np.abs(tried @ tried.T) > rules.one_direction).sum(1).argmax()]
        for _ in range(3):
            cosines = left @ direction
            close = np.abs(cosines) > rules.one_direction
            direction = (left[close] * np.sign(cosines[close])[:, None]).mean(0)
            direction /= np.linalg.norm(direction)
        if close.sum() < rules.least_share * every:
            break
        directions.append(direction)
        left = left[np.abs(left @ direction) < rules.facing]
    return np.array(directions, np.float32).reshape(-1, 3)


def with_planes(depth: np.ndarray, texture: np.ndarray, rays: np.ndarray, directions: np.ndarray,
                rules: PlaneRules = PlaneRules()) -> np.ndarray:
    """
    Return depth float32 (h, w) in which plain flat surfaces lie on planes through their edges.

    depth: metres along unit rays (h, w, 3), world axes, 0 = unknown; texture uint8 (n h, n w, 3);
    directions (K, 3), see `dominant_directions`.
    """
    if not len(directions):
        return depth
    picture = _Picture(depth, rays, _gradient(texture, depth.shape), _leaps(depth, rules.leap),
                       _normals(depth, rays, rules))
    behind = picture.leaps & (depth > (1 + rules.leap) * _nearest(depth))
    edges = (depth > 0) & (picture.gradient >= rules.drawn) & ~behind
    plain = (picture.gradient < rules.drawn) & (picture.normals != 0).any(-1)
    facing = np.concatenate([directions, -directions])
    cosines = picture.normals @ facing.T
    best = np.where(plain & (cosines.max(-1) > rules.facing), cosines.argmax(-1), -1)
    made = depth.copy()
    free = picture.gradient < rules.drawn
    surfaces = []
    for index, direction in enumerate(facing):
        _, labels, boxes, _ = cv2.connectedComponentsWithStats(
            (best == index).astype(np.uint8), connectivity=4)
        # Label 0 is all the rest.
        for label in 1 + np.flatnonzero(boxes[1:, cv2.CC_STAT_AREA] >= rules.least_area):
            window = _window(boxes[label], rules.around, depth.shape)
            surface = labels[window] == label
            distance = _distance(picture, edges, window, surface, direction, rules)
            if distance is None:
                continue
            plane = distance / np.maximum(-(rays[window] @ direction), 1e-3)
            made[window][surface] = plane[surface]
            free[window][surface] = False
            surfaces.append((window, surface, plane))
    for window, surface, plane in surfaces:
        _grow(made[window], free[window], depth[window], surface, plane, rules)
    return made


def move_to_planes(depth: np.ndarray, image: np.ndarray, rays: np.ndarray, block: int,
                   directions: np.ndarray, one_surface: float, rules: PlaneRules = PlaneRules()
                   ) -> None:
    """
    Do what `with_planes` does, in place; surfaces are looked for in blocks of pixels.

    depth, rays, image: all of one size, of whole blocks of `block` squared pixels; depths that
    differ by less than the share `one_surface` are of one surface.
    """
    mesh = mesh_depth(depth, block, one_surface)
    moved = with_planes(mesh, image, block_centres(rays, block), directions, rules) / np.where(
        mesh > 0, mesh, 1)
    moved, mesh = (one.repeat(block, 0).repeat(block, 1) for one in (moved, mesh))
    same = np.abs(depth - mesh) < one_surface * mesh
    depth[same] *= moved[same]


def _distance(picture: _Picture, edges: np.ndarray, window: tuple[slice, slice],
              surface: np.ndarray, direction: np.ndarray, rules: PlaneRules) -> float | None:
    """Return how far away the plane of a surface is; None where its edges do not tell."""
    side = 2 * rules.around + 1
    around = cv2.dilate(surface.astype(np.uint8), np.ones((side, side), np.uint8)) > 0
    away = -picture.depth[window] * (picture.rays[window] @ direction)
    now = float(np.median(away[surface]))
    found = around & edges[window]
    found &= ~(picture.leaps[window] & (away < (1 - rules.in_front) * now))
    asked = away[found]
    low, high = max(now - rules.nearer, rules.spread), now + rules.farther
    asked_near = asked[(asked > low) & (asked < high)]
    if len(asked_near) < rules.least_edges:
        return None
    # Where they lie densest: bins of a third of their spread.
    count, places = np.histogram(asked_near, math.ceil(3 * (high - low) / rules.spread),
                                 (low, high))
    density = cv2.GaussianBlur(count.astype(np.float32)[None], (0, 0), 3,
                               borderType=cv2.BORDER_CONSTANT)[0]
    distance = float(places[density.argmax():][:2].mean())
    held = int((np.abs(asked_near - distance) < 2 * rules.spread).sum())
    enough = held >= max(rules.least_edges, rules.least_edge_share * len(asked))
    return distance if enough else None


def _grow(made: np.ndarray, free: np.ndarray, depth: np.ndarray, surface: np.ndarray,
          plane: np.ndarray, rules: PlaneRules) -> None:
    """Put what lies around a surface onto its plane, where nothing drawn says otherwise."""
    allowed = free & (depth > (1 - rules.in_front / 2) * plane) & (depth < plane + rules.nearer)
    grown = surface.astype(np.uint8)
    for _ in range(rules.around):
        grown = cv2.dilate(grown, np.ones((3, 3), np.uint8)) * (allowed | surface)
    new = (grown > 0) & ~surface
    made[new] = plane[new]
    free[new] = False


def _gradient(texture: np.ndarray, shape: tuple[int, ...]) -> np.ndarray:
    """Return the largest gradient of a picture's grey in each pixel of a coarser one, a pixel."""
    finer = texture.shape[0] // shape[0]
    grey = cv2.GaussianBlur(cv2.cvtColor(texture, cv2.COLOR_RGB2GRAY).astype(np.float32), (0, 0),
                            max(finer / 2, 0.5))
    across, down = (cv2.Sobel(grey, cv2.CV_32F, *order, scale=finer / 8)
                    for order in ((1, 0), (0, 1)))
    blocks = np.hypot(across, down).reshape(shape[0], finer, shape[1], finer)
    gradient: np.ndarray = blocks.max((1, 3))
    return gradient


def _normals(depth: np.ndarray, rays: np.ndarray, rules: PlaneRules) -> np.ndarray:
    """Return unit vectors (h, w, 3) towards the camera; 0 at leaps, at the rim, where unknown."""
    reach = rules.reach
    normals = np.zeros(rays.shape, np.float32)
    if min(depth.shape) <= 2 * reach:
        return normals
    points = depth[..., None] * rays
    across = points[reach:-reach, 2 * reach:] - points[reach:-reach, :-2 * reach]
    down = points[2 * reach:, reach:-reach] - points[:-2 * reach, reach:-reach]
    found = np.cross(across, down).astype(np.float32)
    inner = (slice(reach, -reach),) * 2
    found /= np.maximum(np.linalg.norm(found, axis=-1, keepdims=True), 1e-12)
    found *= -np.sign((found * rays[inner]).sum(-1, keepdims=True))
    normals[inner] = np.where(_leaps(depth, rules.leap, reach)[inner][..., None], 0, found)
    return normals


def _leaps(depth: np.ndarray, leap: float, reach: int = 1) -> np.ndarray:
    """Tell where depth leaps from one pixel to the next within `reach`, or is unknown."""
    leaps = (cv2.dilate(_with_far(depth), np.ones((3, 3), np.uint8))
             > (1 + leap) * _nearest(depth)).astype(np.uint8)
    side = 2 * reach - 1
    return cv2.dilate(leaps, np.ones((side, side), np.uint8)) > 0


def _nearest(depth: np.ndarray) -> np.ndarray:
    return cv2.erode(_with_far(depth), np.ones((3, 3), np.uint8))


def _with_far(depth: np.ndarray) -> np.ndarray:
    return np.where(depth > 0, depth, np.float32(1e3))


def _window(box: np.ndarray, rim: int, shape: tuple[int, ...]) -> tuple[slice, slice]:
    x, y, width, height = box[:4]
    return (slice(max(y - rim, 0), min(y + height + rim, shape[0])),
            slice(max(x - rim, 0), min(x + width + rim, shape[1])))
