"""The page in a real browser: plays, tells what is made up, and says when not to trust it."""
from collections.abc import Iterator
import json
from pathlib import Path
import signal
import time
from typing import Any

import cv2
from narrow_link import narrow_link
import numpy as np
import pytest
from viewer_pages import (
    CONTRAST, HELPERS, KEEP_SOCKETS, opened_page, ServerProcess, wait_for, WAIT_S)
from viewer_process import HEIGHT, INSIDE, RING, WIDTH

# The first of all fixtures: without a browser nothing need start.
pytestmark = [pytest.mark.slow, pytest.mark.usefixtures('browser')]

TOKEN = 'a token of the test'
MORE_VIEWERS = HELPERS / 'more_viewers.js'
TRUE_AGES = HELPERS / 'true_ages.js'
OVERLAPS = HELPERS / 'overlaps.js'
# Where the ring and the camera's frame are in the picture, in shares of it.
LEFT_RING, RIGHT_RING, CENTRE = (0.1, 0.5), (0.9, 0.5), (0.5, 0.5)


class Viewer(ServerProcess):
    """Restartable at the same port."""

    def __init__(self, token: str = '') -> None:
        self.port, self.token = 0, token
        self.start()

    def start(self, rate: float = 20.0) -> None:
        self.launch('viewer_process.py', str(self.port), self.token, str(rate))
        self.port = int(self.url.rstrip('/').rpartition(':')[-1])


@pytest.fixture(scope='module')
def viewer() -> Iterator[Viewer]:
    viewer = Viewer()
    yield viewer
    viewer.stop()


@pytest.fixture
def page(browser: Any, viewer: Viewer) -> Iterator[Any]:
    """Give a page that shows live pictures and, at the end, has raised no error."""
    with opened_page(browser, allowed='CONNECTION_REFUSED') as page:
        viewer.tell('go')
        page.add_init_script(KEEP_SOCKETS)
        page.goto(viewer.url)
        wait_for_state(page, 'live')
        yield page


def wait_for_state(page: Any, state: str, timeout: float = WAIT_S) -> None:
    page.wait_for_selector(f'#connection[data-state={state}]', timeout=1e3 * timeout)


def pixel(page: Any, place: tuple[float, float]) -> list[int]:
    """Return RGB of the canvas at a place, in shares of the picture."""
    return page.evaluate("""([x, y]) => {
        const canvas = document.getElementById('picture');
        const data = canvas.getContext('2d').getImageData(
            Math.round(x * canvas.width), Math.round(y * canvas.height), 1, 1).data;
        return [...data].slice(0, 3);
    }""", list(place))


def left_line(page: Any) -> list[bool]:
    """Return for every row where the frame's left side is white."""
    return page.evaluate("""() => {
        const canvas = document.getElementById('picture');
        const [width, height] = [Math.round(canvas.width / 60), Math.round(canvas.height * 0.4)];
        const data = canvas.getContext('2d').getImageData(
            Math.round(canvas.width / 4 - width / 2), Math.round(canvas.height * 0.3),
            width, height).data;
        return Array.from({length: height}, (_, y) => Array.from({length: width}, (_, x) =>
            Math.min(...data.slice(4 * (y * width + x), 4 * (y * width + x) + 3)))
            .some((white) => white > 120));
    }""")


def wait_for_pixel(page: Any, place: tuple[float, float], expected: Any) -> None:
    deadline = time.monotonic() + WAIT_S
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
    wait_for(page, lambda: 5 < float(page.inner_text('#rate').split()[0]) < 40)
    assert int(page.inner_text('#latency').split()[0]) >= 0
    wait_for(page, lambda: float(page.inner_text('#age').split()[0]) < 0.8)
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
    wait_for_state(page, 'live')
    page.wait_for_selector('#stale-sign', state='hidden')


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
        wait_for_state(page, 'stale')
        wait_for_state(page, 'lost')
    finally:
        viewer.process.send_signal(signal.SIGCONT)
    wait_for_state(page, 'live')


def test_out_of_the_scene_and_other_warnings(page: Any, viewer: Viewer) -> None:
    viewer.tell({'out_of_scene': True, 'level': 1, 'message': 'unlike <b>the scene</b>'})
    page.wait_for_selector('#scene-sign', state='visible')
    assert 'Not in the trained scene' in page.inner_text('#scene-sign')
    assert page.inner_text('#notice') == 'Warning of the node: unlike <b>the scene</b>'
    said = 'Live. Not in the trained scene. Warning of the node: unlike <b>the scene</b>'
    wait_for(page, lambda: page.inner_text('#announcer') == said)
    page.keyboard.press('r')
    wait_for(page, lambda: 'Rate' in page.inner_text('#announcer'))
    assert 'Warning of the node: unlike' in page.inner_text('#announcer')
    page.keyboard.press('f')
    page.wait_for_selector('#stage:fullscreen')
    assert page.is_visible('#notice') and page.evaluate(
        'document.getElementById("stage").contains(document.getElementById("notice"))')
    page.keyboard.press('f')
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


def test_a_place_that_is_not_recognised(page: Any, viewer: Viewer) -> None:
    page.keyboard.press('1')
    assert np.mean(left_line(page)) == 1.0
    viewer.tell({'recognised': False})
    page.wait_for_selector('#place-sign', state='visible')
    assert 'Place not recognised: rough guess' in page.inner_text('#place-sign')
    assert 'rough guess of the network alone' in page.inner_text('#explanation')
    assert 0.3 < np.mean(left_line(page)) < 0.8, 'dashes'
    wait_for(page, lambda: page.inner_text('#announcer')
             == 'Live. Place not recognised: rough guess.')
    viewer.tell({'out_of_scene': True})
    page.wait_for_selector('#scene-sign', state='visible')
    assert page.is_hidden('#place-sign'), 'the stronger sign alone'
    viewer.tell({'out_of_scene': False, 'recognised': True})
    wait_for(page, lambda: 'remembers of the room' in page.inner_text('#explanation'))
    wait_for(page, lambda: page.is_hidden('#place-sign'))
    viewer.tell({'recognised': None})


def test_a_recording_is_not_live(page: Any, viewer: Viewer) -> None:
    assert page.is_hidden('#bag-time')
    viewer.tell({'span': [1.7e9, 1.7e9 + 125]})
    wait_for_state(page, 'recording')
    page.wait_for_selector('#bag-time', state='visible')
    assert page.inner_text('#connection') == page.title().split(' · ')[0] == 'Recording'
    wait_for(page, lambda: page.inner_text('#bag-time').endswith(' of 2:05.0'))
    assert page.is_hidden('#stale-sign')
    with page.expect_download() as download:
        page.keyboard.press('s')
    assert download.value.suggested_filename.startswith('wide_2023-11-14T22-')
    viewer.tell('stop')
    wait_for_state(page, 'stale')
    viewer.tell('go')
    wait_for_state(page, 'recording')
    viewer.tell({'span': None})
    wait_for_state(page, 'live')


def test_no_old_age_stands_beside_live(page: Any, viewer: Viewer) -> None:
    page.evaluate("""() => {
        window.seen = [];
        const look = () => window.seen.push([document.getElementById('connection').textContent,
            parseFloat(document.getElementById('age').textContent)]);
        new MutationObserver(look).observe(document.getElementById('connection'),
            {childList: true, characterData: true, subtree: true});
    }""")
    for _ in range(3):
        viewer.tell('stop')
        wait_for_state(page, 'stale')
        page.wait_for_timeout(700)
        viewer.tell('go')
        wait_for_state(page, 'live')
    seen = page.evaluate('window.seen')
    assert sum(title == 'Live' for title, _ in seen) == 3
    assert all(age <= 0.8 for title, age in seen if title == 'Live'), seen


def test_age_is_true_on_a_thin_link(browser: Any, viewer: Viewer) -> None:
    viewer.tell('go')
    context = browser.new_context()
    page = context.new_page()
    page.add_init_script(path=TRUE_AGES)
    with narrow_link(viewer.port) as link:
        page.goto(f'http://127.0.0.1:{link.port}/')
        wait_for_state(page, 'live')
        link.narrow(3e3, 0.1)
        wait_for_state(page, 'lost')
        wait_for(page, lambda: page.evaluate('window.arrivals.length') >= 60, 120.0)
        readings = page.evaluate("""() => new Promise((done) => {
            const latency = document.getElementById('latency');
            const found = [];
            new MutationObserver(() => {
                found.push([latency.textContent, window.arrivals.slice(-20)]);
                if (found.length === 5) done(found);
            }).observe(latency, {childList: true, characterData: true, subtree: true});
        })""")
    context.close()
    # The server's clock began at another time than the wall's, which the browser knows.
    began_ms = 1e3 * (time.monotonic() - time.time())
    true_ms = [np.median(arrivals) + began_ms for _, arrivals in readings]
    assert min(true_ms) > 400, 'a thin link'
    # A picture may have arrived and not be counted yet: of five readings the middle one.
    errors = [int(shown.split()[0]) / true - 1 for (shown, _), true in zip(readings, true_ms)]
    assert abs(np.median(errors)) < 0.05, (readings, true_ms)


def test_a_thin_link_says_that_its_picture_is_smaller(browser: Any, viewer: Viewer) -> None:
    viewer.tell('go')
    context = browser.new_context()
    page = context.new_page()
    with narrow_link(viewer.port) as link:
        page.goto(f'http://127.0.0.1:{link.port}/')
        wait_for_state(page, 'live')
        wait_for(page, lambda: page.inner_text('#size') == f'{WIDTH} × {HEIGHT}')
        link.narrow(2e3, 0.0)
        small = f'{WIDTH // 2} × {HEIGHT // 2} (thin link: smaller picture)'
        wait_for(page, lambda: page.inner_text('#size') == small, 120.0)
        link.narrow(1e9, 0.0)
        wait_for(page, lambda: page.inner_text('#size') == f'{WIDTH} × {HEIGHT}')
    context.close()


def test_a_page_that_gave_its_place_away_says_so_and_comes_back(page: Any) -> None:
    # The server would take a minute; what the page does of its code shows at once.
    page.evaluate("""() => {
        Object.defineProperty(document, 'hidden', {value: true, configurable: true});
        document.dispatchEvent(new Event('visibilitychange'));
        const socket = window.sockets.findLast(({ url }) => url.endsWith('/stream'));
        socket.onclose({code: 4002});
        socket.close();
    }""")
    wait_for_state(page, 'asleep')
    assert 'gave its place away' in page.inner_text('#stale-text')
    page.wait_for_timeout(1000)
    assert page.get_attribute('#connection', 'data-state') == 'asleep', 'while it is hidden'
    page.evaluate("""() => {
        Object.defineProperty(document, 'hidden', {value: false});
        document.dispatchEvent(new Event('visibilitychange'));
    }""")
    wait_for_state(page, 'live')


@pytest.mark.parametrize('width, height', [
    (683, 384), (911, 512), (667, 375), (375, 667), (640, 360)],
    ids=['1366x768 at 200 %', '1366x768 at 150 %', 'landscape phone', 'phone', '720p at 200 %'])
def test_nothing_covers_anything(browser: Any, viewer: Viewer, width: int, height: int) -> None:
    viewer.tell({'out_of_scene': True, 'level': 2, 'message': 5 * 'unlike the scene ',
                 'span': [1.7e9, 1.7e9 + 125]})
    context = browser.new_context(viewport={'width': width, 'height': height})
    page = context.new_page()
    page.goto(viewer.url)
    page.wait_for_selector('#scene-sign', state='visible')
    wait_for_state(page, 'recording')
    for key in '1234':
        page.keyboard.press(key)
        assert page.evaluate(OVERLAPS.read_text()) == []
    viewer.tell('stop')
    wait_for_state(page, 'stale')
    assert page.evaluate(OVERLAPS.read_text()) == []
    viewer.tell('go')
    viewer.tell({'out_of_scene': False, 'level': 0, 'message': '', 'span': None})
    context.close()


def test_forced_colours_keep_the_scale(browser: Any, viewer: Viewer) -> None:
    context = browser.new_context(forced_colors='active')
    page = context.new_page()
    page.goto(viewer.url)
    wait_for_state(page, 'live')
    page.keyboard.press('3')
    assert 'gradient' in page.evaluate(
        'getComputedStyle(document.querySelector(".scale i")).backgroundImage')
    assert page.evaluate(
        'getComputedStyle(document.querySelector(".scale i")).forcedColorAdjust') == 'none'
    context.close()


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
    contrast = page.evaluate(CONTRAST)
    page.keyboard.press('?')
    contrast |= page.evaluate(CONTRAST)
    assert len(contrast) > 20
    assert {name: ratio for name, ratio in contrast.items() if ratio < 4.5} == {}
    # Phones: nothing to scroll sideways, and targets that a finger hits.
    assert page.evaluate('document.documentElement.scrollWidth') <= 320
    page.keyboard.press('Escape')
    for element in page.query_selector_all('button:visible, fieldset label'):
        box = element.bounding_box()
        assert box['height'] >= 44 and box['width'] >= 44
    names = page.evaluate("""() => [...document.querySelectorAll(
        'button, input, canvas:not([aria-hidden]), section')
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
