"""Which places of a scene an image looks like, by small pictures of it."""
from collections.abc import Iterable

import cv2
from neo_ros.geometry import CameraPose
from neo_ros.memory.scene_memory import Glances
from neo_ros.memory.sight import AmbiguityThresholds, GuideThresholds
import numpy as np


class GlanceFinder:
    """Compares images with all glances of a scene."""

    def __init__(self, glances: Glances, thresholds: GuideThresholds) -> None:
        pictures = glances.pictures
        self.poses = glances.T_world_cam
        self._limits = thresholds
        self._rows = normalized(pictures.reshape(len(pictures), -1))
        self._size = (pictures.shape[2], pictures.shape[1])

    def find(self, image: np.ndarray, around: CameraPose | None = None) -> list[CameraPose]:
        """
        Return places that an image, uint8 RGB (h, w, 3), looks like, the most alike first.

        around: only there, within prior_metres of any height and about in this direction.
        """
        alike = self._likeness(image)
        if around is not None:
            alike[~self._near(around)] = -np.inf
        places = np.argsort(-alike, kind='stable')[:40 * self._limits.candidates]
        chosen = self._apart(places[np.isfinite(alike[places])])
        return [CameraPose(self.poses[index]) for index in chosen]

    def find_rivals(self, image: np.ndarray, found: CameraPose, limits: AmbiguityThresholds
                    ) -> list[CameraPose]:
        """Return the places elsewhere that an image is nearly as like as where it was found."""
        alike, chosen = self._likeness(image), list[CameraPose]()
        here = self._within(found, limits.elsewhere_metres, limits.elsewhere_cosine)
        least = max(alike[here].max(initial=-1.0) - limits.less_alike, 0.0)
        alike[here] = -1
        while len(chosen) < limits.starts and alike.max() > least:
            best = CameraPose(self.poses[int(alike.argmax())])
            chosen.append(best)
            alike[self._within(best, limits.start_metres, limits.start_cosine)] = -1
        return chosen

    def _within(self, pose: CameraPose, metres: float, cosine: float) -> np.ndarray:
        near: np.ndarray = (
            np.linalg.norm(self.poses[:, :3, 3] - pose.position, axis=1) <= metres) & (
                self.poses[:, :3, 2] @ pose.forward >= cosine)
        return near

    def _likeness(self, image: np.ndarray) -> np.ndarray:
        grey = cv2.cvtColor(image, cv2.COLOR_RGB2GRAY)
        small = cv2.resize(grey, self._size, interpolation=cv2.INTER_AREA)
        alike: np.ndarray = self._rows @ normalized(small.reshape(1, -1))[0]
        return alike

    def _near(self, pose: CameraPose) -> np.ndarray:
        away = np.linalg.norm(self.poses[:, :2, 3] - pose.position[:2], axis=1)
        near: np.ndarray = (away < self._limits.prior_metres) & (
            self.poses[:, :3, 2] @ pose.forward > self._limits.prior_cosine)
        return near

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


def normalized(pictures: np.ndarray) -> np.ndarray:
    """Return rows of mean 0 and norm 1, float32; rows of one colour become 0."""
    rows = pictures.astype(np.float32)
    rows -= rows.mean(1, keepdims=True)
    norm = np.linalg.norm(rows, axis=1, keepdims=True)
    return rows / np.maximum(norm, 1)
