"""Publishes once a second on `/diagnostics` how the node is."""
from collections.abc import Callable
from dataclasses import dataclass
import time

from diagnostic_msgs.msg import DiagnosticArray
from neo_ros.messages import SceneWatch
from neo_ros.node.camera_inputs import CameraInputs
from neo_ros.node.diagnostics import build_camera_status, build_status, Health
from neo_ros.node.frame_statistics import Statistics
from neo_ros.node.input_topics import publisher_name
from neo_ros.node.interface import DIAGNOSTICS, OUTPUTS
from neo_ros.node.loaded_model import LoadedModel
from rclpy.clock import Clock, ClockType
from rclpy.node import Node

PERIOD_S = 1.0
# The graph shows a node for a while after it has ended: a twin counts that is seen so often.
TWIN_SEEN = 3


@dataclass(frozen=True)
class NodeState:
    """What the node itself knows: see `diagnostics.Health`."""

    state: str
    fault: str
    loading: bool
    enabled: bool
    subscribed: bool
    model: LoadedModel | None
    transform: str
    warning: str


class Diagnosing:
    """Looks at the node, its inputs and its counts, and says how they are."""

    def __init__(self, node: Node, inputs: CameraInputs, statistics: Statistics,
                 state: Callable[[], NodeState]) -> None:
        self._node, self._inputs, self._statistics = node, inputs, statistics
        self._state, self._twin_seen = state, 0
        self._publisher = node.create_publisher(DIAGNOSTICS.kind, DIAGNOSTICS.name, 10)
        self.begin()
        self._last_s = time.monotonic()
        # Steady, so that a paused simulation is still diagnosed.
        node.create_timer(PERIOD_S, self.publish, clock=Clock(clock_type=ClockType.STEADY_TIME))

    def begin(self) -> None:
        """Forget what was like the scene: another place, or another model."""
        self._scene_watch = SceneWatch()

    def keep_up(self) -> None:
        """Publish where the timer is late, because the executor's thread is busy."""
        if time.monotonic() > self._last_s + PERIOD_S:
            self.publish()

    def publish(self) -> None:
        """Publish one diagnosis."""
        self._last_s = time.monotonic()
        if not self._node.context.ok():
            return  # A model may still be loading at the shutdown, and a publisher would raise.
        self._inputs.forget_lost_camera()
        counts, now = self._statistics.snapshot(), self._state()
        twin = describe_twin(self._node)
        self._twin_seen = self._twin_seen + 1 if twin else 0
        health = Health(
            state=now.state, fault=now.fault, loading=now.loading, enabled=now.enabled,
            topic=self._inputs.topic, publishers=self._inputs.publishers,
            missing=self._inputs.missing, conflict=self._inputs.conflict, transform=now.transform,
            warning=now.warning, twin=twin if self._twin_seen >= TWIN_SEEN else '',
            camera=self._inputs.frame_id, subscribed=now.subscribed,
            memory=now.model is not None and now.model.memory,
            unlike_scene=self._scene_watch.update(counts.out_of_scene), counts=counts)
        name = self._node.get_fully_qualified_name()
        message = DiagnosticArray(status=[
            build_status(name, health, now.model.description if now.model else {}),
            build_camera_status(name, health.camera or health.topic,
                                self._inputs.stamps.report(), self._inputs.remedy)])
        message.header.stamp = self._node.get_clock().now().to_msg()
        self._publisher.publish(message)


def describe_twin(node: Node) -> str:
    """Name another node of the same name, or one that publishes the same; '' = there is none."""
    own = node.get_fully_qualified_name()
    names = [f'{namespace.rstrip("/")}/{name}'
             for name, namespace in node.get_node_names_and_namespaces()]
    if names.count(own) > 1:
        return f'another node is called {own}, too: give each camera a namespace (-r __ns:=/left)'
    topic = node.resolve_topic_name(OUTPUTS['image'].name)
    others = sorted({publisher_name(found)
                     for found in node.get_publishers_info_by_topic(topic)} - {own})
    if not others:
        return ''
    return (f'{topic} is published by {" and ".join(others)}, too: give each camera a namespace '
            '(-r __ns:=/left)')
