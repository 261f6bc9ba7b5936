"""A process that has loaded pycolmap ends when it is asked to."""
import signal
import subprocess
import sys

import pytest

HANDLED = """
import signal
from neo_ros.machine.colmap import load_pycolmap
if {own}:
    signal.signal(signal.SIGTERM, lambda *_: exit(3))
assert load_pycolmap().Camera
load_pycolmap()
signal.raise_signal(signal.SIGTERM)
"""


@pytest.mark.parametrize('own, ends', [(False, -signal.SIGTERM), (True, 3)])
def test_what_answered_the_signal_before_does_so_again(own: bool, ends: int) -> None:
    pytest.importorskip('pycolmap', reason='the extra `train` is not installed')
    done = subprocess.run([sys.executable, '-c', HANDLED.format(own=own)], capture_output=True,
                          text=True, timeout=120)
    assert (done.returncode, done.stderr) == (ends, '')
