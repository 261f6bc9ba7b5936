"""Where else a camera could be: places of a scene that explain an image about as well."""
from collections.abc import Sequence
from dataclasses import replace
from itertools import compress

from neo_ros.geometry import CameraPose
from neo_ros.memory.alignment_kernels import PhotoLevel
from neo_ros.memory.glancing import GlanceFinder
from neo_ros.memory.looking import Looker
from neo_ros.memory.parallel import on_cores
from neo_ros.memory.sight import are_near, CameraImage, is_near, Sight
from neo_ros.memory.thresholds import AmbiguityThresholds
from neo_ros.memory.twins import Twins
import numpy as np


class RivalFinder:
    """Finds such places by what an image is like, and by the twins that a memory knows."""

    def __init__(self, looker: Looker, glances: GlanceFinder, twins: Twins) -> None:
        self.twins = twins
        self._looker, self._glances = looker, glances
        self._limits = looker.thresholds.ambiguity

    def starts(self, image: CameraImage, found: Sight, elsewhere: Sequence[CameraPose] = ()
               ) -> list[CameraPose]:
        """Return where else the camera of an image could be, before it is looked closer."""
        return [*elsewhere, *self._glances.find_rivals(image.pixels, found.pose, self._limits)]

    def find(self, image: CameraImage, found: Sight, starts: Sequence[CameraPose]) -> list[Sight]:
        """
        Return what is seen from other places that explain an image, each place once.

        They are looked for from some starts, and in the twins of where it was found.
        """
        looker, limits = self._looker, self._limits
        small, twins = looker.coarse_aligner.photo(image.pixels), self.twins.of(found.pose)
        rivals, looked = list[Sight](), list[CameraPose]()
        for start in self._likely(small, found, twins, starts):
            if len(rivals) == limits.most_rivals:
                break
            if any(not is_elsewhere(start, rival.pose, limits) for rival in rivals) or any(
                    is_near(start, other, limits.same_metres, limits.same_cosine)
                    for other in looked):
                continue
            looked.append(start)
            pose = start
            if not any(start is twin for twin in twins):  # They are exact already.
                with on_cores(1):
                    pose = looker.coarse_aligner.align(small, pose, rounds=1)
                pose = looker.aligner.align(image.photo, pose, rounds=2)
            pose = looker.aligner.align(image.photo, pose, rounds=1, near=True)
            if any(not is_elsewhere(pose, other.pose, limits) for other in (found, *rivals)):
                continue
            # Not as strictly as what is searched for: a little off, a twin agrees a little less.
            sight, is_twin = self.at_twin(image, looker.glimpse(image, pose), twins)
            least = 1 - limits.as_unexplained * (1 - found.agreement)
            if sight.believed or sight.agreement > (
                    min(least, limits.least_twin) if is_twin else least):
                rivals.append(replace(sight, found='searched'))
        return rivals

    def better_twin(self, image: CameraImage, found: Sight) -> Sight:
        """
        Return what is seen from a twin of where a search ended, if the image agrees more there.

        Of many places that look alike a search may have come to another one than the camera's.
        """
        best = max(self.find(image, found, ()), key=lambda one: one.agreement, default=found)
        if best.agreement <= found.agreement:
            return found
        return self._looker.glimpse(image, best.pose, searched=True)

    def _likely(self, small: list[PhotoLevel], found: Sight, twins: Sequence[CameraPose],
                starts: Sequence[CameraPose]) -> list[CameraPose]:
        """
        Return the places elsewhere that a small image agrees with, the most agreeing first.

        Twins are as exact as what was found. Starts elsewhere than they are aligned with it.
        """
        coarse, limits = self._looker.coarse_aligner, self._limits
        tried = list[tuple[float, CameraPose]]()
        with on_cores(1):  # To share such small views out takes longer.
            # Where somebody stands in the image, or what is shown has changed, all agree less.
            least = min(limits.least_coarse,
                        coarse.agreement(small, found.pose) - limits.agrees_less)
            tried += [(coarse.agreement(small, twin), twin) for twin in twins]
            known = _stacked(twins)
            for start in starts:
                if are_near(known, start, limits.elsewhere_metres, limits.elsewhere_cosine).any():
                    continue
                pose = coarse.align(small, start, rounds=1)
                if is_elsewhere(pose, found.pose, limits):
                    tried.append((coarse.agreement(small, pose), pose))
        return [pose for agrees, pose in sorted(tried, key=lambda one: -one[0])
                if agrees > least]

    def at_twin(self, image: CameraImage, sight: Sight, twins: Sequence[CameraPose]
                ) -> tuple[Sight, bool]:
        """
        Return what is seen from a place, or from a twin there if the image agrees more with that.

        Also whether a twin is there. It is as exact as what it is the twin of: aligning may fail.
        """
        there = are_near(_stacked(twins), sight.pose, self._limits.elsewhere_metres,
                         self._limits.elsewhere_cosine)
        for twin in compress(twins, there):
            other = self._looker.glimpse(image, twin)
            if other.agreement > sight.agreement:
                sight = replace(other, believed=other.believed or sight.believed)
        return sight, bool(there.any())


def is_elsewhere(one: CameraPose, other: CameraPose, limits: AmbiguityThresholds) -> bool:
    """Tell whether two poses are of two places, and not one pose found twice."""
    return bool(np.linalg.norm(one.position - other.position) > limits.elsewhere_metres
                or one.forward @ other.forward < limits.elsewhere_cosine)


def _stacked(poses: Sequence[CameraPose]) -> np.ndarray:
    """Return the poses as (K, 4, 4), also if there are none."""
    return np.array([pose.T_world_cam for pose in poses]).reshape(-1, 4, 4)
