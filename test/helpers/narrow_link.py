"""A link to a port of this machine that can be made narrow and long, as a robot's may be."""
import asyncio
from collections.abc import Iterator
from contextlib import contextmanager
import socket
import threading

# What is on its way at once is small, so that what waits, waits at its sender.
CHUNK = 512


class NarrowLink:
    """Passes on what comes in at `port`; `rate` in bytes per second and direction."""

    def __init__(self, target: int) -> None:
        self.rate, self.delay_s = 1e9, 0.0
        self.port = 0
        self._target = target
        self._pairs: set[asyncio.StreamWriter] = set()

    async def serve(self, ready: threading.Event) -> None:
        """Take connections until end() is called."""
        self._loop, self._ended = asyncio.get_running_loop(), asyncio.Event()
        server = await asyncio.start_server(self._connect, '127.0.0.1', 0, limit=CHUNK)
        self.port = server.sockets[0].getsockname()[1]
        ready.set()
        await self._ended.wait()
        self._cut()
        server.close()

    def narrow(self, rate: float, delay_s: float) -> None:
        """Become narrow for what connects from now on, and cut what is connected."""
        self.rate, self.delay_s = rate, delay_s
        self._loop.call_soon_threadsafe(self._cut)

    def end(self) -> None:
        """Cut everything."""
        self._loop.call_soon_threadsafe(self._ended.set)

    def _cut(self) -> None:
        for writer in self._pairs:
            writer.transport.abort()

    async def _connect(self, reader: asyncio.StreamReader, writer: asyncio.StreamWriter) -> None:
        onward = socket.socket()
        onward.setsockopt(socket.SOL_SOCKET, socket.SO_RCVBUF, 4 * CHUNK)
        onward.setblocking(False)
        await self._loop.sock_connect(onward, ('127.0.0.1', self._target))
        from_server, to_server = await asyncio.open_connection(sock=onward, limit=CHUNK)
        pair = {writer, to_server}
        self._pairs |= pair
        try:
            await asyncio.gather(self._pass(reader, to_server), self._pass(from_server, writer))
        except (ConnectionError, asyncio.CancelledError):
            pass  # Cut, or the test is over.
        finally:
            self._pairs -= pair
            for end in pair:
                end.close()

    async def _pass(self, reader: asyncio.StreamReader, writer: asyncio.StreamWriter) -> None:
        while chunk := await reader.read(CHUNK):
            await asyncio.sleep(len(chunk) / self.rate)
            self._loop.call_later(self.delay_s, writer.write, chunk)
        await asyncio.sleep(self.delay_s)
        writer.close()


@contextmanager
def narrow_link(target: int) -> Iterator[NarrowLink]:
    """Open a link to a port, wide at first."""
    link, ready = NarrowLink(target), threading.Event()
    thread = threading.Thread(target=lambda: asyncio.run(link.serve(ready)), daemon=True)
    thread.start()
    assert ready.wait(30)
    try:
        yield link
    finally:
        link.end()
        thread.join(30)
