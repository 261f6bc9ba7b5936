"""Moments of a bag: the picture at a time, the one before it, and what other topics show then."""
from collections import deque
from collections.abc import Iterator
from typing import Any

from neo_ros.bags import BagReader
from neo_ros.bags.reading import BagMessage
from neo_ros.errors import BagError
from neo_ros.messages.stamps import NS_PER_S, stamp_of
from neo_ros.viewer.wide_topics import read_pixels
import numpy as np

# Pictures of one stamp lie within so long of one another in a bag.
NEAR_NS = NS_PER_S // 5
# A topic that has shown nothing for longer shows nothing.
LONGEST_NS = NS_PER_S


def picture_before(reader: BagReader, topic: str, stamp_ns: int) -> int | None:
    """Return the log time of the last message of a topic before this one; None: there is none."""
    first_ns, reach_ns = reader.span_ns[0], NS_PER_S
    while True:
        found = [message.stamp_ns for message in reader.messages(
            [topic], max(stamp_ns - reach_ns, 0), stamp_ns)]
        if found or stamp_ns - reach_ns <= first_ns:
            return max(found, default=None)
        reach_ns *= 8


def picture_at(reader: BagReader, topic: str, stamp_ns: int) -> int | None:
    """Return the log time of what is shown at a moment: the last message, or the first one."""
    found = picture_before(reader, topic, stamp_ns + 1)
    if found is not None:
        return found
    return next((message.stamp_ns for message in reader.messages([topic], stamp_ns)), None)


class Companion:
    """
    Shows a topic of images beside another one.

    exact: the image of the same header stamp, as truth is; else the newest one.
    """

    def __init__(self, reader: BagReader, topic: str, exact: bool) -> None:
        self._reader, self._topic, self._exact = reader, topic, exact
        self._messages: Iterator[BagMessage] = iter(())
        self._kept: deque[tuple[int, int, Any]] = deque()
        self._at_ns: int | None = None

    def at(self, log_ns: int, stamp_ns: int) -> np.ndarray | None:
        """Return RGB uint8 (H, W, 3) beside the image of this log time and header stamp."""
        if self._at_ns is None or not 0 <= log_ns - self._at_ns < LONGEST_NS:
            self._kept.clear()
            self._messages = self._reader.messages([self._topic], max(log_ns - LONGEST_NS, 0))
        self._at_ns = log_ns
        ends_ns = log_ns + (NEAR_NS if self._exact else 0)
        while not (self._exact and any(stamp == stamp_ns for _, stamp, _ in self._kept)) and (
                not self._kept or self._kept[-1][0] <= ends_ns):
            message = next(self._messages, None)
            if message is None:
                break
            try:
                content = message.read()
            except BagError:
                continue
            self._kept.append((message.stamp_ns, stamp_of(content.header), content))
            while self._kept and (not self._exact and len(self._kept) > 2
                                  or self._kept[0][0] < log_ns - LONGEST_NS):
                self._kept.popleft()
        shown = [content for at_ns, stamp, content in self._kept if (
            stamp == stamp_ns if self._exact else at_ns <= log_ns)]
        return read_pixels(shown[-1]) if shown else None
