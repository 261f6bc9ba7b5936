"""What the tests of the page share: a browser."""
from collections.abc import Iterator
import shutil
from typing import Any

import pytest


@pytest.fixture(scope='module')
def browser() -> Iterator[Any]:
    """Start Chromium; without it, or without playwright, the tests are skipped."""
    chromium = shutil.which('chromium') or shutil.which('chromium-browser')
    if chromium is None:
        pytest.skip('needs a browser: apt install chromium')
    api = pytest.importorskip('playwright.sync_api', reason='comes with the extra dev')
    with api.sync_playwright() as playwright:
        browser = playwright.chromium.launch(
            executable_path=chromium, args=['--no-sandbox', '--disable-gpu'])
        yield browser
        browser.close()
