"""Where is the camera, and what does the memory show around its image: frame after frame."""
from collections.abc import Iterator
from contextlib import contextmanager
from dataclasses import dataclass, replace
import threading

import cv2
from neo_ros.geometry import CameraPose, ViewExpansion
from neo_ros.machine.compiled import ALL_THREADS
from neo_ros.memory.alignment import agreement, Aligner, PhotoLevel
from neo_ros.memory.landmarks import Location, Locator
from neo_ros.memory.local_features import Features
from neo_ros.memory.recent_images import RecentImages, SeenBefore
from neo_ros.memory.rendering import GuideView, MemoryRenderer
from neo_ros.memory.scene_memory import SceneMemory
from neo_ros.pictures.exposure import exposure_gain
from numba import get_num_threads, set_num_threads
import numpy as np

# Correlation of image and memory. Where the pose is right it is 0.956 and more on held-out photos
# of the demo flat and of a real kitchen; where it is wrong, hardly ever more than 0.85. In parts
# that the photos hardly show, it is low even where the pose is right.
SURE = 0.94
LEAST_AGREEMENT = 0.85
# Of a pose that was searched for all over the scene nothing else speaks: it has to agree by more,
# as a whole or in its best part. In a hand-held capture two poses that were found were 15 degrees
# off, with 0.85 and 0.87, 0.99 in the best part; where chairs were moved right ones have 0.86 and
# 0.999.
LEAST_FOUND, LEAST_FOUND_PARTIAL = 0.9, 0.995
# Of the pixels that fit best, for a pose that is where a moving camera was expected to be. With
# 40 % of the held-out photos hidden it is 0.98 and more.
LEAST_PARTIAL = 0.97
EXPECTED_METRES, EXPECTED_COSINE = 0.15, 0.99
# A search takes as long as several frames: a lost camera is searched for every so many frames, one
# whose pose is believed, but not sure, now and then.
SEARCH_EVERY, DOUBT_EVERY = 5, 30
# Looking for landmarks takes as long as a frame: now and then, while image and memory agree. Where
# they contradict, they lead for as many images.
LANDMARKS_EVERY = 10
# A pose that landmarks give is right, even where the memory shows other colours or another depth.
LEAST_LOCATED = 0.5
# Keyframes that are drawn.
SHOWN = 3
# Places that a lost camera is compared with closely, and how far apart they are at least.
CANDIDATES = 8
APART_METRES, APART_COSINE = 0.25, 0.97
# At most some 64 by 64 pixels of an image tell its exposure.
SAMPLES = 64
# Numba may not run parallel loops of two threads at once: one of its backends ends the process.
_PARALLEL_LOOPS = threading.Lock()


@dataclass(frozen=True, eq=False)
class Guide:
    """
    What the memory shows in the wide view of an image.

    image float32 RGB (H, W, 3) in 0 ... 255, in the exposure of the image; known, stretched bool
    (H, W), see GuideView; pose of the camera; agreement of memory and image in [-1, 1];
    seen_before: by how much the last images differ from it, None if none shows any of it.
    """

    image: np.ndarray
    known: np.ndarray
    stretched: np.ndarray
    pose: CameraPose
    agreement: float
    seen_before: SeenBefore | None = None


@dataclass(frozen=True, eq=False)
class Sight:
    """
    A pose, what the memory shows from it, and how well that agrees with the image.

    believed: good enough to be shown; located: landmarks speak for the pose.
    """

    pose: CameraPose
    view: GuideView
    agreement: float
    believed: bool
    located: bool = False

    def rank(self) -> tuple[bool, bool, float]:
        """Return what tells the better of two sights."""
        return self.believed, self.located, self.agreement


class SceneGuide:
    """
    Follows a camera through a known scene.

    Stateful: the last pose is where the search begins. One instance serves one camera.
    """

    def __init__(self, memory: SceneMemory, expansion: ViewExpansion, threads: int = 0) -> None:
        self.expansion = expansion
        self._threads = min(threads or ALL_THREADS, ALL_THREADS)
        self.renderer = MemoryRenderer(memory)
        self.aligner = Aligner(self.renderer, expansion.source)
        self._recent = RecentImages(expansion)
        self._locator = (None if memory.landmarks is None
                         else Locator(memory.landmarks, expansion.source))
        pictures = memory.glances.pictures
        self._glances = normalized(pictures.reshape(len(pictures), -1))
        self._glance_size = (pictures.shape[2], pictures.shape[1])
        self._poses = memory.glances.T_world_cam
        self.reset()

    def reset(self) -> None:
        """Forget the frames so far."""
        self._recent.forget()
        self._last: CameraPose | None = None
        self._motion = np.eye(4)
        self._since_search, self._since_landmarks = SEARCH_EVERY, LANDMARKS_EVERY
        self._features: Features | None = None  # Of the present image.
        self._led = 0  # Images for which landmarks alone still say where the camera is.

    def guide(self, image: np.ndarray) -> Guide | None:
        """Find the pose of an image, uint8 RGB (h, w, 3), and draw the wide view; None if lost."""
        with _parallel_loops(self._threads):
            return self._guide(image)

    def _guide(self, image: np.ndarray) -> Guide | None:
        photo, self._features = self.aligner.photo(image), None
        # Whatever goes wrong with this image, the next one starts anew.
        last, self._last = self._last, None
        best = followed = self._follow(image, photo, last) if last is not None else None
        self._since_search += 1
        if self._search_is_due(best):
            self._since_search = 0
            best = better(best, self._search(image, photo))
        if best is None or not best.believed:
            self._led = 0
            return None
        if best is not followed:
            self._recent.forget()  # The poses before may have been wrong.
        # What was searched for has not moved there: it was taken there.
        self._motion = (last.inverse() @ best.pose.T_world_cam
                        if last is not None and best is followed else np.eye(4))
        self._last = best.pose
        view, known = best.view, best.view.depth > 0
        gain = self._expose(view.image, known, image)
        solid = np.where(view.stretched, 0, view.depth)
        seen_before = self._recent.bring(solid, best.pose, gain)
        self._recent.keep(image, view.image, solid, best.pose, gain)
        return Guide(view.image, known, view.stretched, best.pose, best.agreement, seen_before)

    def _search_is_due(self, best: Sight | None) -> bool:
        if best is None:
            return self._since_search >= SEARCH_EVERY
        if not best.believed:
            return True  # Just lost.
        return best.agreement < SURE and self._since_search >= DOUBT_EVERY

    def warm_up(self) -> None:
        """Compile what is compiled at first use, which takes seconds on a new machine."""
        pose = CameraPose(self._poses[0])
        with _parallel_loops(self._threads):
            view = self.renderer.render(pose, self.expansion.source, SHOWN)
            photo = self.aligner.photo(view.image)
            self.aligner.align(photo, pose, rounds=1)
            wide = self._look(photo, pose).view
            shown = (wide.depth, pose, np.ones(3, np.float32))
            self._recent.keep(self.expansion.crop(wide.image).astype(np.uint8), wide.image, *shown)
            self._recent.bring(*shown)
        self.reset()

    def _follow(self, image: np.ndarray, photo: list[PhotoLevel], last: CameraPose) -> Sight:
        """Track a camera; where landmarks contradict what is found so, they lead for a while."""
        expected = CameraPose(last.T_world_cam @ self._motion)
        if self._led > 0:
            self._led -= 1
            location = self._locate(image, expected)
            if location is not None:
                return located(self._look(photo, location.pose, location.pose))
        # A camera in steady motion would be there now.
        tracked = self._look(photo, self.aligner.align(photo, expected, 1, near=True), expected)
        self._since_landmarks += 1
        if self._since_landmarks >= LANDMARKS_EVERY or tracked.agreement < SURE:
            self._since_landmarks = 0
            location = self._locate(image, tracked.pose)
            if location is not None:
                tracked = (located(tracked) if location.allows(tracked.pose)
                           else self._look_from(location, photo))
        if tracked.believed:
            return tracked
        # It may have stopped while somebody stands in the image.
        again = self._look(photo, self.aligner.align(photo, last, 3, near=True), last)
        return max(tracked, again, key=Sight.rank)

    def _locate(self, image: np.ndarray, around: CameraPose | None) -> Location | None:
        if self._locator is None:
            return None
        if self._features is None:  # As slow as a frame: found once, and only when asked for.
            self._features = self._locator.features(image)
        return self._locator.locate(self._features, around)

    def _look_from(self, location: Location, photo: list[PhotoLevel]) -> Sight:
        """Look from where landmarks say, aligned with the image if they allow that."""
        pose = self.aligner.align(photo, location.pose, 1, near=True)
        if not location.allows(pose):
            pose, self._led = location.pose, LANDMARKS_EVERY
        self._since_landmarks = LANDMARKS_EVERY  # What is tracked next may be off, too.
        return located(self._look(photo, pose, pose))

    def _look(self, photo: list[PhotoLevel], pose: CameraPose,
              expected: CameraPose | None = None, searched: bool = False) -> Sight:
        """Draw the wide view from a pose and compare the image with its part of it."""
        view = self.renderer.render(pose, self.expansion.target, SHOWN)
        rows, columns = self.expansion.observed
        size = photo[0].grey.shape[::-1]
        grey = cv2.cvtColor(view.image[rows, columns] / 255, cv2.COLOR_RGB2GRAY)
        known = view.depth[rows, columns]
        if size != grey.shape[::-1]:
            grey = cv2.resize(grey, size, interpolation=cv2.INTER_AREA)
            known = cv2.resize(known, size, interpolation=cv2.INTER_NEAREST)
        whole, partial = agreement(photo[0].grey, grey, known > 0)
        there = expected is not None and (
            np.linalg.norm(pose.position - expected.position) < EXPECTED_METRES
            and pose.forward @ expected.forward > EXPECTED_COSINE)
        believed = whole >= LEAST_AGREEMENT and (
            not searched or whole >= LEAST_FOUND or partial >= LEAST_FOUND_PARTIAL)
        return Sight(pose, view, whole, believed or bool(there and partial >= LEAST_PARTIAL))

    def _search(self, image: np.ndarray, photo: list[PhotoLevel]) -> Sight | None:
        """
        Find a camera that may be anywhere: by its landmarks, or else by its looks.

        Compares with all glances, aligns with the best ones, takes the pose that agrees most.
        """
        location = self._locate(image, None)
        if location is not None:
            found = self._look_from(location, photo)
            if found.believed:
                return found
        grey = cv2.cvtColor(image, cv2.COLOR_RGB2GRAY)
        small = cv2.resize(grey, self._glance_size, interpolation=cv2.INTER_AREA)
        alike = self._glances @ normalized(small.reshape(1, -1))[0]
        best, most = None, 0.0
        for index in self._candidates(alike):
            pose = self.aligner.align(photo, CameraPose(self._poses[index]), rounds=3)
            agrees = self.aligner.agreement(photo, pose)
            if agrees > most:
                best, most = pose, agrees
            if most > SURE:
                break
        return self._look(photo, best, searched=True) if best is not None else None

    def _candidates(self, alike: np.ndarray) -> list[int]:
        """Return the glances most alike that differ in place or direction."""
        chosen: list[int] = []
        for index in np.argsort(-alike, kind='stable')[:40 * CANDIDATES]:
            pose = self._poses[index]
            near = [other for other in chosen
                    if np.linalg.norm(self._poses[other][:3, 3] - pose[:3, 3]) < APART_METRES
                    and self._poses[other][:3, 2] @ pose[:3, 2] > APART_COSINE]
            if not near:
                chosen.append(int(index))
                if len(chosen) == CANDIDATES:
                    break
        return chosen

    def _expose(self, guide: np.ndarray, known: np.ndarray, image: np.ndarray) -> np.ndarray:
        """Give the guide, float32 RGB (H, W, 3), the image's exposure; return the gain (3,)."""
        rows, columns = self.expansion.observed
        every = max(image.shape[1] // SAMPLES, 1)
        some = (slice(None, None, every), slice(None, None, every))
        seen = known[rows, columns][some]
        gain = exposure_gain(guide[rows, columns][some][seen], image[some][seen])
        # In place, and a row at a time: three colours alone are too few for a quick loop.
        line = guide.reshape(len(guide), -1)
        line *= np.tile(gain, guide.shape[1])
        np.minimum(line, 255, out=line)
        return gain


@contextmanager
def _parallel_loops(threads: int) -> Iterator[None]:
    """Let this thread alone run parallel loops, on so many cores."""
    with _PARALLEL_LOOPS:
        before = get_num_threads()
        set_num_threads(threads)
        try:
            yield
        finally:
            set_num_threads(before)


def located(sight: Sight) -> Sight:
    """Return what is seen from a pose that landmarks speak for: believed, unless all differs."""
    return replace(sight, believed=sight.believed or sight.agreement >= LEAST_LOCATED,
                   located=True)


def better(one: Sight | None, other: Sight | None) -> Sight | None:
    """Return the one that is believed; of such, that landmarks speak for; then, agrees more."""
    if one is None or other is None:
        return one or other
    return max(one, other, key=Sight.rank)


def normalized(pictures: np.ndarray) -> np.ndarray:
    """Return rows of mean 0 and norm 1, float32; rows of one colour become 0."""
    rows = pictures.astype(np.float32)
    rows -= rows.mean(1, keepdims=True)
    norm = np.linalg.norm(rows, axis=1, keepdims=True)
    return rows / np.maximum(norm, 1)
