"""What a replay writes beside the wide images: what the memory knows, and a diagnosis."""
from collections import Counter, deque
from collections.abc import Callable, Collection
from dataclasses import replace
from typing import Any

from neo_ros.errors import BagError
from neo_ros.messages import SceneWatch, WideFrame
from neo_ros.messages.camera_fit import assumed_camera
from neo_ros.messages.memory_messages import (
    MEMORY_OUTPUTS, MemoryMessages, MemorySettings)
from neo_ros.messages.scene_outputs import diagnostics_message, Make, OK, WARN, WIDENING
from neo_ros.messages.stamps import NS_PER_S
import numpy as np

DIAGNOSTICS = '/diagnostics'
DEFAULT_OUTPUTS = ('pose', 'status')
# As the node's: once a second, over the last five.
PERIOD_NS, WINDOW_NS = NS_PER_S, 5 * NS_PER_S
Write = Callable[[str, int, Any], None]


def check_outputs(names: Collection[str]) -> None:
    """Raise BagError for a name that is not one of MEMORY_OUTPUTS."""
    for name in names:
        if name not in MEMORY_OUTPUTS:
            raise BagError(f'output: expected some of {", ".join(MEMORY_OUTPUTS)}, got {name!r}')


def bag_maker(types: Any) -> Make:
    """Return what makes messages of a rosbags type store's `types`."""
    def make(msgtype: str, **fields: Any) -> Any:
        return types[msgtype](**fields)
    return make


def node_name(wide: str) -> str:
    """Return the full name of the node that would publish '/camera/wide/*'."""
    return f'{wide.rpartition("/")[0]}/fov_extrapolator'


class ReplayOutputs:
    """Writes the `names` of MEMORY_OUTPUTS for every frame, and /diagnostics as the node would."""

    def __init__(self, make: Make, names: Collection[str], settings: MemorySettings,
                 write: Write, memory: bool) -> None:
        """`memory`: whether the model has one; without, nothing is said of its guidance."""
        self._make, self._names, self._write = make, frozenset(names), write
        self._messages = MemoryMessages(make, settings)
        self._name, self._memory = f'{settings.name}: {WIDENING}', memory
        self._watch = SceneWatch()
        self._frames: deque[tuple[int, WideFrame]] = deque()
        self._published = 0
        self._diagnosed_ns: int | None = None

    def add(self, stamp_ns: int, header: Any, frame: WideFrame, rejected: Counter[str]) -> None:
        """Write what is known of a frame at its log time."""
        for name, message in self._messages.of(header, frame, self._names):
            self._write(name, stamp_ns, message)
        self._published += 1
        # Bags with a clock that was set back begin anew: nothing before would ever grow old.
        if self._frames and stamp_ns < self._frames[-1][0]:
            self._frames.clear()
        # What the memory keeps for a frame is large: only its verdicts are held on to.
        self._frames.append((stamp_ns, replace(frame, image=None, confidence=None, guide=None)))
        while self._frames and stamp_ns - self._frames[0][0] > WINDOW_NS:
            self._frames.popleft()
        if self._diagnosed_ns is None or not (
                0 <= stamp_ns - self._diagnosed_ns < PERIOD_NS):
            self._diagnosed_ns = stamp_ns
            self._write(DIAGNOSTICS, stamp_ns, self._diagnosis(header, rejected))

    def _diagnosis(self, header: Any, rejected: Counter[str]) -> Any:
        frames = [frame for _, frame in self._frames]
        scores = [frame.out_of_scene for frame in frames if frame.out_of_scene is not None]
        score = float(np.mean(scores)) if scores else None
        unlike = self._watch.update(score)
        level, words = OK, f'replayed: {self._published} images widened'
        if unlike:
            level, words = WARN, (
                'the images are unlike the trained scene: another place, or a camera that is '
                'covered, in the dark or out of focus')
        elif rejected:
            level, words = WARN, 'some images are rejected: ' + ', '.join(sorted(rejected))
        if assumed := assumed_camera(frames[-1].camera_note):
            level, words = WARN, f'{words}; {assumed}'
        return diagnostics_message(self._make, header, self._name, level, words, {
            'published': str(self._published),
            'rejected': str(rejected.total()),
            'camera': frames[-1].camera_note,
            'guided by the scene memory': (
                f'{np.mean([frame.guided for frame in frames]):.0%}' if self._memory
                else 'unknown'),
            'out of the scene': 'unknown' if score is None else f'{score:.2f}',
            'in the trained scene': 'unknown' if score is None else str(not unlike).lower()})
