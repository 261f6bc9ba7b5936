"""The light of now: by how much the scene's surfaces are brighter or darker than in its photos."""
from dataclasses import dataclass
from functools import lru_cache

import cv2
from neo_ros.geometry import CameraPose, Intrinsics, ViewExpansion
from neo_ros.memory.light_kernels import add_light, look_up_light
import numpy as np


@dataclass(frozen=True)
class LightThresholds:
    """How finely light is kept, and when it counts as another one."""

    # Metres between cells, the coarse ones first: they tell what the fine ones do not.
    cells: tuple[float, ...] = (2.0, 0.5)
    # Around the keyframes light is kept so far, metres; beyond, the last cells tell it.
    reach: float = 6.0
    # Images are looked at so wide, pixels; a wide view is lit at twice that.
    width: int = 64
    # The logarithms of image by memory vary by so much around a pixel where something else is
    # seen, not the same in other light.
    varies: float = 0.15
    around: int = 5
    # Where image and memory both have grey levels beyond these, they tell nothing of light.
    darkest: float = 6.0
    brightest: float = 246.0
    # Grey levels that are added before logarithms are taken: noise of what is black.
    black: float = 4.0
    # Of what the cells hold: what came before counts as so much of it; more is forgotten.
    doubt: float = 0.5
    kept: float = 60.0
    # The light is another one where surfaces are by so much brighter or darker than others,
    # averaged over the last images; it is as before where it is less again.
    other: float = 0.10
    same: float = 0.06
    averaged: float = 0.1


class SceneLight:
    """
    The light in which one camera sees a known scene.

    Kept as the logarithm of brightness by the memory's, for each channel, in the scene's space.
    While the light is that of the photos, nothing is changed.
    """

    def __init__(self, positions: np.ndarray, expansion: ViewExpansion,
                 thresholds: LightThresholds = LightThresholds()) -> None:
        self.thresholds = thresholds
        low = positions.min(0) - thresholds.reach
        extent = positions.max(0) + thresholds.reach - low
        self._low = low.astype(np.float32)
        self._cells = [np.zeros((*(np.maximum(np.ceil(extent / cell).astype(int) + 1, 2)), 4),
                                np.float32) for cell in thresholds.cells]
        self._source, self._rays = _small_camera(expansion.source, thresholds.width)
        self._observed = expansion.observed
        self.other = False
        self._difference = 0.0

    def shine(self, image: np.ndarray, depth: np.ndarray, pose: CameraPose, view: Intrinsics
              ) -> np.ndarray | None:
        """
        Show a view of the memory, float32 RGB (H, W, 3), in the light of now, in place.

        depth float32 (H, W) metres, 0 = unknown. Returns what its colours were multiplied with,
        float32 (H, W, 3); None in the photos' light.
        """
        if not self.other:
            return None
        camera, rays = _small_camera(view, 2 * self.thresholds.width)
        small = cv2.resize(depth, (camera.width, camera.height),
                           interpolation=cv2.INTER_NEAREST_EXACT)
        factor = np.exp(self._at(_points(rays, small, pose))).reshape(*small.shape, 3)
        factor = cv2.resize(factor, image.shape[1::-1], interpolation=cv2.INTER_LINEAR)
        np.minimum(cv2.multiply(image, factor), np.float32(255), out=image)
        return factor

    def see(self, image: np.ndarray, shown: np.ndarray, depth: np.ndarray, pose: CameraPose
            ) -> None:
        """
        Take in an image, uint8 RGB (h, w, 3), and its wide view of the memory.

        shown float32 RGB (H, W, 3), in the image's exposure and as `shine` left it; depth float32
        (H, W) metres, 0 = unknown.
        """
        limits = self.thresholds
        size = (self._source.width, self._source.height)
        now = cv2.resize(image, size, interpolation=cv2.INTER_AREA).astype(np.float32)
        then = cv2.resize(shown[self._observed], size, interpolation=cv2.INTER_AREA)
        away = cv2.resize(depth[self._observed], size, interpolation=cv2.INTER_NEAREST_EXACT)
        # Where both are clipped nothing is known; where one is, it is off by that much at least.
        usable = (away > 0) & (np.minimum(now, then).max(-1) > limits.darkest) & (
            np.minimum(now, then).min(-1) < limits.brightest)
        if not usable.any():
            return
        ratio = np.log((now + limits.black) / (then + limits.black))
        trust = _steady(ratio, usable, limits)[usable]
        points = _points(self._rays, away, pose)[usable.ravel()]
        light = self._at(points) if self.other else np.zeros_like(points)
        light += ratio[usable]
        self._note(light, trust)
        for cell, cells in zip(limits.cells, self._cells):
            add_light(points, light, trust, self._low, np.float32(cell), np.float32(limits.kept),
                      cells)

    def _note(self, light: np.ndarray, trust: np.ndarray) -> None:
        """Tell whether it is another light, by how much it differs from place to place."""
        total = trust.sum()
        if total < 1:
            return
        mean = (trust[:, None] * light).sum(0) / total
        off = float((trust * np.abs(light - mean).mean(-1)).sum() / total)
        limits = self.thresholds
        self._difference += limits.averaged * (off - self._difference)
        self.other = self._difference > (limits.same if self.other else limits.other)

    def _at(self, points: np.ndarray) -> np.ndarray:
        light = np.zeros_like(points)
        for cell, cells in zip(self.thresholds.cells, self._cells):
            finer = np.empty_like(light)
            look_up_light(points, self._low, np.float32(cell), cells,
                          np.float32(self.thresholds.doubt), light, finer)
            light = finer
        return light


@lru_cache(maxsize=32)
def _small_camera(view: Intrinsics, width: int) -> tuple[Intrinsics, np.ndarray]:
    """Return a camera that is at most so wide, and its rays."""
    camera = view.scaled(min(1.0, width / view.width))
    return camera, camera.pixel_rays()


def _points(rays: np.ndarray, depth: np.ndarray, pose: CameraPose) -> np.ndarray:
    """Return the world points (h w, 3), float32, at depths along pixel rays (h, w, 3)."""
    R, t = pose.T_world_cam[:3, :3], pose.T_world_cam[:3, 3]
    return np.ascontiguousarray(
        (rays * depth[..., None]).reshape(-1, 3) @ R.T + t, np.float32)


def _steady(ratio: np.ndarray, usable: np.ndarray, limits: LightThresholds) -> np.ndarray:
    """Return how far logarithms (h, w, 3) are those of another light, (h, w) up to 1."""
    side = (limits.around, limits.around)
    known = usable.astype(np.float32)
    count = np.maximum(cv2.blur(known, side), 1e-3)
    used = ratio * known[..., None]
    mean = cv2.blur(used, side) / count[..., None]
    square = cv2.blur(used * used, side) / count[..., None]
    variance = np.maximum(square - mean * mean, 0).mean(-1)
    return 1 / (1 + (variance / limits.varies ** 2) ** 2)
