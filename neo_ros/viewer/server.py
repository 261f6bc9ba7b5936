"""The web server: a fixed set of files, the log-in, and the stream."""
import asyncio
from collections.abc import Callable
from importlib.resources import files
import signal
import socket
import threading

from aiohttp import web, WSCloseCode
from neo_ros.errors import ConfigError
from neo_ros.viewer.access import Access, add_headers
from neo_ros.viewer.around_link import AroundLink
from neo_ros.viewer.hub import Hub, Source
from neo_ros.viewer.settings import ViewerSettings
from neo_ros.viewer.surroundings import Surroundings
from neo_ros.viewer.viewer_link import ViewerLink

# Everything that is served; no name from a request ever becomes a path.
PAGE = {
    '/': ('index.html', 'text/html'),
    '/viewer.css': ('viewer.css', 'text/css'),
    '/viewer.js': ('viewer.js', 'text/javascript'),
    '/link.js': ('link.js', 'text/javascript'),
    '/picture.js': ('picture.js', 'text/javascript'),
    '/around.css': ('around.css', 'text/css'),
    '/around.js': ('around.js', 'text/javascript'),
    '/map.js': ('map.js', 'text/javascript'),
    '/look.js': ('look.js', 'text/javascript'),
    '/icon.svg': ('icon.svg', 'image/svg+xml'),
}
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
        self._surroundings = surroundings
        self._access = Access(settings)
        self._viewers: set[web.WebSocketResponse] = set()
        folder = files('neo_ros.viewer') / 'page'
        self._pages = {url: ((folder / name).read_bytes(), kind)
                       for url, (name, kind) in PAGE.items()}
        self._login = (folder / 'login.html').read_text(encoding='utf-8')
        self.app = web.Application(
            middlewares=[self._access.middleware], client_max_size=MAX_REQUEST_BYTES)
        self.app.on_response_prepare.append(add_headers)
        self.app.on_shutdown.append(self._close_sockets)
        self.app.add_routes([
            *(web.get(url, self._get_page) for url in PAGE),
            web.get('/login', self._get_login), web.post('/login', self._post_login),
            web.get('/map', self._get_map), web.get('/map.webp', self._get_map_picture),
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
        if not isinstance(token, str) or not self._access.is_token(token):
            await asyncio.sleep(WRONG_TOKEN_PAUSE_S)
            return self._login_page('That is not the token.', 403)
        response = web.HTTPSeeOther('/')
        self._access.begin_session(request, response)
        raise response

    def _login_page(self, problem: str, status: int = 200) -> web.Response:
        return web.Response(text=self._login.replace('{{problem}}', problem), status=status,
                            content_type='text/html')

    async def _stream(self, request: web.Request) -> web.WebSocketResponse:
        self._access.check_origin(request)
        # Pictures are compressed already; a viewer has nothing long to say.
        viewer = web.WebSocketResponse(
            max_msg_size=MAX_VIEWER_MESSAGE_BYTES, heartbeat=HEARTBEAT_S, compress=False)
        await viewer.prepare(request)
        if len(self._hub) >= self._settings.max_viewers:
            await viewer.close(code=FULL, message=b'too many viewers')
            return viewer
        link = ViewerLink(viewer, self._settings.max_mbit, self._hub.update_wanted,
                          self._hub.clock)
        self._viewers.add(viewer)
        self._hub.add(link)
        try:
            await viewer.send_json({
                'type': 'hello', 'now': 1e3 * self._hub.clock.now(),
                'stale_ms': 1e3 * self._settings.stale_after})
            await link.serve()
        except ConnectionError:
            pass
        finally:
            self._hub.remove(link)
            self._viewers.discard(viewer)
        return viewer

    async def _get_map(self, request: web.Request) -> web.Response:
        plan = await asyncio.to_thread(self._surroundings.plan)
        return web.json_response(
            {'why': self._surroundings.why} if plan is None else plan.about)

    async def _get_map_picture(self, request: web.Request) -> web.Response:
        plan = await asyncio.to_thread(self._surroundings.plan)
        if plan is None:
            raise web.HTTPNotFound(text=self._surroundings.why)
        return web.Response(body=plan.picture, content_type='image/webp')

    async def _around(self, request: web.Request) -> web.WebSocketResponse:
        self._access.check_origin(request)
        viewer = web.WebSocketResponse(
            max_msg_size=MAX_VIEWER_MESSAGE_BYTES, heartbeat=HEARTBEAT_S, compress=False)
        await viewer.prepare(request)
        where = self._hub.where
        if where.wanted >= self._settings.max_viewers:
            await viewer.close(code=FULL, message=b'too many viewers')
            return viewer
        self._viewers.add(viewer)
        try:
            await AroundLink(viewer, where, self._surroundings, self._hub.clock).serve()
        except ConnectionError:
            pass
        finally:
            self._viewers.discard(viewer)
        return viewer

    async def _close_sockets(self, app: web.Application) -> None:
        for viewer in list(self._viewers):
            await viewer.close(code=WSCloseCode.GOING_AWAY)


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
    runner = web.AppRunner(Server(settings, hub, surroundings).app, access_log=None,
                           shutdown_timeout=1.0)
    await runner.setup()
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
        report(_describe(settings, await _listen(runner, settings)))
        thread.start()
        await finished.wait()
    finally:
        stop.set()
        telling.cancel()
        await runner.cleanup()
        if thread.is_alive():
            await asyncio.to_thread(thread.join, 2.0)
    if failures:
        raise failures[0]


async def _listen(runner: web.AppRunner, settings: ViewerSettings) -> int:
    """Open the port and return it."""
    site = web.TCPSite(runner, settings.host, settings.port, ssl_context=settings.tls())
    try:
        await site.start()
    except OSError as error:
        raise ConfigError(f'host, port: cannot listen on {settings.host}:{settings.port}: '
                          f'{error.strerror}; choose another') from error
    return runner.addresses[0][1]


def _describe(settings: ViewerSettings, port: int) -> str:
    """Say where the page is and what it takes to open it."""
    scheme = 'https' if settings.cert else 'http'
    host = socket.gethostname() if settings.host in ('0.0.0.0', '::') else settings.host
    lines = [f'Viewer: {scheme}://{f"[{host}]" if ":" in host else host}:{port}/']
    if settings.fresh_token:
        lines.append(f'Token: {settings.token}')
    if settings.cert is None and not settings.on_loopback:
        lines.append('Without a certificate, token and pictures travel unencrypted.')
    return '\n'.join(lines)
