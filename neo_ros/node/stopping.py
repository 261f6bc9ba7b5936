"""End commands cleanly on SIGINT and SIGTERM."""
from collections.abc import Iterator
from contextlib import contextmanager
import signal
import threading

import rclpy
from rclpy.node import Node
from rclpy.signals import SignalHandlerOptions


@contextmanager
def ros_node_with_stop(name: str) -> Iterator[tuple[Node, threading.Event]]:
    """
    Give a node, and an event that SIGINT and SIGTERM set.

    rclpy's own handlers would raise in the middle of whatever runs, such as writing a bag.
    """
    stop = threading.Event()
    previous = {number: signal.signal(number, lambda *_: stop.set())
                for number in (signal.SIGINT, signal.SIGTERM)}
    rclpy.init(args=[], signal_handler_options=SignalHandlerOptions.NO)
    node = rclpy.create_node(name)
    try:
        yield node, stop
    finally:
        node.destroy_node()
        rclpy.try_shutdown()
        for number, handler in previous.items():
            signal.signal(number, handler)
