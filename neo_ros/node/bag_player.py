"""Publish a bag on a real ROS graph, with the timing that it was recorded with."""
from collections.abc import Callable, Collection
from dataclasses import dataclass
import threading
import time

from neo_ros.bags import BagReader, BagTopic
from neo_ros.bags.reading import LONGEST_GAP_NS
from neo_ros.bags.topic import CDR, describe_topics
from neo_ros.errors import BagError
from neo_ros.node.message_types import find_message_class
from rclpy.duration import Duration
from rclpy.node import Node
from rclpy.publisher import Publisher
from rclpy.qos import DurabilityPolicy, QoSProfile
from rclpy.time import Time
from rosgraph_msgs.msg import Clock

CLOCK = '/clock'
CLOCK_PERIOD_S = 0.025
# A late subscriber gets the newest so many messages of a latched topic such as /tf_static.
LATCHED_DEPTH = 100
ACKNOWLEDGE_TIMEOUT_S = 2


@dataclass(frozen=True)
class Played:
    """How many messages went out, and how long that took in seconds."""

    messages: int
    seconds: float


class BagPlayer:
    """
    Publishes the messages of an open bag as they are, bytes for bytes.

    All topics are reliable, because Fast DDS loses large best-effort images; latched topics stay
    latched. Topics whose message type is not installed are left out and named to `report`.
    """

    def __init__(self, node: Node, bag: BagReader, names: Collection[str] | None = None,
                 clock: bool = True, report: Callable[[str], None] = print) -> None:
        known = {topic.name for topic in bag.topics}
        if names is not None and (missing := sorted(set(names) - known)):
            raise BagError(f'{bag.path}: expected the topics {", ".join(missing)}, the bag has '
                           f'{", ".join(sorted(known))}')
        self._bag, self._report = bag, report
        self._clock = node.create_publisher(Clock, CLOCK, 10) if clock else None
        # What /clock told last, and when it is due again.
        self._told_ns: int | None = None
        self._next_tick = 0.0
        self._publishers: dict[BagTopic, Publisher] = {}
        for topic in bag.topics:
            if (names is not None and topic.name not in names) or (clock and topic.name == CLOCK):
                continue
            if topic.encoding != CDR:
                report(f'{describe_topics([topic])} is left out: expected ROS 2 messages (cdr)')
                continue
            message_class = find_message_class(topic.msgtype)
            if message_class is None:
                # rclpy takes bytes as they are, but only for a publisher with a type support.
                report(f'{topic.name} is left out: {topic.msgtype} is not installed, and rclpy '
                       'cannot publish without it; install its package, or use ros2 bag play')
                continue
            self._publishers[topic] = node.create_publisher(
                message_class, topic.name, _qos_of(topic))
        if not self._publishers:
            raise BagError(f'{bag.path}: no topic left to play')

    def wait_for_subscribers(self, count: int, stop: threading.Event) -> None:
        """Wait until the played topics have `count` subscriptions in total, or `stop` is set."""
        while self._subscriptions() < count and not stop.wait(0.05):
            pass

    def play(self, stop: threading.Event, rate: float = 1.0) -> Played:
        """
        Publish the bag once, `rate` times as fast as it was recorded, until `stop` is set.

        A message that is late goes out at once: nothing is skipped. Returns when all reliable
        subscribers have acknowledged what was sent.
        """
        if not rate > 0:
            raise BagError(f'rate: expected a number > 0, got {rate}')
        started = counted_from = time.monotonic()
        first_ns: int | None = None
        last_ns: int | None = None
        self._told_ns = None
        count = 0
        for message in self._bag.messages({topic.name for topic in self._publishers}):
            publisher = self._publishers.get(message.topic)
            if publisher is None:
                continue
            if last_ns is not None and message.stamp_ns - last_ns > LONGEST_GAP_NS:
                days = (message.stamp_ns - last_ns) / LONGEST_GAP_NS
                self._report(f'{days:.0f} days without a message are left out: a clock was set')
                counted_from, first_ns = time.monotonic(), message.stamp_ns
            last_ns = message.stamp_ns
            if first_ns is None:
                first_ns = message.stamp_ns
            due = counted_from + (message.stamp_ns - first_ns) / 1e9 / rate
            if not self._wait_until(due, message.stamp_ns, rate, stop):
                break
            # Fast DDS copies a message even where nobody listens, and a wide truth is a large one.
            # Of a latched topic the middleware keeps them for who comes later.
            if message.topic.latched or publisher.get_subscription_count():
                publisher.publish(message.cdr)
            count += 1
        for publisher in self._publishers.values():
            publisher.wait_for_all_acked(Duration(seconds=ACKNOWLEDGE_TIMEOUT_S))
        return Played(count, time.monotonic() - started)

    def _subscriptions(self) -> int:
        return sum(publisher.get_subscription_count()
                   for publisher in self._publishers.values())

    def _wait_until(self, due: float, stamp_ns: int, rate: float, stop: threading.Event) -> bool:
        """Keep `/clock` going until the message is due; return False when stopped."""
        while not stop.is_set():
            now = time.monotonic()
            ahead = due - now
            if ahead <= 0:
                self._publish_clock(stamp_ns, now)
                return True
            if now >= self._next_tick:
                self._publish_clock(stamp_ns - round(ahead * rate * 1e9), now)
            stop.wait(min(ahead, self._next_tick - now))
        return False

    def _publish_clock(self, stamp_ns: int, now: float) -> None:
        self._next_tick = now + CLOCK_PERIOD_S
        # All messages of one moment have one time: told once, or every listener wakes for each.
        if self._clock is not None and stamp_ns != self._told_ns:
            self._told_ns = stamp_ns
            self._clock.publish(Clock(clock=Time(nanoseconds=max(stamp_ns, 0)).to_msg()))


def _qos_of(topic: BagTopic) -> QoSProfile:
    if topic.latched:
        return QoSProfile(depth=LATCHED_DEPTH, durability=DurabilityPolicy.TRANSIENT_LOCAL)
    return QoSProfile(depth=10)
