"""One viewer's connection: the newest picture only, at the speed that this viewer can take."""
import asyncio
from collections.abc import Callable
import json
from typing import Any, NamedTuple

from aiohttp import web, WSMsgType
from neo_ros.viewer.clock import Clock
from neo_ros.viewer.pace import Pace
from neo_ros.viewer.pictures import EncodedPicture

# Two pictures may be on their way unconfirmed: with one, every picture would cost a round trip
# of waiting; with more, a slow link would hold old pictures in its buffers.
MAX_ON_THE_WAY = 2
# A page says something for every picture and now and then besides.
MESSAGES_PER_S, MOST_MESSAGES = 100.0, 200.0
# Who looks away for longer gives the place away.
HIDDEN_S = 60.0
MOST_ROUND_TRIP_S = 2.0
# The page knows these codes.
ASLEEP, TOO_MANY_MESSAGES = 4002, 1008


class _Sent(NamedTuple):
    """A picture on its way: when it left, and its bytes as a share of the full picture's."""

    at: float
    share: float


class ViewerLink:
    """
    Sends pictures to one viewer; holds one at most.

    A picture that waits is replaced by a newer one: a slow viewer gets fewer pictures, never
    older ones, and smaller ones where full ones take too long. `on_change` is called when the
    viewer needs other things than before.
    """

    def __init__(self, socket: web.WebSocketResponse, max_mbit: float,
                 on_change: Callable[[], None], clock: Clock) -> None:
        self.confidence = False
        # Until the viewer says otherwise: it asks for the time first.
        self.paused = True
        self.sent = 0
        self._socket = socket
        self._bytes_per_s = max_mbit * 1e6 / 8
        self._on_change = on_change
        self._clock = clock
        self._picture: EncodedPicture | None = None
        self._status: str | None = None
        self._pace = Pace()
        self._on_the_way: dict[int, _Sent] = {}
        self._free_at = 0.0
        self._work = asyncio.Event()
        self._alarm: asyncio.Task | None = None
        self._awake_at = self._heard_at = clock.now()
        self._messages = MOST_MESSAGES
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
            await self._listen()
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
                await self._socket.close(code=ASLEEP, message=b'hidden for long')
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
        message = picture.message(self.confidence, self.small)
        now = self._clock.now()
        if self._bytes_per_s:
            self._free_at = now + len(message) / self._bytes_per_s
        self._on_the_way[picture.seq] = _Sent(
            now, len(message) / len(picture.message(self.confidence, small=False)))
        self.sent += 1
        await self._socket.send_bytes(message)

    async def _wake(self, seconds: float) -> None:
        await self._clock.sleep(seconds)
        self._work.set()

    async def _listen(self) -> None:
        async for message in self._socket:
            if message.type is not WSMsgType.TEXT:
                await self._socket.close(code=1003, message=b'expected text')
                return
            if not self._may_speak():
                await self._socket.close(code=TOO_MANY_MESSAGES, message=b'too many messages')
                return
            try:
                asked = json.loads(message.data)
                if not isinstance(asked, dict):
                    raise TypeError('expected an object')
                await self._answer(asked)
            except (ValueError, TypeError, OverflowError):
                await self._socket.close(code=1007, message=b'not understood')
                return
            # What has come already is read without a pause: let the others have their turn.
            await asyncio.sleep(0)

    def _may_speak(self) -> bool:
        now = self._clock.now()
        gained = MESSAGES_PER_S * (now - self._heard_at)
        self._messages = min(self._messages + gained, MOST_MESSAGES) - 1
        self._heard_at = now
        return self._messages >= 0

    async def _answer(self, asked: dict[str, Any]) -> None:
        if 'shown' in asked:
            self._confirm(int(asked['shown']))
        if 'round_trip' in asked:
            self._pace.round_trip_s = min(max(
                float(asked['round_trip']) / 1e3, 0.0), MOST_ROUND_TRIP_S)
        if 'confidence' in asked or 'paused' in asked:
            self.confidence = bool(asked.get('confidence', self.confidence))
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
