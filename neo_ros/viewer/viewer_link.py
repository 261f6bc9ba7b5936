"""One viewer's connection: the newest picture only, at the speed that this viewer can take."""
import asyncio
from collections.abc import Callable
import json
from typing import Any

from aiohttp import web, WSMsgType
from neo_ros.viewer.clock import Clock
from neo_ros.viewer.pictures import EncodedPicture

# Two pictures may be on their way unconfirmed: with one, every picture would cost a round trip
# of waiting; with more, a slow link would hold old pictures in its buffers.
MAX_ON_THE_WAY = 2


class ViewerLink:
    """
    Sends pictures to one viewer; holds one at most.

    A picture that waits is replaced by a newer one: a slow viewer gets fewer pictures, never
    older ones. `on_change` is called when the viewer asks for other things than before.
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
        self._on_the_way: set[int] = set()
        self._free_at = 0.0
        self._work = asyncio.Event()
        self._alarm: asyncio.Task | None = None

    def offer(self, picture: EncodedPicture) -> None:
        """Leave a picture for this viewer; one that still waits is dropped for it."""
        if not self.paused:
            self._picture = picture
            self._work.set()

    def tell(self, status: str) -> None:
        """Leave a status, JSON text; one that still waits is dropped for it."""
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
            message = picture.message(self.confidence)
            if self._bytes_per_s:
                self._free_at = self._clock.now() + len(message) / self._bytes_per_s
            self._on_the_way.add(picture.seq)
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
            try:
                asked = json.loads(message.data)
                if not isinstance(asked, dict):
                    raise TypeError('expected an object')
                await self._answer(asked)
            except (ValueError, TypeError, OverflowError):
                await self._socket.close(code=1007, message=b'not understood')
                return

    async def _answer(self, asked: dict[str, Any]) -> None:
        if 'shown' in asked:
            self._on_the_way.discard(int(asked['shown']))
            self._work.set()
        if 'confidence' in asked or 'paused' in asked:
            self.confidence = bool(asked.get('confidence', self.confidence))
            self.paused = bool(asked.get('paused', self.paused))
            if self.paused:
                self._picture = None  # It would be an old one when the viewer goes on.
            self._on_change()
            self._work.set()
        if 'ping' in asked:
            await self._socket.send_json({
                'type': 'pong', 'ping': float(asked['ping']), 'now': 1e3 * self._clock.now()})
