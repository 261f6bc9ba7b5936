"""Connections that nobody uses end, and cannot fill the machine or its logs."""
import asyncio
from contextlib import asynccontextmanager
import logging
import socket
from types import SimpleNamespace
from typing import Any

import aiohttp
from hand_clock import HandClock
from neo_ros.viewer.access import HEADERS
from neo_ros.viewer.connections import (
    _Connection, Connections, IDLE_S, LineLimit, LINES_S, listen, MAX_IDLE, MAX_LINES)
from neo_ros.viewer.hub import Hub
from neo_ros.viewer.server import opened
from neo_ros.viewer.settings import ViewerSettings
import pytest
from viewer_server import run, until, WAIT_S


@asynccontextmanager
async def serving():
    """Serve at a port of its own; the clock stands unless the test turns it."""
    hub = Hub(80, HandClock())
    async with opened(ViewerSettings(port=0), hub) as port:
        yield hub, port


async def ask(port, text='GET /viewer.css HTTP/1.1\r\nHost: localhost\r\n\r\n'):
    """Send a text and return the reader, the writer and the first line of the answer."""
    reader, writer = await asyncio.open_connection('127.0.0.1', port)
    writer.write(text.encode())
    line = await asyncio.wait_for(reader.readline(), WAIT_S) if text else b''
    return reader, writer, line


async def ended(reader):
    """Read to the end, which a connection has that the server closed or cut."""
    try:
        await asyncio.wait_for(reader.read(), WAIT_S)
    except ConnectionError:
        pass
    return True


async def turn(clock, seconds):
    """Let time pass second by second, and everybody do what is due."""
    for _ in range(round(seconds)):
        clock.turn(1.0)
        await asyncio.sleep(0.01)


@pytest.mark.parametrize('said', ['', 'GET / HT'], ids=['silent', 'in the middle'])
def test_idle_connections_end_and_viewers_stay(said):
    async def test():
        async with serving() as (hub, port), aiohttp.ClientSession() as session:
            origin = f'http://127.0.0.1:{port}'
            async with session.ws_connect(f'{origin}/stream', origin=origin) as viewer:
                reader, writer = await asyncio.open_connection('127.0.0.1', port)
                writer.write(said.encode())
                used, *_ = await ask(port)
                await turn(hub.clock, IDLE_S - 2)
                assert not reader.at_eof()
                await turn(hub.clock, 4)
                assert await ended(reader) and await ended(used)
                await viewer.send_json({'ping': 1})
                async with asyncio.timeout(WAIT_S):
                    while (await viewer.receive_json())['type'] != 'pong':
                        pass
                assert len(hub) == 1
    run(test)


def test_who_has_gone_keeps_no_other_connection_in_its_handshake():
    clock = HandClock()
    connections, (ours, theirs) = Connections(clock), socket.socketpair()
    waiting = _Connection(ours, clock.now() + IDLE_S)
    connections._open.append(waiting)
    clock.turn(5.0)
    gone: Any = SimpleNamespace(transport=None)
    connections.touch(gone, watching=True)
    assert (waiting.until, waiting.watching) == (1000.0 + IDLE_S, False)
    ours.close()
    theirs.close()


def test_many_silent_connections_lock_nobody_out():
    async def test():
        async with serving() as (_, port):
            silent = [await asyncio.open_connection('127.0.0.1', port)
                      for _ in range(2 * MAX_IDLE)]
            *_, line = await ask(port)
            assert line == b'HTTP/1.1 200 OK\r\n'
            # The oldest went; of the newest most are still there.
            for reader, _ in silent[:MAX_IDLE]:
                assert await ended(reader)
            await asyncio.sleep(0)
            assert not any(reader.at_eof() for reader, _ in silent[-MAX_IDLE // 2:])
            for _, writer in silent:
                writer.close()
    run(test)


@pytest.mark.parametrize('text', [
    'GET / HTTP/1.1\r\nHost: local\0host\r\n\r\n', 'nonsense\r\n\r\n',
    'GET / HTTP/9.x\r\n\r\n', f'GET /{"x" * 9000} HTTP/1.1\r\n\r\n'],
    ids=['zero byte', 'nonsense', 'version', 'long line'])
def test_what_is_no_request_is_answered_with_the_safety_headers(text):
    async def test():
        async with serving() as (_, port):
            reader, writer, line = await ask(port, text)
            assert line.split()[1] == b'400'
            answer = line + await asyncio.wait_for(reader.read(), WAIT_S)
            head, _, body = answer.decode().partition('\r\n\r\n')
            fields = dict(field.split(': ', 1) for field in head.split('\r\n')[1:])
            assert {name: fields[name] for name in HEADERS} == HEADERS
            assert body == 'Bad Request' and 'aiohttp' not in head and 'Python' not in head
            writer.close()
    run(test)


def test_a_log_has_few_lines_and_says_how_many_are_missing():
    clock, lines = HandClock(), []
    logger = logging.Logger('test')
    logger.addFilter(LineLimit(clock))

    class Keep(logging.Handler):

        def emit(self, record):
            lines.append(record.getMessage())

    logger.addHandler(Keep())
    for number in range(1000):
        logger.warning('line %d', number)
    assert lines == [f'line {number}' for number in range(MAX_LINES)]
    clock.turn(LINES_S)
    logger.warning('later')
    assert lines[MAX_LINES:] == [f'({1000 - MAX_LINES} lines left out) later']


def test_a_name_that_leads_nowhere_here_is_no_obstacle_and_none_at_all_is_told(monkeypatch):
    there = socket.getaddrinfo('127.0.0.1', 0, type=socket.SOCK_STREAM)
    gone = [(socket.AF_INET, socket.SOCK_STREAM, 6, '', ('192.0.2.1', 0))]  # Nobody's: RFC 5737.
    monkeypatch.setattr(socket, 'getaddrinfo', lambda *_, **__: gone + there)
    one, = listen('localhost', 0)
    assert one.getsockname()[0] == '127.0.0.1'
    one.close()
    monkeypatch.setattr(socket, 'getaddrinfo', lambda *_, **__: gone)
    with pytest.raises(OSError, match='assign requested address'):
        listen('localhost', 0)
    monkeypatch.undo()
    with pytest.raises(OSError, match='no name of a host'):
        listen(64 * 'x', 0)


def test_the_server_leaves_no_connection_behind():
    async def test():
        async with serving() as (_, port):
            reader, _, _ = await ask(port)
        assert await ended(reader)
        with pytest.raises(ConnectionRefusedError):
            await asyncio.open_connection('127.0.0.1', port)
        await until(lambda: True)
    run(test)
