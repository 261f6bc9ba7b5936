"""The page in a real browser: plays, tells what is made up, and says when not to trust it."""
from collections.abc import Iterator
import json
import os
from pathlib import Path
import shutil
import signal
import subprocess
import sys
import time
from typing import Any

import cv2
import neo_ros
import numpy as np
import pytest
from viewer_process import HEIGHT, INSIDE, RING, WIDTH

pytestmark = pytest.mark.slow

CHROMIUM = shutil.which('chromium') or shutil.which('chromium-browser')
if CHROMIUM is None:
    pytest.skip('needs a browser: apt install chromium', allow_module_level=True)
playwright_api = pytest.importorskip('playwright.sync_api', reason='comes with the extra dev')

TOKEN = 'a token of the test'
HELPERS = Path(__file__).parents[1] / 'helpers'
PROCESS = HELPERS / 'viewer_process.py'
PYTHONPATH = {'PYTHONPATH': str(Path(neo_ros.__file__).parents[1])}
CONTRAST = HELPERS / 'contrast.js'
MORE_VIEWERS = HELPERS / 'more_viewers.js'
# Where the ring and the camera's frame are in the picture, in shares of it.
LEFT_RING, RIGHT_RING, CENTRE = (0.1, 0.5), (0.9, 0.5), (0.5, 0.5)


class Viewer:
    """The server's process; restartable at the same port."""

    def __init__(self, token: str = '') -> None:
        self.port, self.token = 0, token
        self.start()

    def start(self, rate: float = 20.0) -> None:
        self.process = subprocess.Popen(
            [sys.executable, PROCESS, str(self.port), self.token, str(rate)], text=True,
            stdin=subprocess.PIPE, stdout=subprocess.PIPE, env=os.environ | PYTHONPATH)
        assert self.process.stdout is not None
        self.url = self.process.stdout.readline().split()[-1]
        self.port = int(self.url.rstrip('/').rpartition(':')[-1])

    def tell(self, command: str | dict[str, Any]) -> None:
        line = command if isinstance(command, str) else json.dumps(command)
        assert self.process.stdin is not None
        self.process.stdin.write(f'{line}\n')
        self.process.stdin.flush()

    def stop(self) -> None:
        self.process.terminate()
        assert self.process.wait(10) == 0


@pytest.fixture(scope='module')
def browser() -> Iterator[Any]:
    with playwright_api.sync_playwright() as playwright:
        browser = playwright.chromium.launch(
            executable_path=CHROMIUM, args=['--no-sandbox', '--disable-gpu'])
        yield browser
        browser.close()


@pytest.fixture(scope='module')
def viewer() -> Iterator[Viewer]:
    viewer = Viewer()
    yield viewer
    viewer.stop()


@pytest.fixture
def page(browser: Any, viewer: Viewer) -> Iterator[Any]:
    """Give a page that shows live pictures and, at the end, has raised no error."""
    context = browser.new_context(viewport={'width': 1000, 'height': 700})
    page = context.new_page()
    problems: list[str] = []
    page.on('pageerror', lambda error: problems.append(str(error)))
    page.on('console', lambda line: problems.append(line.text) if (
        line.type == 'error' and 'CONNECTION_REFUSED' not in line.text) else None)
    viewer.tell('go')
    page.goto(viewer.url)
    wait_for_state(page, 'live')
    yield page
    context.close()
    assert problems == []


def wait_for_state(page: Any, state: str, timeout: float = 15.0) -> None:
    page.wait_for_selector(f'#connection[data-state={state}]', timeout=1e3 * timeout)


def pixel(page: Any, place: tuple[float, float]) -> list[int]:
    """Return RGB of the canvas at a place, in shares of the picture."""
    return page.evaluate("""([x, y]) => {
        const canvas = document.getElementById('picture');
        const data = canvas.getContext('2d').getImageData(
            Math.round(x * canvas.width), Math.round(y * canvas.height), 1, 1).data;
        return [...data].slice(0, 3);
    }""", list(place))


def wait_for_pixel(page: Any, place: tuple[float, float], expected: Any) -> None:
    deadline = time.monotonic() + 5
    while np.abs(np.subtract(found := pixel(page, place), expected)).max() > 12:
        assert time.monotonic() < deadline, (place, found, expected)
        page.wait_for_timeout(50)


def test_the_stream_plays(page: Any) -> None:
    seen = set()
    for _ in range(40):
        seen.add(json.dumps([pixel(page, (x, 0.97)) for x in (0.1, 0.3, 0.5, 0.7, 0.9)]))
        page.wait_for_timeout(30)
    assert len(seen) >= 3, 'the spot moves'
    page.wait_for_timeout(1500)
    rate = float(page.inner_text('#rate').split()[0])
    assert 5 < rate < 40
    assert 0 <= int(page.inner_text('#latency').split()[0]) < 500
    assert float(page.inner_text('#age').split()[0]) < 0.8
    assert page.inner_text('#source') == '/camera/wide/image'
    assert page.inner_text('#node-latency') == '12 ms'
    assert page.inner_text('#size') == f'{WIDTH} × {HEIGHT}'
    assert page.is_hidden('#stale-sign') and page.is_hidden('#scene-sign')


@pytest.mark.parametrize('how', ['key', 'click', 'arrows'])
def test_ways_to_show_what_is_made_up(page: Any, how: str) -> None:
    dim = [0.38 * value for value in RING]
    tinted = np.add(np.multiply(0.2, RING), np.multiply(0.8, (255, 64, 129)))
    shown = {'Dim': (dim, dim), 'Confidence': (tinted, RING),
             'Camera only': ((0, 0, 0), (0, 0, 0)), 'Outline': (RING, RING)}
    page.focus('input[value=outline]')
    for number, (name, (left, right)) in zip('2341', shown.items()):
        if how == 'key':
            page.keyboard.press(number)
        elif how == 'arrows':
            page.keyboard.press('ArrowRight')
        else:
            page.click(f'role=radio[name="{name}"]')
        wait_for_pixel(page, LEFT_RING, left)
        wait_for_pixel(page, RIGHT_RING, right)
        wait_for_pixel(page, CENTRE, INSIDE)
        assert page.is_checked(f'role=radio[name="{name}"]')
        # The line around the camera's frame: white, with black beside it.
        line = [pixel(page, (0.25 + step / 1000, 0.5)) for step in range(-8, 9)]
        assert max(map(min, line)) > 120
    page.keyboard.press('2')
    page.reload()
    wait_for_state(page, 'live')
    assert page.is_checked('role=radio[name="Dim"]'), 'the choice is remembered'
    page.keyboard.press('1')


def test_stale_within_a_second_and_live_again(page: Any, viewer: Viewer) -> None:
    # The page's own clock: this process may be slow to look.
    page.evaluate("""() => new MutationObserver(() => {
        window.ageWhenStale ??= document.getElementById('age').textContent;
    }).observe(document.getElementById('stale-sign'), {attributes: true})""")
    viewer.tell('stop')
    page.wait_for_selector('#stale-sign', state='visible')
    assert 0.3 < float(page.evaluate('window.ageWhenStale').split()[0]) < 1.0
    assert page.inner_text('#stale-title') == 'Stale'
    assert 'old' in page.inner_text('#stale-text')
    page.wait_for_timeout(1700)
    assert page.inner_text('#announcer') == 'Stale.'
    assert float(page.inner_text('#age').split()[0]) > 1.5
    viewer.tell('go')
    wait_for_state(page, 'live', 2.0)
    assert page.is_hidden('#stale-sign')


def test_reconnects_after_the_server_restarts(page: Any, viewer: Viewer) -> None:
    viewer.stop()
    wait_for_state(page, 'lost')
    assert page.inner_text('#stale-title') == 'Stale · Disconnected'
    page.wait_for_timeout(1000)
    viewer.start()
    wait_for_state(page, 'live')
    wait_for_pixel(page, CENTRE, INSIDE)


def test_a_frozen_server_is_noticed(page: Any, viewer: Viewer) -> None:
    viewer.process.send_signal(signal.SIGSTOP)
    try:
        wait_for_state(page, 'stale', 1.5)
        wait_for_state(page, 'lost', 5.0)
    finally:
        viewer.process.send_signal(signal.SIGCONT)
    wait_for_state(page, 'live')


def test_out_of_the_scene_and_other_warnings(page: Any, viewer: Viewer) -> None:
    viewer.tell({'out_of_scene': True, 'level': 1, 'message': 'unlike <b>the scene</b>'})
    page.wait_for_selector('#scene-sign', state='visible')
    assert 'Not in the trained scene' in page.inner_text('#scene-sign')
    assert page.inner_text('#notice') == 'Warning of the node: unlike <b>the scene</b>'
    page.wait_for_timeout(2000)
    assert page.inner_text('#announcer') == 'Live. Not in the trained scene.'
    viewer.tell({'out_of_scene': False, 'level': 0, 'message': ''})
    page.wait_for_selector('#scene-sign', state='hidden')
    assert page.is_hidden('#notice')
    viewer.tell('stop')
    viewer.tell({'waiting': 'waiting for /camera/wide/image, publishers: 0'})
    wait_for_state(page, 'waiting')
    assert 'publishers: 0' in page.inner_text('#stale-text')
    viewer.tell({'waiting': ''})
    viewer.tell('go')
    wait_for_state(page, 'live')


def test_snapshot_holds_the_picture_and_says_what_it_is(page: Any, tmp_path: Path) -> None:
    page.keyboard.press('2')
    wait_for_pixel(page, LEFT_RING, [0.38 * value for value in RING])
    with page.expect_download() as download:
        page.keyboard.press('s')
    path = tmp_path / 'snapshot.png'
    download.value.save_as(path)
    assert download.value.suggested_filename.startswith('wide_20')
    saved = cv2.imread(str(path))
    assert saved is not None
    image = cv2.cvtColor(saved, cv2.COLOR_BGR2RGB)
    scale = image.shape[1] // WIDTH
    assert scale >= 1 and image.shape[0] > HEIGHT * scale
    ring = image[HEIGHT * scale // 2, WIDTH * scale // 10]
    assert np.abs(np.subtract(ring, [0.38 * value for value in RING])).max() < 12
    assert image[HEIGHT * scale:].max() > 200, 'the caption'
    page.keyboard.press('1')


def test_full_screen_and_the_list_of_keys(page: Any) -> None:
    page.keyboard.press('f')
    page.wait_for_selector('#stage:fullscreen')
    assert page.is_visible('#rate') and page.get_attribute('#full-screen', 'aria-pressed')
    page.keyboard.press('f')
    page.keyboard.press('?')
    page.wait_for_selector('#keys', state='visible')
    page.uncheck('#keys-on')
    page.keyboard.press('Escape')
    page.keyboard.press('2')
    assert page.is_checked('role=radio[name="Outline"]'), 'the keys are switched off'


def test_log_in_with_the_token(browser: Any) -> None:
    viewer = Viewer(TOKEN)
    page = browser.new_page()
    try:
        page.goto(viewer.url)
        assert page.url == f'{viewer.url}login'
        page.get_by_label('Token').fill('wrong')
        page.keyboard.press('Enter')
        page.wait_for_selector('role=alert')
        assert 'not the token' in page.inner_text('role=alert')
        page.get_by_label('Token').fill(TOKEN)
        page.click('role=button[name="Log in"]')
        wait_for_state(page, 'live')
        assert page.url == viewer.url
        assert page.evaluate('document.cookie') == '', 'out of reach for scripts'
        viewer.stop()
        viewer.start()
        wait_for_state(page, 'live')
        viewer.stop()
        viewer.token = TOKEN + ' changed'
        viewer.start()
        page.wait_for_url('**/login')
    finally:
        page.close()
        viewer.stop()


@pytest.mark.parametrize('scheme', ['light', 'dark'])
def test_contrast_names_and_widths(browser: Any, viewer: Viewer, scheme: str) -> None:
    context = browser.new_context(color_scheme=scheme, viewport={'width': 320, 'height': 640})
    page = context.new_page()
    page.goto(viewer.url)
    wait_for_state(page, 'live')
    viewer.tell({'out_of_scene': True, 'level': 2, 'message': 'unlike the scene'})
    viewer.tell('stop')
    wait_for_state(page, 'stale')
    page.keyboard.press('3')
    page.wait_for_timeout(300)
    contrast = page.evaluate(CONTRAST.read_text())
    page.keyboard.press('?')
    contrast |= page.evaluate(CONTRAST.read_text())
    assert len(contrast) > 20
    assert {name: ratio for name, ratio in contrast.items() if ratio < 4.5} == {}
    # Phones: nothing to scroll sideways, and targets that a finger hits.
    assert page.evaluate('document.documentElement.scrollWidth') <= 320
    page.keyboard.press('Escape')
    for element in page.query_selector_all('button:visible, fieldset label'):
        box = element.bounding_box()
        assert box['height'] >= 44 and box['width'] >= 44
    names = page.evaluate("""() => [...document.querySelectorAll('button, input, canvas, section')
        ].map((e) => e.ariaLabel || e.labels?.[0]?.textContent || e.textContent)""")
    assert all(name.strip() for name in names)
    viewer.tell({'out_of_scene': False, 'level': 0, 'message': ''})
    viewer.tell('go')
    context.close()


def test_twenty_viewers_watch_and_one_more_does_not(page: Any, browser: Any,
                                                    viewer: Viewer) -> None:
    page.wait_for_selector('#viewers:text-is("1")')  # Those of other tests have left.
    # Twenty pages would measure how long Chromium takes to start them.
    counts = page.evaluate(MORE_VIEWERS.read_text())
    # 20 Hz for 2 s, on a machine that may be busy.
    assert len(counts) == 19 and min(counts) > 20
    assert page.inner_text('#viewers') == '20'
    wait_for_state(page, 'live')
    context = browser.new_context()
    extra = context.new_page()
    extra.goto(viewer.url)
    wait_for_state(extra, 'full')
    assert 'As many viewers' in extra.inner_text('#stale-text')
    context.close()
