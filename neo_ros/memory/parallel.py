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
    with _PARALLEL_LOOPS:
        before = get_num_threads()
        set_num_threads(threads)
        try:
            yield
        finally:
            set_num_threads(before)


@contextmanager
def on_one_core() -> Iterator[None]:
    """Run loops of small views on this core alone: to share them out would take longer."""
    before = get_num_threads()
    set_num_threads(1)
    try:
        yield
    finally:
        set_num_threads(before)
