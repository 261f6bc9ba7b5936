"""The end of the viewer's process while something is still at work."""
from pathlib import Path
import subprocess
import sys

import pytest

ENDING = """
import atexit, threading, time
from neo_ros.viewer.ending import end_if_busy
atexit.register(print, 'torn down')
if {busy}:
    threading.Thread(target=time.sleep, args=(60,), daemon=True).start()
print('said')
end_if_busy()
"""


@pytest.mark.parametrize('busy', [False, True])
def test_the_interpreter_is_torn_down_unless_a_thread_works(busy: bool) -> None:
    result = subprocess.run([sys.executable, '-c', ENDING.format(busy=busy)], text=True,
                            cwd=Path(__file__).parents[2], capture_output=True, check=True)
    assert result.stdout.split('\n')[:-1] == ['said', *([] if busy else ['torn down'])]
