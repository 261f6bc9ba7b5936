"""Where is the camera, and what does the memory show around its image: frame after frame."""
from contextlib import AbstractContextManager
from dataclasses import replace
from functools import partial

from neo_ros.geometry import CameraPose, ViewExpansion
from neo_ros.machine.compiled import ALL_THREADS
from neo_ros.memory.changes import Changes
from neo_ros.memory.colour_kernels import apply_gain
from neo_ros.memory.doubt import Doubt
from neo_ros.memory.landmarks import Location
from neo_ros.memory.learning import Learner
from neo_ros.memory.local_features import Features
from neo_ros.memory.looking import Looker
from neo_ros.memory.panorama import draw_panorama, Panorama
from neo_ros.memory.parallel import parallel_loops
from neo_ros.memory.place_finder import PlaceFinder
from neo_ros.memory.recent_images import RecentImages
from neo_ros.memory.scene_light import SceneLight
from neo_ros.memory.scene_memory import SceneMemory
from neo_ros.memory.sight import CameraImage, Found, Guide, is_near, located, Sight
from neo_ros.memory.thresholds import GuideThresholds
from neo_ros.pictures.exposure import exposure_gain
import numpy as np


class SceneGuide:
    """
    Follows a camera through a known scene.

    Stateful: the last pose is where the search begins. One instance serves one camera.
    """

    def __init__(self, memory: SceneMemory, expansion: ViewExpansion, threads: int = 0,
                 thresholds: GuideThresholds = GuideThresholds()) -> None:
        self.expansion, self.thresholds = expansion, thresholds
        self.learner: Learner | None = None
        self._memory = memory
        self._threads = min(threads or ALL_THREADS, ALL_THREADS)
        self._looker = Looker(memory, expansion, thresholds)
        self.renderer, self.aligner = self._looker.renderer, self._looker.aligner
        self._recent = RecentImages(expansion, thresholds.recent)
        self.light = SceneLight(memory.positions, expansion, thresholds.light)
        self._looker.show_in(self.light)
        self._places = PlaceFinder(self._looker, memory, expansion.source, self._threads,
                                   thresholds)
        self._doubt = Doubt(self._looker, self._places.glances, memory.twins)
        self.reset()

    def loops(self) -> AbstractContextManager[None]:
        """Let this thread alone run parallel loops."""
        return parallel_loops(self._threads)

    @property
    def ambiguous(self) -> bool:
        """Whether the camera of the last image may be at several places that look alike."""
        return self._doubt.is_open

    def reset(self) -> None:
        """Forget the frames so far."""
        self._recent.forget()
        self._doubt.forget()
        self._last: Sight | None = None
        # Where it was believed last, moved on since, and for how many images nothing was.
        self._lost: Sight | None = None
        self._lost_for = 0
        self._seen_ns: int | None = None  # When the last image was taken that was believed.
        self._motion = np.eye(4)
        self._since_search = self.thresholds.search_every
        self._places.watch.forget()
        self._led = 0  # Images in which landmarks are still asked first.

    def guide(self, image: np.ndarray, prior: CameraPose | None = None,
              motion: np.ndarray | None = None, pace: float = 1.0, stamp_ns: int | None = None
              ) -> Guide | None:
        """
        Find the pose of an image, uint8 RGB (h, w, 3), and draw the wide view.

        None if lost, or if several places explain the images equally well: `ambiguous`.

        prior: where somebody says that the camera is, within metres; motion: (4, 4), the camera's
        pose in the axes of the image before, as odometry measures it; pace: without it, how many
        times as long as the time before the last image was the one before this image. They only
        say where to look first: without the image's agreement they are dropped.

        stamp_ns: when the image was taken, to learn from it; None: now.
        """
        with self.loops():
            return self._guide(self._camera_image(image), prior, motion, pace, stamp_ns)

    def _camera_image(self, pixels: np.ndarray) -> CameraImage:
        return CameraImage(pixels, self.aligner.photo(pixels), self._find_features)

    def _find_features(self, pixels: np.ndarray) -> Features:
        assert self._places.locator is not None
        return self._places.locator.features(pixels)

    def _guide(self, image: CameraImage, prior: CameraPose | None, motion: np.ndarray | None,
               pace: float, stamp_ns: int | None) -> Guide | None:
        # Whatever goes wrong with this image, the next one starts anew.
        before, self._last, self._lost = self._last or self._lost_since(stamp_ns), None, None
        last = before.pose if before is not None else None
        if motion is not None:
            self._motion = motion
        elif pace != 1 and before is not None:
            self._motion = CameraPose(np.eye(4)).interpolated(
                CameraPose(self._motion), pace).T_world_cam
        led = self._led > 0
        best = followed = self._follow(image, before) if before is not None else None
        left = None  # The one place that is left of those between which images had not decided.
        told = self._places.look_around(image, prior) if prior is not None else None
        if told is not None and told.believed and not (
                followed is not None and followed.believed
                and is_near(followed.pose, told.pose, self.thresholds.expected_metres,
                            self.thresholds.expected_cosine)):
            best = told
            self._doubt.forget()
            self._places.watch.forget()  # What it waits for is of the pose before.
        elif self._doubt.is_open:
            left = self._doubt.follow(image, motion)
            best = None if left is None else left.sight
        self._since_search += 1
        if self._doubt.is_lost and self._since_search >= self.thresholds.search_every:
            self._doubt.forget()
        if not self._doubt.is_open and self._search_is_due(best):
            self._since_search = 0
            best = self._doubt.settle(image, best, *self._places.search(image))
        if self._doubt.is_open or best is None or not best.believed:
            self._led = 0
            self._lose(before)
            return None
        self._lost_for, self._seen_ns = 0, stamp_ns
        if best.led and not led:
            self._led = self.thresholds.landmarks_every
        if best is not followed:
            self._recent.forget()  # The poses before may have been wrong.
        if last is not None and best is followed:
            self._motion = last.inverse() @ best.pose.T_world_cam
        elif left is not None and best is left.sight:
            self._motion = left.motion
        else:  # What was searched for has not moved there: it was taken there.
            self._motion = np.eye(4)
        self._last = best
        self._decode_ahead(best.pose)
        view, known = best.view, best.view.depth > 0
        gain = self._expose(view.image, known, image.pixels)
        solid = np.where(view.stretched, 0, view.depth)
        light_before = self.light.shown
        self.light.see(image.pixels, view.image, solid, best.pose)
        same_light = self.light.shown is light_before
        if not same_light:
            self._recent.forget()  # They differ from what is drawn no more.
        seen_before = self._recent.bring(solid, best.pose, gain)
        if same_light:  # Else the view was drawn in the light before.
            self._recent.keep(image.pixels, view.image, solid, best.pose, gain)
        light = None if view.light is None else view.light[self.expansion.observed]
        changes = self._memory.changes
        # Another light would be learnt as a change.
        if self.learner is not None and same_light and self.light.as_in_photos:
            self.learner.see(image.pixels, view.image, solid, best.pose, gain, best.agreement,
                             stamp_ns)
            if self._memory.changes is not None and self._memory.changes is not changes:
                self._recent.distrust(self._memory.changes)
        return Guide(view.image, known, view.stretched, best.pose, best.agreement, seen_before,
                     best.found, len(best.location.points) if best.location else 0, view.depth,
                     partial(self._looker.covariance, best, image.photo[0]),
                     self.expansion.observed, partial(self._panorama, best.pose, gain), light,
                     None if changes is None else changes.shown_at(
                         view.depth, self.expansion.target, best.pose))

    def _decode_ahead(self, pose: CameraPose) -> None:
        """Have decoded what will be drawn if the camera moves on as it does."""
        step = (pose.T_world_cam @ self._motion)[:3, 3] - pose.position
        soon = pose.position + self.thresholds.decoded_ahead * step
        nearest = [int(index) for index in self.renderer.nearest(soon, self.thresholds.shown)]
        # In the order in which an image needs them: it is aligned before the wide view is drawn.
        for camera in (self.aligner.levels[0], self.expansion.target):
            self._memory.decode_ahead(nearest, camera.fx)

    def _lose(self, before: Sight | None) -> None:
        """Keep where it was for the next images: one that shows nothing is soon over."""
        self._lost_for += 1
        if before is not None and not self._doubt.is_open:
            moved = CameraPose.nearest(before.pose.T_world_cam @ self._motion)
            self._lost = replace(before, pose=moved, agreement=0.0)  # It was drawn elsewhere.

    def _lost_since(self, stamp_ns: int | None) -> Sight | None:
        """Return where it would be, if it was lost but now; else it may have been carried off."""
        long_ago = (stamp_ns is not None and self._seen_ns is not None
                    and not 0 <= stamp_ns - self._seen_ns <= self.thresholds.lost_ns)
        return None if long_ago or self._lost_for > self.thresholds.search_every else self._lost

    def _search_is_due(self, best: Sight | None) -> bool:
        if best is None or (not best.believed and self._lost_for):
            return self._since_search >= self.thresholds.search_every
        if not best.believed:
            return True  # Just lost.
        return (best.agreement < self.thresholds.sure
                and self._since_search >= self.thresholds.doubt_every)

    def warm_up(self) -> Guide:
        """
        Search once: compiles what is compiled at first use, which takes seconds on a new machine.

        A camera's first image must not take longer than those after it. Returns what was shown.
        """
        pose = CameraPose(self._places.glances.poses[0])
        with self.loops():
            view = self.renderer.render(pose, self.expansion.source, self.thresholds.shown)
            image = self._camera_image(view.image.astype(np.uint8))
            self._doubt.settle(image, None, *self._places.search(image))
            sight = self._looker.look(image, pose)
            self._looker.look_in_any_light(image, sight)
            wide, known = sight.view, sight.view.depth > 0
            known[0, 0] = False  # So that what fills gaps is compiled, too.
            gain = self._expose(wide.image, known, image.pixels)
            self._recent.keep(image.pixels, wide.image, wide.depth, pose, gain)
            seen_before = self._recent.bring(wide.depth, pose, gain)
            (self._memory.changes or Changes(())).shown_at(
                wide.depth, self.expansion.target, pose)
            lit = SceneLight(self._memory.positions, self.expansion, self.thresholds.light)
            lit.other = True
            lit.see(image.pixels, wide.image, wide.depth, pose)
            lit.relight(wide.image, wide.depth, pose, self.expansion.target)
        self.reset()
        return Guide(wide.image, known, wide.stretched, pose, sight.agreement, seen_before)

    def _follow(self, image: CameraImage, before: Sight) -> Sight:
        """Track a camera; where landmarks contradict what is found so, they lead for a while."""
        last = before.pose
        expected = CameraPose(last.T_world_cam @ self._motion)
        if self._led > 0:
            self._led -= 1
            location = self._places.locate(image, expected)
            if location is not None:
                return self._places.look_from(location, image)
        # A camera in steady motion would be there now.
        tracked = self._tracked_as_drawn(image, before, expected) or self._looker.look(
            image, self.aligner.align(image.photo, expected, 1, near=True), expected)
        tracked = self._checked(image, tracked)
        if tracked.believed:
            return tracked
        # It may have stopped while somebody stands in the image.
        again = self._looker.look(image, self.aligner.align(image.photo, last, 3, near=True), last)
        return max(tracked, again, key=Sight.rank)

    def _checked(self, image: CameraImage, tracked: Sight) -> Sight:
        """Ask landmarks about a pose: now if image and memory disagree, else beside the images."""
        if tracked.agreement >= self.thresholds.sure:
            told = self._places.watch.follow(image, tracked.pose)
            if told is None:
                return tracked
            location, there = told
            if location.allows(there):
                return self._located(tracked, location, 'tracked')
        self._places.watch.forget()
        now = self._places.locate(image, tracked.pose)
        if now is None:
            return tracked
        return (self._located(tracked, now, 'tracked') if now.allows(tracked.pose)
                else self._places.look_from(now, image))

    def _tracked_as_drawn(self, image: CameraImage, before: Sight, expected: CameraPose
                          ) -> Sight | None:
        """
        Track a camera with what was drawn for the image before.

        None where it moves too fast for that, or something stands before it, which would drag the
        pose along.
        """
        limits = self.thresholds
        if before.agreement < limits.sure or not is_near(
                expected, before.pose, limits.redrawn_metres, limits.redrawn_cosine):
            return None
        sight = self._looker.look(image, self.aligner.align(
            image.photo, expected, 1, near=True, drawn=before.drawn), expected)
        return sight if sight.agreement >= limits.sure else None

    def _located(self, sight: Sight, location: Location, found: Found) -> Sight:
        return located(sight, self.thresholds.least_located, location, found)

    def _panorama(self, pose: CameraPose, gain: np.ndarray, wide_image: np.ndarray, width: int
                  ) -> Panorama:
        with self.loops():
            return draw_panorama(self.renderer, pose, gain, wide_image, self.expansion, width)

    def _expose(self, guide: np.ndarray, known: np.ndarray, image: np.ndarray) -> np.ndarray:
        """Give the guide, float32 RGB (H, W, 3), the image's exposure; return the gain (3,)."""
        rows, columns = self.expansion.observed
        every = max(image.shape[1] // self.thresholds.samples, 1)
        some = (slice(None, None, every), slice(None, None, every))
        seen = known[rows, columns][some]
        gain = exposure_gain(guide[rows, columns][some][seen], image[some][seen],
                             self.thresholds.alignment.exposure)
        apply_gain(guide, gain)
        return gain
