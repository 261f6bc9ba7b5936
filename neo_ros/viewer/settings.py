"""What the viewer's server is told: where it listens, who may look, and its limits."""
from dataclasses import dataclass, field
import ipaddress
import os
from pathlib import Path
import secrets
import ssl

from neo_ros.errors import ConfigError

# What a person may choose; the tokens that the viewer makes are longer.
MIN_TOKEN, MAX_TOKEN = 12, 200
TOKEN_VARIABLE = 'NEO_VIEWER_TOKEN'


@dataclass(frozen=True)
class ViewerSettings:
    """
    Settings of the server.

    host, port: where to listen; port 0 takes any free one. token: what a viewer has to know;
    empty: none on loopback without a proxy, a fresh one everywhere else. cert, key: PEM files for
    TLS. max_viewers: how many may watch at a time. max_mbit: megabit per second for each of them,
    0 = no limit. quality: of the JPEG pictures, 1 to 100. stale_after: seconds until a picture
    counts as stale. public_origin: what viewers open where a proxy stands before the server, such
    as https://robot.example; empty: no proxy. model: whose memory shows the map and looks around;
    None: neither. floor: a walkable.json or the YAML of a map_server map, whose outlines lie under
    that map. fresh_token: whether the token was made here and has to be shown once.
    """

    host: str = '127.0.0.1'
    port: int = 8600
    token: str = ''
    cert: Path | None = None
    key: Path | None = None
    max_viewers: int = 20
    max_mbit: float = 20.0
    quality: int = 80
    stale_after: float = 0.8
    public_origin: str = ''
    model: Path | None = None
    floor: Path | None = None
    fresh_token: bool = field(default=False, init=False)

    def __post_init__(self) -> None:
        """Check the values; make a token where one is needed. Raises ConfigError."""
        for name, low, high in (('port', 0, 65535), ('max_viewers', 1, 1000),
                                ('max_mbit', 0, 10_000), ('quality', 1, 100),
                                ('stale_after', 0.1, 60)):
            value = getattr(self, name)
            if not low <= value <= high:
                raise ConfigError(f'{name}: expected {low} to {high}, got {value}')
        if self.public_origin:
            object.__setattr__(self, 'public_origin', _as_browsers_say(self.public_origin))
        if not self.token and (self.public_origin or not self.on_loopback):
            object.__setattr__(self, 'token', secrets.token_urlsafe(18))
            object.__setattr__(self, 'fresh_token', True)
        if self.token and not MIN_TOKEN <= len(self.token) <= MAX_TOKEN:
            raise ConfigError(f'token: expected {MIN_TOKEN} to {MAX_TOKEN} characters, got '
                              f'{len(self.token)}')
        if (self.cert is None) != (self.key is None):
            raise ConfigError('cert, key: expected both or none, got one')

    @property
    def on_loopback(self) -> bool:
        """Whether only this machine can reach the server."""
        try:
            return ipaddress.ip_address(self.host).is_loopback
        except ValueError:
            return self.host == 'localhost'

    def tls(self) -> ssl.SSLContext | None:
        """Return the TLS context, None without a certificate; raises ConfigError."""
        if self.cert is None or self.key is None:
            return None
        context = ssl.SSLContext(ssl.PROTOCOL_TLS_SERVER)
        context.minimum_version = ssl.TLSVersion.TLSv1_2
        try:
            context.load_cert_chain(self.cert, self.key)
        except (OSError, ssl.SSLError) as error:
            raise ConfigError(f'cert, key: expected PEM files that belong together, got '
                              f'{self.cert} and {self.key}: {error}') from error
        return context


def _as_browsers_say(public_origin: str) -> str:
    """Return an origin in small letters and without its scheme's own port; raises ConfigError."""
    from yarl import URL  # It comes with aiohttp: without it `serve` says what to install.

    try:
        url = URL(public_origin)
        good = url.host and url.scheme in ('http', 'https') and url.origin() == url
    except ValueError:
        good = False
    if not good:
        raise ConfigError('public_origin: expected scheme and host such as '
                          f'https://robot.example, got {public_origin!r}')
    # The yarl of Ubuntu 24.04 keeps the port.
    return str(url.origin().with_port(None) if url.is_default_port() else url.origin())


def read_token(file: Path | None) -> str:
    """
    Return the token in a file, or in the variable NEO_VIEWER_TOKEN, or an empty string.

    Neither shows in the list of processes, as an argument would. Raises ConfigError.
    """
    if file is None:
        return os.environ.get(TOKEN_VARIABLE, '').strip()
    try:
        token = file.read_text(encoding='utf-8').strip()
    except (OSError, ValueError) as error:
        raise ConfigError(f'token_file: cannot read {file}: {error}') from error
    if not token:
        raise ConfigError(f'token_file: expected a token in {file}, the file is empty')
    return token
