"""Time as the viewer's server sees it."""
import asyncio
import threading
import time


class Clock:
    """The machine's monotonic clock, in seconds; tests put one in its place that they turn."""

    def now(self) -> float:
        """Return the time; only differences mean anything."""
        return time.monotonic()

    def pause(self, seconds: float, stop: threading.Event) -> bool:
        """Hold a thread up, until `stop` is set at most; return whether it is."""
        return stop.wait(max(seconds, 0))

    async def sleep(self, seconds: float) -> None:
        """Hold a task up."""
        await asyncio.sleep(seconds)
