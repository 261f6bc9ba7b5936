"""What the node counts: frames in and out, drops, refusals, and where the time goes."""
from collections import Counter, deque
from collections.abc import Callable, Mapping
from dataclasses import dataclass
import threading
import time
from typing import NamedTuple

import numpy as np

WINDOW_S = 5.0
# A stage's latencies are kept for so many frames: 10 s at 30 Hz.
KEPT_FRAMES = 300


class Spread(NamedTuple):
    """Latency of one stage over the last frames, milliseconds."""

    median: float
    p95: float
    max: float  # noqa: A003


@dataclass(frozen=True)
class Snapshot:
    """
    Totals since the start, and what happened in the last WINDOW_S seconds.

    `recent_*` count events inside the window, `rate_*` are per second. `rejected` counts by
    reason; `last_rejection` is the newest refusal in words, also when it is older than the window.
    `out_of_scene` is the mean score of the window, None without one; `guided` the share of its
    widened images that the scene memory guided, None without one; `camera_note` says what was done
    to the newest image to make it the model's view, 'unknown' without one.
    """

    received: int
    published: int
    dropped: int
    rejected: dict[str, int]
    last_rejection: str
    recent_received: int
    recent_published: int
    recent_rejected: int
    rate_in: float
    rate_out: float
    out_of_scene: float | None
    guided: float | None
    camera_note: str
    latency_ms: dict[str, Spread]


class Statistics:
    """Counters that the executor's thread and the worker share."""

    def __init__(self, now: Callable[[], float] = time.monotonic) -> None:
        """Take the clock as an argument, so that tests need not wait."""
        self._now = now
        self._lock = threading.Lock()
        self._totals: Counter[str] = Counter()
        self._reasons: Counter[str] = Counter()
        self._last_rejection = ''
        self.begin()

    def begin(self) -> None:
        """Let the window begin now: images are taken from here on."""
        with self._lock:
            self._started = self._now()
            self._times: dict[str, deque[float]] = {
                event: deque() for event in ('received', 'published', 'rejected')}
        self.forget_model()

    def forget_model(self) -> None:
        """Drop what the next model may do otherwise: scores and latencies."""
        with self._lock:
            self._latencies: dict[str, deque[float]] = {}
            self._scores: deque[tuple[float, float]] = deque()
            self._guided: deque[tuple[float, float]] = deque()
            self._camera_note = 'unknown'

    def count_received(self) -> None:
        """Count a frame that arrived."""
        with self._lock:
            self._count('received')

    def count_dropped(self) -> None:
        """Count a frame that a newer one replaced before its turn."""
        with self._lock:
            self._totals['dropped'] += 1

    def count_rejected(self, reason: str, message: str) -> None:
        """Count a refused frame under its stable reason and keep the words of the newest."""
        with self._lock:
            self._count('rejected')
            self._reasons[reason] += 1
            self._last_rejection = message
            self._camera_note = 'rejected'

    def count_published(self, stages_ms: Mapping[str, float], out_of_scene: float | None = None,
                        guided: bool | None = None, camera_note: str = 'unknown') -> None:
        """
        Count a frame that went out, the milliseconds of each stage, and what it was like.

        `guided` is None for a frame that was not widened.
        """
        with self._lock:
            self._count('published')
            self._camera_note = camera_note
            if guided is not None:
                self._guided.append((self._now(), guided))
            if out_of_scene is not None:
                self._scores.append((self._now(), out_of_scene))
            self._forget()
            for stage, duration in stages_ms.items():
                kept = self._latencies.setdefault(stage, deque(maxlen=KEPT_FRAMES))
                kept.append(duration)

    def snapshot(self) -> Snapshot:
        """Return all numbers as they stand now."""
        with self._lock:
            recent = {event: self._recent(event) for event in self._times}
            latencies = {stage: list(kept) for stage, kept in self._latencies.items()}
            window = max(min(WINDOW_S, self._now() - self._started), 1e-3)
            totals, reasons = self._totals.copy(), dict(self._reasons)
            last_rejection, camera_note = self._last_rejection, self._camera_note
            self._forget()
            guided, out_of_scene = _mean(self._guided), _mean(self._scores)
        return Snapshot(
            received=totals['received'], published=totals['published'],
            dropped=totals['dropped'], rejected=reasons, last_rejection=last_rejection,
            recent_received=recent['received'], recent_published=recent['published'],
            recent_rejected=recent['rejected'], rate_in=recent['received'] / window,
            rate_out=recent['published'] / window, camera_note=camera_note,
            guided=guided, out_of_scene=out_of_scene,
            latency_ms={stage: Spread(*np.percentile(values, [50, 95, 100]).tolist())
                        for stage, values in latencies.items()})

    def _count(self, event: str) -> None:
        self._totals[event] += 1
        self._times[event].append(self._now())
        self._recent(event)

    def _forget(self) -> None:
        """Drop what has left the window."""
        begin = self._now() - WINDOW_S
        for kept in (self._scores, self._guided):
            while kept and kept[0][0] < begin:
                kept.popleft()

    def _recent(self, event: str) -> int:
        times = self._times[event]
        while times and times[0] < self._now() - WINDOW_S:
            times.popleft()
        return len(times)


def _mean(timed: deque[tuple[float, float]]) -> float | None:
    return float(np.mean([value for _, value in timed])) if timed else None
