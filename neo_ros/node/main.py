"""The executable `fov_extrapolator`."""
from collections.abc import Sequence
import os
import sys

from neo_ros.node.extrapolator_node import ExtrapolatorNode
from neo_ros.node.fastdds_profile import use_large_image_profile
import rclpy
from rclpy.executors import ExternalShutdownException, SingleThreadedExecutor
from rclpy.impl.implementation_singleton import rclpy_implementation


def main(arguments: Sequence[str] | None = None) -> None:
    """Run the node until SIGINT, SIGTERM or a shutdown of its context."""
    use_large_image_profile()
    rclpy.init(args=list(arguments) if arguments is not None else None)
    node = ExtrapolatorNode()
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


def _spin(node: ExtrapolatorNode) -> None:
    executor = SingleThreadedExecutor()
    executor.add_node(node)
    while True:
        try:
            executor.spin()
            return
        except rclpy_implementation.RCLError as error:
            # rclpy lets a request for an impossible transition end the whole node.
            node.get_logger().error(f'request refused: {error}')


if __name__ == '__main__':
    main()
