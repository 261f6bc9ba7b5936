"""Which places of a scene an image looks like, by small pictures of it."""
from collections.abc import Iterable

import cv2
from neo_ros.geometry import CameraPose
from neo_ros.memory.inverted_index import InvertedIndex
from neo_ros.memory.scene_memory import Glances
from neo_ros.memory.sight import are_near
from neo_ros.memory.thresholds import AmbiguityThresholds, GuideThresholds
import numpy as np

# A picture of mean 0 and norm 1 in bytes; of 256 pixels hardly one is farther from 0 than a half.
MIDDLE, STEPS = np.float32(128), np.float32(256)


class GlanceFinder:
    """Compares images with the glances of a scene that they are most like."""

    def __init__(self, glances: Glances, thresholds: GuideThresholds) -> None:
        pictures = glances.pictures
        self.poses = glances.T_world_cam
        self._limits = thresholds
        self._size = (pictures.shape[2], pictures.shape[1])
        self._codes = np.concatenate([  # As floats all of a building's would be large.
            coded(pictures[first:first + 4096].reshape(-1, pictures[0].size))
            for first in range(0, len(pictures), 4096)])
        self._index = InvertedIndex(self._codes)

    def find(self, image: np.ndarray, around: CameraPose | None = None) -> list[CameraPose]:
        """
        Return places that an image, uint8 RGB (h, w, 3), looks like, the most alike first.

        around: only there, within prior_metres on its storey and about in this direction.
        """
        if around is None:
            places, _ = self._most_alike(image)
        else:
            near = np.flatnonzero(are_near(self.poses, self.on_storey(around),
                                           self._limits.prior_metres, self._limits.prior_cosine))
            order = np.argsort(-self._likeness(image, near), kind='stable')
            places = near[order[:self._limits.alike]]
        return [CameraPose(self.poses[index]) for index in self._apart(places)]

    def find_rivals(self, image: np.ndarray, found: CameraPose, limits: AmbiguityThresholds
                    ) -> list[CameraPose]:
        """Return the places elsewhere that an image is nearly as like as where it was found."""
        here = np.flatnonzero(are_near(
            self.poses, found, limits.elsewhere_metres, limits.elsewhere_cosine))
        least = max(self._likeness(image, here).max(initial=-1.0) - limits.less_alike, 0.0)
        left, alike = self._most_alike(image)
        left = left[(alike > least) & ~np.isin(left, here)]
        chosen = list[CameraPose]()
        while len(chosen) < limits.starts and len(left):
            best = CameraPose(self.poses[left[0]])
            chosen.append(best)
            left = left[~are_near(
                self.poses[left], best, limits.start_metres, limits.start_cosine)]
        return chosen

    def _most_alike(self, image: np.ndarray) -> tuple[np.ndarray, np.ndarray]:
        """Return what an image is most like, and the correlations, the most alike first."""
        found, _ = self._index.nearest(self._code(image), self._limits.lists, self._limits.alike)
        places = found[0, found[0] >= 0]
        return places, self._likeness(image, places)

    def _code(self, image: np.ndarray) -> np.ndarray:
        grey = cv2.cvtColor(image, cv2.COLOR_RGB2GRAY)
        return coded(cv2.resize(grey, self._size, interpolation=cv2.INTER_AREA).reshape(1, -1))

    def _likeness(self, image: np.ndarray, places: np.ndarray) -> np.ndarray:
        own = self._code(image)[0].astype(np.float32) - MIDDLE
        alike: np.ndarray = (self._codes[places].astype(np.float32) - MIDDLE) @ own / STEPS ** 2
        return alike

    def on_storey(self, pose: CameraPose) -> CameraPose:
        """Return a pose in the height of the glances around it that is nearest to its own."""
        away = np.linalg.norm(self.poses[:, :2, 3] - pose.position[:2], axis=1)
        heights = self.poses[away < self._limits.prior_metres, 2, 3]
        if not len(heights):
            return pose
        T = pose.T_world_cam.copy()
        T[2, 3] = heights[np.abs(heights - T[2, 3]).argmin()]
        return CameraPose(T)

    def _apart(self, places: Iterable[int]) -> list[int]:
        """Choose the first glances that differ in place or direction."""
        limits, chosen = self._limits, list[int]()
        for index in places:
            pose = self.poses[index]
            near = [other for other in self.poses[chosen]
                    if np.linalg.norm(other[:3, 3] - pose[:3, 3]) < limits.apart_metres
                    and other[:3, 2] @ pose[:3, 2] > limits.apart_cosine]
            if not near:
                chosen.append(int(index))
                if len(chosen) == limits.candidates:
                    break
        return chosen


def coded(pictures: np.ndarray) -> np.ndarray:
    """Bring rows to mean 0 and norm 1, in bytes: MIDDLE and STEPS times that; of one colour 0."""
    rows = pictures.astype(np.float32)
    rows -= rows.mean(1, keepdims=True)
    rows *= STEPS / np.maximum(np.linalg.norm(rows, axis=1, keepdims=True), 1)
    return np.clip(np.rint(rows + MIDDLE), 0, 255).astype(np.uint8)
