"""The viewer's server as a process that a test commands, and its page in a browser."""
from collections.abc import Callable, Iterator
from contextlib import contextmanager
import json
import os
from pathlib import Path
import subprocess
import sys
import time
from typing import Any

import neo_ros

HELPERS = Path(__file__).parent
# How long a test waits for what never comes; a stall of the machine is shorter.
WAIT_S = 60.0
CONTRAST = (HELPERS / 'contrast.js').read_text()
KEEP_SOCKETS = """
const Socket = window.WebSocket;
window.sockets = [];
window.WebSocket = class extends Socket {
    constructor(...address) { super(...address); window.sockets.push(this); }
};"""
PYTHONPATH = {'PYTHONPATH': str(Path(neo_ros.__file__).parents[1])}


class ServerProcess:
    """A script of this folder that prints the server's address and reads commands."""

    def __init__(self, script: str, *arguments: str) -> None:
        self.launch(script, *arguments)

    def launch(self, script: str, *arguments: str) -> None:
        """Start it and read the address."""
        self.process = subprocess.Popen(
            [sys.executable, HELPERS / script, *arguments], text=True,
            stdin=subprocess.PIPE, stdout=subprocess.PIPE, env=os.environ | PYTHONPATH)
        assert self.process.stdout is not None
        self.url = self.process.stdout.readline().split()[-1]

    def tell(self, command: str | dict[str, Any]) -> None:
        """Send a line, or a JSON object."""
        line = command if isinstance(command, str) else json.dumps(command)
        assert self.process.stdin is not None
        self.process.stdin.write(f'{line}\n')
        self.process.stdin.flush()

    def stop(self) -> None:
        """End it as a person would."""
        self.process.terminate()
        assert self.process.wait(WAIT_S) == 0


@contextmanager
def opened_page(browser: Any, allowed: str | None = None, **options: Any) -> Iterator[Any]:
    """Open an empty page that in the end has raised no error but those with `allowed` words."""
    context = browser.new_context(viewport={'width': 1000, 'height': 700}, **options)
    context.set_default_timeout(1000 * WAIT_S)
    page = context.new_page()
    problems: list[str] = []
    page.on('pageerror', lambda error: problems.append(str(error)))
    page.on('console', lambda line: problems.append(line.text) if line.type == 'error' else None)
    yield page
    context.close()
    assert [line for line in problems if allowed is None or allowed not in line] == []


def close_sockets(page: Any) -> None:
    """Close all connections of a page that began with KEEP_SOCKETS, as a server's end does."""
    page.evaluate('window.sockets.forEach((socket) => socket.close())')


def wait_for(page: Any, condition: Callable[[], bool], timeout: float = WAIT_S) -> None:
    """Wait until a condition holds."""
    deadline = time.monotonic() + timeout
    while not condition():
        assert time.monotonic() < deadline, 'waited in vain'
        page.wait_for_timeout(50)
