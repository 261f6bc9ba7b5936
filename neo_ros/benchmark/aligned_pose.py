"""
Where a field looks most like an image: direct alignment, from a pose that is nearly right.

Each pixel's point lies where the field shows a surface; the pose is moved until the photo's
colours there are the field's, as in Direct Sparse Odometry (Engel et al., PAMI 2018).
"""
from dataclasses import dataclass

import cv2
from neo_ros.field.radiance_field import RadianceField
from neo_ros.field.rendering import render_rays
from neo_ros.geometry import Intrinsics
from neo_ros.geometry.camera_pose import rotation_from_vector, rotation_vector
import numpy as np


@dataclass(frozen=True)
class AlignmentRules:
    """How poses are aligned, and how far they may go."""

    pixels: int = 400          # of a photo, of four times as many those where its colours change
    rounds: int = 5
    most_turn: float = 0.02    # radians away from where the image was
    most_shift: float = 0.02   # likewise, as a share of the median distance
    noise: float = 0.08        # of colours in [0, 1]: what is farther off hardly counts
    # How far poses are off, most likely, in the same units: what colours do not tell stays.
    likely: float = 0.004


def aligned_pose(field: RadianceField, image: np.ndarray, camera: Intrinsics,
                 T_world_cam: np.ndarray, gain: np.ndarray, random: np.random.Generator,
                 usable: np.ndarray | None = None, rules: AlignmentRules = AlignmentRules(),
                 ) -> np.ndarray:
    """
    Return T_world_cam (4, 4) at which the field looks most like an image uint8 (H, W, 3).

    gain (3,) takes colours of the field to the photo's. usable: bool (H, W), the pixels that show
    the scene; None: all. The pose as it came is returned where too
    little is seen.
    """
    photo = cv2.GaussianBlur(image, (0, 0), 0.7).astype(np.float32) / 255
    across = cv2.Sobel(photo, cv2.CV_32F, 1, 0, scale=1 / 8)
    down = cv2.Sobel(photo, cv2.CV_32F, 0, 1, scale=1 / 8)
    change = np.abs(across) + np.abs(down)
    if usable is not None:  # Blur and slope see three pixels far.
        left_out = cv2.dilate((~usable).astype(np.uint8), np.ones((7, 7), np.uint8)) > 0
        change[left_out] = 0
    rows, columns = _telling_pixels(change, random, rules.pixels)
    rays = camera.pixel_rays()[rows, columns].astype(np.float64)
    T = T_world_cam.copy()
    for _ in range(rules.rounds):
        world = rays @ T[:3, :3].T
        length = np.linalg.norm(world, axis=-1, keepdims=True)
        shown = render_rays(field, T[:3, 3].astype(np.float32), (world / length).astype(
            np.float32))
        met = (shown.opacity > 0.9) & (shown.coverage > 0.5)
        if met.sum() < rules.pixels / 4:
            return T_world_cam
        points = (rays * shown.depth[:, None] / length)[met]
        off = photo[rows, columns][met] - gain * shown.image[met]
        slopes = np.stack([across[rows, columns][met], down[rows, columns][met]], -1)
        T = T @ _step(points, off, slopes, camera, rules)
    return _bounded(T_world_cam, T, float(np.median(points[:, 2])), rules)


def _telling_pixels(change: np.ndarray, random: np.random.Generator, count: int
                    ) -> tuple[np.ndarray, np.ndarray]:
    """Draw rows and columns of pixels where a photo's colours change (H, W, 3)."""
    height, width = change.shape[:2]
    rows, columns = (random.integers(1, size - 1, size=4 * count) for size in (height, width))
    strength = change[rows, columns].sum(-1)
    best = np.argsort(-strength, kind='stable')[:count]
    return rows[best], columns[best]


def _step(points: np.ndarray, off: np.ndarray, slopes: np.ndarray, camera: Intrinsics,
          rules: AlignmentRules) -> np.ndarray:
    """
    Return the motion (4, 4) of the camera, in its own axes, by which colours agree best.

    points (N, 3) in camera axes, off (N, 3) by which photo and field differ, slopes (N, 3, 2) of
    the photo's colours across and down.
    """
    x, y, z = points.T
    zero = np.zeros_like(z)
    project = np.stack([np.stack([camera.fx / z, zero, -camera.fx * x / z ** 2], -1),
                        np.stack([zero, camera.fy / z, -camera.fy * y / z ** 2], -1)], -2)
    # A camera that moves by v and turns by w has the point at p - v + p x w.
    cross = np.stack([np.stack([zero, -z, y], -1), np.stack([z, zero, -x], -1),
                      np.stack([-y, x, zero], -1)], -2)
    distance = np.median(z)
    moved = np.concatenate([-np.broadcast_to(np.eye(3), cross.shape) * distance, cross], -1)
    jacobian = (slopes @ project @ moved).reshape(-1, 6)
    residual = off.reshape(-1)
    weight = 1 / (1 + (residual / rules.noise) ** 2) ** 2 / rules.noise ** 2
    normal = (jacobian * weight[:, None]).T @ jacobian + np.eye(6) / rules.likely ** 2
    step = -np.linalg.solve(normal, (jacobian * weight[:, None]).T @ residual)
    T = np.eye(4)
    T[:3, :3], T[:3, 3] = rotation_from_vector(step[3:]), distance * step[:3]
    return T


def _bounded(before: np.ndarray, after: np.ndarray, distance: float, rules: AlignmentRules
             ) -> np.ndarray:
    """Return `after`, or `before` where the way from one to the other is too long to be true."""
    shift = np.linalg.norm(after[:3, 3] - before[:3, 3]) / max(distance, 1e-9)
    turn = np.linalg.norm(rotation_vector(before[:3, :3].T @ after[:3, :3]))
    return after if shift < rules.most_shift and turn < rules.most_turn else before
