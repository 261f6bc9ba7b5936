"""Takes connections, ends those that nobody uses, and keeps the logs short."""
import asyncio
from collections.abc import Callable
from dataclasses import dataclass
import errno
from http import HTTPStatus
import logging
import socket
import ssl

from aiohttp import web
from neo_ros.viewer.access import HEADERS
from neo_ros.viewer.clock import Clock

# A connection that shows no viewer anything ends so long after its last request.
IDLE_S = 10.0
# Of these there are so many at most; for one more the oldest is ended.
MAX_IDLE = 64
LOOK_PERIOD_S = 1.0
# When the machine has no more to give, a pause does more good than to ask again at once.
EXHAUSTED_PAUSE_S = 1.0
# Lines of a log in so long; what a stranger sends must not fill the disk.
MAX_LINES, LINES_S = 20, 60.0
LOGGERS = ('aiohttp.server', 'aiohttp.web', 'aiohttp.websocket', 'asyncio')


@dataclass(eq=False)
class _Connection:
    """A connection: until when it may be idle, and what there is of it so far."""

    socket: socket.socket
    until: float
    task: asyncio.Task | None = None
    transport: asyncio.BaseTransport | None = None
    watching: bool = False

    @property
    def ended(self) -> bool:
        if self.transport is not None:
            return self.transport.is_closing()
        return self.task is not None and self.task.done()

    def end(self) -> None:
        if isinstance(self.transport, asyncio.WriteTransport):
            self.transport.abort()
        elif self.task is not None:
            self.task.cancel()
            self.socket.close()


class Connections:
    """All connections of a server; also those that have not said anything yet."""

    def __init__(self, clock: Clock) -> None:
        self._clock = clock
        self._open: list[_Connection] = []

    def __len__(self) -> int:
        """Return how many there are."""
        self._open = [connection for connection in self._open if not connection.ended]
        return len(self._open)

    def touch(self, request: web.Request, watching: bool = False) -> None:
        """Let the connection of a request stay: for a while, or while its viewer watches."""
        if request.transport is None:  # Gone; those in their handshake have none, either.
            return
        for connection in self._open:
            if connection.transport is request.transport:
                connection.until = self._clock.now() + IDLE_S
                connection.watching = watching

    async def serve(self, listener: socket.socket, factory: Callable[[], asyncio.Protocol],
                    tls: ssl.SSLContext | None) -> None:
        """Take the connections of a listening, non-blocking socket until cancelled."""
        loop = asyncio.get_running_loop()
        while True:
            try:
                accepted, _ = await loop.sock_accept(listener)
            except OSError:
                self._make_room(0)
                await self._clock.sleep(EXHAUSTED_PAUSE_S)
                continue
            self._make_room(MAX_IDLE - 1)
            connection = _Connection(accepted, self._clock.now() + IDLE_S)
            self._open.append(connection)
            connection.task = asyncio.create_task(self._begin(connection, factory, tls))

    async def keep_clearing(self) -> None:
        """End what is idle for too long, until cancelled."""
        while True:
            await self._clock.sleep(LOOK_PERIOD_S)
            now = self._clock.now()
            for connection in self._idle():
                if connection.until < now:
                    connection.end()

    async def _begin(self, connection: _Connection, factory: Callable[[], asyncio.Protocol],
                     tls: ssl.SSLContext | None) -> None:
        try:
            connection.transport, _ = (
                await asyncio.get_running_loop().connect_accepted_socket(
                    factory, connection.socket, ssl=tls,
                    ssl_handshake_timeout=IDLE_S if tls is not None else None))
        except (OSError, asyncio.CancelledError):
            connection.socket.close()  # No handshake, or none in time.

    def _idle(self) -> list[_Connection]:
        """Return the connections without a viewer, the one that was idle for longest first."""
        self._open = [connection for connection in self._open if not connection.ended]
        return sorted((connection for connection in self._open if not connection.watching),
                      key=lambda connection: connection.until)

    def _make_room(self, most: int) -> None:
        idle = self._idle()
        for connection in idle[:max(len(idle) - most, 0)]:
            connection.end()


class PoliteHandler(web.RequestHandler):
    """Answers what is no request, too, with the safety headers and without telling a version."""

    def handle_error(self, request: web.BaseRequest, status: int = 500,
                     exc: BaseException | None = None,
                     message: str | None = None) -> web.StreamResponse:
        """Return the answer to a request that cannot be read, or failed here."""
        if status >= HTTPStatus.INTERNAL_SERVER_ERROR:
            self.log_exception('Error handling a request', exc_info=exc)
        if request.writer is not None and request.writer.output_size > 0:
            raise ConnectionError('the answer has begun')
        answer = web.Response(status=status, text=HTTPStatus(status).phrase, headers=HEADERS)
        answer.force_close()
        return answer


class LineLimit(logging.Filter):
    """Lets only so many lines of a log through in a while, and says how many it left out."""

    def __init__(self, clock: Clock) -> None:
        super().__init__()
        self._clock = clock
        self._until, self._lines, self._dropped = 0.0, 0, 0

    def filter(self, record: logging.LogRecord) -> bool:  # noqa: A003
        """Return whether the line goes into the log."""
        now = self._clock.now()
        if now >= self._until:
            if self._dropped:
                record.msg = f'({self._dropped} lines left out) {record.msg}'
            self._until, self._lines, self._dropped = now + LINES_S, 0, 0
        self._lines += 1
        self._dropped += self._lines > MAX_LINES
        return self._lines <= MAX_LINES


def limit_logs(clock: Clock) -> Callable[[], None]:
    """Bound the logs that a stranger can cause; returns what takes the bound away."""
    limit = LineLimit(clock)
    loggers = [logging.getLogger(name) for name in LOGGERS]
    for logger in loggers:
        logger.addFilter(limit)

    def undo() -> None:
        for logger in loggers:
            logger.removeFilter(limit)
    return undo


def listen(host: str, port: int) -> list[socket.socket]:
    """Open a port at every address of a host; port 0: any free one. Raises OSError."""
    opened: list[socket.socket] = []
    try:
        found = socket.getaddrinfo(host, port, type=socket.SOCK_STREAM, flags=socket.AI_PASSIVE)
    except UnicodeError as error:
        raise OSError(errno.EINVAL, 'that is no name of a host') from error
    absent: OSError | None = None
    try:
        for family, address in dict.fromkeys((entry[0], entry[4]) for entry in found):
            if opened:
                address = (address[0], opened[0].getsockname()[1], *address[2:])
            try:
                listener = socket.create_server(address, family=family, backlog=MAX_IDLE)
            except OSError as error:
                if error.errno not in (errno.EADDRNOTAVAIL, errno.EAFNOSUPPORT):
                    raise
                absent = error  # Such as ::1 of a localhost without IPv6.
                continue
            listener.setblocking(False)
            opened.append(listener)
    except OSError:
        for listener in opened:
            listener.close()
        raise
    if not opened and absent is not None:
        raise absent
    return opened
