"""Who may look at the stream, what is served, and what is refused."""
import asyncio
import http.client
from pathlib import Path
import shutil
import ssl
import subprocess
import sys
import threading
from unittest import mock
import urllib.request

from aiohttp import WSServerHandshakeError
import cv2
from hand_clock import HandClock
from neo_ros.errors import ConfigError
from neo_ros.viewer import access, hearing
from neo_ros.viewer.access import HEADERS, MAX_WRONG_TOKENS, WRONG_TOKENS_S
from neo_ros.viewer.server import PAGE
from neo_ros.viewer.settings import read_token, TOKEN_VARIABLE, ViewerSettings
import numpy as np
import pytest
from viewer_server import (
    CONFIDENCE, origin, picture, receive_picture, run, running, until, WAIT_S, watching)

TOKEN = 'a token of the test'
PATHS = [*PAGE, '/login']


@pytest.mark.parametrize('settings, words', [
    ({'port': 70000}, 'port'), ({'quality': 0}, 'quality'), ({'max_viewers': 0}, 'max_viewers'),
    ({'max_mbit': -1.0}, 'max_mbit'), ({'stale_after': 0.0}, 'stale_after'),
    ({'token': 'short'}, 'token'), ({'token': 201 * 'x'}, 'token'),
    ({'cert': Path('c.pem')}, 'cert, key'), ({'public_origin': 'robot.example'}, 'public_origin'),
    ({'public_origin': 'https://robot.example/viewer'}, 'public_origin'),
    ({'public_origin': 'ftp://robot.example'}, 'public_origin'),
], ids=lambda value: str(value))
def test_bad_settings_are_named(settings, words):
    with pytest.raises(ConfigError, match=words):
        ViewerSettings(**settings)


@pytest.mark.parametrize('host, needed', [
    ('127.0.0.1', False), ('127.9.9.9', False), ('::1', False), ('localhost', False),
    ('0.0.0.0', True), ('::', True), ('192.168.1.5', True), ('robot.local', True)])
def test_a_token_is_needed_off_loopback(host, needed):
    settings = ViewerSettings(host=host)
    assert bool(settings.token) == settings.fresh_token == needed
    assert not needed or len(settings.token) >= 24
    assert ViewerSettings(host=host, token=TOKEN).token == TOKEN
    assert settings.token != ViewerSettings(host=host).token or not needed


def test_token_comes_from_a_file_or_the_environment(tmp_path, monkeypatch):
    monkeypatch.setenv(TOKEN_VARIABLE, f'{TOKEN}\n')
    assert read_token(None) == TOKEN
    file = tmp_path / 'token'
    file.write_text('another token of the test\n')
    assert read_token(file) == 'another token of the test'
    file.write_text('\n')
    for path in (file, tmp_path / 'missing'):
        with pytest.raises(ConfigError, match='token_file'):
            read_token(path)


def test_every_answer_carries_the_safety_headers():
    async def test():
        async with running() as (client, _):
            for path in [*PATHS, '/missing']:
                answer = await client.get(path)
                assert answer.status == (404 if path == '/missing' else 200)
                assert {name: answer.headers[name] for name in HEADERS} == HEADERS
    run(test)
    policy = HEADERS['Content-Security-Policy']
    assert "default-src 'none'" in policy and 'unsafe' not in policy


def test_the_page_has_nothing_inline():
    folder = Path(access.__file__).parent / 'page'
    for page in folder.glob('*.html'):
        text = page.read_text()
        assert '<style' not in text and ' style=' not in text and ' on' + 'click' not in text
        assert text.count('<script') == text.count('<script type="module" src=')


@pytest.mark.parametrize('path', [
    '/../settings.py', '/..%2fsettings.py', '/%2e%2e/settings.py', '/page/viewer.js',
    '//etc/passwd', '/viewer.js/../../server.py', '/static/', '/login.html', '/index.html',
    '/viewer.css%00.js'])
def test_no_path_leads_out_of_the_page(path):
    async def test():
        async with running() as (client, _):
            reader, writer = await asyncio.open_connection('127.0.0.1', client.port)
            writer.write(f'GET {path} HTTP/1.1\r\nHost: localhost\r\nConnection: close\r\n\r\n'
                         .encode())
            status = await reader.readline()
            assert status.split()[1] in (b'404', b'400'), status
            writer.close()
    run(test)


@pytest.mark.parametrize('method', ['POST', 'PUT', 'DELETE', 'PATCH'])
def test_nothing_can_be_changed(method):
    async def test():
        async with running() as (client, _):
            for path in ('/', '/viewer.js', '/stream'):
                assert (await client.request(method, path)).status == 405
    run(test)


def test_nothing_but_the_login_is_served_without_the_token():
    async def test():
        async with running(token=TOKEN) as (client, _):
            opened = {path: (await client.get(path, allow_redirects=False)).status
                      for path in [*PATHS, '/stream', '/missing']}
            assert opened == dict.fromkeys([*PATHS, '/stream', '/missing'], 401) | {
                '/': 303, '/base.css': 200, '/icon.svg': 200, '/login': 200}
    run(test)


def test_token_is_exchanged_for_a_cookie():
    async def test():
        async with running(token=TOKEN) as (client, hub):
            for wrong in (TOKEN[:-1], TOKEN + 'x', '', 'ä' * 40):
                answer = await client.post('/login', data={'token': wrong},
                                           headers=origin(client))
                assert answer.status == 403 and 'not the token' in await answer.text()
                assert not answer.cookies
            answer = await client.post('/login', data={'token': TOKEN}, headers=origin(client),
                                       allow_redirects=False)
            assert (answer.status, answer.headers['Location']) == (303, '/')
            cookie, = answer.cookies.values()
            assert cookie['httponly'] and cookie['samesite'] == 'Strict' and cookie['path'] == '/'
            assert TOKEN not in cookie.value and not cookie['secure']
            page = await client.get('/', cookies={cookie.key: cookie.value})
            assert page.status == 200 and page.url.query_string == ''
            async with client.ws_connect('/stream', headers=origin(client)):
                await until(lambda: len(hub) == 1)
    with mock.patch('neo_ros.viewer.server.WRONG_TOKEN_PAUSE_S', 0.0):
        run(test)


def test_wrong_tokens_are_few_whoever_tries_them():
    async def test():
        async with running(token=TOKEN) as (client, hub):
            async def status_of(token):
                answer = await client.post('/login', data={'token': token}, headers={
                    **origin(client), 'Connection': 'close'}, allow_redirects=False)
                return answer.status

            assert [await status_of(f'{TOKEN}{number}') for number in range(MAX_WRONG_TOKENS)
                    ] == MAX_WRONG_TOKENS * [403]
            assert await status_of('another') == await status_of(TOKEN) == 429
            assert isinstance(hub.clock, HandClock)
            hub.clock.turn(WRONG_TOKENS_S)
            assert await status_of(TOKEN) == 303
    with mock.patch('neo_ros.viewer.server.WRONG_TOKEN_PAUSE_S', 0.0):
        run(test)


@pytest.mark.parametrize('host, public_origin', [
    ('robot.example', 'https://robot.example'), ('127.0.0.1:8600', 'https://robot.example'),
    ('robot.example', 'https://Robot.Example/'), ('127.0.0.1:8600', 'https://robot.example:443'),
    ('robot.example', 'HTTPS://robot.example')],
    ids=['host kept', 'host of the proxy', 'capitals', 'port', 'scheme'])
def test_behind_a_proxy_that_speaks_tls(host, public_origin):
    async def test():
        settings = {'token': TOKEN, 'public_origin': public_origin}
        async with running(**settings) as (client, hub):
            headers = {'Host': host, 'Origin': 'https://robot.example'}
            answer = await client.post('/login', data={'token': TOKEN}, headers=headers,
                                       allow_redirects=False)
            assert (answer.status, answer.headers['Location']) == (303, '/')
            cookie, = answer.cookies.values()
            assert cookie['secure'] and cookie['httponly']
            headers['Cookie'] = f'{cookie.key}={cookie.value}'
            async with client.ws_connect('/stream', headers=headers):
                await until(lambda: len(hub) == 1)
            for foreign in ('https://robot.example.evil', 'http://robot.example', 'null'):
                answer = await client.post('/login', data={'token': TOKEN}, headers={
                    'Host': host, 'Origin': foreign})
                assert answer.status == 403
    run(test)


def test_whoever_comes_through_a_proxy_needs_a_token():
    settings = ViewerSettings(public_origin='https://robot.example')
    assert settings.on_loopback and settings.fresh_token and len(settings.token) >= 24


def test_session_survives_a_restart_but_not_another_token_or_its_end():
    async def cookies_of(client):
        answer = await client.post('/login', data={'token': TOKEN}, headers=origin(client),
                                   allow_redirects=False)
        cookie, = answer.cookies.values()
        return cookie.value

    async def status(client, value):
        answer = await client.get('/viewer.js', headers={
            'Cookie': f'neo_viewer_{client.port}={value}'})
        return answer.status

    async def test():
        async with running(token=TOKEN) as (client, _):
            value = await cookies_of(client)
        async with running(token=TOKEN) as (client, _):
            assert await status(client, value) == 200
            end, _, proof = value.partition('.')
            for forged in (f'{int(end) + 1}.{proof}', f'{end}.{proof[:-1]}', f'{end}.', 'x.y',
                           f'{end}.{"0" * 64}', '٣.' + proof, f'"{end}.\\377"'):
                assert await status(client, forged) == 401, forged
            with mock.patch('neo_ros.viewer.access.time.time', lambda: int(end) + 1):
                assert await status(client, value) == 401
        async with running(token=TOKEN + '!') as (client, _):
            assert await status(client, value) == 401
    run(test)


@pytest.mark.parametrize('headers', [
    {}, {'Origin': 'http://evil.example'}, {'Origin': 'null'}, {'Origin': 'http://127.0.0.1:1'},
], ids=['none', 'foreign', 'null', 'other port'])
def test_requests_of_other_sites_are_refused(headers):
    async def test():
        async with running(token=TOKEN) as (client, _):
            answer = await client.post('/login', data={'token': TOKEN}, headers=headers)
            assert answer.status == 403
        async with running() as (client, hub):
            with pytest.raises(WSServerHandshakeError) as refused:
                await client.ws_connect('/stream', headers=headers)
            assert refused.value.status == 403 and len(hub) == 0
    run(test)


def test_without_a_token_only_names_of_this_machine_are_served():
    async def test():
        async with running() as (client, _):
            for host, status in (('localhost:1', 200), ('127.0.0.1', 200), ('[::1]:8600', 200),
                                 ('evil.example', 421), ('127.0.0.1.evil.example', 421),
                                 ('a b', 421)):
                assert (await client.get('/', headers={'Host': host})).status == status, host
        async with running(token=TOKEN) as (client, _):
            assert (await client.get('/login', headers={'Host': 'robot.local'})).status == 200
    run(test)


def test_large_requests_are_refused():
    async def test():
        async with running(token=TOKEN) as (client, _):
            answer = await client.post('/login', data={'token': 'x' * 5000},
                                       headers=origin(client))
            assert answer.status == 413
    run(test)


def test_no_more_viewers_than_allowed():
    async def test():
        async with running(max_viewers=2) as (client, hub):
            async with watching(client), watching(client):
                async with client.ws_connect('/stream', headers=origin(client)) as third:
                    message = await third.receive()
                    assert (third.close_code, message.extra) == (4001, 'too many viewers')
                assert len(hub) == 2
            await until(lambda: len(hub) == 0)
            async with watching(client):
                assert len(hub) == 1
    run(test)


def test_a_link_that_stands_still_keeps_nobody_waiting(monkeypatch):
    async def never(**_):
        await asyncio.Event().wait()

    monkeypatch.setattr(hearing, 'HANG_UP_S', 0.05)
    run(lambda: hearing.hang_up(mock.Mock(close=never), 1001))


def test_who_waits_for_the_map_takes_no_worker_from_others():
    drawn = threading.Event()
    surroundings = mock.Mock(plan=lambda: drawn.wait(WAIT_S) and None, why='none', looks=None)

    async def test():
        async with running(surroundings) as (client, _):
            waiting = [asyncio.create_task(client.get('/map')) for _ in range(40)]
            await asyncio.sleep(0.2)
            assert await asyncio.wait_for(asyncio.to_thread(lambda: 7), WAIT_S) == 7
            assert not any(task.done() for task in waiting)
            drawn.set()
            for answer in await asyncio.gather(*waiting):
                assert await answer.json() == {'why': 'none'}
    run(test)


def test_a_map_that_cannot_be_drawn_keeps_nobody_waiting():
    surroundings = mock.Mock(plan=mock.Mock(side_effect=MemoryError('too large')), looks=None)

    async def test():
        async with running(surroundings) as (client, _):
            assert (await client.get('/map')).status == 500
    run(test)


@pytest.mark.parametrize('send, code', [
    (lambda socket: socket.send_str('x' * 600), 1009),
    (lambda socket: socket.send_bytes(b'x'), 1003),
    (lambda socket: socket.send_str('not json'), 1007),
    (lambda socket: socket.send_str('[]'), 1007),
    (lambda socket: socket.send_str('17'), 1007),
    (lambda socket: socket.send_str('{"shown": "one"}'), 1007),
    (lambda socket: socket.send_str('{"shown": Infinity}'), 1007),
    (lambda socket: socket.send_str('{"ping": [1]}'), 1007),
], ids=['large', 'binary', 'no json', 'list', 'number', 'no seq', 'endless seq', 'no ping'])
def test_a_viewer_that_talks_nonsense_is_cut_off(send, code):
    async def test():
        async with running() as (client, hub):
            async with watching(client) as good, watching(client) as bad:
                await send(bad)
                while not bad.closed:
                    await asyncio.wait_for(bad.receive(), WAIT_S)
                assert bad.close_code == code
                await until(lambda: len(hub) == 1)
                hub.publish(picture())
                assert (await receive_picture(good))[0]['seq'] == 1
    run(test)


def test_pictures_and_confidence_arrive_as_asked():
    async def test():
        async with running(quality=95) as (client, hub):
            async with watching(client) as plain, watching(client) as full:
                await full.send_json({'confidence': True})
                await until(lambda: hub.wanted.confidence)
                hub.publish(picture())
                meta, image, confidence = await receive_picture(plain)
                assert meta['seen'] == [0.25, 0.25, 0.5, 0.5] and meta['timed'] is True
                assert image.startswith(b'\xff\xd8\xff') and confidence == b''
                _, same, confidence = await receive_picture(full)
                grey = cv2.imdecode(np.frombuffer(confidence, np.uint8), cv2.IMREAD_UNCHANGED)
                assert grey is not None
                assert same == image and grey.shape == CONFIDENCE.shape
                assert abs(int(grey.mean()) - 64) <= 1 and hub.encoded == 1
                hub.publish(picture(b'\xff\xd8\xffpassed on'))
                assert (await receive_picture(plain))[1] == b'\xff\xd8\xffpassed on'
    run(test)


def test_tls(tmp_path):
    if shutil.which('openssl') is None:
        pytest.skip('openssl is not installed')
    cert, key = tmp_path / 'cert.pem', tmp_path / 'key.pem'
    subprocess.run(['openssl', 'req', '-x509', '-newkey', 'ec', '-pkeyopt',
                    'ec_paramgen_curve:P-256', '-nodes', '-days', '2', '-subj', '/CN=localhost',
                    '-addext', 'subjectAltName=IP:127.0.0.1', '-keyout', key, '-out', cert],
                   check=True, capture_output=True)
    script = ('import sys; from neo_ros.viewer.server import serve; '
              'from neo_ros.viewer.settings import ViewerSettings; from pathlib import Path\n'
              'class Nothing:\n    def run(self, hub, stop): stop.wait()\n'
              'serve(Nothing(), ViewerSettings(port=0, token="a token of the test", '
              'cert=Path(sys.argv[1]), key=Path(sys.argv[2])), lambda line: print(line, '
              'flush=True))')
    process = subprocess.Popen([sys.executable, '-c', script, cert, key], text=True,
                               stdout=subprocess.PIPE)
    try:
        assert process.stdout is not None
        url = process.stdout.readline().split()[-1]
        assert url.startswith('https://127.0.0.1:')
        context = ssl.create_default_context(cafile=cert)
        with urllib.request.urlopen(f'{url}login', context=context, timeout=WAIT_S) as answer:
            assert answer.status == 200
        connection = http.client.HTTPSConnection(
            '127.0.0.1', int(url.rsplit(':')[-1].strip('/')), context=context, timeout=WAIT_S)
        connection.request('POST', '/login', 'token=a+token+of+the+test', {
            'Origin': url.rstrip('/'), 'Content-Type': 'application/x-www-form-urlencoded'})
        answer = connection.getresponse()
        assert answer.status == 303 and 'Secure' in answer.headers['Set-Cookie']
    finally:
        process.terminate()
        assert process.wait(WAIT_S) == 0
    with pytest.raises(ConfigError, match='cert, key'):
        ViewerSettings(cert=key, key=cert).tls()
