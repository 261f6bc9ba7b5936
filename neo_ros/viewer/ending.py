"""The end of a viewer's process."""
import os
import sys
import threading


def end_if_busy() -> None:
    """
    End the process at once, with code 0, while threads are at work that nobody waits for.

    They draw the plan, read the time line or widen a picture: tearing the interpreter down below
    them may crash, waiting for them may take seconds.
    """
    if any(thread.daemon and thread is not threading.current_thread()
           for thread in threading.enumerate()):
        sys.stdout.flush()
        sys.stderr.flush()
        os._exit(0)
