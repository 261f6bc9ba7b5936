"""SIGINT and SIGTERM at any moment end the node with code 0 and without a traceback."""
from pathlib import Path
import signal
import sys
import time

import neo_ros
import pytest
from ros_graph import WAIT_S

REPOSITORY = Path(neo_ros.__file__).parent.parent
SHELL = Path('/bin/sh').resolve()
# Seconds after the signals are blocked: interpreter, imports, rclpy, the model, spinning.
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
    """Wait until the shell has handed over: before, a signal ends it as it ends any program."""
    def is_taken():
        # Until it runs the shell it is a copy of this process, which blocks signals as it starts.
        if b'fov_extrapolator' not in Path(f'/proc/{process.pid}/cmdline').read_bytes():
            return False
        # The shell blocks signals for a moment when it forks; after its turn env starts unblocked.
        if Path(f'/proc/{process.pid}/exe').resolve() == SHELL:
            return False
        lines = Path(f'/proc/{process.pid}/status').read_text().splitlines()
        masks = [int(line.split()[1], 16) for line in lines
                 if line.startswith(('SigBlk', 'SigCgt'))]
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


HOLDING = """
import os, signal, time
from neo_ros.node.running import _Stop
import rclpy
from rclpy.signals import SignalHandlerOptions
from rclpy.utilities import get_default_context
stop = _Stop()
rclpy.init(signal_handler_options=SignalHandlerOptions.NO)
with get_default_context()._lock:  # As rclpy.ok and others hold it.
    os.kill(os.getpid(), signal.SIGINT)
while rclpy.ok():
    time.sleep(0.01)
"""


def test_a_signal_that_meets_a_lock_of_rclpy_ends_it(graph):
    assert graph.start('-c', HOLDING).wait(WAIT_S) == 0


def test_signals_that_come_in_a_row_do_no_harm(graph, executable, model):
    process = graph.start_program(executable, '--ros-args', '-p', f'model:={model}')
    wait_for_the_shell(process)
    time.sleep(2.5)
    deadline = time.monotonic() + WAIT_S
    while process.poll() is None:
        assert time.monotonic() < deadline
        process.send_signal(signal.SIGINT)
        time.sleep(0.01)
    assert process.returncode == 0 and 'Traceback' not in process.stdout.read()


WORKING = """
import atexit, threading, time
from neo_ros.node import running
def serve(stop):
    threading.Thread(target=time.sleep, args=(60,), name='learn', daemon=True).start()
    return True
atexit.register(print, 'the interpreter is torn down')
running._serve = serve
running.run([])
"""


def test_no_interpreter_is_torn_down_below_a_thread_that_learns(graph):
    process = graph.start('-c', WORKING)
    assert process.wait(WAIT_S) == 0
    assert 'torn down' not in process.stdout.read()
