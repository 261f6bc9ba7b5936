"""
Make the pictures of docs/guides/viewer.md and the README: the page in a browser, on a walk.

    PYTHONPATH=. python test/helpers/guide_pictures.py WALK_WIDE

WALK_WIDE is `neo replay` of a walk of `neo demo` with `--output pose --output status`.
"""
from collections.abc import Callable
from functools import partial
from pathlib import Path
import shutil
import sys
import threading
from typing import Any

from neo_ros.machine.files import share_dir
from neo_ros.speed.predicted_looks import read_walk
from neo_ros.viewer.bag_source import BagSource
from neo_ros.viewer.hub import Hub, Source
from neo_ros.viewer.pictures import SourcePicture, SourceState
from neo_ros.viewer.server import serve
from neo_ros.viewer.settings import ViewerSettings
from neo_ros.viewer.whereabouts import Place
import numpy as np
from playwright.sync_api import sync_playwright

DOCS = Path(__file__).parents[2] / 'docs'
MODEL = share_dir() / 'models' / 'demo_flat.onnx'
PERIOD_S = 0.1


class Walk:
    """The wide pictures and poses of a bag as a live stream, from a frame on."""

    def __init__(self, bag: Path, first: int) -> None:
        self._frames = read_walk(bag, '/camera/wide/image')[first:]

    def run(self, hub: Hub, stop: threading.Event) -> None:
        """Walk once while somebody watches, and stand at the end."""
        hub.report(SourceState('/camera/wide/image', recognised=True, node_ms=14.0))
        number = 0
        while not stop.wait(PERIOD_S):
            _, pose, image = self._frames[min(number, len(self._frames) - 1)]
            number += hub.wanted.image
            now = hub.clock.now()
            hub.where.put(Place(pose, now, partial(np.asarray, image)))
            hub.publish(SourcePicture(image, now, True, None, (0.25, 0.25, 0.5, 0.5)))


def shoot(source: Source, act: Callable[[Any], None], name: str, fragment: str = '') -> None:
    """Serve a source, do something on its page, and keep a picture of it."""
    def browse(line: str) -> None:
        url = line.split()[1] + fragment
        threading.Thread(target=look, args=(url,)).start()

    def look(url: str) -> None:
        with sync_playwright() as playwright:
            browser = playwright.chromium.launch(
                executable_path=shutil.which('chromium'), args=['--no-sandbox', '--disable-gpu'])
            page = browser.new_page(viewport={'width': 1180, 'height': 740})
            page.goto(url)
            page.wait_for_selector('#map', state='visible')
            act(page)
            page.screenshot(path=DOCS / name, type='jpeg', quality=72)
            browser.close()
        import os
        import signal
        os.kill(os.getpid(), signal.SIGINT)

    serve(source, ViewerSettings(port=0, model=MODEL), browse)


def look_away(page: Any) -> None:
    """Turn to the left, and ask how far away the middle is."""
    page.wait_for_timeout(5000)
    for _ in range(8):
        page.keyboard.press('ArrowLeft')
        page.wait_for_timeout(100)
    page.wait_for_timeout(700)
    page.keyboard.press('d')
    page.wait_for_selector('#distance', state='visible')
    page.wait_for_timeout(400)


def compare(page: Any) -> None:
    """Put the truth beside the picture."""
    page.select_option('#beside-choice', 'truth')
    page.wait_for_timeout(3000)


if __name__ == '__main__':
    walk = Path(sys.argv[1])
    shoot(Walk(walk, 20), look_away, 'viewer.jpg')
    shoot(BagSource(walk, MODEL), compare, 'viewer_bag.jpg', '#t=22.6')
