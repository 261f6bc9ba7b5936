"""The executable `fov_extrapolator`."""
from collections.abc import Sequence
import gc
import os
from pathlib import Path
import sys

from neo_ros.node.extrapolator_node import ExtrapolatorNode
from neo_ros.node.fastdds_profile import use_large_image_profile
import rclpy
from rclpy.exceptions import InvalidParameterTypeException, InvalidParameterValueException
from rclpy.executors import ExternalShutdownException, SingleThreadedExecutor
from rclpy.impl.implementation_singleton import rclpy_implementation

WAIT_S = 0.2


def main(arguments: Sequence[str] | None = None) -> None:
    """Run the node until SIGINT, SIGTERM or a shutdown of its context."""
    use_large_image_profile()
    # Threads of numba's loops wait for one another asleep: while they spin, nobody else has their
    # core, and where other programs want it, too, a frame took six times as long. OpenMP reads it
    # with the first scene memory.
    os.environ.setdefault('OMP_WAIT_POLICY', 'PASSIVE')
    arguments = list(sys.argv if arguments is None else arguments)
    if not _can_log():
        print('fov_extrapolator: the folder of the log files cannot be written; logging to the '
              'console and /rosout only', file=sys.stderr)
        arguments += ['--ros-args', '--disable-external-lib-logs']
    rclpy.init(args=arguments)
    try:
        node = ExtrapolatorNode()
    except (InvalidParameterTypeException, InvalidParameterValueException) as error:
        rclpy.try_shutdown()
        sys.exit(f'fov_extrapolator: {error}')
    idle = True
    try:
        node.autostart()
        _spin(node)
    except (KeyboardInterrupt, ExternalShutdownException):
        pass
    finally:
        idle = node.stop()
        rclpy.try_shutdown()
    if not idle:
        # The network is in the middle of a frame and cannot be interrupted; tearing the
        # interpreter down below it may crash, waiting for it may take seconds.
        sys.stdout.flush()
        sys.stderr.flush()
        os._exit(0)
    # The interpreter's last garbage collections walk through all of numba: two thirds of the time
    # that ending takes.
    gc.freeze()


def _can_log() -> bool:
    """Say whether ROS can write its log files; where it cannot, rclpy does not even start."""
    home = Path(os.environ.get('ROS_HOME') or Path(os.environ.get('HOME', '/'), '.ros'))
    folder = Path(os.environ.get('ROS_LOG_DIR') or home / 'log')
    try:
        folder.mkdir(parents=True, exist_ok=True)
    except OSError:
        return False
    return os.access(folder, os.W_OK)


def _spin(node: ExtrapolatorNode) -> None:
    executor = SingleThreadedExecutor()
    executor.add_node(node)
    while rclpy.ok():
        try:
            # A wait may begin after a signal and before the context is down: brief ones end soon.
            executor.spin_once(timeout_sec=WAIT_S)
        except rclpy_implementation.RCLError as error:
            # rclpy lets a request for an impossible transition end the whole node.
            node.get_logger().error(f'request refused: {error}')


if __name__ == '__main__':
    main()
