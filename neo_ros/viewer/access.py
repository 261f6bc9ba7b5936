"""Who may look: the token, the session cookie, and where requests may come from."""
from collections import deque
from collections.abc import Awaitable, Callable
import hashlib
import hmac
import time

from aiohttp import web
from neo_ros.viewer.clock import Clock
from neo_ros.viewer.settings import ViewerSettings
from yarl import URL

SESSION_S = 12 * 3600
# More wrong tokens in so long, from all connections together, and nobody may try any more.
MAX_WRONG_TOKENS, WRONG_TOKENS_S = 10, 60.0
# The log-in page and what it needs.
OPEN_TO_ALL = {'/login', '/base.css', '/icon.svg'}
LOOPBACK_NAMES = {'localhost', '127.0.0.1', '::1'}
Handler = Callable[[web.Request], Awaitable[web.StreamResponse]]

HEADERS = {
    'Content-Security-Policy': (
        "default-src 'none'; script-src 'self'; style-src 'self'; img-src 'self' blob:; "
        "connect-src 'self'; form-action 'self'; base-uri 'none'; frame-ancestors 'none'"),
    'Cache-Control': 'no-store',
    'Cross-Origin-Opener-Policy': 'same-origin',
    'Cross-Origin-Resource-Policy': 'same-origin',
    # With 'no-referrer' browsers hide the origin of the log-in form from us.
    'Referrer-Policy': 'same-origin',
    'Server': 'neo_ros',
    'X-Content-Type-Options': 'nosniff',
    'X-Frame-Options': 'DENY',
}


class Access:
    """
    Lets in who knows the token.

    The token is sent once, by the log-in form, and exchanged for a cookie that proves it was
    known: an end time and its HMAC under the token. So sessions survive a restart of the server
    with the same token, and nothing is stored.
    """

    def __init__(self, settings: ViewerSettings, clock: Clock) -> None:
        self._token = settings.token
        self._public_origin = settings.public_origin
        public = _authority(settings.public_origin)
        self._public_host = public[0] if public else None
        self._secure = (settings.cert is not None
                        or settings.public_origin.startswith('https:'))
        self._hosts = LOOPBACK_NAMES | {settings.host}
        self._clock = clock
        self._wrong: deque[float] = deque()
        self._key = hashlib.sha256(b'neo_ros viewer session ' + self._token.encode()).digest()

    def may_guess(self) -> bool:
        """Say whether one more token may be tried: few wrong ones are, whoever tries them."""
        while self._wrong and self._wrong[0] <= self._clock.now() - WRONG_TOKENS_S:
            self._wrong.popleft()
        return len(self._wrong) < MAX_WRONG_TOKENS

    def count_wrong_token(self) -> None:
        """Remember that somebody did not know the token."""
        self._wrong.append(self._clock.now())

    def is_token(self, candidate: str) -> bool:
        """Compare in constant time, whatever the lengths."""
        given, known = (hashlib.sha256(text.encode(errors='surrogatepass')).digest()
                        for text in (candidate, self._token))
        return hmac.compare_digest(given, known)

    def has_session(self, request: web.Request) -> bool:
        """Say whether the request comes from a viewer that logged in."""
        if not self._token:
            return True
        end, _, proof = request.cookies.get(self._cookie(request), '').partition('.')
        if not (end.isascii() and end.isdigit() and len(end) <= 12):
            return False
        return hmac.compare_digest(
            self._prove(end), proof.encode(errors='surrogatepass')) and int(end) > time.time()

    def begin_session(self, request: web.Request, response: web.StreamResponse) -> None:
        """Give the cookie: out of reach for scripts and for other sites."""
        end = str(int(time.time()) + SESSION_S)
        response.set_cookie(
            self._cookie(request), f'{end}.{self._prove(end).decode()}', max_age=SESSION_S,
            path='/', httponly=True, samesite='Strict', secure=self._secure)

    @web.middleware
    async def middleware(self, request: web.Request, handler: Handler) -> web.StreamResponse:
        """Turn away who may not look, before anything else happens."""
        self._check_host(request)
        if request.path not in OPEN_TO_ALL and not self.has_session(request):
            if request.path == '/':
                raise web.HTTPSeeOther('/login')
            raise web.HTTPUnauthorized(text='log in first')
        return await handler(request)

    def check_origin(self, request: web.Request) -> None:
        """Raise 403 unless the request comes from a page of this server."""
        origin = request.headers.get('Origin', '')
        if self._public_origin and origin == self._public_origin:
            return
        own = _authority(f'{request.scheme}://{request.host}')
        if own is None or own[0] == self._public_host or _authority(origin) != own:
            raise web.HTTPForbidden(text='this request comes from another site')

    def _check_host(self, request: web.Request) -> None:
        """
        Without a token, serve only who asks for this machine by a name of its own.

        A foreign web page could otherwise point a name of its own to 127.0.0.1 and read along.
        """
        authority = _authority(f'{request.scheme}://{request.host}')
        if authority is None or (not self._token and authority[0] not in self._hosts):
            raise web.HTTPMisdirectedRequest(text='unknown host name')

    def _cookie(self, request: web.Request) -> str:
        # Cookies do not know ports: two viewers on one machine would log each other out.
        authority = _authority(f'{request.scheme}://{request.host}')
        return f'neo_viewer_{authority[1] if authority else 0}'

    def _prove(self, end: str) -> bytes:
        return hmac.new(self._key, end.encode(), 'sha256').hexdigest().encode()


async def add_headers(request: web.Request, response: web.StreamResponse) -> None:
    """Put the safety headers on every answer."""
    response.headers.update(HEADERS)


def _authority(url: str) -> tuple[str, int] | None:
    """Return host and port of a URL, None for none."""
    try:
        parsed = URL(url)
        return (parsed.host, parsed.port) if parsed.host and parsed.port else None
    except ValueError:
        return None
