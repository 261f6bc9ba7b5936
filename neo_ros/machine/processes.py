"""Processes that do a part of the work, and those of a ROS graph that are to end."""
from collections.abc import Callable, Iterator, Sequence
from concurrent.futures import ProcessPoolExecutor
import multiprocessing
import os
import signal
import subprocess
import sys
import threading
from typing import Any, TypeVar

GRACE_S = 10.0
Result = TypeVar('Result')


def map_in_processes(function: Callable[[Any], Result], jobs: Sequence[Any],
                     workers: int) -> Iterator[Result]:
    """Yield the results in order, from several processes if that pays."""
    if workers == 1 or len(jobs) < 8:
        yield from map(function, jobs)
        return
    # spawn: forking a process that has threads (torch, ROS) may hang the child.
    with ProcessPoolExecutor(workers, multiprocessing.get_context('spawn'),
                             _end_with_parent) as pool:
        yield from pool.map(function, jobs, chunksize=4)


def _end_with_parent() -> None:
    """End this process when the one that started it is killed: else it waits for work for ever."""
    parent = multiprocessing.parent_process()
    assert parent is not None

    def watch() -> None:
        parent.join()
        os._exit(1)

    threading.Thread(target=watch, daemon=True).start()


def end_process(process: subprocess.Popen) -> None:
    """Interrupt a process as Ctrl-C would, and kill it if it does not end."""
    process.send_signal(signal.SIGINT)
    try:
        process.wait(GRACE_S)
    except subprocess.TimeoutExpired:
        process.kill()
        process.wait()


def end_if_busy(busy: bool = False) -> None:
    """
    End this process at once, with code 0, if it is busy or has a thread that nobody waits for.

    Tearing the interpreter down below such work may crash, waiting for it may take seconds.
    """
    if busy or any(thread.daemon and thread is not threading.current_thread()
                   for thread in threading.enumerate()):
        sys.stdout.flush()
        sys.stderr.flush()
        os._exit(0)
