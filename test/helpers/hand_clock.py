"""A clock that stands still unless a test turns it."""
import asyncio
from collections.abc import Callable
import heapq
import threading

from neo_ros.viewer.clock import Clock


class HandClock(Clock):
    """Whoever pauses a thread turns it; a task sleeps until somebody does."""

    def __init__(self) -> None:
        self._now = 1000.0
        self._alarms: list[tuple[float, int, Callable[[], object]]] = []
        self._count = 0

    def now(self) -> float:
        """Return the time in seconds."""
        return self._now

    def at(self, seconds: float, call: Callable[[], object]) -> None:
        """Call something so many seconds from now."""
        self._count += 1
        heapq.heappush(self._alarms, (self._now + seconds, self._count, call))

    def turn(self, seconds: float) -> None:
        """Let time pass, with everything that happens meanwhile."""
        until = self._now + seconds
        while self._alarms and self._alarms[0][0] <= until:
            self._now, _, call = heapq.heappop(self._alarms)
            call()
        self._now = until

    def pause(self, seconds: float, stop: threading.Event) -> bool:
        """Let the time pass at once."""
        if not stop.is_set():
            self.turn(max(seconds, 0))
        return stop.is_set()

    async def sleep(self, seconds: float) -> None:
        """Sleep until a test has turned the clock so far."""
        if seconds <= 0:
            return await asyncio.sleep(0)
        awake = asyncio.Event()
        self.at(seconds, awake.set)
        await awake.wait()
