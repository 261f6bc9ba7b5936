"""Record topics of a real ROS graph into a bag."""
from collections import Counter
from collections.abc import Callable, Sequence
import functools
import threading
import time
from typing import Any

from neo_ros.bags import BagTopic, BagWriter
from neo_ros.bags.qos import LATCHED
from neo_ros.errors import BagError
from neo_ros.node.message_types import find_message_class
from rclpy.executors import SingleThreadedExecutor
from rclpy.node import Node
from rclpy.qos import DurabilityPolicy, QoSProfile, ReliabilityPolicy

# A disk that stalls for a moment must not cost messages.
DEPTH = 100
LOOK_PERIOD_S = 0.2


class BagRecorder:
    """
    Writes the messages of the named topics as they come, undecoded.

    Types are taken from the graph; a topic is subscribed as soon as it has a publisher, as
    reliable and as latched as its publishers offer. The log time is the time of arrival.
    `counts` holds the messages per topic so far.
    """

    def __init__(self, node: Node, writer: BagWriter, names: Sequence[str],
                 report: Callable[[str], None] = print) -> None:
        self._node = node
        self._writer = writer
        self._report = report
        self._waiting = {node.resolve_topic_name(name) for name in names}
        self.counts: Counter[str] = Counter(dict.fromkeys(self._waiting, 0))
        self._last_message = 0.0

    def record(self, stop: threading.Event, seconds: float | None = None,
               messages: int | None = None, idle_timeout: float | None = None) -> None:
        """
        Record until `stop` is set, or the first of these that is given comes true.

        `seconds` passed; every topic has at least `messages` messages; nothing came for
        `idle_timeout` seconds after the first message. Raises BagError where no type of the
        topics is installed.
        """
        executor = SingleThreadedExecutor(context=self._node.context)
        executor.add_node(self._node)
        try:
            self._spin(executor, stop, seconds, messages, idle_timeout)
        finally:
            executor.remove_node(self._node)

    def _spin(self, executor: SingleThreadedExecutor, stop: threading.Event,
              seconds: float | None, messages: int | None, idle_timeout: float | None) -> None:
        started = time.monotonic()
        next_look = started
        while not stop.is_set():
            now = time.monotonic()
            if self._waiting and now >= next_look:
                self._look_for_topics()
                if not self.counts:
                    raise BagError('no topic left to record; install the packages of their types')
                next_look = now + LOOK_PERIOD_S
            executor.spin_once(timeout_sec=0.05)
            if seconds is not None and now - started >= seconds:
                break
            if messages is not None and min(self.counts.values(), default=0) >= messages:
                break
            if (idle_timeout is not None and self._last_message
                    and now - self._last_message >= idle_timeout):
                break

    def _look_for_topics(self) -> None:
        for name, msgtypes in self._node.get_topic_names_and_types():
            # Other subscribers make a topic visible, too, but only a publisher has a QoS.
            if name not in self._waiting:
                continue
            qos = self._qos_of(name)
            if qos is None:
                continue
            self._waiting.remove(name)
            message_class = find_message_class(msgtypes[0])
            if message_class is None:
                self._report(f'{name} is left out: {msgtypes[0]} is not installed')
                del self.counts[name]
                continue
            if msgtypes[0] not in self._writer.typestore.types:
                self._report(f'{name}: the bag does not say what a {msgtypes[0]} consists of, '
                             'as it is none of the types of ROS 2 Jazzy itself')
            latched = qos.durability == DurabilityPolicy.TRANSIENT_LOCAL
            topic = self._writer.add_topic(name, msgtypes[0], (LATCHED,) if latched else ())
            self._node.create_subscription(
                message_class, name, functools.partial(self._write, topic), qos, raw=True)

    def _write(self, topic: BagTopic, cdr: bytes, info: dict[str, Any]) -> None:
        self._writer.write_cdr(topic, info['received_timestamp'] or time.time_ns(), cdr)
        self.counts[topic.name] += 1
        self._last_message = time.monotonic()

    def _qos_of(self, name: str) -> QoSProfile | None:
        offers = [info.qos_profile for info in self._node.get_publishers_info_by_topic(name)]
        if not offers:
            return None
        reliable = all(offer.reliability == ReliabilityPolicy.RELIABLE for offer in offers)
        latched = all(offer.durability == DurabilityPolicy.TRANSIENT_LOCAL for offer in offers)
        return QoSProfile(
            depth=DEPTH,
            reliability=(ReliabilityPolicy.RELIABLE if reliable
                         else ReliabilityPolicy.BEST_EFFORT),
            durability=(DurabilityPolicy.TRANSIENT_LOCAL if latched
                        else DurabilityPolicy.VOLATILE))
