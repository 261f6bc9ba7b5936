"""A bag in a real browser: played by keys and buttons, its time line, what is beside it, links."""
from collections.abc import Iterator
import os
from pathlib import Path
import subprocess
import sys
from typing import Any

from bag_files import write_box_bags
from box_room import box_walk, EXPANSION, view
from neo_ros.bags import BagReader, BagWriter
import numpy as np
import pytest
from viewer_pages import (
    close_sockets, CONTRAST, HELPERS, KEEP_SOCKETS, opened_page, PYTHONPATH, ServerProcess,
    wait_for)

# The first of all fixtures: without a browser nothing need start.
pytestmark = [pytest.mark.slow, pytest.mark.usefixtures('browser')]

# At 2 Hz: a picture stands long enough to be looked at.
FRAMES, STEP_S = 30, 0.5
OVERLAPS = (HELPERS / 'overlaps.js').read_text()


class BagViewer(ServerProcess):
    """`neo view --bag`, as a person starts it."""

    def launch(self, script: str, *arguments: str) -> None:
        """Start it and read the address."""
        self.process = subprocess.Popen(
            [sys.executable, '-m', 'neo_ros.cli.main', 'view', '--bag', script, '--port', '0',
             *arguments], text=True, stdout=subprocess.PIPE, env=os.environ | PYTHONPATH)
        assert self.process.stdout is not None
        self.url = self.process.stdout.readline().split()[-1]


@pytest.fixture(scope='module')
def folder(tmp_path_factory: pytest.TempPathFactory) -> Path:
    path = tmp_path_factory.mktemp('player')
    write_box_bags(path, FRAMES, STEP_S)
    return path


@pytest.fixture(scope='module')
def viewer(folder: Path) -> Iterator[BagViewer]:
    viewer = BagViewer(str(folder / 'wide'), '--model', str(folder / 'box.onnx'))
    yield viewer
    viewer.stop()


@pytest.fixture
def page(browser: Any, viewer: BagViewer) -> Iterator[Any]:
    """Give a page that plays the bag from its start and, at the end, has raised no error."""
    with opened_page(browser) as page:
        page.goto(viewer.url)
        page.wait_for_selector('#player', state='visible')
        wait_for(page, lambda: moment(page) > 0 or page.inner_text('#play') != 'Pause')
        page.keyboard.press('Home')
        if page.inner_text('#play') != 'Pause':
            page.keyboard.press(' ')
        page.wait_for_selector('#connection[data-state=recording]')
        yield page


def moment(page: Any) -> float:
    """Return the seconds that the page shows."""
    minutes, seconds = page.inner_text('#moment').split()[0].split(':')
    return 60 * int(minutes) + float(seconds)


def wait_for_moment(page: Any, expected: float) -> None:
    wait_for(page, lambda: abs(moment(page) - expected) < 0.06)


def pause(page: Any, at: float) -> None:
    """Stand still at a moment, by link."""
    page.evaluate(f'location.hash = "#t={at}"')
    page.wait_for_selector('#connection[data-state=paused]')
    wait_for_moment(page, at)
    page.wait_for_timeout(300)


def test_space_pauses_and_nothing_counts_as_stale(page: Any) -> None:
    page.keyboard.press(' ')
    page.wait_for_selector('#connection[data-state=paused]')
    assert page.inner_text('#play') == 'Play'
    stands = page.inner_text('#moment')
    page.wait_for_timeout(1500)
    assert page.inner_text('#moment') == stands and page.is_hidden('#stale-sign')
    assert page.inner_text('#age') == page.inner_text('#rate') == '–'
    assert page.inner_text('#place').endswith('paused')
    page.keyboard.press(' ')
    wait_for(page, lambda: page.inner_text('#moment') != stands)


def test_keys_lead_through_time(page: Any) -> None:
    pause(page, 2.0)
    for key, expected in (('.', 2.5), ('.', 3.0), (',', 2.5), ('ArrowRight', 7.5),
                          ('ArrowLeft', 2.5), ('End', 14.5), ('Home', 0.0)):
        page.keyboard.press(key)
        wait_for_moment(page, expected)
        page.wait_for_timeout(150)
    assert page.get_attribute('#connection', 'data-state') == 'paused'


def test_speed_by_keys_and_by_the_list(page: Any) -> None:
    page.keyboard.press('>')
    wait_for(page, lambda: page.input_value('#speed') == '2')
    page.keyboard.press('<')
    wait_for(page, lambda: page.input_value('#speed') == '1')
    page.select_option('#speed', '8')
    page.wait_for_selector('#connection[data-state=ended]')
    assert page.inner_text('#play') == 'Again' and moment(page) == pytest.approx(14.5, abs=0.06)
    assert page.inner_text('#connection') == 'End of the recording'
    page.wait_for_timeout(1200)
    assert page.get_attribute('#connection', 'data-state') == 'ended', 'it does not begin again'
    page.select_option('#speed', '1')
    page.click('#play')
    page.wait_for_selector('#connection[data-state=recording]')
    assert moment(page) < 5


def test_the_time_line_seeks_and_says_what_is_known(page: Any) -> None:
    box = page.query_selector('#seek').bounding_box()
    page.mouse.click(box['x'] + box['width'] / 2, box['y'] + box['height'] / 2)
    wait_for(page, lambda: abs(moment(page) - 7.25) < 1.0)
    wait_for(page, lambda: 'guided 100 %' in page.get_attribute('#seek', 'aria-valuetext'))
    spoken = page.get_attribute('#seek', 'aria-valuetext')
    assert ' of 0:14.5, ' in spoken and 'agreement 0.' in spoken and ' dB' in spoken
    # The focus is on the slider: its keys are the same.
    page.keyboard.press(' ')
    page.wait_for_selector('#connection[data-state=paused]')
    before = moment(page)
    page.keyboard.press('ArrowLeft')
    wait_for(page, lambda: abs(moment(page) - (before - 5)) < 0.6)
    colours = page.evaluate("""() => {
        const canvas = document.getElementById('timeline');
        const { data } = canvas.getContext('2d').getImageData(0, 0, canvas.width, canvas.height);
        const found = new Set();
        for (let i = 0; i < data.length; i += 4) {
            found.add([data[i], data[i + 1], data[i + 2]].join());
        }
        return [...found];
    }""")
    assert {'37,92,63', '94,211,148', '98,174,247'} <= set(colours), 'guided, agreement, truth'


def test_a_link_leads_to_its_moment(page: Any, browser: Any, viewer: BagViewer) -> None:
    pause(page, 4.5)
    page.keyboard.press('.')
    wait_for(page, lambda: page.url.endswith('#t=5.00'))
    address = page.url
    page.keyboard.press('Home')
    wait_for(page, lambda: moment(page) == 0)
    with opened_page(browser) as other:
        other.goto(address)
        other.wait_for_selector('#connection[data-state=paused]')
        wait_for(other, lambda: moment(other) == 5.0)
        # All who watch see the same moment.
        wait_for(page, lambda: moment(page) == 5.0)


def test_a_link_that_was_lost_turns_no_time_back(browser: Any, viewer: BagViewer) -> None:
    with opened_page(browser) as page:
        page.add_init_script("""const Socket = window.WebSocket;
            window.WebSocket = class extends Socket {
                constructor(...address) { super(...address); window.newest ??= this; }
            };""")
        page.goto(f'{viewer.url}#t=4.50')
        page.wait_for_selector('#connection[data-state=paused]')
        wait_for_moment(page, 4.5)
        page.keyboard.press(' ')
        wait_for(page, lambda: moment(page) > 6)
        page.evaluate('window.newest.close()')
        page.wait_for_timeout(1500)
        page.wait_for_selector('#connection[data-state=recording]')
        assert moment(page) > 6


def test_a_page_that_is_loaded_again_does_not_lead_back_to_where_it_stood(page: Any) -> None:
    pause(page, 4.5)
    assert page.url.endswith('#t=4.50')
    page.keyboard.press(' ')
    page.wait_for_selector('#connection[data-state=recording]')
    wait_for(page, lambda: '#' not in page.url and moment(page) > 6)
    page.reload()
    page.wait_for_selector('#connection[data-state=recording]')
    wait_for(page, lambda: moment(page) > 0 or page.inner_text('#play') != 'Pause')
    assert moment(page) > 6


def test_a_bag_that_stands_still_keeps_its_place_when_the_map_comes_late(
        browser: Any, viewer: BagViewer) -> None:
    held: list[Any] = []
    with opened_page(browser) as page:
        page.route('**/map', lambda route: held.append(route))
        page.goto(f'{viewer.url}#t=4.50')
        page.wait_for_selector('#connection[data-state=paused]')
        wait_for_moment(page, 4.5)
        page.wait_for_timeout(1000)
        for route in held:
            route.continue_()
        page.wait_for_selector('#map', state='visible')
        wait_for(page, lambda: page.inner_text('#place').endswith('paused'))


def test_a_viewer_started_anew_tells_the_place_of_a_bag_that_stands_still(
        browser: Any, viewer: BagViewer) -> None:
    """Also where another model's map comes last."""
    held: list[Any] = []
    with opened_page(browser) as page:
        page.add_init_script(KEEP_SOCKETS)
        page.goto(f'{viewer.url}#t=4.50')
        page.wait_for_selector('#connection[data-state=paused]')
        wait_for(page, lambda: page.inner_text('#place').endswith('paused'))
        told = page.inner_text('#place')
        page.route('**/map', lambda route: held.append(route))
        close_sockets(page)
        wait_for(page, lambda: len(held) > 0)
        wait_for(page, lambda: page.inner_text('#place') == told)
        page.wait_for_timeout(1000)
        route = held[-1]
        about = route.fetch().json()
        route.fulfill(json={**about, 'metric': False})
        wait_for(page, lambda: page.inner_text('#place') == told.replace(' m', ''))


def test_the_slider_asks_now_and_then_and_for_its_last_place(page: Any) -> None:
    """A hand moves it with every frame of the screen, and everybody who watches is led along."""
    pause(page, 1.0)
    page.evaluate("""() => {
        const send = WebSocket.prototype.send;
        window.sought = [];
        WebSocket.prototype.send = function (text) {
            if (text.includes('seek')) window.sought.push(text);
            return send.call(this, text);
        };
        const slider = document.getElementById('seek');
        for (let step = 0; step <= 100; step += 1) {
            slider.value = step * slider.max / 125;
            slider.dispatchEvent(new Event('input'));
        }
    }""")
    wait_for_moment(page, 11.5)
    page.wait_for_timeout(300)
    assert page.evaluate('window.sought.length') == 2
    wait_for_moment(page, 11.5)


def test_truth_and_camera_stand_beside_the_picture(page: Any) -> None:
    pause(page, 3.0)
    page.select_option('#beside-choice', 'truth')

    def colours(name: str) -> np.ndarray:
        return np.array(page.evaluate("""(name) => {
            const canvas = document.getElementById(name);
            const context = canvas.getContext('2d');
            return [0.1, 0.3, 0.5, 0.7, 0.9].map((share) => [...context.getImageData(
                Math.floor(share * canvas.width), Math.floor(0.7 * canvas.height), 1, 1
            ).data].slice(0, 3));
        }""", name))

    truth = view(box_walk(FRAMES)[6], EXPANSION.target)[0]
    height, width = truth.shape[:2]
    expected = np.array([truth[int(0.7 * height), int(share * width)]
                         for share in (0.1, 0.3, 0.5, 0.7, 0.9)])
    wait_for(page, lambda: bool(np.median(np.abs(colours('beside') - expected).max(1)) < 20))
    left, right = (page.query_selector(name).bounding_box() for name in ('#picture', '#beside'))
    assert right['x'] >= left['x'] + left['width']
    page.select_option('#beside-choice', 'camera')
    wait_for(page, lambda: bool(colours('beside')[[0, 4]].max() < 8))
    assert np.abs(colours('beside')[2] - colours('picture')[2]).max() < 20
    assert page.get_attribute('#beside', 'aria-label') == 'What the camera sees'
    page.select_option('#beside-choice', 'none')
    assert page.is_hidden('#beside')


def test_looking_around_while_it_is_paused(page: Any) -> None:
    pause(page, 3.0)
    page.keyboard.press('ArrowRight')
    assert page.is_hidden('#look'), 'arrows alone lead through time'
    pause(page, 3.0)
    for _ in range(4):
        page.keyboard.press('Shift+ArrowLeft')
    page.wait_for_selector('#look', state='visible')
    page.wait_for_timeout(2500)
    assert page.is_hidden('#look-sign'), 'neither predicted nor stale'
    page.keyboard.press('0')
    assert page.is_hidden('#look')


def test_cameras_are_tiles_and_buttons(browser: Any, folder: Path) -> None:
    with BagReader(folder / 'wide') as reader, BagWriter(folder / 'two') as writer:
        names = {topic.name: topic for topic in reader.topics if '/wide/' in topic.name
                 and not topic.name.endswith('_raw')}
        for camera in ('front', 'rear'):
            topics = {name: writer.add_topic(name.replace('/camera', f'/{camera}'), topic.msgtype)
                      for name, topic in names.items()}
            for message in reader.messages(names):
                writer.write_cdr(topics[message.topic.name], message.stamp_ns, message.cdr)
    viewer = BagViewer(str(folder / 'two'))
    try:
        with opened_page(browser) as page:
            page.goto(viewer.url)
            page.wait_for_selector('#cameras', state='visible')
            page.select_option('#beside-choice', 'cameras')
            page.wait_for_selector('#beside', state='visible')
            assert page.is_hidden('#beside-choice option[value=truth]')
            page.click('role=button[name="/rear/wide/image"]')
            wait_for(page, lambda: page.inner_text('#source') == 'two /rear/wide/image')
            assert page.get_attribute('#cameras button:nth-child(2)', 'aria-pressed') == 'true'
    finally:
        viewer.stop()


@pytest.mark.parametrize('scheme', ['light', 'dark'])
@pytest.mark.parametrize('width, height', [(1366, 768), (683, 384), (320, 640), (667, 375)],
                         ids=['desk', '1366x768 at 200 %', 'phone', 'landscape phone'])
def test_contrast_names_sizes_and_no_overlaps(browser: Any, viewer: BagViewer, scheme: str,
                                              width: int, height: int) -> None:
    with opened_page(browser, color_scheme=scheme) as page:
        page.set_viewport_size({'width': width, 'height': height})
        page.goto(f'{viewer.url}#t=3')
        page.wait_for_selector('#connection[data-state=paused]')
        for beside in ('none', 'truth'):
            page.select_option('#beside-choice', beside)
            page.wait_for_timeout(300)
            contrast = page.evaluate(CONTRAST)
            assert {name: ratio for name, ratio in contrast.items() if ratio < 4.5} == {}
            assert page.evaluate(OVERLAPS) == []
            assert page.evaluate('document.documentElement.scrollWidth') <= width
        for element in page.query_selector_all('#player button:visible, #player select:visible'):
            box = element.bounding_box()
            assert box['height'] >= 44 and box['width'] >= 44
        names = page.evaluate("""() => [...document.querySelectorAll(
            '#player button, #player select, #player input')].map((element) => element.ariaLabel
                || element.labels?.[0]?.textContent || element.textContent)""")
        assert len(names) >= 7 and all(name.strip() for name in names)
