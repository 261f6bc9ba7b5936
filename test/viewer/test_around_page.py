"""The map and looking around in a real browser, in a room whose every view is known."""
from collections.abc import Iterator
import math
from typing import Any

from box_room import cast, planar
import numpy as np
import pytest
from viewer_pages import (
    close_sockets, CONTRAST, KEEP_SOCKETS, opened_page, ServerProcess, wait_for)

# The first of all fixtures: without a browser nothing need start.
pytestmark = [pytest.mark.slow, pytest.mark.usefixtures('browser')]

START = {'x': 1.9, 'y': 1.7, 'yaw': 30.0, 'lost': False, 'late': 0.0, 'torn': False}
# What an arrow key turns, radians, and + zooms by; the wide view is shown at first.
STEP, ZOOM, FIELD = 0.12, 1.15, 1.75
YELLOW = (255, 214, 0)


@pytest.fixture(scope='module')
def viewer(tmp_path_factory: pytest.TempPathFactory) -> Iterator[ServerProcess]:
    viewer = start(str(tmp_path_factory.mktemp('around')))
    yield viewer
    viewer.stop()


def start(folder: str) -> ServerProcess:
    return ServerProcess('around_process.py', folder)


@pytest.fixture
def page(browser: Any, viewer: ServerProcess) -> Iterator[Any]:
    """Give a page that shows the map and, at the end, has raised no error."""
    with opened_page(browser, has_touch=True) as page:
        viewer.tell(START)
        page.goto(viewer.url)
        page.wait_for_selector('#map', state='visible', timeout=60_000)
        wait_for(page, lambda: 'x 1.9' in page.inner_text('#place'))
        # Only with its first picture the stage has its size: a click before would miss it.
        wait_for(page, lambda: pixels(page, 'picture', [(0.5, 0.5)]).max() > 8)
        yield page


def pixels(page: Any, name: str, places: list[tuple[float, float]]) -> np.ndarray:
    """Return RGB of a canvas at places, in shares of it."""
    return np.array(page.evaluate("""([name, places]) => {
        const canvas = document.getElementById(name);
        const context = canvas.getContext('2d');
        return places.map(([x, y]) => [...context.getImageData(Math.floor(x * canvas.width),
            Math.floor(y * canvas.height), 1, 1).data].slice(0, 3));
    }""", [name, places]))


def expected(page: Any, yaw: float, pitch: float, hfov: float, places: list[tuple[float, float]],
             position: tuple[float, float] = (1.9, 1.7)) -> np.ndarray:
    """Return the room's true colours at places of a look, in shares of the canvas."""
    box = page.query_selector('#look').bounding_box()
    focal = box['width'] / 2 / math.tan(hfov / 2)
    at = np.array(places) - 0.5
    local = np.stack([at[:, 0] * box['width'] / focal, at[:, 1] * box['height'] / focal,
                      np.ones(len(at))], 1)
    c, s = math.cos(pitch), math.sin(pitch)
    pose = planar(*position, math.degrees(yaw))
    rays = local @ (pose.T_world_cam[:3, :3] @ np.array([[1, 0, 0], [0, c, -s], [0, s, c]])).T
    return cast(pose.position, rays / np.linalg.norm(rays, axis=1, keepdims=True))[0]


def wait_for_look(page: Any, yaw: float, pitch: float = 0.0, hfov: float = FIELD,
                  **more: Any) -> None:
    """Wait until the look shows the room's colours in this direction."""
    places = [(0.12, 0.6), (0.3, 0.3), (0.45, 0.7), (0.5, 0.5), (0.62, 0.4), (0.65, 0.65)]
    wanted = expected(page, yaw, pitch, hfov, places, **more)

    def near() -> bool:
        return bool(np.median(np.abs(pixels(page, 'look', places) - wanted).max(1)) < 25)

    wait_for(page, near)


def camera_yaw(degrees: float = 30.0) -> float:
    return math.radians(degrees)


def test_the_map_shows_the_camera_where_it_is(page: Any, viewer: ServerProcess) -> None:
    about = page.evaluate("fetch('/map').then((answer) => answer.json())")

    def there(x: float, y: float) -> bool:
        at = ((x - about['origin'][0]) / about['resolution'] / about['width'],
              1 - (y - about['origin'][1]) / about['resolution'] / about['height'])
        return bool(np.abs(pixels(page, 'map', [at])[0] - YELLOW).max() < 30)

    wait_for(page, lambda: there(1.9, 1.7))
    viewer.tell({'x': 3.1, 'y': 2.4})
    wait_for(page, lambda: 'x 3.1 m, y 2.4 m' in page.inner_text('#place'))
    wait_for(page, lambda: there(3.1, 2.4) and not there(1.9, 1.7))
    wait_for(page, lambda: float(page.inner_text('#place').split()[-3]) < 2)


def test_a_server_that_was_started_anew_tells_another_map(browser: Any, viewer: ServerProcess
                                                          ) -> None:
    """With another model, while somebody watches; the page is not loaded again."""
    with opened_page(browser) as page:
        page.add_init_script(KEEP_SOCKETS)
        viewer.tell(START)
        page.goto(viewer.url)
        page.wait_for_selector('#map', state='visible')
        page.route('**/map', lambda route: route.fulfill(json={'why': 'No memory, no map.'}))
        close_sockets(page)
        page.wait_for_selector('#map', state='hidden')
        assert page.inner_text('#no-map') == 'No memory, no map.'
        page.unroute('**/map')
        close_sockets(page)
        page.wait_for_selector('#map', state='visible')
        assert page.is_hidden('#no-map')
        wait_for(page, lambda: 'x 1.9' in page.inner_text('#place'))


def test_the_map_says_when_the_place_is_not_recognised(page: Any, viewer: ServerProcess) -> None:
    viewer.tell({'lost': True})
    page.wait_for_selector('#where.lost')
    wait_for(page, lambda: 'not recognised for 2 s' in page.inner_text('#place'))
    viewer.tell({'lost': False})
    page.wait_for_selector('#where:not(.lost)')


def test_arrow_keys_turn_and_zoom_and_0_brings_back(page: Any) -> None:
    for _ in range(6):
        page.keyboard.press('ArrowLeft')
    wait_for_look(page, camera_yaw() + 6 * STEP)
    assert page.inner_text('#look-where') == 'Looking 41° to the left'
    for _ in range(3):
        page.keyboard.press('ArrowUp')
    wait_for_look(page, camera_yaw() + 6 * STEP, 3 * STEP)
    for _ in range(4):
        page.keyboard.press('+')
    wait_for_look(page, camera_yaw() + 6 * STEP, 3 * STEP, FIELD / ZOOM ** 4)
    page.keyboard.press('0')
    assert page.is_hidden('#look') and page.is_hidden('#look-legend')
    wide = page.query_selector('#picture').bounding_box()
    assert wide['width'] > 300, 'the live picture has its place again'


def test_dragging_pulls_the_scene_and_wheel_zooms(page: Any) -> None:
    box = page.query_selector('#picture').bounding_box()
    x, y = box['x'] + box['width'] / 2, box['y'] + box['height'] / 2
    page.mouse.move(x, y)
    page.mouse.down()
    page.mouse.move(x + 50, y, steps=4)
    page.mouse.move(x + 150, y, steps=6)
    page.mouse.up()
    page.wait_for_selector('#look', state='visible')
    wait_for(page, lambda: 'to the left' in page.inner_text('#look-where'))
    turned = math.radians(int(page.inner_text('#look-where').split()[1].rstrip('°')))
    width = page.query_selector('#look').bounding_box()['width']
    assert turned == pytest.approx(150 * FIELD / width, abs=0.1)
    wait_for_look(page, camera_yaw() + turned)
    page.mouse.wheel(0, -200)
    wait_for_look(page, camera_yaw() + turned, hfov=FIELD / ZOOM ** 2)
    page.click('#look-bar button')
    assert page.is_hidden('#look')


def test_two_fingers_zoom(page: Any) -> None:
    page.keyboard.press('ArrowLeft')
    page.wait_for_selector('#look', state='visible')
    box = page.query_selector('#look').bounding_box()
    x, y = box['x'] + box['width'] / 2, box['y'] + box['height'] / 2
    touch = page.context.new_cdp_session(page)
    for apart in (60, 70, 80, 100, 120):
        touch.send('Input.dispatchTouchEvent', {
            'type': 'touchStart' if apart == 60 else 'touchMove',
            'touchPoints': [{'x': x - apart, 'y': y, 'id': 1}, {'x': x + apart, 'y': y, 'id': 2}]})
        page.wait_for_timeout(40)
    touch.send('Input.dispatchTouchEvent', {'type': 'touchEnd', 'touchPoints': []})
    # The first steps do not count: a finger that hardly moves clicks.
    wait_for_look(page, camera_yaw() + STEP, hfov=FIELD * 66 / 120)


def test_ones_own_direction_holds_while_the_robot_turns(page: Any, viewer: ServerProcess) -> None:
    for _ in range(8):
        page.keyboard.press('ArrowRight')
    wait_for_look(page, camera_yaw() - 8 * STEP)
    viewer.tell({'yaw': -100.0})
    wait_for(page, lambda: page.inner_text('#look-where') == 'Looking 75° to the left')
    wait_for_look(page, camera_yaw() - 8 * STEP)


def test_a_look_goes_on_after_the_page_was_hidden(page: Any, viewer: ServerProcess) -> None:
    page.keyboard.press('ArrowLeft')
    wait_for_look(page, camera_yaw() + STEP)
    # Then looks come for 4 s more, and no others: what follows are few.
    viewer.tell({'lost': True})
    page.wait_for_timeout(5000)
    for hidden in ('true', 'false'):
        page.evaluate(f"""() => {{
            Object.defineProperty(document, 'hidden', {{value: {hidden}, configurable: true}});
            document.dispatchEvent(new Event('visibilitychange'));
        }}""")
    for _ in range(6):
        page.keyboard.press('ArrowLeft')
    wait_for_look(page, camera_yaw() + 7 * STEP)
    # The look before, moved there, would leave this edge empty.
    wait_for(page, lambda: pixels(page, 'look', [(0.02, 0.5)]).max() > 40)


def test_what_is_behind_the_camera_is_never_shown_as_live(page: Any) -> None:
    for _ in range(26):
        page.keyboard.press('ArrowLeft')
    wait_for(page, lambda: page.inner_text('#look-where') == 'Looking behind the camera')
    wait_for_look(page, camera_yaw() + 26 * STEP)
    page.keyboard.press('4')  # Camera only.
    wait_for(page, lambda: pixels(page, 'look', [(0.2, 0.5), (0.5, 0.5), (0.8, 0.4)]).max() < 8)
    page.keyboard.press('0')
    page.keyboard.press('ArrowLeft')
    wait_for(page, lambda: pixels(page, 'look', [(0.5, 0.5)]).max() > 40)
    page.keyboard.press('1')


def test_a_late_look_says_so(page: Any, viewer: ServerProcess) -> None:
    page.keyboard.press('ArrowLeft')
    wait_for_look(page, camera_yaw() + STEP)
    page.wait_for_selector('#look-sign', state='hidden')
    viewer.tell({'late': 1.0})
    # On a busy machine looks are late by themselves.
    wait_for(page, lambda: page.inner_text('#look-sign').startswith('Predicted: 1.'))
    viewer.tell({'late': 3.0})
    wait_for(page, lambda: page.inner_text('#look-sign').startswith('Stale: nothing has come for'))
    viewer.tell({'late': 0.0})
    page.wait_for_selector('#look-sign', state='hidden')


def test_a_look_that_cannot_be_drawn_says_why(page: Any, viewer: ServerProcess) -> None:
    page.keyboard.press('ArrowLeft')
    wait_for_look(page, camera_yaw() + STEP)
    viewer.tell({'torn': True})
    wait_for(page, lambda: page.inner_text('#look-sign') == 'Cannot be drawn: image 7: damaged')
    viewer.tell({'torn': False})
    page.wait_for_selector('#look-sign', state='hidden')


def test_a_click_says_how_far_away_a_point_is(page: Any) -> None:
    box = page.query_selector('#picture').bounding_box()
    side = min(box['width'], box['height'])  # The picture is square; beside it there is nothing.
    page.mouse.click(box['x'] + box['width'] / 2 + 0.1 * side, box['y'] + box['height'] / 2)
    page.wait_for_selector('#distance', state='visible')
    metres, _, more = page.inner_text('#distance').partition(' ± ')
    # A tenth of a view of twice atan(2).
    ray = planar(1.9, 1.7, 30).T_world_cam[:3, :3] @ (0.1 * 4, 0, 1)
    _, truth = cast(planar(1.9, 1.7, 30).position, ray / np.linalg.norm(ray))
    assert float(metres) == pytest.approx(float(truth), rel=0.03)
    assert more.endswith(' m, as remembered')
    assert page.is_hidden('#look'), 'a click turns nothing'
    page.keyboard.press('ArrowRight')
    assert page.is_hidden('#distance')
    wait_for_look(page, camera_yaw() - STEP)
    page.keyboard.press('d')
    page.wait_for_selector('#distance', state='visible')
    ray = planar(1.9, 1.7, math.degrees(camera_yaw() - STEP)).forward
    _, truth = cast(planar(1.9, 1.7, 0).position, ray)
    assert float(page.inner_text('#distance').split()[0]) == pytest.approx(float(truth), rel=0.03)


def test_a_gamepad_looks_around(page: Any) -> None:
    page.evaluate("""() => {
        window.pad = {index: 0, mapping: 'standard', axes: [0.05, -0.1, 0, 0],
            buttons: Array.from({length: 17}, () => ({pressed: false}))};
        navigator.getGamepads = () => [null, window.pad];
        window.dispatchEvent(new Event('gamepadconnected'));
    }""")
    page.wait_for_timeout(300)
    assert page.is_hidden('#look'), 'sticks at rest turn nothing'
    page.evaluate('window.pad.axes = [0, 0, -1, 0]')
    page.wait_for_selector('#look', state='visible')
    page.wait_for_timeout(400)
    page.evaluate('window.pad.axes = [0, 0, 0, 0]')
    page.wait_for_timeout(150)
    words = page.inner_text('#look-where')
    assert words.endswith(' to the left')
    turned = math.radians(int(words.split()[1].rstrip('°')))
    wait_for_look(page, camera_yaw() + turned)
    page.evaluate('window.pad.buttons[0].pressed = true')
    page.wait_for_selector('#distance', state='visible')
    page.evaluate('window.pad.buttons[1].pressed = true')
    page.wait_for_selector('#look', state='hidden')
    page.evaluate('window.pad = null')


def test_full_screen_has_the_map_in_it(page: Any) -> None:
    page.keyboard.press('f')
    page.wait_for_selector('#stage:fullscreen #map')
    page.keyboard.press('ArrowLeft')
    wait_for_look(page, camera_yaw() + STEP)
    assert page.is_visible('#map') and page.is_visible('#look-where')
    page.keyboard.press('f')
    page.wait_for_selector('aside #map')


def test_without_a_model_the_page_says_why(browser: Any) -> None:
    viewer = start('')
    page = browser.new_page()
    try:
        page.goto(viewer.url)
        wait_for(page, lambda: '--model' in page.inner_text('#no-map'))
        page.wait_for_selector('#connection[data-state=live]')
        page.keyboard.press('ArrowLeft')
        page.wait_for_timeout(300)
        assert page.is_hidden('#look') and page.is_hidden('#map') and page.is_hidden('#turns')
    finally:
        page.close()
        viewer.stop()


@pytest.mark.parametrize('scheme', ['light', 'dark'])
def test_contrast_names_and_widths_while_looking(browser: Any, viewer: ServerProcess, scheme: str
                                                 ) -> None:
    context = browser.new_context(color_scheme=scheme, viewport={'width': 320, 'height': 640})
    page = context.new_page()
    viewer.tell(START)
    page.goto(viewer.url)
    page.wait_for_selector('#map', state='visible', timeout=60_000)
    viewer.tell({'late': 1.0})

    def late_look() -> bool:
        page.click('role=button[name="Look left"]')  # On a busy machine the first may be lost.
        return page.is_visible('#look-sign')

    wait_for(page, late_look)
    page.keyboard.press('d')
    page.wait_for_selector('#distance', state='visible')
    contrast = page.evaluate(CONTRAST)
    assert {name: ratio for name, ratio in contrast.items() if ratio < 4.5} == {}
    # All at once: whatever comes meanwhile may move the page.
    boxes = page.evaluate("""() => [
        '#look-where', '#look-bar button', '#look-sign', '#picture', '.readings'
    ].map((name) => document.querySelector(name).getBoundingClientRect().toJSON())""")
    assert not [(a, b) for i, a in enumerate(boxes) for b in boxes[i + 1:]
                if a['x'] < b['x'] + b['width'] and b['x'] < a['x'] + a['width']
                and a['y'] < b['y'] + b['height'] and b['y'] < a['y'] + a['height']]
    assert page.evaluate('document.documentElement.scrollWidth') <= 320
    for element in page.query_selector_all('#turns button, #look-bar button'):
        box = element.bounding_box()
        assert box['height'] >= 44 and box['width'] >= 44
    names = page.evaluate("""() => [...document.querySelectorAll(
        '#where button, #where canvas, #look, #look-bar button')].map(
            (e) => e.ariaLabel || e.textContent)""")
    assert len(names) == 9 and all(name.strip() for name in names)
    viewer.tell(START)
    context.close()
