"""Run the node from its arguments to its end."""
import _thread
from collections.abc import Sequence
import gc
import os
from pathlib import Path
import signal
import sys
from typing import Any

from neo_ros.machine.processes import end_if_busy
from neo_ros.node.extrapolator_node import ExtrapolatorNode
from neo_ros.node.fastdds_profile import use_large_image_profile
from neo_ros.node.main import SIGNALS
import rclpy
from rclpy.exceptions import InvalidParameterTypeException, InvalidParameterValueException
from rclpy.executors import SingleThreadedExecutor
from rclpy.signals import SignalHandlerOptions

WAIT_S = 0.2


class _Stop:
    """Whether a signal came; it takes the context down, which ends the wait for a model, too."""

    def __init__(self) -> None:
        self.asked = False
        # rclpy's own handlers would raise in the middle of whatever runs.
        for number in SIGNALS:
            signal.signal(number, self._on_signal)

    def _on_signal(self, *_: Any) -> None:
        self.asked = True
        # In a thread: it takes a lock that the code below this handler may hold, as rclpy.ok does.
        # Thread.start has a lock of the same kind.
        _thread.start_new_thread(rclpy.try_shutdown, ())


def run(arguments: Sequence[str] | None = None) -> None:
    """Run the node until SIGINT, SIGTERM or a shutdown of its context."""
    use_large_image_profile()
    arguments = list(sys.argv if arguments is None else arguments)
    if not _can_log():
        print('fov_extrapolator: the folder of the log files cannot be written; logging to the '
              'console and /rosout only', file=sys.stderr)
        arguments += ['--ros-args', '--disable-external-lib-logs']
    stop, idle = _Stop(), True
    try:
        rclpy.init(args=arguments, signal_handler_options=SignalHandlerOptions.NO)
        idle = _serve(stop)
    except BaseException:
        # What runs while the context goes down raises whatever it likes.
        if not stop.asked:
            raise
        idle = False
    for number in SIGNALS:
        signal.signal(number, signal.SIG_IGN)  # It is ending.
    rclpy.try_shutdown()
    # The network may be in the middle of a frame, and cannot be interrupted; threads learn, or
    # draw the map.
    end_if_busy(not idle)
    # The interpreter's last garbage collections walk through all of numba: two thirds of the time
    # that ending takes.
    gc.freeze()


def _serve(stop: _Stop) -> bool:
    """Run a node until the context is down; return whether nothing is at work any more."""
    try:
        node = ExtrapolatorNode()
    except (InvalidParameterTypeException, InvalidParameterValueException) as error:
        rclpy.try_shutdown()
        sys.exit(f'fov_extrapolator: {error}')
    idle = False
    try:
        node.autostart()
        executor = SingleThreadedExecutor()
        executor.add_node(node)
        while rclpy.ok() and not stop.asked:
            # A signal is only seen between waits.
            executor.spin_once(timeout_sec=WAIT_S)
    except BaseException:
        if rclpy.ok():
            raise
    finally:
        idle = node.end()
    return idle


def _can_log() -> bool:
    """Say whether ROS can write its log files; where it cannot, rclpy does not even start."""
    home = Path(os.environ.get('ROS_HOME') or Path(os.environ.get('HOME', '/'), '.ros'))
    folder = Path(os.environ.get('ROS_LOG_DIR') or home / 'log')
    try:
        folder.mkdir(parents=True, exist_ok=True)
    except OSError:
        return False
    return os.access(folder, os.W_OK)
