"""
Which places of a scene look alike: each of its views is searched for elsewhere, in the memory.

A robot that is lost in one of them has to doubt; what it has to doubt is found here, once and
for all views of a place, where a robot has the time for a few of one image.
"""
from dataclasses import dataclass, replace

from neo_ros.geometry import CameraPose, ViewExpansion
from neo_ros.machine.compiled import ALL_THREADS
from neo_ros.machine.progress import no_progress, Progress
from neo_ros.memory.doubt import Doubt
from neo_ros.memory.glancing import GlanceFinder
from neo_ros.memory.local_features import find_features
from neo_ros.memory.looking import Looker
from neo_ros.memory.parallel import parallel_loops
from neo_ros.memory.scene_memory import SceneMemory
from neo_ros.memory.sight import CameraImage, GuideThresholds
from neo_ros.memory.twins import NO_TWINS, Twins
import numpy as np


@dataclass(frozen=True)
class TwinRules:
    """How the views of a memory are compared."""

    every: int = 4             # of a keyframe's headings: they are 15 degrees apart
    starts: int = 8            # places that a view is most like, which are compared with it
    least_known: float = 0.8   # of a view by the memory
    # Two ways from a place to its twin are one if they lead so near.
    same_metres: float = 0.5
    same_cosine: float = 0.97


@dataclass
class _Pair:
    """A way from a place to its twin, and where it was found."""

    T: np.ndarray
    pose: CameraPose
    low: np.ndarray
    high: np.ndarray

    def explains(self, one: CameraPose, other: CameraPose, rules: TwinRules) -> bool:
        """Tell whether it leads from one pose to another, about, and take the first in if so."""
        there = self.T @ one.T_world_cam
        leads = bool(np.linalg.norm(there[:3, 3] - other.position) < rules.same_metres
                     and there[:3, 2] @ other.forward > rules.same_cosine)
        if leads:
            self.grow(one)
        return leads

    def grow(self, pose: CameraPose) -> None:
        """Take a pose into the area."""
        self.low, self.high = (np.minimum(self.low, pose.position),
                               np.maximum(self.high, pose.position))


def find_twins(memory: SceneMemory, expansion: ViewExpansion, progress: Progress = no_progress,
               rules: TwinRules = TwinRules()) -> Twins:
    """Find the places of a memory that a camera of this view cannot tell apart, from some view."""
    thresholds = GuideThresholds()
    thresholds = replace(thresholds, ambiguity=replace(
        thresholds.ambiguity, starts=rules.starts))
    looker = Looker(memory, expansion, thresholds)
    glances = GlanceFinder(memory.glances, thresholds)
    doubt = Doubt(looker, glances)
    pairs = list[_Pair]()
    with parallel_loops(ALL_THREADS):
        for done, position in enumerate(memory.positions):
            for pose in _views_at(position, memory.glances.T_world_cam, rules):
                view = looker.renderer.render(pose, expansion.source, thresholds.shown)
                if (view.depth > 0).mean() < rules.least_known:
                    continue
                pixels = view.image.clip(0, 255).astype(np.uint8)
                left = _unexplained(pairs, pose, glances.find_rivals(
                    pixels, pose, thresholds.ambiguity), rules)
                if not left:
                    continue
                image = CameraImage(pixels, looker.aligner.photo(pixels), find_features)
                for equal in doubt.equals(image, looker.look(image, pose), left):
                    if _unexplained(pairs, pose, [equal.pose], rules):
                        T = equal.pose.T_world_cam @ np.linalg.inv(pose.T_world_cam)
                        pairs.append(_Pair(T, pose, pose.position, pose.position))
            progress(done + 1, len(memory.positions))
    if not pairs:
        return NO_TWINS
    return Twins(np.stack([pair.T for pair in pairs]),
                 np.stack([[pair.low, pair.high] for pair in pairs]),
                 np.stack([pair.pose.T_world_cam for pair in pairs]))


def _views_at(position: np.ndarray, T_world_cam: np.ndarray, rules: TwinRules
              ) -> list[CameraPose]:
    """Return some of the poses that glances at a keyframe were taken from."""
    here = np.flatnonzero((T_world_cam[:, :3, 3] == position).all(1))
    return [CameraPose(T_world_cam[index]) for index in here[::rules.every]]


def _unexplained(pairs: list[_Pair], pose: CameraPose, places: list[CameraPose],
                 rules: TwinRules) -> list[CameraPose]:
    """Return the places that no known pair leads to from a pose, or back."""
    left = list[CameraPose]()
    for place in places:
        ways = [pair.explains(*ends, rules) for pair in pairs
                for ends in ((pose, place), (place, pose))]
        if not any(ways):
            left.append(place)
    return left
