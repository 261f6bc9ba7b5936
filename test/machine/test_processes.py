"""Work in several processes: in order, none outlives who asked for it, and how one ends."""
import os
from pathlib import Path
import signal
import subprocess
import sys
import time

from neo_ros.machine.processes import map_in_processes
import pytest

WAIT_S = 60.0
ASKING = """
import sys
sys.path.insert(0, sys.argv[2])
from neo_ros.machine.processes import map_in_processes
from test_processes import note_and_wait
if __name__ == '__main__':
    list(map_in_processes(note_and_wait, [sys.argv[1]] * 8, 2))
"""


def note_and_wait(folder: str) -> None:
    Path(folder, str(os.getpid())).touch()
    time.sleep(600)


def test_results_come_in_order() -> None:
    assert list(map_in_processes(abs, range(-9, 0), 2)) == list(range(9, 0, -1))


def is_there(process: int) -> bool:
    try:
        state = Path(f'/proc/{process}/stat').read_text().rsplit(')', 1)[1].split()[0]
    except FileNotFoundError:
        return False
    return state != 'Z'  # Nobody may have asked yet how it ended.


@pytest.mark.skipif(not Path('/proc/self/stat').exists(), reason='not Linux')
def test_they_end_with_the_process_that_asked_even_if_it_is_killed(tmp_path: Path) -> None:
    script, notes = tmp_path / 'asking.py', tmp_path / 'notes'
    script.write_text(ASKING)
    notes.mkdir()
    asking = subprocess.Popen([sys.executable, script, notes, Path(__file__).parent])
    deadline = time.monotonic() + WAIT_S
    while len(list(notes.iterdir())) < 2:
        assert time.monotonic() < deadline and asking.poll() is None
        time.sleep(0.05)
    workers = [int(path.name) for path in notes.iterdir()]
    asking.send_signal(signal.SIGKILL)
    asking.wait()
    while any(map(is_there, workers)):
        assert time.monotonic() < deadline
        time.sleep(0.05)


ENDING = """
import atexit, threading, time
from neo_ros.machine.processes import end_if_busy
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
