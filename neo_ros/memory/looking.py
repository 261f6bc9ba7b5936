"""Look at the memory from a pose, or from where it agrees most with an image."""
from collections.abc import Callable, Iterator, Sequence
from dataclasses import replace
from functools import cache, partial

import cv2
from neo_ros.geometry import CameraPose, ViewExpansion
from neo_ros.memory.alignment import agreement, Aligner, Drawn, fine_agreement, grey_of
from neo_ros.memory.alignment_kernels import GuideLevel, PhotoLevel
from neo_ros.memory.coarse_memory import CoarseMemory
from neo_ros.memory.parallel import on_cores
from neo_ros.memory.pose_covariance import (
    aligned_covariance, in_world, located_covariance, with_floor)
from neo_ros.memory.rendering import GuideView, MemoryRenderer
from neo_ros.memory.scene_light import SceneLight
from neo_ros.memory.scene_memory import SceneMemory
from neo_ros.memory.sight import CameraImage, Found, is_near, Sight
from neo_ros.memory.thresholds import GuideThresholds
import numpy as np


class Looker:
    """Compares images of one camera with what one memory shows."""

    def __init__(self, memory: SceneMemory, expansion: ViewExpansion,
                 thresholds: GuideThresholds) -> None:
        self.expansion, self.thresholds = expansion, thresholds
        self.renderer = MemoryRenderer(memory)
        self.aligner = Aligner(self.renderer, expansion.source, thresholds.alignment)
        width = thresholds.ambiguity.coarse
        coarse = CoarseMemory(memory, expansion.source.fx * width / expansion.source.width)
        self.coarse_aligner = Aligner(MemoryRenderer(coarse), expansion.source, replace(
            thresholds.alignment, finest=width, coarsest=width // 2))

    def show_in(self, light: SceneLight) -> None:
        """Draw in this light from now on, small views, too."""
        self.renderer.light = self.coarse_aligner.renderer.light = light

    def look(self, image: CameraImage, pose: CameraPose, expected: CameraPose | None = None
             ) -> Sight:
        """Draw the wide view from a pose and compare the image with its part of it."""
        view = self.renderer.render(pose, self.expansion.target, self.thresholds.shown)
        grey, depth = self.observed(view)
        rows, columns = self.expansion.observed
        part = GuideView(view.image[rows, columns], view.depth[rows, columns],
                         view.stretched[rows, columns])
        return self._compared(image, Drawn(pose, grey, depth), part, lambda: view, expected)

    def glimpse(self, image: CameraImage, pose: CameraPose, expected: CameraPose | None = None,
                searched: bool = False) -> Sight:
        """
        Draw no more than the image is compared with; the wide view when it is asked for.

        Of all that a search looks at but one is shown, and it is compared in small views.
        """
        shown = self.thresholds.shown
        part = self.renderer.render(pose, self.aligner.levels[0], shown)
        show = cache(partial(self.renderer.render, pose, self.expansion.target, shown))
        return self._compared(image, Drawn(pose, grey_of(part.image), part.depth), part, show,
                              expected, searched)

    def _compared(self, image: CameraImage, drawn: Drawn, part: GuideView,
                  show: Callable[[], GuideView], expected: CameraPose | None,
                  searched: bool = False) -> Sight:
        limits, pose = self.thresholds, drawn.pose
        whole, best = agreement(image.photo[0].grey, drawn.grey, drawn.depth > 0,
                                limits.alignment)
        there = expected is not None and (
            np.linalg.norm(pose.position - expected.position) < limits.expected_metres
            and pose.forward @ expected.forward > limits.expected_cosine)
        believed = whole >= limits.least_agreement and (
            not searched or whole >= limits.least_found or best >= limits.least_found_partial)
        believed = believed or bool(there and best >= limits.least_partial)
        return Sight(pose, show, part, drawn, whole, believed,
                     found='searched' if searched else 'tracked')

    def look_in_any_light(self, image: CameraImage, sight: Sight) -> Sight:
        """
        Look where the image agrees in a light that the memory may not know, from about there.

        Believed if what is fine agrees. Another light would drag a pose along.
        """
        limits, photo = self.thresholds, image.photo
        pose = self.aligner.align(photo, sight.pose, 3, near=True, any_light=True)
        found = self.glimpse(image, pose)
        fine = fine_agreement(photo[0].grey, found.drawn.grey, found.drawn.depth > 0,
                              limits.alignment)
        return replace(found, found=sight.found, believed=(
            fine >= limits.least_fine and found.agreement >= limits.least_located))

    def observed(self, view: GuideView) -> tuple[np.ndarray, np.ndarray]:
        """Return grey in [0, 1] and depth of what the camera sees of a view, float32 (h, w)."""
        rows, columns = self.expansion.observed
        finest = self.aligner.levels[0]
        size = (finest.width, finest.height)
        grey = grey_of(view.image[rows, columns])
        depth = view.depth[rows, columns]
        if size != grey.shape[::-1]:
            grey = cv2.resize(grey, size, interpolation=cv2.INTER_AREA)
            depth = cv2.resize(depth, size, interpolation=cv2.INTER_NEAREST)
        return grey, depth

    def covariance(self, sight: Sight, photo: PhotoLevel) -> np.ndarray:
        """Return how exactly an image tells a sight's pose, (6, 6); photo: its finest level."""
        return in_world(with_floor(self._covariance(sight, photo), self.thresholds.covariance),
                        sight.pose)

    def _covariance(self, sight: Sight, photo: PhotoLevel) -> np.ndarray:
        limits, location = self.thresholds, sight.location
        if location is not None and sight.led:
            return located_covariance(location, limits.covariance)
        camera, drawn = self.aligner.levels[0], sight.drawn
        # As it was drawn, but by now in the image's exposure.
        grey = cv2.cvtColor(sight.view.image[self.expansion.observed], cv2.COLOR_RGB2GRAY)
        grey = cv2.resize(grey, drawn.grey.shape[::-1], interpolation=cv2.INTER_AREA) / 255
        shown = GuideLevel(grey, drawn.depth, self.aligner.rays[0])
        return aligned_covariance(photo, shown, camera, limits.alignment.geman_mcclure,
                                  limits.covariance)

    def best_of(self, image: CameraImage, starts: Sequence[CameraPose], found: Found
                ) -> Sight | None:
        """Align with the memory from each start; look from the pose that agrees most."""
        best, most = None, 0.0
        for start in self._most_likely(image, starts):
            pose = self.aligner.align(image.photo, start, rounds=3)
            agrees = self.aligner.agreement(image.photo, pose)
            if agrees > most:
                best, most = pose, agrees
            if most > self.thresholds.sure:
                break
        return (replace(self.glimpse(image, best, searched=True), found=found)
                if best is not None else None)

    def _most_likely(self, image: CameraImage, starts: Sequence[CameraPose]
                     ) -> Iterator[CameraPose]:
        """Yield the first start, then from where all agree most, aligned and seen coarsely."""
        yield from starts[:1]
        coarse, limits = self.coarse_aligner, self.thresholds
        photo, tried = coarse.photo(image.pixels), list[tuple[float, CameraPose]]()
        with on_cores(1):  # To share such small views out takes longer.
            for start in starts:
                pose = coarse.align(photo, start, rounds=1)
                tried.append((coarse.agreement(photo, pose), pose))
        likely, same = list[CameraPose](), limits.ambiguity
        for agrees, pose in sorted(tried, key=lambda one: -one[0]):
            if agrees <= limits.least_likely or len(likely) == limits.likely:
                return
            if not any(is_near(pose, other, same.same_metres, same.same_cosine)
                       for other in likely):
                likely.append(pose)
                with on_cores(1):
                    pose = coarse.align(photo, pose, rounds=1)
                yield pose
