"""One viewer's connection: the newest picture only, at the speed that this viewer can take."""
import asyncio
from collections.abc import Callable
from typing import Any, NamedTuple

from aiohttp import web
from neo_ros.viewer.clock import Clock
from neo_ros.viewer.hearing import hang_up, hear
from neo_ros.viewer.pace import Pace
from neo_ros.viewer.pictures import EncodedPicture

# Two pictures may be on their way unconfirmed: with one, every picture would cost a round trip
# of waiting; with more, a slow link would hold old pictures in its buffers.
MAX_ON_THE_WAY = 2
# Who looks away for longer gives the place away.
HIDDEN_S = 60.0
MOST_ROUND_TRIP_S = 2.0
# The page knows this code.
ASLEEP = 4002


class _Sent(NamedTuple):
    """A picture on its way: when it left, and its bytes as a share of the full picture's."""

    at: float
    share: float


class ViewerLink:
    """
    Sends pictures to one viewer; holds one at most.

    A picture that waits is replaced by a newer one: a slow viewer gets fewer pictures, never
    older ones, and smaller ones where full ones take too long. `on_change` is called when the
    viewer needs other things than before, `command` with what it wants of a bag.
    """

    def __init__(self, socket: web.WebSocketResponse, max_mbit: float,
                 on_change: Callable[[], None], clock: Clock,
                 command: Callable[[dict[str, Any]], None] = lambda asked: None) -> None:
        self.confidence, self.beside = False, ''
        # Until the viewer says otherwise: it asks for the time first.
        self.paused = True
        self.sent = 0
        self._socket = socket
        self._bytes_per_s = max_mbit * 1e6 / 8
        self._on_change, self._command = on_change, command
        self._clock = clock
        self._picture: EncodedPicture | None = None
        self._status: str | None = None
        self._pace = Pace()
        self._on_the_way: dict[int, _Sent] = {}
        self._free_at = 0.0
        self._work = asyncio.Event()
        self._alarm: asyncio.Task | None = None
        self._awake_at = clock.now()
        self._asleep = False

    @property
    def small(self) -> bool:
        """Whether full pictures take too long for this viewer."""
        return self._pace.small

    def offer(self, picture: EncodedPicture) -> None:
        """Leave a picture for this viewer; one that still waits is dropped for it."""
        if not self.paused:
            self._picture = picture
            self._work.set()

    def tell(self, status: str) -> None:
        """Leave a status, JSON text; one that still waits is dropped for it."""
        if self.paused and self._clock.now() - self._awake_at > HIDDEN_S:
            self._asleep = True
        self._status = status
        self._work.set()

    async def serve(self) -> None:
        """Send and listen until the connection ends."""
        sender = asyncio.create_task(self._send())
        try:
            await hear(self._socket, self._clock, self._answer)
        finally:
            tasks = [task for task in (sender, self._alarm) if task is not None]
            for task in tasks:
                task.cancel()
            await asyncio.gather(*tasks, return_exceptions=True)

    async def _send(self) -> None:
        while True:
            await self._work.wait()
            self._work.clear()
            if self._asleep:
                await hang_up(self._socket, ASLEEP, b'hidden for long')
                return
            if self._status is not None:
                status, self._status = self._status, None
                await self._socket.send_str(status)
            if self._picture is None:
                continue
            if len(self._on_the_way) >= MAX_ON_THE_WAY:
                continue  # The next confirmation sets the event again.
            wait = self._free_at - self._clock.now()
            if wait > 0:
                if self._alarm is None or self._alarm.done():
                    self._alarm = asyncio.create_task(self._wake(wait))
                continue
            picture, self._picture = self._picture, None
            await self._send_picture(picture)

    async def _send_picture(self, picture: EncodedPicture) -> None:
        message = picture.message(self.confidence, self.small, self.beside)
        now = self._clock.now()
        if self._bytes_per_s:
            self._free_at = now + len(message) / self._bytes_per_s
        self._on_the_way[picture.seq] = _Sent(
            now, len(message) / len(picture.message(self.confidence, False, self.beside)))
        self.sent += 1
        await self._socket.send_bytes(message)

    async def _wake(self, seconds: float) -> None:
        await self._clock.sleep(seconds)
        self._work.set()

    async def _answer(self, asked: dict[str, Any]) -> None:
        if 'shown' in asked:
            self._confirm(int(asked['shown']))
        if 'round_trip' in asked:
            self._pace.round_trip_s = min(max(
                float(asked['round_trip']) / 1e3, 0.0), MOST_ROUND_TRIP_S)
        if 'thin' in asked:
            self._pace.small = True
            self._on_change()
        if 'player' in asked:
            self._command(dict(asked['player']))
        if not {'confidence', 'paused', 'beside'}.isdisjoint(asked):
            self.confidence = bool(asked.get('confidence', self.confidence))
            self.beside = str(asked.get('beside', self.beside))
            self._pause(bool(asked.get('paused', self.paused)))
            self._on_change()
            self._work.set()
        if 'ping' in asked:
            await self._socket.send_json({
                'type': 'pong', 'ping': float(asked['ping']), 'now': 1e3 * self._clock.now()})

    def _pause(self, paused: bool) -> None:
        if paused:
            self._picture = None  # It would be an old one when the viewer goes on.
        if not self.paused or not paused:
            self._awake_at = self._clock.now()
        self.paused = paused

    def _confirm(self, seq: int) -> None:
        sent = self._on_the_way.pop(seq, None)
        if sent is not None:
            small = self.small
            self._pace.confirm(self._clock.now() - sent.at, sent.share)
            if small != self.small:
                self._on_change()
        self._work.set()
