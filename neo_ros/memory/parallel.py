"""Who may run numba's parallel loops."""
from collections.abc import Iterator
from contextlib import contextmanager
import threading

from numba import get_num_threads, set_num_threads

# Numba may not run parallel loops of two threads at once: one of its backends ends the process.
_PARALLEL_LOOPS = threading.Lock()


@contextmanager
def parallel_loops(threads: int) -> Iterator[None]:
    """Let this thread alone run parallel loops, on so many cores."""
    with _PARALLEL_LOOPS, on_cores(threads):
        yield


@contextmanager
def on_cores(threads: int) -> Iterator[None]:
    """Share loops out to so many cores; of who runs them already, as in `parallel_loops`."""
    before = get_num_threads()
    set_num_threads(threads)
    try:
        yield
    finally:
        set_num_threads(before)
