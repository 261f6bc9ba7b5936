"""The light of now: by how much the scene's surfaces are brighter or darker than in its photos."""
from dataclasses import dataclass
from functools import lru_cache

import cv2
from neo_ros.geometry import CameraPose, Intrinsics, ViewExpansion
from neo_ros.memory.light_file import Cells, MOST_LIGHTS, MOST_TRUST
from neo_ros.memory.light_kernels import add_light, look_up_light
import numpy as np


@dataclass(frozen=True)
class LightThresholds:
    """How finely light is kept, and when it counts as another one."""

    # Metres between cells, the coarse ones first: they tell what the fine ones do not.
    cells: tuple[float, ...] = (2.0, 0.5, 0.25)
    # Around the keyframes light is kept so far, metres; beyond, the last cells tell it.
    reach: float = 6.0
    # Images are looked at so wide, pixels, which takes 0.8 ms; a wide view is lit at twice that.
    width: int = 32
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
    kept: float = MOST_TRUST
    # Logarithms of brightness, at most: what is black in a memory stays so, whatever it is
    # multiplied with, and would be made brighter with each image.
    most_log: float = 3.0
    # The light is another one where surfaces are by so much brighter or darker than others,
    # averaged over the last images; it may be as before where it is less. The tenth of an image
    # that differs most does not count: something may stand there. In the flat 95 % of the images
    # have 0.015 at most, with chairs moved, too; in the sun half of them 0.019, by lamps 0.12.
    other: float = 0.02
    same: float = 0.014
    counted: float = 0.9
    averaged: float = 0.3
    # And what images before say of it leaves less than this share of that; more than the second
    # again: errors of the memory, which no image before foretells, are no light. Of the lights of
    # before one is taken that leaves less than the first of what is left now.
    better: float = 0.7
    worse: float = 0.9
    # After so many images that need no other light it is the photos' again: one wall tells little.
    calm: int = 30
    # Of an image at least this share has to tell of light.
    least: float = 0.05
    most_lights: int = MOST_LIGHTS
    # Of all cells of one size there are so many at most: in a large building they are larger.
    most_cells: int = 1 << 20


# Of a pixel's trust, from which on it tells of light by itself.
SURE = 0.5


class SceneLight:
    """
    The light in which one camera sees a known scene.

    Kept as the logarithm of brightness by the memory's, for each channel, in the scene's space.
    While the light is that of the photos, nothing is changed. `lights` are those of before: where
    one of them is nearer to what is seen, it goes on from there.
    """

    def __init__(self, positions: np.ndarray, expansion: ViewExpansion,
                 thresholds: LightThresholds = LightThresholds()) -> None:
        self.thresholds = thresholds
        low = positions.min(0) - thresholds.reach
        extent = positions.max(0) + thresholds.reach - low
        self._low = low.astype(np.float32)
        self._sizes = [_cell_that_fits(extent, cell, thresholds.most_cells)
                       for cell in thresholds.cells]
        self.empty: Cells = [np.zeros((*_counts(extent, cell), 4), np.float32)
                             for cell in self._sizes]
        self._source, self._rays = _small_camera(expansion.source, thresholds.width)
        self._observed = expansion.observed
        self.begin([])

    def begin(self, lights: list[Cells]) -> None:
        """Forget what was seen; lights: of before."""
        self.lights = list(lights)
        self.other = False
        self._go_on_from(None)
        # By how much the light differs from the photos', and from what was kept of it before.
        self._deviation: float | None = None
        self._residual: float | None = None

    @property
    def shown(self) -> Cells | None:
        """What views are multiplied with, the same object while it grows; None: nothing."""
        return self._now if self.other else None

    @property
    def as_in_photos(self) -> bool:
        """Whether the last images show the photos' light: what differs in them is no light."""
        return not self.other and self._residual is not None and (
            self._residual <= self.thresholds.same)

    def known(self) -> list[Cells]:
        """Return the lights of before and the one of now, the last of them."""
        if not self.other:
            return self.lights
        return [*(light for light in self.lights if light is not self._from),
                self._now][-self.thresholds.most_lights:]

    def _go_on_from(self, light: Cells | None) -> None:
        """Begin with one of the lights of before, None: with the photos'."""
        self._from, self._calm = light, 0
        # Memory of zeros is none until something is written there: of a building little is.
        self._now = ([np.zeros(cells.shape, cells.dtype) for cells in self.empty]
                     if light is None else [cells.copy() for cells in light])

    def relight(self, image: np.ndarray, depth: np.ndarray, pose: CameraPose, view: Intrinsics
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
        factor = np.exp(self._at(_points(rays, small, pose), self._now)).reshape(*small.shape, 3)
        factor = cv2.resize(factor, image.shape[1::-1], interpolation=cv2.INTER_LINEAR)
        cv2.multiply(image, factor, dst=image)
        return factor

    def see(self, image: np.ndarray, shown: np.ndarray, depth: np.ndarray, pose: CameraPose
            ) -> None:
        """
        Take in an image, uint8 RGB (h, w, 3), and its wide view of the memory.

        shown float32 RGB (H, W, 3), in the image's exposure and as `relight` left it; depth
        float32 (H, W) metres, 0 = unknown.
        """
        limits = self.thresholds
        size = (self._source.width, self._source.height)
        now = cv2.resize(image, size, interpolation=cv2.INTER_AREA).astype(np.float32)
        then = cv2.resize(shown[self._observed], size, interpolation=cv2.INTER_AREA)
        away = cv2.resize(depth[self._observed], size, interpolation=cv2.INTER_NEAREST_EXACT)
        # Where both are clipped nothing is known; where one is, it is off by that much at least.
        darker = cv2.split(np.minimum(now, then))
        usable = (away > 0) & (np.maximum.reduce(darker) > limits.darkest) & (
            np.minimum.reduce(darker) < limits.brightest)
        ratio = log_ratio(now, then, limits)
        trust = steadiness(ratio, usable, limits)[usable]
        if (trust > SURE).sum() < limits.least * usable.size:
            return
        ratio, points = ratio[usable], _points(self._rays, away, pose)[usable.ravel()]
        kept = self._at(points, self._now)
        light = np.clip(ratio + kept, -limits.most_log, limits.most_log) if (
            self.other) else ratio
        off, left = (_trimmed_deviation(one, trust, limits.counted)
                     for one in (light, light - kept))
        self._deviation = _moving_average(self._deviation, off, limits.averaged)
        self._residual = _moving_average(self._residual, left, limits.averaged)
        if self._residual > limits.other:
            self._choose(points, light, trust, left)
        least, most = (limits.same, limits.worse) if self.other else (limits.other, limits.better)
        if self._deviation > least and self._residual < most * self._deviation:
            if not self.other:
                self._go_on_from(None)  # Without the images before, which show the photos'.
            self.other, self._calm = True, 0
        elif self.other:
            self._calm += 1
            if self._calm == limits.calm:
                self._put_aside()
        for cell, cells in zip(self._sizes, self._now):
            add_light(points, light, trust, self._low, cell, np.float32(limits.kept), cells)

    def _put_aside(self) -> None:
        """Keep the light of now with those of before; the photos' is back."""
        self.lights, self.other = self.known(), False
        self._go_on_from(None)

    def _choose(self, points: np.ndarray, light: np.ndarray, trust: np.ndarray, now: float
                ) -> None:
        """Go on from the light of before, or the photos', that is nearest to what is seen."""
        limits = self.thresholds
        others = [cells for cells in self.lights if cells is not self._from]
        if self.other:
            others.append(self.empty)
        left = [_trimmed_deviation(light - self._at(points, cells), trust, limits.counted)
                for cells in others]
        best = int(np.argmin(left)) if left else 0
        if not left or left[best] > limits.better * now:
            return
        if self.other:
            self._put_aside()
        if others[best] is not self.empty:
            self.other = True
            self._go_on_from(others[best])
        self._deviation = _trimmed_deviation(light, trust, limits.counted)
        self._residual = left[best]

    def _at(self, points: np.ndarray, cells: Cells) -> np.ndarray:
        light = np.zeros_like(points)
        for size, one in zip(self._sizes, cells):
            finer = np.empty_like(light)
            look_up_light(points, self._low, size, one, np.float32(self.thresholds.doubt), light,
                          finer)
            light = finer
        return light


def _counts(extent: np.ndarray, cell: np.float32) -> np.ndarray:
    """Return how many cells (3,) hold an extent (3,), metres."""
    return np.maximum(np.ceil(extent / cell).astype(int) + 1, 2)


def _cell_that_fits(extent: np.ndarray, cell: float, most: int) -> np.float32:
    """Return the edge of so many cells at most, metres: `cell`, or what is needed beyond it."""
    size = np.float32(max(cell, float(np.cbrt(extent.prod() / most))))
    # At the borders there are more than the volume tells: of a long corridor many times more.
    while _counts(extent, size).prod() > most:
        size *= np.float32(1.02)
    return size


def _trimmed_deviation(light: np.ndarray, trust: np.ndarray, counted: float) -> float:
    """
    Return the mean absolute deviation of logarithms (M, 3) from their median, by trust (M,).

    counted: of all trust, so much, that which differs least.
    """
    off = np.abs(light - np.median(light[trust > SURE], axis=0)).mean(-1)
    order = np.argsort(off)
    below = np.cumsum(trust[order])
    last = int(np.searchsorted(below, counted * below[-1])) + 1
    least = order[:last]
    return float((trust[least] * off[least]).sum() / trust[least].sum())


def _moving_average(before: float | None, now: float, share: float) -> float:
    return now if before is None else before + share * (now - before)


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


def log_ratio(now: np.ndarray, then: np.ndarray, limits: LightThresholds = LightThresholds()
              ) -> np.ndarray:
    """Return by how much an image float32 (h, w, 3) is brighter than another, as logarithms."""
    return np.log((np.maximum(now, 0) + limits.black) / (np.maximum(then, 0) + limits.black))


def steadiness(ratio: np.ndarray, usable: np.ndarray,
               limits: LightThresholds = LightThresholds()) -> np.ndarray:
    """Return how far logarithms (h, w, 3) are those of another light, (h, w) up to 1."""
    side = (limits.around, limits.around)
    known = usable.astype(np.float32)
    count = np.maximum(cv2.blur(known, side), 1e-3)
    used = ratio * known[..., None]
    mean = cv2.blur(used, side) / count[..., None]
    square = cv2.blur(used * used, side) / count[..., None]
    variance = np.maximum(square - mean * mean, 0).mean(-1)
    return 1 / (1 + (variance / limits.varies ** 2) ** 2)
