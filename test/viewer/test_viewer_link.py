"""The newest picture for each viewer at its own speed, by a clock that the test turns."""
import asyncio
from collections.abc import AsyncIterator
from contextlib import asynccontextmanager
import json
import struct
from types import SimpleNamespace
from typing import Any

from aiohttp import WSMsgType
from hand_clock import HandClock
from neo_ros.viewer.hub import Hub
from neo_ros.viewer.pictures import SourcePicture
from neo_ros.viewer.viewer_link import MAX_ON_THE_WAY, ViewerLink
from viewer_server import IMAGE, run


class Socket:
    """Stands for the connection: keeps what is sent, says what the test has the viewer say."""

    def __init__(self, clock: HandClock) -> None:
        self.clock = clock
        self.pictures: list[tuple[int, float, int]] = []
        self.said: asyncio.Queue[Any] = asyncio.Queue()
        self.texts: list[dict[str, Any]] = []

    async def send_bytes(self, data: bytes) -> None:
        """Keep (seq, age in seconds, bytes) of a picture."""
        meta = json.loads(data[8:8 + struct.unpack_from('<I', data)[0]])
        age = self.clock.now() - meta['captured'] / 1e3
        self.pictures.append((meta['seq'], age, len(data)))

    async def send_str(self, text: str) -> None:
        """Keep a status."""
        self.texts.append(json.loads(text))

    async def send_json(self, content: dict[str, Any]) -> None:
        """Keep an answer."""
        self.texts.append(content)

    def say(self, **message: Any) -> None:
        """Let the viewer send a message."""
        self.said.put_nowait(SimpleNamespace(type=WSMsgType.TEXT, data=json.dumps(message)))

    def confirm(self) -> None:
        """Let the viewer confirm its newest picture."""
        self.say(shown=self.pictures[-1][0])

    async def __aiter__(self) -> AsyncIterator[Any]:
        """Give what the viewer says."""
        while True:
            yield await self.said.get()


class Bench:
    """A hub and its viewers; nothing happens but in turn."""

    def __init__(self) -> None:
        self.clock = HandClock()
        self.hub = Hub(quality=80, clock=self.clock)
        self._tasks: list[asyncio.Task] = []

    async def watch(self, max_mbit: float = 0.0) -> Socket:
        """Let a viewer in."""
        socket: Any = Socket(self.clock)
        link = ViewerLink(socket, max_mbit, self.hub.update_wanted, self.clock)
        self.hub.add(link)
        self._tasks.append(asyncio.create_task(link.serve()))
        socket.say(paused=False)
        await self.settle()
        return socket

    async def settle(self) -> None:
        """Let all tasks do what they can do at this moment."""
        for _ in range(8):
            await asyncio.sleep(0)

    async def publish(self) -> None:
        """Give a picture to the hub."""
        self.hub.publish(SourcePicture(IMAGE, self.clock.now(), True))
        await self.settle()

    async def turn(self, seconds: float) -> None:
        """Let time pass, a millisecond at a time."""
        for _ in range(round(1e3 * seconds)):
            self.clock.turn(1e-3)
            await self.settle()

    async def end(self) -> None:
        """Cut all viewers off."""
        for task in self._tasks:
            task.cancel()
        await asyncio.gather(*self._tasks, return_exceptions=True)


@asynccontextmanager
async def opened() -> AsyncIterator[Bench]:
    bench = Bench()
    try:
        yield bench
    finally:
        await bench.end()


def test_a_slow_viewer_gets_fewer_pictures_never_older_ones():
    async def test():
        async with opened() as bench:
            slow, fast = await bench.watch(), await bench.watch()
            for number in range(100):  # 50 Hz for 2 s
                await bench.publish()
                fast.confirm()
                if number % 10 == 9:
                    slow.confirm()
                await bench.settle()
                await bench.turn(0.02)
            assert [seq for seq, *_ in fast.pictures] == list(range(1, 101))
            # Two at first; then one for each that it confirms, of the moment when it does.
            assert [seq for seq, *_ in slow.pictures] == [1, 2, *range(10, 101, 10)]
            assert {age for _, age, _ in slow.pictures} == {0.0}
    run(test)


def test_a_viewer_that_confirms_nothing_costs_nothing():
    async def test():
        async with opened() as bench:
            dead, good = await bench.watch(), await bench.watch()
            for _ in range(20):
                await bench.publish()
                good.confirm()
                await bench.turn(0.05)
            assert [seq for seq, *_ in good.pictures] == list(range(1, 21))
            assert [seq for seq, *_ in dead.pictures] == list(range(1, MAX_ON_THE_WAY + 1))
    run(test)


def test_bandwidth_limit_holds():
    async def test():
        async with opened() as bench:
            socket = await bench.watch(max_mbit=0.4)
            for _ in range(125):  # 62 Hz for 2 s
                await bench.publish()
                if socket.pictures:
                    socket.confirm()
                await bench.turn(0.016)
            size = socket.pictures[0][2]
            # The first one goes out at once, the others at 50 kB/s.
            assert 100_000 / size - 2 <= len(socket.pictures) <= 100_000 / size + 1
            assert max(age for _, age, _ in socket.pictures) <= 0.016, 'what is sent is the newest'
    run(test)


def test_a_viewer_that_goes_on_gets_no_picture_from_before():
    async def test():
        async with opened() as bench:
            socket = await bench.watch(max_mbit=0.1)
            for _ in range(2):  # The second waits: the first used up the bandwidth.
                await bench.publish()
            socket.confirm()
            socket.say(paused=True)
            await bench.settle()
            assert not bench.hub.wanted.image
            socket.say(paused=False)
            await bench.settle()
            await bench.turn(10)
            assert [seq for seq, *_ in socket.pictures] == [1]
            await bench.publish()
            assert [seq for seq, *_ in socket.pictures] == [1, 3]
    run(test)


def test_a_status_does_not_wait_for_the_bandwidth():
    async def test():
        async with opened() as bench:
            telling = asyncio.create_task(bench.hub.keep_telling())
            socket = await bench.watch(max_mbit=0.1)
            for _ in range(2):
                await bench.publish()
            before = len(socket.texts)
            await bench.turn(0.6)
            assert len(socket.texts) == before + 1
            assert socket.texts[-1]['rate'] == 1.0, 'two pictures within the last two seconds'
            await bench.turn(2.5)
            assert socket.texts[-1]['rate'] == 0.0
            telling.cancel()
    run(test)
