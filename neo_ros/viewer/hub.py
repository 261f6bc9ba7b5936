"""Between the source's thread and the viewers: encodes once, hands to all, counts."""
import asyncio
from collections import deque
from dataclasses import asdict
import json
import threading
from typing import Any, NamedTuple, Protocol

from neo_ros.viewer.clock import Clock
from neo_ros.viewer.pictures import EncodedPicture, SourcePicture, SourceState
from neo_ros.viewer.playback import Playback
from neo_ros.viewer.viewer_link import ViewerLink
from neo_ros.viewer.whereabouts import Whereabouts

RATE_WINDOW_S = 2.0
STATUS_PERIOD_S = 0.5


class Wanted(NamedTuple):
    """What somebody watches; a source that nobody watches need not do anything."""

    image: bool = False
    confidence: bool = False
    small: bool = False
    beside: frozenset[str] = frozenset()


class Source(Protocol):
    """Where pictures come from."""

    def run(self, hub: 'Hub', stop: threading.Event) -> None:
        """Give pictures to the hub until `stop` is set; has a thread of its own."""


class Hub:
    """
    Takes pictures from the source's thread and gives every viewer the newest one.

    `publish` and `report` may be called from any thread, the rest from the event loop's.
    """

    def __init__(self, quality: int, clock: Clock = Clock()) -> None:
        self.clock = clock
        self.wanted = Wanted()
        self.where = Whereabouts()
        # Of a bag; None for a live stream.
        self.playback: Playback | None = None
        # How often the viewers have asked for anything.
        self.changes = 0
        self.encoded = 0
        self._loop = asyncio.get_running_loop()
        self._quality = quality
        self._links: set[ViewerLink] = set()
        self._arrivals: deque[float] = deque()
        self._state = SourceState('', 'starting')

    def __len__(self) -> int:
        """Return how many viewers there are."""
        return len(self._links)

    def publish(self, picture: SourcePicture) -> None:
        """Encode a picture, unless nobody watches, and hand it to all viewers."""
        wanted = self.wanted
        if not wanted.image:
            return
        self.encoded += 1
        encoded = EncodedPicture(self.encoded, picture, self._quality, wanted.confidence,
                                 wanted.small)
        self._call(self._deliver, encoded)

    def report(self, state: SourceState) -> None:
        """Say what is known of the sender."""
        if state != self._state:
            self._state = state
            self._call(self._tell_all)

    def add(self, link: ViewerLink) -> None:
        """Let a viewer in."""
        self._links.add(link)
        self.update_wanted()
        link.tell(self._status())

    def remove(self, link: ViewerLink) -> None:
        """Forget a viewer."""
        self._links.discard(link)
        self.update_wanted()

    def update_wanted(self) -> None:
        """Look again at what the viewers ask for."""
        awake = [link for link in self._links if not link.paused]
        self.wanted = Wanted(bool(awake), any(link.confidence for link in awake),
                             any(link.small for link in awake),
                             frozenset(link.beside for link in awake if link.beside))
        self.changes += 1

    def command(self, asked: dict[str, Any]) -> None:
        """Pass on what a viewer wants of a bag; see `Playback.command`."""
        if self.playback is not None:
            self.playback.command(asked)

    async def keep_telling(self) -> None:
        """Send the status to all now and then, which also tells that the server lives."""
        while True:
            await self.clock.sleep(STATUS_PERIOD_S)
            self._tell_all()

    def _call(self, function, *arguments) -> None:  # type: ignore[no-untyped-def]
        try:
            self._loop.call_soon_threadsafe(function, *arguments)
        except RuntimeError:
            pass  # The server has ended while the source was at work.

    def _deliver(self, picture: EncodedPicture) -> None:
        self._arrivals.append(self.clock.now())
        for link in self._links:
            link.offer(picture)

    def _tell_all(self) -> None:
        status = self._status()
        for link in self._links:
            link.tell(status)

    def _status(self) -> str:
        now = self.clock.now()
        while self._arrivals and self._arrivals[0] < now - RATE_WINDOW_S:
            self._arrivals.popleft()
        return json.dumps({'type': 'status', **asdict(self._state), 'viewers': len(self),
                           'rate': len(self._arrivals) / RATE_WINDOW_S})
