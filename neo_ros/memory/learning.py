"""Learn while driving what has changed: images that contradict the memory become patches."""
from collections.abc import Callable, Sequence
from concurrent.futures import Future
from dataclasses import dataclass
import logging
import os
import threading
import time
from typing import Literal, NamedTuple, TYPE_CHECKING

import cv2
from neo_ros.geometry import CameraPose, ViewExpansion
from neo_ros.memory.changes import Changes
from neo_ros.memory.contradiction import contradicted, contradiction
from neo_ros.memory.decoded import Key
from neo_ros.memory.journal import JournalWriter
from neo_ros.memory.keyframe import Keyframe
from neo_ros.memory.patch import Patch
from neo_ros.memory.patch_finding import find_patches, PatchThresholds
from neo_ros.memory.states import find_turn
from neo_ros.memory.stereo import Shot
from neo_ros.memory.turn import PAUSE_NS, Record, Turn
import numpy as np

if TYPE_CHECKING:
    from neo_ros.memory.scene_memory import SceneMemory

logger = logging.getLogger(__name__)
# Said of images when they were looked at, and what they showed is on the disk.
LOOKED = 'learning: %d records of images up to the stamp %d'
# Beside the images, which does not hold them up, or at once, which gives the same every time.
Learn = Literal['never', 'beside', 'at once']


@dataclass(frozen=True)
class LearningThresholds:
    """Which images are learnt from, and when."""

    # They are at most so wide, pixels: as textures of a keyframe, hardly finer.
    widest: int = 256
    # One is kept if the camera has moved so far since the one before, metres or radians.
    metres: float = 0.04
    radians: float = 0.05
    # Each time that there are so many new ones they are looked at, together with those before.
    batch: int = 36
    window: int = 108
    # Images of which more than this share contradicts are of a pose that is wrong.
    most_contradicted: float = 0.5
    least_agreement: float = 0.7
    patches: PatchThresholds = PatchThresholds()


class Learnt(NamedTuple):
    """
    The changes of the memory with what was found, and keyframes that show these.

    others: somebody else wrote the journal meanwhile; turned: something is shown as before.
    """

    changes: Changes
    drawn: dict[Key, Keyframe]
    others: bool
    turned: bool


class Learner:
    """
    Follows the images of one camera, and changes the memory that they contradict.

    Beside the images: on a thread of low priority, and what comes while it works waits; else at
    once, which holds the images up, and gives the same result for the same images.
    """

    def __init__(self, memory: 'SceneMemory', expansion: ViewExpansion,
                 open_journal: Callable[[], JournalWriter], beside: bool,
                 thresholds: LearningThresholds = LearningThresholds()) -> None:
        self.thresholds = thresholds
        self._memory, self._open_journal, self._beside = memory, open_journal, beside
        # Opened when there is something to write: who had it before may still hold it.
        self._journal: JournalWriter | None = None
        self._holding = threading.Lock()
        self._closed = threading.Event()
        self._observed = expansion.observed
        source = expansion.source
        # A patch of a tall image has to fit, too.
        self._camera = source.scaled(min(1.0, thresholds.widest / source.width,
                                         2 * thresholds.widest / source.height))
        self._rays = self._camera.pixel_rays()
        self._shots: list[Shot] = []
        self._depths: dict[Shot, np.ndarray] = {}
        self._new = 0
        self._ahead: int | None = None  # Nanoseconds that the clock here is ahead of the images'.
        self._begin_visit(memory.changes or Changes(()))
        self._pending: Future[Learnt] | None = None

    def _begin_visit(self, changes: Changes) -> None:
        self._changes = changes
        self._batch = 1 + max((record.batch for record in changes.records), default=-1)
        self._begun = self._batch  # The first one of this visit.

    def see(self, image: np.ndarray, shown: np.ndarray, depth: np.ndarray, pose: CameraPose,
            gain: np.ndarray, agreement: float, stamp_ns: int | None = None) -> None:
        """
        Take in an image uint8 RGB (h, w, 3) and its wide view of the memory.

        shown float32 RGB (H, W, 3), in the image's exposure, which is the memory's times gain
        (3,); depth float32 (H, W) metres, 0 = unknown. Nothing of it is kept. stamp_ns: when it
        was taken, which counts where images are learnt from at once; None: now.
        """
        version = self._memory.version
        self._take_up()
        if self._memory.version != version:
            return  # It was drawn before that.
        limits = self.thresholds
        now = self._time_of(stamp_ns)
        if agreement < limits.least_agreement or (
                self._shots and not pose.is_apart(
                    self._shots[-1].pose, limits.metres, limits.radians)):
            return
        shot = self._shot(image, shown[self._observed], depth[self._observed], pose, gain, now)
        if shot.contradicted.mean() > limits.most_contradicted:
            return
        if self._shots and now - self._shots[-1].stamp_ns > PAUSE_NS:
            self._shots, self._new = [], 0
        self._shots = [*self._shots, shot][-limits.window:]
        self._new += 1
        if self._new >= limits.batch:
            self._begin()

    def _time_of(self, stamp_ns: int | None) -> int:
        """
        Return when an image was taken, by this machine's clock.

        Cameras have clocks of their own. A replay, which may be fast or slow, counts from its
        first image on as the camera did.
        """
        if self._beside or stamp_ns is None:
            return time.time_ns()
        if self._ahead is None:
            self._ahead = time.time_ns() - stamp_ns
        return stamp_ns + self._ahead

    def finish(self) -> None:
        """Look at what is left, wait for it, and let others write the journal."""
        self._take_up(wait=True)
        if self._new:
            self._begin()
            self._take_up(wait=True)
        self.close()

    def close(self) -> None:
        """Let others write the journal; what was not looked at yet is forgotten."""
        self._closed.set()
        if self._pending is None or self._pending.done():
            self._release()  # Else who works on it does that.

    def _release(self) -> None:
        with self._holding:
            journal, self._journal = self._journal, None
        if journal is not None:
            journal.close()

    def _shot(self, image: np.ndarray, shown: np.ndarray, depth: np.ndarray, pose: CameraPose,
              gain: np.ndarray, stamp_ns: int) -> Shot:
        size = (self._camera.width, self._camera.height)
        if size != image.shape[1::-1]:
            image, shown = (cv2.resize(one, size, interpolation=cv2.INTER_AREA)
                            for one in (image, shown))
            depth = cv2.resize(depth, size, interpolation=cv2.INTER_NEAREST_EXACT)
        now, before = image.astype(np.float32) / gain, shown / gain
        limits = self.thresholds.patches.contradiction
        score = contradiction(now, before, depth > 0, limits)
        return Shot(pose, now, before, np.array(depth), contradicted(score, limits), score,
                    stamp_ns)

    def _begin(self) -> None:
        """Have the new images looked at; while the last ones are looked at, they wait."""
        if self._pending is not None:
            return
        shots, new, self._new = self._shots, min(self._new, len(self._shots)), 0
        if not any(shot.contradicted.any() for shot in shots[-new:]):
            logger.debug(LOOKED, 0, shots[-1].stamp_ns)
            return
        self._pending = Future()
        work = (self._pending, shots, new, self._changes, self._batch)
        self._batch += 1
        if self._beside:
            # A daemon: what it has not written yet is lost with the process, and no more.
            threading.Thread(target=self._work, args=work, name='learn', daemon=True).start()
        else:
            self._work(*work)

    def _work(self, pending: 'Future[Learnt]', shots: Sequence[Shot], new: int,
              changes: Changes, batch: int) -> None:
        if self._beside and hasattr(os, 'setpriority'):
            # On Linux a thread has a priority of its own.
            os.setpriority(os.PRIO_PROCESS, threading.get_native_id(), 19)
        try:
            pending.set_result(self._learn(shots, new, changes, batch))
        except Exception as error:
            self._release()  # It may hold what is not among the changes: it is read again.
            pending.set_exception(error)
        if self._closed.is_set():
            self._release()

    def _learn(self, shots: Sequence[Shot], new: int, before: Changes, batch: int) -> Learnt:
        journal, others, records = self._journal, False, list[Record]()
        if journal is None:
            journal = self._journal = self._open_journal()
            others = not _are_same(journal.records, before.records)
            # Decoded they are ten times as large, and hold what the changes hold.
            written, journal.records = journal.records, []
        if others:  # The images were compared with what is shown no more.
            changes = Changes(written)
        else:
            turn = find_turn(shots[-new:], before, self._camera, batch, self._begun,
                             self.thresholds.patches.states)
            patches = [] if journal.full else find_patches(
                shots, new, self._camera, self._rays, batch, self._depths,
                self.thresholds.patches)
            changes, records = _write(journal, before, [*([] if turn is None else [turn]),
                                                        *patches])
        logger.debug(LOOKED, len(records), shots[-1].stamp_ns)
        changes.cells  # Found here: who draws does not wait for it, nor for keyframes.
        drawn = self._memory.drawn_with(changes) if self._beside and changes is not before else {}
        return Learnt(changes, drawn, others, any(isinstance(one, Turn) for one in records))

    def _take_up(self, wait: bool = False) -> None:
        """Let the memory show what was found meanwhile."""
        if self._pending is None or not (wait or self._pending.done()):
            return
        pending, self._pending = self._pending, None
        try:
            learnt = pending.result()
        except Exception as error:  # A full disk must not end the camera.
            logger.warning('learning: %s: %s', type(error).__name__, error)
            return
        if learnt.changes is not self._changes:
            self._changes = learnt.changes
            self._memory.change(learnt.changes, learnt.drawn)
        if learnt.others:
            self._begin_visit(learnt.changes)
            self._shots, self._new = [], 0
        elif learnt.turned:
            # What waits was compared with what is shown no more.
            self._shots, self._new = self._shots[:max(len(self._shots) - self._new, 0)], 0


def _write(journal: JournalWriter, before: Changes, found: Sequence[Record]
           ) -> tuple[Changes, list[Record]]:
    """Append what was found; where it does not fit, what was replaced makes room for it."""
    records = journal.append(found)
    changes = before.with_more(records) if records else before
    if len(records) == len(found) or journal.full:
        return changes, records
    kept = journal.make_room(changes.records)
    if kept is not changes.records:
        changes = Changes(kept)
    # A turn that did not fit goes by numbers of before: it is found again.
    more = journal.append([one for one in found[len(records):] if isinstance(one, Patch)])
    return changes.with_more(more) if more else changes, [*records, *more]


def _are_same(some: Sequence[Record], others: Sequence[Record]) -> bool:
    return len(some) == len(others) and all(
        one.to_bytes() == other.to_bytes() for one, other in zip(some, others))
