"""SIGINT and SIGTERM at any moment end the node with code 0 and without a traceback."""
from pathlib import Path
import signal
import sys
import time

import neo_ros
import pytest
from ros_graph import WAIT_S

REPOSITORY = Path(neo_ros.__file__).parent.parent
# Seconds after the first line of the shell: interpreter, imports, rclpy, the model, spinning.
MOMENTS = (0, 0.01, 0.03, 0.06, 0.1, 0.2, 0.3, 0.4, 0.5, 0.6, 0.8, 1, 1.3, 1.6, 2, 2.5, 3.5)


@pytest.fixture
def executable(tmp_path):
    """Lay out the executable as an installation does."""
    for folder in ('lib/neo_ros', 'bin'):
        (tmp_path / folder).mkdir(parents=True)
    script = tmp_path / 'bin' / 'fov_extrapolator'
    script.write_text(f'#!{sys.executable}\nimport sys\nfrom neo_ros.node.main import main\n'
                      'sys.exit(main())\n')
    script.chmod(0o755)
    node = tmp_path / 'lib' / 'neo_ros' / 'fov_extrapolator'
    node.write_bytes((REPOSITORY / 'scripts' / 'fov_extrapolator').read_bytes())
    node.chmod(0o755)
    return node


def wait_for_the_shell(process):
    """Wait until the first line has run: SIGTERM is caught or blocked."""
    def is_taken():
        lines = Path(f'/proc/{process.pid}/status').read_text().splitlines()
        masks = [int(line.split()[1], 16) for line in lines if line[:6] in ('SigBlk', 'SigCgt')]
        return any(mask & 1 << signal.SIGTERM - 1 for mask in masks)

    deadline = time.monotonic() + WAIT_S
    while not is_taken():
        assert time.monotonic() < deadline and process.poll() is None
        time.sleep(0.001)


@pytest.mark.parametrize('number', [signal.SIGINT, signal.SIGTERM], ids=['SIGINT', 'SIGTERM'])
def test_a_signal_at_any_moment_ends_it_quietly(graph, executable, model, number):
    ends = {}
    for moment in MOMENTS:
        process = graph.start_program(executable, '--ros-args', '-p', f'model:={model}')
        wait_for_the_shell(process)
        time.sleep(moment)
        process.send_signal(number)
        code, text = process.wait(WAIT_S), process.stdout.read()
        ends[moment] = code, 'Traceback' in text or 'Error' in text, text
    assert {moment: end for moment, end in ends.items() if end[:2] != (0, False)} == {}


def test_signals_that_come_in_a_row_do_no_harm(graph, executable, model):
    process = graph.start_program(executable, '--ros-args', '-p', f'model:={model}')
    time.sleep(2.5)
    while process.poll() is None:
        process.send_signal(signal.SIGINT)
        time.sleep(0.01)
    assert process.returncode == 0 and 'Traceback' not in process.stdout.read()
