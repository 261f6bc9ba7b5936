"""How far away is what contradicts the memory: from images of one camera at known poses."""
from collections.abc import Sequence
from dataclasses import dataclass

import cv2
from neo_ros.geometry import CameraPose, Intrinsics
from neo_ros.memory import stereo_kernels as kernels
from neo_ros.memory.kernels import Pinhole
import numpy as np


@dataclass(frozen=True)
class StereoThresholds:
    """Which images are compared, at which depths, and which depths are believed."""

    # Metres. What is nearer or farther is not found; inverse depth has so many steps.
    nearest: float = 0.6
    farthest: float = 14.0
    levels: int = 112
    # Images that are compared with one: those whose poses are so far apart, metres, and look the
    # same way.
    compared: int = 8
    baseline: tuple[float, float] = (0.15, 1.5)
    cosine: float = 0.7
    # Of the images that show a point this share counts, the better: others may be hidden there.
    share: float = 0.6
    # What it costs, grey levels, if neighbours differ by one step of depth, or by more.
    slant: float = 2.5
    leap: float = 24.0
    # Pixels around what contradicts that are looked at, too: they hold its depth.
    margin: int = 6
    # Grey levels by which images of a surface differ at most.
    most_error: float = 20.0
    # So many other images have to show the same, and more than do not; depths of one surface
    # differ by this share at most.
    witnesses: int = 2
    same: float = 0.1


@dataclass(frozen=True, eq=False)
class Shot:
    """
    One image of the camera and what the memory showed there, all of the same size.

    image, shown float32 RGB (h, w, 3), grey levels, in the memory's exposure; depth float32
    (h, w), metres along the optical axis, 0 = unknown; contradicted bool (h, w); score: by how
    many grey levels, float32 (h, w).
    """

    pose: CameraPose
    image: np.ndarray
    shown: np.ndarray
    depth: np.ndarray
    contradicted: np.ndarray
    score: np.ndarray
    stamp_ns: int


def partners(shots: Sequence[Shot], index: int, limits: StereoThresholds) -> list[int]:
    """Return the images that one is compared with: of all baselines there are, evenly."""
    own = shots[index].pose
    low, high = limits.baseline
    found = []
    for other, shot in enumerate(shots):
        apart = float(np.linalg.norm(shot.pose.position - own.position))
        if low <= apart <= high and shot.pose.forward @ own.forward > limits.cosine:
            found.append((apart, other))
    found.sort()
    if len(found) > limits.compared:
        found = [found[i] for i in np.linspace(0, len(found) - 1, limits.compared).astype(int)]
    return [other for _, other in found]


def relative(shots: Sequence[Shot], others: Sequence[int], index: int
             ) -> tuple[np.ndarray, np.ndarray]:
    """Return R (N, 3, 3), t (N, 3), float32, from the camera of one image to those of others."""
    T = np.stack([shots[other].pose.inverse() @ shots[index].pose.T_world_cam
                  for other in others])
    return (np.ascontiguousarray(T[:, :3, :3], np.float32),
            np.ascontiguousarray(T[:, :3, 3], np.float32))


def find_depth(shots: Sequence[Shot], index: int, camera: Intrinsics, rays: np.ndarray,
               limits: StereoThresholds) -> tuple[np.ndarray, np.ndarray]:
    """
    Return depth float32 (h, w) of what contradicts the memory in an image, and its error.

    Metres, 0 = nothing contradicts there, or it is not known. rays: of the camera's pixels.
    """
    shot = shots[index]
    depth, error = np.zeros_like(shot.depth), np.full_like(shot.depth, np.inf)
    others = partners(shots, index, limits)
    rows, columns = (np.flatnonzero(shot.contradicted.any(axis)) for axis in (1, 0))
    if len(others) < 2 or not len(rows):
        return depth, error
    part = tuple(slice(max(int(found[0]) - limits.margin, 0), int(found[-1]) + limits.margin + 1)
                 for found in (rows, columns))
    inverse = np.linspace(1 / limits.farthest, 1 / limits.nearest, limits.levels,
                          dtype=np.float32)
    size = shot.depth[part].shape
    wanted = cv2.dilate(shot.contradicted[part].view(np.uint8), np.ones((5, 5), np.uint8)) > 0
    cost = np.empty((*size, limits.levels), np.float32)
    kernels.sweep(shot.image, rays,
                  kernels.Shots(np.stack([shots[other].image for other in others]),
                                *relative(shots, others, index)),
                  _pinhole(camera), inverse, wanted, part[0].start, part[1].start,
                  np.float32(limits.share), cost)
    photo = cv2.blur(cost.reshape(size[0], -1), (1, 3)).reshape(cost.shape)
    known = shot.depth[part]
    levels = np.where(known > 0, (1 / np.maximum(known, 1e-3) - inverse[0])
                      / (inverse[1] - inverse[0]), -1).astype(np.float32)
    kernels.anchor(cost, levels, shot.contradicted[part])
    total = np.zeros_like(cost)
    kernels.smooth(cost, np.ascontiguousarray(shot.image[part]),
                   np.float32(limits.slant), np.float32(limits.leap), total)
    found_depth, found_error = np.empty(size, np.float32), np.empty(size, np.float32)
    kernels.choose(total, photo, inverse, found_depth, found_error)
    depth[part], error[part] = found_depth, found_error
    depth[~shot.contradicted] = 0
    return depth, error


def confirm(shots: Sequence[Shot], index: int, depths: np.ndarray, camera: Intrinsics,
            rays: np.ndarray, limits: StereoThresholds) -> np.ndarray:
    """
    Return the depth, float32 (h, w), of what other images confirm, 0 elsewhere.

    depths (N, h, w): of all images, by `find_depth`.
    """
    depth = np.zeros_like(depths[index])
    others = [other for other, shot in enumerate(shots) if np.linalg.norm(
        shot.pose.position - shots[index].pose.position) >= limits.baseline[0] / 2]
    if not others or not depths[index].any():
        return depth
    chosen = [shots[other] for other in others]
    views = kernels.Views(
        np.stack([shot.image for shot in chosen]), depths[others],
        np.stack([shot.depth for shot in chosen]),
        np.stack([shot.contradicted for shot in chosen]), *relative(shots, others, index))
    votes = np.empty((*depth.shape, 2), np.int8)
    kernels.confirm(shots[index].image, rays, depths[index], views, _pinhole(camera),
                    np.float32(limits.same), np.float32(limits.most_error), depth, votes)
    depth[(votes[..., 0] < limits.witnesses) | (votes[..., 0] <= votes[..., 1])] = 0
    return depth


def _pinhole(camera: Intrinsics) -> Pinhole:
    return Pinhole(*map(np.float32, (camera.fx, camera.fy, camera.cx, camera.cy)))
