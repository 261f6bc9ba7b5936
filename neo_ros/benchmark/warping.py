"""
B2: warp the most similar photos onto the wide view, and blend them; no pose, no depth, no field.

Retrieval by VLAD, RootSIFT matches, a homography a photo that bends to its matches (as
projective as possible; Zaragoza et al., 2013), one gain per channel; of all photos that match,
those that together cover the ring best; multi-band blending (Burt and Adelson, 1983). What no
photo covers is extended from what is there, and counted.
"""
from dataclasses import dataclass
from typing import NamedTuple

import cv2
from neo_ros.baking.photo_bank import PhotoBank
from neo_ros.geometry import CameraPose, ViewExpansion
from neo_ros.memory.local_features import find_features, match_features
from neo_ros.pictures.exposure import exposure_gain
from neo_ros.pictures.filling import blend_bands, extend_edges, sample_pixels
import numpy as np


@dataclass(frozen=True)
class WarpingRules:
    """Which photos are warped and how; chosen by measuring."""

    retrieved: int = 160          # photos that are looked at
    fused: int = 12               # photos that may contribute
    ratio: float = 0.85           # of the best to the second distance of descriptors
    plane_pixels: float = 2.5     # a match within so many pixels of the homography is kept
    least_inliers: int = 10
    nodes: int = 17               # of the grid on which a warp is solved, per side
    # Of the wide image's width: how far a match bends the warp. Matches beyond that keep the warp
    # one homography, with this weight.
    reach: float = 0.12
    far_weight: float = 0.02
    observed_weight: float = 2.0  # beside the photos', which are at most 1
    off_levels: float = 5.0       # grey levels that a photo may be off before it counts less
    # Of the wide image's width: how far from a match a warp is trusted; beyond, this much.
    trusted: float = 0.2
    least_trust: float = 0.02


class WarpedPhoto(NamedTuple):
    """
    A photo as it would look in the wide view.

    image   uint8 (H, W, 3)
    weight  float32 (H, W): 0 where the photo shows nothing, up to how well the photo fits
    """

    image: np.ndarray
    weight: np.ndarray


class Warping:
    """B2 as a method. `uncovered` is the share of the ring that no photo covered last time."""

    name = 'warping'
    observed_pasted = True

    def __init__(self, bank: PhotoBank, expansion: ViewExpansion,
                 train_minutes: float | None = None,
                 rules: WarpingRules = WarpingRules()) -> None:
        self.bank, self.expansion, self.rules = bank, expansion, rules
        self.train_minutes = train_minutes
        self.images = bank.photos.read_images(bank.scale)
        self.usable = bank.photos.read_all_usable(bank.scale)
        files = [path.stat().st_size for path in bank.photos.image_paths]
        self.model_mb: float | None = bank.megabytes + sum(files) / 1e6
        self.uncovered = 1.0

    def expand(self, narrow_image: np.ndarray) -> np.ndarray:
        """Widen (h, w, 3) RGB uint8 to (H, W, 3) RGB uint8."""
        expansion = self.expansion
        ring = expansion.extrapolated_mask
        warped = covering(self._warped_photos(narrow_image), ring, self.rules)
        weights = [one.weight for one in warped]
        covered = np.any([weight > 0 for weight in weights], axis=0) if weights else ~ring
        self.uncovered = float((~covered)[ring].mean())
        # The observed image, extended, is one more source: colours flow out of it.
        observed = expansion.paste(narrow_image, np.zeros((*ring.shape, 3), np.uint8))
        extended = extend_edges(observed.astype(np.float32), ~ring)
        images = [np.where(one.weight[..., None] > 0, one.image, extended)
                  for one in warped] + [extended]
        blended = blend_bands(
            images, [*weights, np.where(ring, 0, self.rules.observed_weight).astype(np.float32)])
        filled = extend_edges(blended, covered | ~ring)
        return expansion.paste(narrow_image, np.clip(filled + 0.5, 0, 255).astype(np.uint8))

    def notes(self, true_pose: CameraPose) -> dict[str, float]:
        """Return the share of the ring that was not covered by a photo in the last frame."""
        return {'uncovered': self.uncovered}

    def _warped_photos(self, narrow_image: np.ndarray) -> list[WarpedPhoto]:
        features = find_features(narrow_image)
        shift = np.array([self.expansion.left, self.expansion.top], np.float32)
        found = []
        for index in self.bank.nearest(features, self.rules.retrieved):
            photo = self.bank.features[index]
            matches = match_features(features.descriptors, photo.descriptors, self.rules.ratio)
            wide, other = features.points[matches[:, 0]] + shift, photo.points[matches[:, 1]]
            kept = on_plane(wide, other, self.rules)
            if kept.sum() >= self.rules.least_inliers:
                one = self._warp(narrow_image, index, wide[kept], other[kept])
                if one is not None:
                    found.append(one)
        return found

    def _warp(self, narrow_image: np.ndarray, index: int, wide: np.ndarray,
              other: np.ndarray) -> WarpedPhoto | None:
        """Bring a photo into the wide view by matched pixels (N, 2); None if it does not fit."""
        photo, target = self.images[index], self.expansion.target
        where = smooth_warp(wide, other, target.width, target.height, self.rules)
        height, width = photo.shape[:2]
        rim = np.minimum(np.minimum(where[..., 0], width - where[..., 0]),
                         np.minimum(where[..., 1], height - where[..., 1]))
        # Weights fall off towards the photo's rim, so that it leaves no edge.
        feather = np.clip(np.nan_to_num(rim, nan=-1) / (0.1 * width), 0, 1)
        if self.usable is not None:
            feather *= sample_pixels(self.usable[index].astype(np.float32), where) > 0.9999
        if (feather > 0).sum() < 0.01 * feather.size:
            return None
        image = sample_pixels(photo, where).astype(np.float32)
        common = self.expansion.crop(feather) > 0.2
        if common.mean() < 0.05:
            return None
        shown = self.expansion.crop(image)
        gain = exposure_gain(shown[common], narrow_image[common])
        image = np.clip(image * gain, 0, 255)
        off = np.abs(self.expansion.crop(image)[common] - narrow_image[common]).mean()
        fit = np.exp(-off / self.rules.off_levels) * near_matches(
            wide, target.width, target.height, self.rules)
        return WarpedPhoto((image + 0.5).astype(np.uint8), (feather * fit).astype(np.float32))


def covering(photos: list[WarpedPhoto], ring: np.ndarray,
             rules: WarpingRules = WarpingRules()) -> list[WarpedPhoto]:
    """
    Choose the photos to fuse, best first.

    Each is the one that adds most: to the sum, over the ring (H, W), of the best weight so far.
    """
    weights = np.array([one.weight[ring] for one in photos])
    best = np.zeros(int(ring.sum()), np.float32)
    chosen: list[WarpedPhoto] = []
    while len(chosen) < min(rules.fused, len(photos)):
        added = np.maximum(weights - best, 0).sum(1)
        index = int(added.argmax())
        if added[index] <= 0:
            break
        chosen.append(photos[index])
        best = np.maximum(best, weights[index])
    return chosen


def near_matches(wide: np.ndarray, width: int, height: int,
                 rules: WarpingRules = WarpingRules()) -> np.ndarray:
    """Return how far a warp can be trusted, (height, width) up to 1: it is best at its matches."""
    away = np.ones((height, width), np.uint8)
    x, y = np.clip(wide.astype(int), 0, [width - 1, height - 1]).T
    away[y, x] = 0
    distance = cv2.distanceTransform(away, cv2.DIST_L2, 5) / (rules.trusted * width)
    return np.maximum(np.exp(-distance ** 2), rules.least_trust)


def on_plane(wide: np.ndarray, other: np.ndarray,
             rules: WarpingRules = WarpingRules()) -> np.ndarray:
    """Tell which matches (N, 2) lie on the homography that explains most."""
    if len(wide) < rules.least_inliers:
        return np.zeros(len(wide), bool)
    cv2.setRNGSeed(0)
    H, inliers = cv2.findHomography(wide, other, cv2.USAC_MAGSAC, rules.plane_pixels,
                                    maxIters=2000, confidence=0.999)
    return np.zeros(len(wide), bool) if H is None else inliers.ravel() > 0


def smooth_warp(wide: np.ndarray, other: np.ndarray, width: int, height: int,
                rules: WarpingRules = WarpingRules()) -> np.ndarray:
    """
    Fit a warp to matches (N, 2) that bends near them and is one homography far from them.

    Returns float32 (height, width, 2): for every pixel of the wide view the pixel of the other
    image; NaN where the warp turns over or shrinks the photo more than four times.
    """
    across_nodes = np.linspace(-0.5, 0.5, rules.nodes)
    centre, size = np.array([width, height]) / 2, float(width)
    a, b = (wide - centre) / size, (other - other.mean(0)) / size
    zero, one = np.zeros(len(a)), np.ones(len(a))
    x, y = a.T
    u, v = b.T
    rows = np.stack([
        np.stack([x, y, one, zero, zero, zero, -u * x, -u * y, -u], 1),
        np.stack([zero, zero, zero, x, y, one, -v * x, -v * y, -v], 1)], 1)
    outer = (rows.swapaxes(1, 2) @ rows).reshape(-1, 81)
    nodes = np.stack(np.meshgrid(across_nodes, across_nodes * height / width), -1)
    apart = ((nodes[:, :, None] - a) ** 2).sum(-1)
    weight = np.maximum(np.exp(-apart / (2 * rules.reach ** 2)), rules.far_weight)
    sums = (weight @ outer).reshape(*nodes.shape[:2], 9, 9)
    # The last number of a homography is 1: the middle of the wide view is before the photo.
    solved = np.linalg.solve(sums[..., :8, :8] + 1e-9 * np.eye(8), -sums[..., :8, 8:])
    H = np.concatenate([solved[..., 0], np.ones((*nodes.shape[:2], 1))], -1)
    corners = np.dstack([nodes, np.ones(nodes.shape[:2])])[..., None]
    point = (H.reshape(*nodes.shape[:2], 3, 3) @ corners)[..., 0]
    depth = np.where(point[..., 2] > 0.2, point[..., 2], np.nan)
    grid = (point[..., :2] / depth[..., None] * size + other.mean(0)).astype(np.float32)
    where = _upsampled(grid, width, height)
    across, down = np.gradient(where, axis=1), np.gradient(where, axis=0)
    area = across[..., 0] * down[..., 1] - across[..., 1] * down[..., 0]
    where[~((area > 1 / 16) & (area < 16))] = np.nan
    return where


def _upsampled(grid: np.ndarray, width: int, height: int) -> np.ndarray:
    """Interpolate node values (n, n, 2), which reach to the image's rim, at pixels."""
    x = (np.arange(width, dtype=np.float32) + 0.5) / width * (len(grid) - 1)
    y = (np.arange(height, dtype=np.float32) + 0.5) / height * (len(grid) - 1)
    return cv2.remap(grid, *np.meshgrid(x, y), cv2.INTER_LINEAR)
