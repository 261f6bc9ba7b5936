"""What the camera has just seen, and looks past now: the last images correct the memory."""
from dataclasses import dataclass
from typing import NamedTuple

import cv2
from neo_ros.geometry import CameraPose, ViewExpansion
from neo_ros.geometry.camera_pose import rotation_angle
from neo_ros.memory.changes import Changes
from neo_ros.memory.kernels import Pinhole
from neo_ros.memory.recent_kernels import bring_differences, SeenImages
import numpy as np


@dataclass(frozen=True)
class RecentThresholds:
    """Which images are kept, and how far each is trusted."""

    # They are at most so wide, pixels: as those that are aligned.
    widest: int = 128
    # Images that are kept. A new one is kept beside the one before if surfaces have moved by this
    # share of its width; otherwise in its place.
    kept: int = 8
    moved: float = 0.1
    # Images after which what was seen is forgotten: nobody knows whether it is still there.
    forgotten: int = 150
    # Grey levels by which image and memory differ where the image is no longer trusted: there may
    # be somebody who moves. The mean over squares of so many pixels counts.
    untrusted: float = 24.0
    around: int = 9
    # Of an image whose Laplacian is this much weaker than the memory's only coarse differences
    # count, smoothed by so many pixels: what a blurred image does not show is still there.
    blurred: float = 0.75
    coarse: float = 2.0


class SeenBefore(NamedTuple):
    """
    By how much the last images differ from the memory, in the wide view of the present one.

    weight float32 (h, w) in [0, 1], 0 where none of them saw the surface, never 0 all over;
    difference float32 (h, w, 3), the weight times grey levels in the present image's exposure.
    They are as fine as the images that were kept, and show the whole view.
    """

    difference: np.ndarray
    weight: np.ndarray

    def at(self, shape: tuple[int, ...]) -> 'SeenBefore':
        """Return it for every pixel of the view of (H, W) pixels."""
        if self.weight.shape == shape:
            return self
        return SeenBefore(*(cv2.resize(one, shape[::-1], interpolation=cv2.INTER_LINEAR)
                            for one in self))


class RecentImages:
    """The last images of one camera that follows a scene memory, made small."""

    def __init__(self, expansion: ViewExpansion,
                 thresholds: RecentThresholds = RecentThresholds()) -> None:
        self.thresholds = thresholds
        scale = min(1.0, thresholds.widest / expansion.source.width)
        self._source, self._target = expansion.source.scaled(scale), expansion.target.scaled(scale)
        self._observed = expansion.observed
        self._rays = self._target.pixel_rays()
        self._ring = cv2.resize(expansion.extrapolated_mask.view(np.uint8),
                                (self._target.width, self._target.height),
                                interpolation=cv2.INTER_NEAREST_EXACT)
        shape = (thresholds.kept, self._source.height, self._source.width)
        self._differences = np.zeros((*shape, 3), np.float32)
        self._depths, self._trusts = np.zeros(shape, np.float32), np.zeros(shape, np.float32)
        self._poses = [CameraPose(np.eye(4))] * thresholds.kept
        self._numbers = [0] * thresholds.kept
        self.forget()

    def forget(self) -> None:
        """Forget all images."""
        self._order: list[int] = []  # The newest first.
        self._number = 0
        self._twins = False  # The newest is from the pose of the one before, or nearly so.

    def keep(self, image: np.ndarray, shown: np.ndarray, depth: np.ndarray, pose: CameraPose,
             gain: np.ndarray) -> None:
        """
        Keep an image, uint8 RGB (h, w, 3), of this pose.

        shown, depth: what the memory shows in its wide view, float32 RGB (H, W, 3) in the image's
        exposure, which is the memory's times gain (3,), and float32 (H, W) metres, 0 = unknown.
        """
        limits = self.thresholds
        self._number += 1
        if self._twins and len(self._order) > 1:
            slot = self._order.pop(0)
        else:
            if len(self._order) == limits.kept:
                self._order.pop()
            slot = next(slot for slot in range(limits.kept) if slot not in self._order)
        self._order.insert(0, slot)
        size = (self._source.width, self._source.height)
        window = depth[self._observed]
        known = cv2.resize((window > 0).astype(np.float32), size, interpolation=cv2.INTER_AREA)
        self._depths[slot] = np.where(known > 0.999, cv2.resize(
            window, size, interpolation=cv2.INTER_NEAREST_EXACT), 0)
        now = cv2.resize(image, size, interpolation=cv2.INTER_AREA).astype(np.float32)
        remembered = np.where(self._depths[slot][..., None] > 0, cv2.resize(
            shown[self._observed], size, interpolation=cv2.INTER_AREA), now)
        difference: np.ndarray = (now - remembered) / gain
        if _sharpness(now) < limits.blurred * _sharpness(remembered):
            difference = cv2.GaussianBlur(difference, (0, 0), limits.coarse)
        self._differences[slot] = difference
        # A maximum along an axis of three takes NumPy seven times as long.
        largest = np.maximum.reduce(cv2.split(np.abs(difference)))
        largest = cv2.blur(largest, (limits.around, limits.around))
        self._trusts[slot] = np.clip(2 * (1 - largest / limits.untrusted), 0, 1)
        self._poses[slot], self._numbers[slot] = pose, self._number
        self._twins = len(self._order) > 1 and (
            self._moved(*self._order[:2]) < limits.moved)

    def distrust(self, changes: Changes) -> None:
        """Trust no image where the memory has changed: it differed from what was shown before."""
        for slot in self._order:
            changed = changes.shown_at(self._depths[slot], self._source, self._poses[slot])
            self._trusts[slot][changed > 0] = 0

    def _moved(self, one: int, other: int) -> float:
        """Return by which share of the width surfaces move from one kept image to another."""
        T = self._poses[one].inverse() @ self._poses[other].T_world_cam
        known = self._depths[one][self._depths[one] > 0]
        away = float(np.median(known)) if len(known) else 1.0
        return float((np.linalg.norm(T[:3, 3]) / away + rotation_angle(T[:3, :3]))
                     * self._source.fx / self._source.width)

    def bring(self, depth: np.ndarray, pose: CameraPose, gain: np.ndarray) -> SeenBefore | None:
        """Show what they saw in the wide view from a pose; None: nothing. Arguments as `keep`."""
        self._order = [slot for slot in self._order
                       if self._number - self._numbers[slot] < self.thresholds.forgotten]
        order = self._order
        if not order:
            return None
        size = (self._target.width, self._target.height)
        small = cv2.resize(depth, size, interpolation=cv2.INTER_NEAREST_EXACT) * self._ring
        T = np.stack([self._poses[slot].inverse() @ pose.T_world_cam for slot in order])
        brought = np.empty((*small.shape, 3), np.float32)
        weight = np.empty(small.shape, np.float32)
        source = self._source
        camera = Pinhole(*map(np.float32, (source.fx, source.fy, source.cx, source.cy)))
        seen = SeenImages(self._differences, self._depths, self._trusts, np.array(order),
                          T[:, :3, :3].astype(np.float32), T[:, :3, 3].astype(np.float32))
        bring_differences(self._rays, small, gain, seen, self._twins, camera, brought, weight)
        return SeenBefore(brought, weight) if weight.any() else None


def _sharpness(image: np.ndarray) -> float:
    """Return how much an image, float32 (h, w, 3), changes between neighbours."""
    return float(cv2.Laplacian(image, cv2.CV_32F).std())
