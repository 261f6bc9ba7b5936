"""The web server: a fixed set of files, the log-in, and the stream."""
import asyncio
from collections.abc import AsyncIterator, Awaitable, Callable
from contextlib import asynccontextmanager, suppress
from importlib.resources import files
from pathlib import Path
import signal
import socket
import threading
from typing import Any

from aiohttp import web, WSCloseCode
from neo_ros.errors import ConfigError
from neo_ros.viewer.access import Access, add_headers
from neo_ros.viewer.around_link import AroundLink
from neo_ros.viewer.connections import Connections, limit_logs, listen, PoliteHandler
from neo_ros.viewer.hearing import hang_up
from neo_ros.viewer.hub import Hub, Source
from neo_ros.viewer.settings import ViewerSettings
from neo_ros.viewer.surroundings import PlanPicture, Surroundings
from neo_ros.viewer.viewer_link import ViewerLink

# Everything that is served; no name from a request ever becomes a path.
KINDS = {'.css': 'text/css', '.js': 'text/javascript', '.svg': 'image/svg+xml'}
FILES = (
    'around.css', 'around.js', 'around_link.js', 'base.css', 'elements.js', 'gamepad.js',
    'hands.js', 'icon.svg', 'link.js', 'look.js', 'map.js', 'picture.js', 'player.css',
    'player.js', 'socket.js', 'timeline.js', 'viewer.css', 'viewer.js', 'words.js')
PAGE = {'/': ('index.html', 'text/html'),
        **{f'/{name}': (name, KINDS[Path(name).suffix]) for name in FILES}}
MAX_REQUEST_BYTES = 2048
MAX_VIEWER_MESSAGE_BYTES = 512
HEARTBEAT_S = 10.0
WRONG_TOKEN_PAUSE_S = 0.5
# The page shows what this code means.
FULL = 4001


class Server:
    """The application: serves the page and the stream of one hub."""

    def __init__(self, settings: ViewerSettings, hub: Hub,
                 surroundings: Surroundings = Surroundings(None)) -> None:
        self._settings = settings
        self._hub = hub
        self.connections = Connections(hub.clock)
        self._surroundings = surroundings
        self._plan: asyncio.Future[PlanPicture | None] | None = None
        self._access = Access(settings, hub.clock)
        self._viewers: set[web.WebSocketResponse] = set()
        folder = files('neo_ros.viewer') / 'page'
        self._pages = {url: ((folder / name).read_bytes(), kind)
                       for url, (name, kind) in PAGE.items()}
        self._login = (folder / 'login.html').read_text(encoding='utf-8')
        self.app = web.Application(
            middlewares=[self._access.middleware], client_max_size=MAX_REQUEST_BYTES)
        self.app.on_response_prepare.append(add_headers)
        self.app.on_response_prepare.append(self._touch)
        self.app.on_shutdown.append(self._close_sockets)
        self.app.add_routes([
            *(web.get(url, self._get_page) for url in PAGE),
            web.get('/login', self._get_login), web.post('/login', self._post_login),
            web.get('/map', self._get_map), web.get('/map.webp', self._get_map_picture),
            web.get('/timeline', self._get_timeline),
            web.get('/stream', self._stream), web.get('/around', self._around)])

    async def _get_page(self, request: web.Request) -> web.Response:
        body, kind = self._pages[request.path]
        return web.Response(body=body, content_type=kind, charset='utf-8')

    async def _get_login(self, request: web.Request) -> web.Response:
        if self._access.has_session(request):
            raise web.HTTPSeeOther('/')
        return self._login_page('')

    async def _post_login(self, request: web.Request) -> web.Response:
        self._access.check_origin(request)
        token = (await request.post()).get('token', '')
        if not self._access.may_guess():
            return self._login_page('Too many wrong tokens. Try again in a minute.', 429)
        if not isinstance(token, str) or not self._access.is_token(token):
            self._access.count_wrong_token()
            await self._hub.clock.sleep(WRONG_TOKEN_PAUSE_S)
            return self._login_page('That is not the token.', 403)
        response = web.HTTPSeeOther('/')
        self._access.begin_session(request, response)
        raise response

    def _login_page(self, problem: str, status: int = 200) -> web.Response:
        return web.Response(text=self._login.replace('{{problem}}', problem), status=status,
                            content_type='text/html')

    async def _stream(self, request: web.Request) -> web.WebSocketResponse:
        hub = self._hub

        async def show(viewer: web.WebSocketResponse) -> None:
            link = ViewerLink(viewer, self._settings.max_mbit, hub.update_wanted, hub.clock,
                              hub.command)
            hub.add(link)
            try:
                await viewer.send_json({
                    'type': 'hello', 'now': 1e3 * hub.clock.now(),
                    'stale_ms': 1e3 * self._settings.stale_after})
                await link.serve()
            finally:
                hub.remove(link)

        return await self._take(request, lambda: len(hub), show)

    async def _touch(self, request: web.Request, response: web.StreamResponse) -> None:
        self.connections.touch(request)

    async def _get_plan(self, request: web.Request) -> PlanPicture | None:
        # It may be drawn still: who waits for it is not idle until the answer.
        self.connections.touch(request, watching=True)
        if self._plan is None:
            self._plan = asyncio.get_running_loop().create_future()
            # No worker of the pool: looks and the end of the server would wait for it.
            threading.Thread(target=self._draw_plan, args=(self._plan,), name='viewer plan',
                             daemon=True).start()
        return await asyncio.shield(self._plan)

    def _draw_plan(self, drawn: 'asyncio.Future[PlanPicture | None]') -> None:
        put: Callable[[Any], None] = drawn.set_result
        found: Any = None
        try:
            found = self._surroundings.plan()
        except Exception as error:  # Whoever waits has to hear of it.
            put, found = drawn.set_exception, error
        with suppress(RuntimeError):  # The loop may have ended meanwhile.
            drawn.get_loop().call_soon_threadsafe(put, found)

    async def _get_map(self, request: web.Request) -> web.Response:
        plan = await self._get_plan(request)
        return web.json_response(
            {'why': self._surroundings.why} if plan is None else plan.about)

    async def _get_map_picture(self, request: web.Request) -> web.Response:
        plan = await self._get_plan(request)
        if plan is None:
            raise web.HTTPNotFound(text=self._surroundings.why)
        return web.Response(body=plan.picture, content_type='image/webp')

    async def _get_timeline(self, request: web.Request) -> web.Response:
        if self._hub.playback is None:
            raise web.HTTPNotFound(text='what is shown is no bag')
        return web.json_response(self._hub.playback.timeline.describe())

    async def _around(self, request: web.Request) -> web.WebSocketResponse:
        where = self._hub.where
        return await self._take(
            request, lambda: where.wanted,
            lambda viewer: AroundLink(viewer, where, self._surroundings, self._hub.clock).serve())

    async def _take(self, request: web.Request, taken: Callable[[], int],
                    serve: Callable[[web.WebSocketResponse], Awaitable[None]]
                    ) -> web.WebSocketResponse:
        """Open a viewer's WebSocket and serve it to its end, unless all places are taken."""
        self._access.check_origin(request)
        # Pictures are compressed already; a viewer has nothing long to say.
        viewer = web.WebSocketResponse(
            max_msg_size=MAX_VIEWER_MESSAGE_BYTES, heartbeat=HEARTBEAT_S, compress=False)
        await viewer.prepare(request)
        if taken() >= self._settings.max_viewers:
            await hang_up(viewer, FULL, b'too many viewers')
            return viewer
        self._viewers.add(viewer)
        self.connections.touch(request, watching=True)
        try:
            await serve(viewer)
        except ConnectionError:
            pass
        finally:
            self._viewers.discard(viewer)
            self.connections.touch(request)
        return viewer

    async def _close_sockets(self, app: web.Application) -> None:
        await asyncio.gather(*(hang_up(viewer, WSCloseCode.GOING_AWAY)
                               for viewer in self._viewers))


def serve(source: Source, settings: ViewerSettings, report: Callable[[str], None] = print) -> None:
    """
    Serve the pictures of a source until SIGINT or SIGTERM; the address goes to `report`.

    Raises ConfigError where the server cannot listen, and what the source raises.
    """
    asyncio.run(_serve(source, settings, report))


async def _serve(source: Source, settings: ViewerSettings,
                 report: Callable[[str], None]) -> None:
    hub, stop, finished = Hub(settings.quality), threading.Event(), asyncio.Event()
    loop = asyncio.get_running_loop()
    for number in (signal.SIGINT, signal.SIGTERM):
        loop.add_signal_handler(number, finished.set)
    surroundings = Surroundings(settings.model, settings.floor)
    failures: list[BaseException] = []

    def feed() -> None:
        try:
            source.run(hub, stop)
        except Exception as error:  # The main thread raises it again.
            failures.append(error)
            loop.call_soon_threadsafe(finished.set)

    thread = threading.Thread(target=feed, name='viewer source', daemon=True)
    telling = asyncio.create_task(hub.keep_telling())
    threading.Thread(target=surroundings.warm_up, name='viewer plan', daemon=True).start()
    try:
        async with opened(settings, hub, surroundings) as port:
            report(_describe(settings, port))
            thread.start()
            await finished.wait()
            stop.set()
    finally:
        stop.set()
        telling.cancel()
        if thread.is_alive():
            await asyncio.to_thread(thread.join, 2.0)
    if failures:
        raise failures[0]


@asynccontextmanager
async def opened(settings: ViewerSettings, hub: Hub,
                 surroundings: Surroundings = Surroundings(None)) -> AsyncIterator[int]:
    """Serve a hub at the settings' port, which is given; raises ConfigError."""
    tls = settings.tls()
    try:
        listeners = listen(settings.host, settings.port)
    except OSError as error:
        raise ConfigError(f'host, port: cannot listen on {settings.host}:{settings.port}: '
                          f'{error.strerror}; choose another') from error
    server = Server(settings, hub, surroundings)
    runner = web.AppRunner(server.app, access_log=None, shutdown_timeout=1.0)
    await runner.setup()
    manager, loop = runner.server, asyncio.get_running_loop()
    assert manager is not None
    undo = limit_logs(hub.clock)
    tasks = [asyncio.create_task(server.connections.keep_clearing()), *(
        asyncio.create_task(server.connections.serve(
            listener, lambda: PoliteHandler(manager, loop=loop), tls))
        for listener in listeners)]
    try:
        yield listeners[0].getsockname()[1]
    finally:
        for task in tasks:
            task.cancel()
        await asyncio.gather(*tasks, return_exceptions=True)
        for listener in listeners:
            listener.close()
        await runner.cleanup()
        undo()


def _describe(settings: ViewerSettings, port: int) -> str:
    """Say where the page is and what it takes to open it."""
    scheme = 'https' if settings.cert else 'http'
    host = socket.gethostname() if settings.host in ('0.0.0.0', '::') else settings.host
    lines = [f'Viewer: {scheme}://{f"[{host}]" if ":" in host else host}:{port}/']
    if settings.public_origin:
        lines.append(f'Through the proxy: {settings.public_origin}/')
    if settings.fresh_token:
        lines.append(f'Token: {settings.token}')
    if settings.cert is None and not settings.on_loopback:
        lines.append('Without a certificate, token and pictures travel unencrypted.')
    return '\n'.join(lines)
