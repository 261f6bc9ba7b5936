"""How a bag is played: where, how fast, and whether at all; viewers command, the source obeys."""
from collections.abc import Collection
import threading
from typing import Any, NamedTuple

from neo_ros.messages.stamps import NS_PER_S
from neo_ros.viewer.hearing import finite
from neo_ros.viewer.timeline import Timeline

SLOWEST, FASTEST = 0.001, 100.0


class Jump(NamedTuple):
    """Where to go on: at a log time, None = what is shown now; `back`: the picture before."""

    to_ns: int | None
    back: bool = False


class Playback:
    """
    What the viewers want of a bag; all of them see the same moment.

    span_ns: first and last log time. rate: times as fast as it was recorded. camera: the wide
    topic that is shown, one of `cameras`.
    """

    def __init__(self, span_ns: tuple[int, int], rate: float = 1.0, camera: str = '',
                 cameras: Collection[str] = ('',), beside: Collection[str] = ()) -> None:
        self.span_ns, self.rate, self.camera = span_ns, rate, camera
        self.timelines = {name: Timeline(span_ns) for name in cameras}
        self.playing, self.ended = True, False
        self._cameras, self._beside = tuple(cameras), tuple(beside)
        self._jump: Jump | None = None
        self._steps = 0
        self._busy = threading.Lock()

    @property
    def timeline(self) -> Timeline:
        """Of the camera that is shown."""
        return self.timelines[self.camera]

    def describe(self) -> dict[str, Any]:
        """Return what the page shows."""
        with self._busy:
            return {'playing': self.playing, 'ended': self.ended, 'rate': self.rate,
                    'camera': self.camera, 'cameras': self._cameras, 'beside': self._beside}

    def command(self, asked: dict[str, Any]) -> None:
        """
        Obey a viewer.

        asked: some of `play` (bool), `seek` (seconds from the start), `step` (1 or -1), `rate`,
        `camera` (a topic). Raises ValueError, TypeError or OverflowError for anything else.
        """
        with self._busy:
            if 'rate' in asked:
                self.rate = min(max(finite(asked['rate']), SLOWEST), FASTEST)
            if 'camera' in asked and asked['camera'] in self._cameras:
                self.camera = asked['camera']
                self._jump = self._jump or Jump(None)
            if 'seek' in asked:
                first, last = self.span_ns
                at = first + round(finite(asked['seek']) * NS_PER_S)
                self._go(Jump(min(max(at, first), last)))
            if 'step' in asked:
                self._step(int(asked['step']))
            if 'play' in asked:
                self.playing, self._steps = bool(asked['play']), 0
                if self.playing and self.ended:
                    self._go(Jump(self.span_ns[0]))

    def _step(self, step: int) -> None:
        self.playing = False
        if step < 0:
            self._go(Jump(None, back=True))
        elif not self.ended:
            self._steps += 1

    def _go(self, jump: Jump) -> None:
        self._jump, self._steps, self.ended = jump, 0, False

    @property
    def jumps(self) -> bool:
        """Whether something else is to be shown than what comes next."""
        return self._jump is not None

    @property
    def moves(self) -> bool:
        """Whether the next picture is wanted."""
        return self.playing or self._steps > 0

    def take_jump(self) -> Jump | None:
        """Return where to go on, once."""
        with self._busy:
            jump, self._jump = self._jump, None
            return jump

    def count_step(self) -> None:
        """Note that the next picture was shown."""
        with self._busy:
            self._steps = max(self._steps - 1, 0)

    def end(self) -> None:
        """Note that there is nothing more, unless somebody wants to be elsewhere already."""
        with self._busy:
            if self._jump is None:
                self.playing, self.ended = False, True
