"""The viewer's server in the test's own event loop, and a viewer without a browser."""
import asyncio
from collections.abc import AsyncIterator, Awaitable, Callable
from contextlib import asynccontextmanager
import json
import struct
import time
from typing import Any

from aiohttp import ClientWebSocketResponse, WSMsgType
from aiohttp.test_utils import TestClient, TestServer
from hand_clock import HandClock
from neo_ros.viewer.hub import Hub
from neo_ros.viewer.pictures import SourcePicture
from neo_ros.viewer.server import Server
from neo_ros.viewer.settings import ViewerSettings
from neo_ros.viewer.surroundings import Surroundings
import numpy as np

# How long a test waits for what never comes; a stall of the machine is shorter.
WAIT_S = 60.0
IMAGE = np.random.default_rng(0).integers(0, 256, (48, 64, 3), np.uint8)
CONFIDENCE = np.full((48, 64), 64, np.uint8)


def picture(image: np.ndarray | bytes = IMAGE) -> SourcePicture:
    """Return a picture."""
    return SourcePicture(image, 0.0, True, CONFIDENCE, (0.25, 0.25, 0.5, 0.5))


@asynccontextmanager
async def running(surroundings: Surroundings = Surroundings(None), **settings: Any
                  ) -> AsyncIterator[tuple[TestClient, Hub]]:
    """Serve a hub of its own on a free port; its clock stands unless the test turns it."""
    # Without a limit: by a clock that stands, its time would never come.
    values = ViewerSettings(**{'max_mbit': 0.0} | settings)
    hub = Hub(values.quality, HandClock())
    async with TestClient(TestServer(Server(values, hub, surroundings).app)) as client:
        yield client, hub


def origin(client: TestClient) -> dict[str, str]:
    """Return the header that a page of the server itself would send."""
    return {'Origin': str(client.make_url('/')).rstrip('/')}


@asynccontextmanager
async def watching(client: TestClient) -> AsyncIterator[ClientWebSocketResponse]:
    """Open the stream, read the greeting and the first status, and ask for pictures."""
    async with client.ws_connect('/stream', headers=origin(client)) as socket:
        kinds = {(await socket.receive_json())['type'] for _ in range(2)}
        assert kinds == {'hello', 'status'}
        await socket.send_json({'paused': False, 'ping': 0})
        assert (await socket.receive_json())['type'] == 'pong'
        yield socket


async def receive_picture(socket: ClientWebSocketResponse, confirm: bool = True
                          ) -> tuple[dict[str, Any], bytes, bytes]:
    """Return meta, image and confidence of the next picture."""
    while True:
        message = await asyncio.wait_for(socket.receive(), WAIT_S)
        assert message.type in (WSMsgType.TEXT, WSMsgType.BINARY), message
        if message.type is WSMsgType.BINARY:
            break
    parts = split(message.data)
    if confirm:
        await socket.send_json({'shown': parts[0]['seq']})
    return parts


def split(data: bytes) -> tuple[dict[str, Any], bytes, bytes]:
    """Return meta, image and confidence of a message."""
    meta, image, confidence, _ = split_all(data)
    return meta, image, confidence


def split_all(data: bytes) -> tuple[dict[str, Any], bytes, bytes, bytes]:
    """Return meta, image, confidence and what is beside it of a message."""
    first, second, third = (12 + end for end in
                            np.cumsum(struct.unpack_from('<III', data)).tolist())
    return json.loads(data[12:first]), data[first:second], data[second:third], data[third:]


async def until(condition: Callable[[], Any]) -> None:
    """Let the server work until the condition holds."""
    deadline = time.monotonic() + WAIT_S
    while not condition():
        assert time.monotonic() < deadline, 'waited in vain'
        await asyncio.sleep(0.01)


def run(test: Callable[[], Awaitable[None]]) -> None:
    """Run an asynchronous test."""
    async def limited() -> None:
        await asyncio.wait_for(test(), 2 * WAIT_S)

    asyncio.run(limited())
