"""A real ROS graph of processes for tests, on this machine only, with a domain of its own."""
from collections.abc import Callable, Iterator
from contextlib import contextmanager
import gc
from itertools import cycle
import os
from pathlib import Path
import signal
import subprocess
import sys
import time
from typing import Any

import neo_ros
from neo_ros.machine.ros_domain import own_domain
import rclpy
from rclpy.client import Client
from rclpy.context import Context
from rclpy.executors import SingleThreadedExecutor

# How long a test waits for what never comes; a stall of the machine is shorter.
WAIT_S = 120.0
# A shell starts what it runs in the background deaf to SIGINT, and that is inherited.
if signal.getsignal(signal.SIGINT) is signal.SIG_IGN:
    signal.signal(signal.SIGINT, signal.default_int_handler)
# Two pytest processes at a time must not hear one another, and a test no node of the one before:
# where it is still in the graph there would be two of one name.
_NUMBERS = cycle(range(10))
ENVIRONMENT = {
    'ROS_DOMAIN_ID': str(own_domain()),
    'ROS_AUTOMATIC_DISCOVERY_RANGE': 'LOCALHOST',
    'PYTHONPATH': os.pathsep.join(
        [str(Path(neo_ros.__file__).parent.parent), os.environ.get('PYTHONPATH', '')]),
}


class RosGraph:
    """The test's own node, and the processes that it started."""

    def __init__(self) -> None:
        self._processes: list[subprocess.Popen] = []
        self._clients: dict[str, Client] = {}
        domain = own_domain(next(_NUMBERS))
        self.environment = ENVIRONMENT | {'ROS_DOMAIN_ID': str(domain)}
        self.context = Context()
        rclpy.init(context=self.context, domain_id=domain)
        self.node = rclpy.create_node('test', context=self.context)
        self.executor = SingleThreadedExecutor(context=self.context)
        self.executor.add_node(self.node)

    def start(self, *arguments: str) -> subprocess.Popen:
        """Start Python with these arguments; close() ends it."""
        return self.start_program(sys.executable, *arguments)

    def start_program(self, *command: Path | str) -> subprocess.Popen:
        """Start a program; close() ends it."""
        process = subprocess.Popen(
            command, env=os.environ | self.environment,
            stdout=subprocess.PIPE, stderr=subprocess.STDOUT, text=True)
        self._processes.append(process)
        return process

    def collect(self, kind: type, topic: str, qos: Any = 10) -> list:
        """Subscribe; return the list that the messages go to."""
        messages: list = []
        self.node.create_subscription(kind, topic, messages.append, qos)
        return messages

    def spin_until(self, condition: Callable[[], Any], timeout: float = WAIT_S) -> Any:
        """Spin until the condition holds and return its value; fail when it never does."""
        deadline = time.monotonic() + timeout
        while not (value := condition()):
            assert time.monotonic() < deadline, 'waited in vain'
            self.executor.spin_once(timeout_sec=0.02)
        return value

    def spin_for(self, seconds: float) -> None:
        """Spin for a while."""
        deadline = time.monotonic() + seconds
        while time.monotonic() < deadline:
            self.executor.spin_once(timeout_sec=0.02)

    def call(self, kind: type, service: str, request: Any) -> Any:
        """Call a service and return its response."""
        if service not in self._clients:
            client = self._clients[service] = self.node.create_client(kind, service)
            self.spin_until(client.service_is_ready)
            # The server finds our reader of replies a moment later, and drops a reply before that
            # (ros2/rmw_fastrtps#842).
            self.spin_for(0.5)
        future = self._clients[service].call_async(request)
        self.spin_until(future.done)
        return future.result()

    def close(self) -> None:
        """End all processes and the test's node."""
        for process in self._processes:
            process.terminate()
        for process in self._processes:
            try:
                process.wait(5)
            except subprocess.TimeoutExpired:
                process.kill()  # Last, because it leaves shared memory behind.
                process.wait()
            if process.stdout and not process.stdout.closed:
                print(process.stdout.read())  # pytest shows it where the test failed.
        self.executor.shutdown()
        self.node.destroy_node()
        self.context.try_shutdown()


@contextmanager
def ros_graph() -> Iterator[RosGraph]:
    """Open a graph and close it, whatever happens."""
    previous = os.environ.get('ROS_AUTOMATIC_DISCOVERY_RANGE')
    os.environ['ROS_AUTOMATIC_DISCOVERY_RANGE'] = 'LOCALHOST'
    # A node that an earlier test destroyed stays in the graph until its cycles are collected.
    gc.collect()
    graph = RosGraph()
    try:
        yield graph
    finally:
        graph.close()
        if previous is None:
            del os.environ['ROS_AUTOMATIC_DISCOVERY_RANGE']
        else:
            os.environ['ROS_AUTOMATIC_DISCOVERY_RANGE'] = previous
