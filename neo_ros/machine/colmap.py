"""pycolmap, which takes over the signal that asks a process to end."""
import signal
import threading
from types import ModuleType


def load_pycolmap() -> ModuleType:
    """
    Import pycolmap; raises ModuleNotFoundError where it is not installed.

    Its library for logs answers SIGTERM with a trace, and may wait in that for ever for a lock
    that the code below it holds: a training that is asked to end would stay, with its memory.
    What answered before does so again.
    """
    import pycolmap
    if threading.current_thread() is threading.main_thread():  # No other may do it.
        signal.signal(signal.SIGTERM, signal.getsignal(signal.SIGTERM))
    return pycolmap
