"""
Which places of a scene could show an image, and which of them it contradicts.

Rooms can look alike. A place that was searched for is believed only if no other place could be
it; the images that follow tell them apart, or nothing does.
"""
from collections.abc import Sequence
from dataclasses import dataclass, replace

from neo_ros.geometry import CameraPose
from neo_ros.memory.evidence import ask, least_refuted
from neo_ros.memory.glancing import GlanceFinder
from neo_ros.memory.looking import Looker
from neo_ros.memory.rivals import is_elsewhere, RivalFinder
from neo_ros.memory.sight import better, CameraImage, is_near, Sight
from neo_ros.memory.twins import NO_TWINS, Twins
import numpy as np


@dataclass
class Hypothesis:
    """
    A place that could be it.

    motion: (4, 4), of the camera's last step there; asked: the pose there of the last image that
    was asked; refuted: (4, 4) each, from where the camera is, if it is here, to where it is not
    though it looked alike, in world axes.
    """

    sight: Sight
    motion: np.ndarray
    asked: CameraPose
    refuted: tuple[np.ndarray, ...] = ()

    def way_to(self, pose: CameraPose) -> np.ndarray:
        """Return what takes the camera here to a pose, (4, 4) in world axes."""
        return pose.T_world_cam @ np.linalg.inv(self.sight.pose.T_world_cam)


class Doubt:
    """The places between which the images of one camera have not decided yet."""

    def __init__(self, looker: Looker, glances: GlanceFinder, twins: Twins = NO_TWINS) -> None:
        self._looker, self._rivals = looker, RivalFinder(looker, glances, twins)
        self._limits = looker.thresholds.ambiguity
        self.forget()

    def forget(self) -> None:
        """Decide nothing, doubt nothing."""
        self._open: list[Hypothesis] = []
        # Of all images that were asked, float (N, N): what speaks against one for another.
        self._evidence = np.zeros((0, 0))

    @property
    def is_open(self) -> bool:
        """Whether there are several places that could be it."""
        return bool(self._open)

    @property
    def is_lost(self) -> bool:
        """Whether the last image agrees with none of them by so much as a search needs."""
        return self.is_open and self._best.sight.agreement < self._looker.thresholds.least_found

    @property
    def _best(self) -> Hypothesis:
        return max(self._open, key=lambda one: one.sight.agreement)

    def settle(self, image: CameraImage, followed: Sight | None, found: Sight | None,
               elsewhere: Sequence[CameraPose]) -> Sight | None:
        """
        Choose between where a camera was followed to and where a search found it, or elsewhere.

        A search is believed if no place elsewhere explains the image as well; else, a followed
        camera stays where it is, and of a lost one the places are kept to be told apart.
        """
        if found is not None and not found.believed:
            found = self._rivals.better_twin(image, found)
        if found is None or not found.believed:
            return better(followed, found)
        stays = followed if followed is not None and followed.believed else None
        if stays is not None and not self._is_elsewhere(found, stays):
            return better(followed, found)
        self.forget()
        candidates = [found, *self._rivals.find(
            image, found, self._rivals.starts(image, found, elsewhere))]
        if stays is not None:
            candidates.append(stays)
        evidence = self._ask(image, candidates)
        best = least_refuted(evidence)
        asked = 0
        while best != asked and len(candidates) <= 2 * self._limits.most_rivals:
            # What was found may lie a little off, as landmarks do, and look worse than it is: its
            # twin leads to where exactly it would be.
            asked, winner = best, candidates[best]
            candidates += self._rivals.find(image, winner, ())
            evidence = self._ask(image, candidates)
            best = least_refuted(evidence)
        # What led to the best may be a little off it, the same place.
        left = [index for index, share in enumerate(evidence[:, best]) if index == best or (
            share < self._limits.decisive
            and self._is_elsewhere(candidates[index], candidates[best]))]
        if len(left) == 1:
            return candidates[best]
        if stays is not None:
            return stays
        self._open = [Hypothesis(candidates[index], np.eye(4), candidates[index].pose)
                      for index in left]
        self._evidence = evidence[np.ix_(left, left)]
        return None

    def follow(self, image: CameraImage, motion: np.ndarray | None) -> Hypothesis | None:
        """
        Follow the camera at all places where it could be; return the one that is left.

        motion: (4, 4), as in `SceneGuide.guide`. None while several are left, or none.
        """
        self._follow_all(image, motion)
        if not self._open:
            self.forget()
            return None
        if self._is_worth_asking(self._best):
            self._evidence *= self._limits.remembered
            self._evidence += self._ask(image, [one.sight for one in self._open])
            for one in self._open:
                one.asked = one.sight.pose
        against = self._evidence[:, least_refuted(self._evidence)]
        refuted = [one.sight.pose for one, share in zip(self._open, against)
                   if share >= self._limits.decisive_together]
        self._keep(np.flatnonzero(against < self._limits.decisive_together).tolist())
        for one in self._open:
            one.refuted += tuple(map(one.way_to, refuted))
        best = self._open[0]
        if len(self._open) == 1:
            self._doubt_anew(image, best)
        if len(self._open) > 1:
            return None
        self.forget()
        return replace(best, sight=replace(best.sight, found='searched'))

    def _is_worth_asking(self, best: Hypothesis) -> bool:
        """Tell whether an image that agrees so shows what the last one that was asked did not."""
        return best.sight.agreement >= self._looker.thresholds.least_agreement and not is_near(
            best.sight.pose, best.asked, self._limits.asked_metres, self._limits.asked_cosine)

    def _keep(self, kept: list[int]) -> None:
        self._open = [self._open[index] for index in kept]
        self._evidence = self._evidence[np.ix_(kept, kept)]

    def _follow_all(self, image: CameraImage, motion: np.ndarray | None) -> None:
        """Move all places on with the camera, and drop those that the image does not fit."""
        moved = [self._moved(image, one, motion) for one in self._open]
        best = max(moved, key=lambda one: one.sight.agreement)
        twins = self._rivals.twins.of(best.sight.pose)
        sure, kept = self._looker.thresholds.sure, list[int]()
        for index, (before, one) in enumerate(zip(self._open, moved)):
            last = before.sight.pose
            if motion is None and one.sight.agreement < min(sure, best.sight.agreement):
                # It is one camera: where it is followed best tells how it moves.
                pose = CameraPose.nearest(last.T_world_cam @ best.motion)
                sight = self._looker.glimpse(image, pose, pose)
                if best.sight.agreement >= sure or sight.agreement > one.sight.agreement:
                    one = replace(one, sight=sight, motion=best.motion)
            sight, _ = self._rivals.at_twin(image, one.sight, twins)
            moved[index] = one = replace(one, sight=sight)
            steps = [motion] if motion is not None else [np.eye(4), before.motion]
            if all(self._is_elsewhere(one.sight, moved[other].sight) for other in kept) and any(
                    not is_elsewhere(one.sight.pose,
                                     CameraPose.nearest(last.T_world_cam @ step), self._limits)
                    for step in steps):
                kept.append(index)
        self._open = moved
        least = 1 - max((moved[index].sight.agreement for index in kept), default=1.0)
        self._keep([index for index in kept if moved[index].sight.believed or (
            any(moved[other].sight.believed for other in kept)
            and 1 - moved[index].sight.agreement < self._limits.unexplained * least)])

    def _moved(self, image: CameraImage, one: Hypothesis, motion: np.ndarray | None
               ) -> Hypothesis:
        """Follow the camera from one place, by its own last step where no motion is known."""
        last, step = one.sight.pose, one.motion if motion is None else motion
        expected = CameraPose.nearest(last.T_world_cam @ step)
        pose = self._looker.aligner.align(image.photo, expected, 1, near=True)
        sight = self._looker.glimpse(image, pose, expected)
        if not sight.believed and motion is None:
            pose = self._looker.aligner.align(image.photo, last, 3, near=True)
            sight = self._looker.glimpse(image, pose, last)
        return replace(one, sight=sight, motion=last.inverse() @ pose.T_world_cam)

    def _doubt_anew(self, image: CameraImage, only: Hypothesis) -> None:
        """Find places that could be it but were not followed, before the last one is believed."""
        here = only.sight.pose.T_world_cam
        refuted = [CameraPose.nearest(T @ here) for T in only.refuted]
        rivals = [rival for rival in self._rivals.find(image, only.sight, self._rivals.starts(
            image, only.sight)) if all(
                is_elsewhere(rival.pose, pose, self._limits) for pose in refuted)]
        equal, self._evidence = self._equal(image, only.sight, rivals)
        for rival in equal:
            one = Hypothesis(rival, only.motion, rival.pose)
            one.refuted = tuple(map(one.way_to, refuted))
            self._open.append(one)
        only.asked = only.sight.pose

    def equals(self, image: CameraImage, here: Sight, starts: Sequence[CameraPose]
               ) -> list[Sight]:
        """Return what is seen from places near some starts that an image does not tell apart."""
        return self._equal(image, here, self._rivals.find(image, here, starts))[0]

    def _equal(self, image: CameraImage, here: Sight, rivals: list[Sight]
               ) -> tuple[list[Sight], np.ndarray]:
        """Return the rivals that an image does not refute, and the evidence: `here` is first."""
        evidence = self._ask(image, [here, *rivals])
        left = np.flatnonzero(evidence[1:, 0] < self._limits.decisive) + 1
        kept = [0, *left.tolist()]
        return [rivals[index - 1] for index in left], evidence[np.ix_(kept, kept)]

    def _ask(self, image: CameraImage, sights: list[Sight]) -> np.ndarray:
        return ask(self._looker, image, sights)

    def _is_elsewhere(self, one: Sight, other: Sight) -> bool:
        return is_elsewhere(one.pose, other.pose, self._limits)
