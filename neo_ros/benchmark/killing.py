"""Start processes and kill them, and look at what is left with others."""
from collections.abc import Callable
import json
from pathlib import Path
import subprocess
import sys
import time
from typing import Any, NamedTuple

from neo_ros.errors import NeoError
from neo_ros.machine.files import sha256_of
from neo_ros.memory.learning import Learn

ALWAYS: Callable[[], bool] = lambda: True


class Killed(NamedTuple):
    """A killed process: whether it was still alive, when it was killed, and what it had said."""

    alive: bool
    at_ns: int
    said: dict[str, Any]


class Found(NamedTuple):
    """
    What a fresh process finds in a journal.

    records: what tells them from each other; last_ns: the newest one's stamp; cut_short: the last
    one was not whole.
    """

    records: list[int]
    last_ns: int
    cut_short: bool


def neo(*words: object) -> list[str]:
    """Return the command line of `neo` in this interpreter."""
    return [sys.executable, '-m', 'neo_ros.cli.main', *map(str, words)]


def camera(model: Path, post: tuple[float, float], rounds: int, learn: Learn = 'at once'
           ) -> list[str]:
    """Return the command line of a camera that learns, see `kill_victims.py`."""
    return [sys.executable, '-m', 'neo_ros.benchmark.kill_victims', str(model),
            *map(str, post), str(rounds), learn]


def end(command: list[str]) -> float:
    """Let a process end; return its seconds. Raises NeoError with what it said if it fails."""
    began = time.monotonic()
    done = subprocess.run(command, capture_output=True, text=True)
    if done.returncode:
        raise NeoError(f'{" ".join(command)}: {done.stdout[-500:]}{done.stderr[-1500:]}')
    return time.monotonic() - began


def kill(command: list[str], ready: Callable[[], bool] = ALWAYS, delay: float = 0.0,
         pause: float = 5e-4, look: Callable[[], object] = lambda: None) -> Killed:
    """
    Start a process, and kill it so many seconds after `ready`, which is asked after each pause.

    look: is called right before.
    """
    process = subprocess.Popen(command, stdout=subprocess.PIPE, stderr=subprocess.DEVNULL,
                               text=True)
    while not ready() and process.poll() is None:
        time.sleep(pause)
    time.sleep(delay)
    look()
    alive, at_ns = process.poll() is None, time.time_ns()
    process.kill()
    return Killed(alive, at_ns, _told(process.communicate()[0]))


def find(model: Path) -> Found | None:
    """Let a fresh process load a model, its memory and journal; None where it cannot."""
    done = subprocess.run(camera(model, (0, 0), 0), capture_output=True, text=True)
    told = _told(done.stdout)
    if done.returncode or not told.get('guided') or 'works without' in done.stderr:
        print(done.stdout[-500:], done.stderr[-1500:], file=sys.stderr)
        return None
    return Found(told['records'], told['last'], 'no whole record' in done.stderr)


def digests(folder: Path) -> dict[str, str]:
    """Return the SHA-256 of each file below a folder."""
    return {str(path.relative_to(folder)): sha256_of(path)
            for path in sorted(folder.rglob('*')) if path.is_file()}


def _told(said: str) -> dict[str, Any]:
    """Return what a camera said in JSON, as far as its lines are whole."""
    told: dict[str, Any] = {}
    for line in said.splitlines():
        if line.startswith('{') and line.endswith('}'):
            told |= json.loads(line)
    return told
