"""The documented proxies, run for real: log-in and pictures through their TLS in a browser."""
from collections.abc import Iterator
from contextlib import contextmanager
import math
import os
from pathlib import Path
import re
import shutil
import socket
import subprocess
import sys
from typing import Any

from bag_files import write_walk_bag
from neo_ros.bags import replay
from neo_ros.geometry import Intrinsics, ViewExpansion
from neo_ros.runtime import FovExtrapolator
import pytest
from tiny_model import write_tiny_model
from viewer_pages import opened_page, PYTHONPATH, wait_for, WAIT_S

pytestmark = [pytest.mark.slow, pytest.mark.usefixtures('browser')]
GUIDE = Path(__file__).parents[2] / 'docs' / 'guides' / 'viewer.md'
EXPANSION = ViewExpansion.to_size(Intrinsics.from_hfov(32, 24, math.pi / 2), 64, 48)
TOKEN = 'a token of the test'


def documented(start: str) -> str:
    """Return the indented block of the guide that begins with these words."""
    found = re.search(rf'^    {re.escape(start)}.*\n(?:(?:    .*)?\n)*?    }}$',
                      GUIDE.read_text(), re.MULTILINE)
    assert found, start
    return found[0]


def free_port() -> int:
    with socket.socket() as taken:
        taken.bind(('127.0.0.1', 0))
        return int(taken.getsockname()[1])


def nginx(folder: Path, port: int, behind: int) -> list[str | Path]:
    subprocess.run(['openssl', 'req', '-x509', '-newkey', 'rsa:2048', '-nodes', '-keyout',
                    folder / 'key.pem', '-out', folder / 'cert.pem', '-days', '1', '-subj',
                    '/CN=localhost'], check=True, capture_output=True)
    server = documented('server {').replace('443', str(port)).replace('8600', str(behind))
    server = server.replace('robot.example', 'localhost')
    server = re.sub(r' (\w+\.pem);', rf' {folder}/\1;', server)
    (folder / 'nginx.conf').write_text(
        f'daemon off; pid {folder}/pid; error_log stderr; events {{}}\n'
        f'http {{ access_log off; client_body_temp_path {folder}/body; '
        f'proxy_temp_path {folder}/proxy; fastcgi_temp_path {folder}/f; '
        f'uwsgi_temp_path {folder}/u; scgi_temp_path {folder}/s;\n{server}\n}}')
    return ['nginx', '-c', folder / 'nginx.conf', '-p', folder, '-e', 'stderr']


def caddy(folder: Path, port: int, behind: int) -> list[str | Path]:
    site = documented('robot.example {').replace('8600', str(behind))
    # For localhost it is its own authority; nothing is to be installed on this machine.
    (folder / 'Caddyfile').write_text(
        '{\n skip_install_trust\n auto_https disable_redirects\n admin off\n}\n'
        + site.replace('robot.example', f'localhost:{port}').replace('    ', '', 1))
    return ['caddy', 'run', '--adapter', 'caddyfile', '--config', folder / 'Caddyfile']


@contextmanager
def process(command: list[Any], folder: Path) -> Iterator[subprocess.Popen]:
    run = subprocess.Popen(command, text=True, stdout=subprocess.PIPE, env=os.environ | PYTHONPATH
                           | {'XDG_DATA_HOME': str(folder), 'XDG_CONFIG_HOME': str(folder)},
                           stderr=(folder / f'{command[0]}.log'.replace('/', '_')).open('w'))
    try:
        yield run
    finally:
        run.terminate()
        run.wait(WAIT_S)


@pytest.mark.parametrize('proxy', [nginx, caddy], ids=lambda proxy: proxy.__name__)
def test_log_in_and_pictures_through_a_documented_proxy(browser: Any, tmp_path: Path, proxy: Any
                                                        ) -> None:
    if shutil.which(proxy.__name__) is None:
        pytest.skip(f'needs {proxy.__name__}: apt install {proxy.__name__}')
    model = write_tiny_model(tmp_path / 'm.onnx', EXPANSION)
    replay(write_walk_bag(tmp_path / 'walk', EXPANSION, 30), FovExtrapolator.load(model),
           tmp_path / 'wide')
    (tmp_path / 'token').write_text(TOKEN)
    port, behind = free_port(), free_port()
    origin = f'https://localhost:{port}'
    view = [sys.executable, '-m', 'neo_ros.cli.main', 'view', '--bag', tmp_path / 'wide', '--port',
            str(behind), '--public-origin', origin, '--token-file', tmp_path / 'token']
    with process(view, tmp_path) as viewer, process(proxy(tmp_path, port, behind), tmp_path):
        assert viewer.stdout is not None
        assert viewer.stdout.readline().strip() == f'Viewer: http://127.0.0.1:{behind}/'
        assert viewer.stdout.readline().strip() == f'Through the proxy: {origin}/'
        with opened_page(browser, allowed='ERR_CONNECTION_REFUSED',
                         ignore_https_errors=True) as page:
            def reached() -> bool:
                try:
                    page.goto(f'{origin}/')
                except Exception:
                    page.wait_for_timeout(200)
                    return False
                return bool(page.url.endswith('/login'))

            wait_for(page, reached)
            page.get_by_label('Token').fill(TOKEN)
            page.keyboard.press('Enter')
            page.wait_for_selector('#connection[data-state=recording]')
            wait_for(page, lambda: page.inner_text('#size') == '64 × 48')
            cookie, = page.context.cookies()
            assert cookie['secure'] and cookie['httpOnly'] and cookie['sameSite'] == 'Strict'
            page.keyboard.press(' ')
            page.wait_for_selector('#connection[data-state=paused]')
