"""Jobs that go wrong on a cluster: workers import them from here."""
import os
from pathlib import Path
import signal
import time

from numba import get_num_threads


def die(folder: str) -> None:
    """Leave a mark of having begun, and do what no worker survives."""
    Path(folder, f'{time.time_ns()}').touch()
    os.kill(os.getpid(), signal.SIGKILL)


def halve(job: int) -> int:
    """Halve a number; raises ValueError for odd ones."""
    if job % 2:
        raise ValueError(f'{job} is odd')
    return job // 2


def cores(job: int) -> int:
    """Return how many cores compiled loops would take."""
    return get_num_threads()
