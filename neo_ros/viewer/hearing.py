"""What viewers say: JSON objects, and not too many of them."""
import asyncio
from collections.abc import Awaitable, Callable
from contextlib import suppress
import json
import math
from typing import Any

from aiohttp import web, WSMsgType
from neo_ros.viewer.clock import Clock

# A page says something for every picture and now and then besides.
MESSAGES_PER_S, MOST_MESSAGES = 100.0, 200.0
NO_TEXT, NOT_UNDERSTOOD, TOO_MANY_MESSAGES = 1003, 1007, 1008
# What is not sent by then will not be: the link stands still.
HANG_UP_S = 1.0


async def hear(socket: web.WebSocketResponse, clock: Clock,
               answer: Callable[[dict[str, Any]], Awaitable[None]]) -> None:
    """
    Give what a viewer says to `answer` until the connection ends.

    A flood of messages ends it, and what is no JSON object, or what `answer` cannot read: it
    raises ValueError, TypeError, KeyError or OverflowError then.
    """
    messages, heard_at = MOST_MESSAGES, clock.now()
    async for message in socket:
        if message.type is not WSMsgType.TEXT:
            await hang_up(socket, NO_TEXT, b'expected text')
            return
        now = clock.now()
        messages = min(messages + MESSAGES_PER_S * (now - heard_at), MOST_MESSAGES) - 1
        heard_at = now
        if messages < 0:
            await hang_up(socket, TOO_MANY_MESSAGES, b'too many messages')
            return
        try:
            asked = json.loads(message.data)
            if not isinstance(asked, dict):
                raise TypeError('expected an object')
            await answer(asked)
        except (ValueError, TypeError, KeyError, OverflowError):
            await hang_up(socket, NOT_UNDERSTOOD, b'not understood')
            return
        # What has come already is read without a pause: let the others have their turn.
        await asyncio.sleep(0)


async def hang_up(socket: web.WebSocketResponse, code: int, message: bytes = b'') -> None:
    """End a connection, and do not wait for a viewer whose link stands still."""
    with suppress(asyncio.TimeoutError):
        await asyncio.wait_for(socket.close(code=code, message=message), HANG_UP_S)


def finite(value: Any) -> float:
    """Return a number that a viewer said; ValueError, TypeError or OverflowError for none."""
    number = float(value)
    if not math.isfinite(number):
        raise ValueError(f'expected a finite number, got {value}')
    return number
