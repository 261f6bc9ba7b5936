"""The newest picture for each viewer at its own speed, by a clock that the test turns."""
import asyncio
from collections.abc import AsyncIterator
from contextlib import asynccontextmanager
import json
from types import SimpleNamespace
from typing import Any

from aiohttp import WSMsgType
import cv2
from hand_clock import HandClock
from neo_ros.viewer.hearing import MOST_MESSAGES, TOO_MANY_MESSAGES
from neo_ros.viewer.hub import Hub
from neo_ros.viewer.pace import Pace
from neo_ros.viewer.pictures import SourcePicture
from neo_ros.viewer.viewer_link import ASLEEP, HIDDEN_S, MAX_ON_THE_WAY, ViewerLink
import numpy as np
from viewer_server import IMAGE, run, split


class Socket:
    """Stands for the connection: keeps what is sent, says what the test has the viewer say."""

    def __init__(self, clock: HandClock) -> None:
        self.clock = clock
        self.pictures: list[tuple[int, float, int]] = []
        self.said: asyncio.Queue[Any] = asyncio.Queue()
        self.texts: list[dict[str, Any]] = []
        self.closed: int | None = None

    async def send_bytes(self, data: bytes) -> None:
        """Keep (seq, age in seconds, bytes) of a picture."""
        meta = split(data)[0]
        age = self.clock.now() - meta['captured'] / 1e3
        self.pictures.append((meta['seq'], age, len(data)))

    async def send_str(self, text: str) -> None:
        """Keep a status."""
        self.texts.append(json.loads(text))

    async def close(self, code: int, message: bytes) -> None:
        """Keep why the server ends the connection."""
        assert self.closed is None and message
        self.closed = code

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


class ThinSocket(Socket):
    """A link of so many bytes per second and seconds of delay; the viewer confirms at once."""

    def __init__(self, clock: HandClock, rate: float, delay_s: float) -> None:
        super().__init__(clock)
        self.rate, self.delay_s = rate, delay_s
        self.ages: list[tuple[float, bool]] = []
        self._free_at = 0.0

    async def send_bytes(self, data: bytes) -> None:
        """Bring a picture over; keep its age on the screen, and whether it is small."""
        meta = split(data)[0]
        self._free_at = max(self._free_at, self.clock.now()) + len(data) / self.rate

        def arrive() -> None:
            self.ages.append((self.clock.now() - meta['captured'] / 1e3, meta['small']))
            self.clock.at(self.delay_s, lambda: self.say(shown=meta['seq']))

        self.clock.at(self._free_at - self.clock.now() + self.delay_s, arrive)


class Bench:
    """A hub and its viewers; nothing happens but in turn."""

    def __init__(self) -> None:
        self.clock = HandClock()
        self.hub = Hub(quality=80, clock=self.clock)
        self._tasks: list[asyncio.Task] = []

    async def watch(self, max_mbit: float = 0.0, socket: Any = None) -> Any:
        """Let a viewer in."""
        socket = socket or Socket(self.clock)
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

    async def publish(self, image: np.ndarray = IMAGE) -> None:
        """Give a picture to the hub."""
        self.hub.publish(SourcePicture(image, self.clock.now(), True))
        await self.settle()

    async def turn(self, seconds: float) -> None:
        """Let time pass, a millisecond at a time."""
        for _ in range(round(1e3 * seconds)):
            self.clock.turn(1e-3)
            await self.settle()

    async def turn_coarsely(self, seconds: float) -> None:
        """Let time pass at once."""
        self.clock.turn(seconds)
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


# As rich as a room: 36 kB at quality 80.
ROOM = np.array(cv2.resize(IMAGE, (512, 512), interpolation=cv2.INTER_CUBIC))
ROOM[:, 256:] = ROOM[:, 256:] // 16


def test_a_thin_link_gets_smaller_pictures_and_a_good_one_full_ones_again():
    async def test():
        async with opened() as bench:
            thin = await bench.watch(socket=ThinSocket(bench.clock, 250e3 / 8, 0.02))
            good = await bench.watch(socket=ThinSocket(bench.clock, 20e6 / 8, 0.15))
            for socket in (thin, good):
                socket.say(round_trip=2e3 * socket.delay_s)
            for _ in range(100):  # 10 Hz for 10 s
                await bench.publish(ROOM)
                await bench.turn(0.1)
            assert not any(small for _, small in good.ages), 'a long way is no thin link'
            settled = thin.ages[len(thin.ages) // 3:]
            assert all(small for _, small in settled)
            assert max(age for age, _ in settled) < 0.7 < max(age for age, _ in thin.ages)
            thin.rate = 20e6 / 8
            for _ in range(40):
                await bench.publish(ROOM)
                await bench.turn(0.1)
            assert not thin.ages[-1][1] and not bench.hub.wanted.small
    run(test)


def test_a_page_that_lost_its_link_behind_a_picture_gets_small_ones_first():
    async def test():
        async with opened() as bench:
            socket = await bench.watch(socket=ThinSocket(bench.clock, 250e3 / 8, 0.02))
            socket.say(thin=True)
            await bench.turn(0.1)
            assert bench.hub.wanted.small
            await bench.publish(ROOM)
            await bench.turn(1.0)
            assert socket.ages[0][1]
    run(test)


def test_one_stall_makes_nothing_smaller():
    pace = Pace()
    for took_s in (0.1, 5.0, 0.1, 5.0, 0.1):
        pace.confirm(took_s, 1.0)
        assert not pace.small


def test_a_hidden_viewer_gives_its_place_away_after_a_minute():
    async def test():
        async with opened() as bench:
            telling = asyncio.create_task(bench.hub.keep_telling())
            hidden, seen = await bench.watch(), await bench.watch()
            for _ in range(2):  # To say so again does not make the time begin anew.
                hidden.say(paused=True)
                for _ in range(round(HIDDEN_S) - 1):
                    await bench.turn_coarsely(0.5)
            assert hidden.closed is None
            for _ in range(6):
                await bench.turn_coarsely(0.5)
            assert hidden.closed == ASLEEP and seen.closed is None
            telling.cancel()
    run(test)


def test_a_flood_of_messages_ends_and_slows_nobody():
    async def test():
        async with opened() as bench:
            flooding, good = await bench.watch(), await bench.watch()
            for _ in range(100_000):
                flooding.say(ping=1)
            await bench.publish()
            assert [seq for seq, *_ in good.pictures] == [1], 'in its turn among the flood'
            for _ in range(100):
                await bench.settle()
            assert flooding.closed == TOO_MANY_MESSAGES
            assert len(flooding.texts) <= MOST_MESSAGES + 1 and good.closed is None
            # A page at 60 Hz may say all it has to say, for ever.
            for _ in range(600):
                good.say(shown=1)
                await bench.settle()
                bench.clock.turn(1 / 60)
            assert good.closed is None
    run(test)
