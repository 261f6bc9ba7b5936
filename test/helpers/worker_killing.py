"""Kill a worker on Ray while it is at a job."""
from collections.abc import Iterator
from contextlib import contextmanager
import os
from pathlib import Path
import signal
import threading


@contextmanager
def first_worker_killed(function: str) -> Iterator[list[int]]:
    """Kill the first of this process' workers on Ray that is found at a function; yields whom."""
    killed: list[int] = []
    stop = threading.Event()

    def watch() -> None:
        while not killed and not stop.wait(0.002):
            for pid in workers_at(function):
                os.kill(pid, signal.SIGKILL)
                killed.append(pid)
                break

    thread = threading.Thread(target=watch)
    thread.start()
    try:
        yield killed
    finally:
        stop.set()
        thread.join()


def workers_at(function: str) -> list[int]:
    """Return the processes below this one that are at a function: Ray puts it in their title."""
    found, parents = [], {}
    for folder in Path('/proc').glob('[0-9]*'):
        try:
            parents[int(folder.name)] = int(
                (folder / 'stat').read_text().rpartition(')')[2].split()[1])
            if (folder / 'cmdline').read_bytes().startswith(f'ray::{function}'.encode()):
                found.append(int(folder.name))
        except OSError:  # It has ended.
            pass
    return [pid for pid in found if os.getpid() in ancestors(pid, parents)]


def ancestors(pid: int, parents: dict[int, int]) -> list[int]:
    """Return the process above one, the one above that, and so on."""
    above = []
    while pid := parents.get(pid, 0):
        above.append(pid)
    return above
