"""
Which places of a scene look alike: each of its views is searched for elsewhere, in the memory.

A robot that is lost in one of them has to doubt; what it has to doubt is found here, once and
for all views of a place, where a robot has the time for a few of one image.
"""
from dataclasses import dataclass, replace

from neo_ros.geometry import CameraPose, ViewExpansion
from neo_ros.machine.compiled import ALL_THREADS
from neo_ros.machine.evenly import evenly
from neo_ros.machine.progress import no_progress, Progress
from neo_ros.memory.doubt import Doubt
from neo_ros.memory.glancing import GlanceFinder
from neo_ros.memory.local_features import find_features
from neo_ros.memory.looking import Looker
from neo_ros.memory.parallel import parallel_loops
from neo_ros.memory.scene_memory import SceneMemory
from neo_ros.memory.sight import CameraImage
from neo_ros.memory.thresholds import GuideThresholds
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
    exact_views: int = 12      # by which the way of a pair is told exactly


@dataclass
class _Pair:
    """A way from a place to its twin, and the views that it leads there."""

    T: np.ndarray
    poses: list[CameraPose]

    def explains(self, one: CameraPose, other: CameraPose, rules: TwinRules) -> bool:
        """Tell whether it leads from one pose to another, about, and take the first in if so."""
        there = self.T @ one.T_world_cam
        leads = bool(np.linalg.norm(there[:3, 3] - other.position) < rules.same_metres
                     and there[:3, 2] @ other.forward > rules.same_cosine)
        if leads:
            self.poses.append(one)
        return leads

    @property
    def area(self) -> np.ndarray:
        """The corners of where its views were taken, (2, 3)."""
        positions = np.stack([pose.position for pose in self.poses])
        return np.stack([positions.min(0), positions.max(0)])


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
                        pairs.append(_Pair(T, [pose]))
            progress(done + 1, len(memory.positions))
        exact = [_exact(pair, looker, rules) for pair in pairs]
    if not pairs:
        return NO_TWINS
    return Twins(np.stack(exact), np.stack([pair.area for pair in pairs]),
                 np.stack([pair.poses[0].T_world_cam for pair in pairs]))


def _exact(pair: _Pair, looker: Looker, rules: TwinRules) -> np.ndarray:
    """Return a pair's way (4, 4) as most of some views tell it; one of them may tell it badly."""
    ways = [pair.T]
    for index in evenly(len(pair.poses), rules.exact_views):
        pose = pair.poses[index]
        view = looker.renderer.render(pose, looker.expansion.source, looker.thresholds.shown)
        photo = looker.aligner.photo(view.image.clip(0, 255).astype(np.uint8))
        there = CameraPose.nearest(pair.T @ pose.T_world_cam)
        found = looker.aligner.align(photo, there, rounds=3, near=True)
        if looker.aligner.agreement(photo, found) >= looker.thresholds.least_agreement:
            ways.append(found.T_world_cam @ np.linalg.inv(pose.T_world_cam))
    # The way that leads the corners of the place nearest to where all others lead them.
    corners = np.stack([np.append(corner, 1.0) for corner in pair.area])
    ends = np.stack([corners @ way.T for way in ways])[..., :3].reshape(len(ways), -1)
    apart = np.linalg.norm(ends[:, None] - ends, axis=-1)
    return ways[int(apart.sum(1).argmin())]


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
