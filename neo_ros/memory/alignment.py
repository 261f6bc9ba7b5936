"""
Find a camera's pose from its image: direct photometric alignment with the scene memory.

Gauss-Newton on the difference of grey images, coarse to fine, in six degrees of freedom, with
gain and bias free and Huber weights (Lucas and Kanade 1981; as in DSO, Engel et al. 2018).
"""
from dataclasses import dataclass, replace

import cv2
from neo_ros.geometry import CameraPose, Intrinsics
from neo_ros.memory import alignment_kernels as kernels
from neo_ros.memory.alignment_kernels import GuideLevel, PhotoLevel, Warp
from neo_ros.memory.descent_kernels import descend, Descent
from neo_ros.memory.kernels import Pinhole
from neo_ros.memory.rendering import MemoryRenderer
from neo_ros.pictures.exposure import exposure_gain, ExposureThresholds
import numpy as np


@dataclass(frozen=True)
class AlignmentThresholds:
    """How an image is aligned, and when image and memory agree."""

    # Scales of the residuals' weights, grey levels in [0, 1]. Far from the pose Huber's pull from
    # everywhere; near it Geman and McClure's let somebody who stands in the image have no say.
    huber: float = 0.05
    geman_mcclure: float = 0.08
    # The finest level is at most so wide, pixels. A level is half as wide as the one before; the
    # coarsest is at least so wide.
    finest: int = 128
    coarsest: int = 24
    iterations: int = 12
    # A step that moves no pixel by more than this, pixels, is the last one of its level.
    still: float = 0.02
    damping: float = 1e-4
    # Keyframes that the image is aligned with: fewer than are shown.
    aligned_with: int = 2
    # Share of the image that the memory has to know.
    least_overlap: float = 0.3
    # A step that leaves less than this share of the guide's pixels in the image has lost it.
    lost: float = 0.05
    # Share of an image that somebody may hide.
    occluded: float = 0.35
    # Surroundings in another light are a share of the width wide; darker pixels tell nothing.
    surroundings: float = 1 / 8
    darkest: float = 0.02
    exposure: ExposureThresholds = ExposureThresholds()


@dataclass(frozen=True, eq=False)
class Drawn:
    """
    What the memory shows the camera from a pose: grey float32 (h, w) in [0, 1].

    depth float32 (h, w), z in metres, 0 = unknown.
    """

    pose: CameraPose
    grey: np.ndarray
    depth: np.ndarray


class Aligner:
    """Aligns images of one camera with one memory."""

    def __init__(self, renderer: MemoryRenderer, source: Intrinsics,
                 thresholds: AlignmentThresholds = AlignmentThresholds()) -> None:
        self.renderer, self.thresholds = renderer, thresholds
        finest = source.scaled(min(1.0, thresholds.finest / source.width))
        self.levels = [finest]
        while self.levels[-1].width >= 2 * thresholds.coarsest:
            self.levels.append(finest.scaled(0.5 ** len(self.levels)))
        self.rays = [level.pixel_rays() for level in self.levels]
        self._sizes = [(level.width, level.height) for level in self.levels]

    def photo(self, image: np.ndarray) -> list[PhotoLevel]:
        """Prepare a camera image, RGB uint8 (h, w, 3), for `align` and `agreement`."""
        whole = grey_of(image)
        greys = [cv2.resize(whole, size, interpolation=cv2.INTER_AREA) for size in self._sizes]
        return [PhotoLevel(grey, np.gradient(grey, axis=1).astype(np.float32),
                           np.gradient(grey, axis=0).astype(np.float32)) for grey in greys]

    def align(self, photo: list[PhotoLevel], start: CameraPose, rounds: int,
              near: bool = False, drawn: Drawn | None = None, any_light: bool = False
              ) -> CameraPose:
        """
        Improve a pose until image and memory agree; `photo` is what `self.photo` gave.

        Every round draws the memory anew from the pose that the round before has found; the first
        one takes what is `drawn` already. `near`: the start is a few centimetres and degrees off;
        then occluders do little harm. `any_light`: with what is drawn in the image's own light.
        """
        pose, coarsest = start, len(self.levels) - 1
        for _ in range(rounds):
            guide, drawn = drawn or self._draw(pose), None
            if any_light:
                guide = lit_as(photo[0].grey, guide, self.thresholds)
            levels = self._levels(guide)
            warp = Warp(pose.inverse() @ guide.pose.T_world_cam,
                        self._first_gain(photo[-1], levels[-1]), 0.0)
            for level in range(coarsest, -1, -1):
                warp = self._align_level(level, photo[level], levels[level], warp, near)
            pose = CameraPose.nearest(guide.pose.T_world_cam @ np.linalg.inv(warp.T))
            coarsest = min(coarsest, 1)
        return pose

    def _draw(self, pose: CameraPose) -> Drawn:
        view = self.renderer.render(pose, self.levels[0], self.thresholds.aligned_with)
        return Drawn(pose, grey_of(view.image), view.depth)

    def _levels(self, drawn: Drawn) -> list[GuideLevel]:
        return [GuideLevel(cv2.resize(drawn.grey, size, interpolation=cv2.INTER_AREA),
                           cv2.resize(drawn.depth, size, interpolation=cv2.INTER_NEAREST), rays)
                for size, rays in zip(self._sizes, self.rays)]

    def agreement(self, photo: list[PhotoLevel], pose: CameraPose) -> float:
        """Return the correlation of image and memory at a pose, in [-1, 1]."""
        level = min(1, len(self.levels) - 1)
        guide = self.renderer.render(pose, self.levels[level], self.thresholds.aligned_with)
        return whole_agreement(photo[level].grey, grey_of(guide.image), guide.depth > 0,
                               self.thresholds)

    def _first_gain(self, photo: PhotoLevel, guide: GuideLevel) -> float:
        """Return what takes the photo to the guide's exposure, if they show the same."""
        known = guide.depth > 0
        if not known.any():
            return 1.0
        return 1 / float(exposure_gain(
            255 * guide.grey[known, None], 255 * photo.grey[known, None],
            self.thresholds.exposure)[0])

    def _align_level(self, level: int, photo: PhotoLevel, guide: GuideLevel, warp: Warp,
                     near: bool) -> Warp:
        view, limits = self.levels[level], self.thresholds
        most_gain = limits.exposure.most_gain
        found: Warp = descend(
            photo, guide, Pinhole(view.fx, view.fy, view.cx, view.cy), warp, Descent(
                limits.geman_mcclure if near else limits.huber, near, limits.iterations,
                limits.still, limits.damping, limits.lost,
                (0.8 / most_gain, 1.25 * most_gain)))
        return found


def grey_of(image: np.ndarray) -> np.ndarray:
    """Return grey float32 (h, w) in [0, 1] of an RGB image (h, w, 3) in 0 ... 255."""
    return cv2.cvtColor(image.astype(np.float32, copy=False) / 255, cv2.COLOR_RGB2GRAY)


def agreement(image: np.ndarray, guide: np.ndarray, known: np.ndarray,
              thresholds: AlignmentThresholds = AlignmentThresholds()) -> tuple[float, float]:
    """
    Return the correlations in [-1, 1] of an image and a guide where the guide is known.

    The first is of all pixels, the second of those that fit best: without a third of them, as
    if somebody stood there. What grows evenly across the image does not count: a finger on the
    lens is a gradient, too, and so is many a wall. image, guide: float (h, w); known: bool
    (h, w). Both are -1 where too little is known, and 0 if one of the images is of one colour.
    """
    whole = whole_agreement(image, guide, known, thresholds)
    if whole == -1:
        return -1.0, -1.0
    a, b = image[known], guide[known]
    fits, most = np.ones(len(a), bool), int((1 - thresholds.occluded) * (len(a) - 1))
    for _ in range(3):
        slope, errors = kernels.line_errors(a, b, fits)
        fits = errors <= np.partition(errors, most)[most]
    kept = known.copy()
    kept[known] = fits
    return whole, kernels.detail_correlation(image, guide, kept) if slope > 0 else 0.0


def whole_agreement(image: np.ndarray, guide: np.ndarray, known: np.ndarray,
                    thresholds: AlignmentThresholds = AlignmentThresholds()) -> float:
    """Return the first correlation of `agreement`, without the second."""
    if known.mean() < thresholds.least_overlap:
        return -1.0
    return kernels.detail_correlation(image, guide, known)


def fine_agreement(image: np.ndarray, guide: np.ndarray, known: np.ndarray,
                   thresholds: AlignmentThresholds = AlignmentThresholds()) -> float:
    """
    Return the correlation in [-1, 1] of what differs from its surroundings, by ratios.

    It is the same in every light that differs little from one place to the next. Arguments, and
    when it is -1, are those of `agreement`.
    """
    if known.mean() < thresholds.least_overlap:
        return -1.0
    (_, a), (_, b) = (_in_light(one, known, thresholds) for one in (image, guide))
    return kernels.detail_correlation(a, b, known)


def lit_as(image: np.ndarray, drawn: Drawn, thresholds: AlignmentThresholds = AlignmentThresholds()
           ) -> Drawn:
    """Return what is drawn in the light that an image, float (h, w), shows around each pixel."""
    (now, _), (then, _) = (_in_light(one, drawn.depth > 0, thresholds)
                           for one in (image, drawn.grey))
    return replace(drawn, grey=drawn.grey * np.exp(now - then))


def _in_light(grey: np.ndarray, known: np.ndarray, thresholds: AlignmentThresholds
              ) -> tuple[np.ndarray, np.ndarray]:
    """Return the logarithm around each pixel, of those known, and what the pixel has beyond it."""
    sigma, kept = thresholds.surroundings * grey.shape[1], known.astype(np.float32)
    whole = np.log(np.maximum(grey, thresholds.darkest))
    around = (cv2.GaussianBlur(whole * kept, (0, 0), sigma)
              / np.maximum(cv2.GaussianBlur(kept, (0, 0), sigma), 1e-6))
    return around, whole - around
