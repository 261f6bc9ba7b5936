"""Pictures from a ROS graph: subscribes to what somebody watches, and to nothing else."""
from collections.abc import Callable, Mapping
from dataclasses import replace
from functools import partial
import threading
from typing import Any

from diagnostic_msgs.msg import DiagnosticArray
from geometry_msgs.msg import PoseWithCovarianceStamped
from neo_ros.errors import GeometryError, ImageRejected
from neo_ros.messages.hints import read_pose
from neo_ros.messages.stamps import NS_PER_S, stamp_of
from neo_ros.viewer.hub import Hub
from neo_ros.viewer.pictures import SourcePicture, SourceState
from neo_ros.viewer.whereabouts import PoseJoiner
from neo_ros.viewer.wide_topics import (
    NodeDiagnosis, read_grey, read_picture, read_pixels, seen_share, WideTopics)
import numpy as np
from rclpy.executors import SingleThreadedExecutor
from rclpy.node import Node
from rclpy.qos import QoSProfile, ReliabilityPolicy
from rclpy.subscription import Subscription
from sensor_msgs.msg import CompressedImage, Image

IMAGE_TYPES = {'sensor_msgs/msg/Image': Image, 'sensor_msgs/msg/CompressedImage': CompressedImage}
LOOK_PERIOD_S = 0.25
SPIN_S = 0.05
# Without a diagnosis for so long, nothing is known of the node any more.
DIAGNOSIS_VALID_S = 5.0
# The node may load another model meanwhile: the mask is read again so often.
MASK_PERIOD_S = 10.0
# Stamps that are older are of another clock: a bag that is played, a camera without a clock.
MOST_DELAY_S = 60.0
EARLIEST_S = -0.05
# The newest picture only. Best effort takes what reliable and best-effort publishers offer.
NEWEST = QoSProfile(depth=1, reliability=ReliabilityPolicy.BEST_EFFORT)


class RosSource:
    """
    Shows a wide image topic of the graph, `image`, with the confidence and the mask beside it.

    The topic may be an Image, or a CompressedImage whose JPEG goes to the viewers as it is. While
    nobody watches there is no subscription, so the node does not widen for the viewer's sake.
    """

    def __init__(self, node: Node, image: str = 'wide/image') -> None:
        self._node = node
        self._topics = WideTopics(node.resolve_topic_name(image))
        self._subscriptions: dict[str, Subscription] = {}
        self._seen: tuple[float, float, float, float] | None = None
        self._next_mask = 0.0
        self._size = (0, 0)
        self._confidence: Any = None
        self._pending: tuple[Any, float, bool] | None = None
        self._state = SourceState(self._topics.image, 'starting')
        self._diagnosis = NodeDiagnosis(self._topics.camera)
        self._diagnosed = 0.0
        self._complaint = ''

    def run(self, hub: Hub, stop: threading.Event) -> None:
        """Give pictures to the hub until `stop` is set."""
        self._hub = hub
        self._joiner = PoseJoiner(hub.where)
        executor = SingleThreadedExecutor(context=self._node.context)
        executor.add_node(self._node)
        next_look = 0.0
        wanted = hub.wanted
        try:
            while not stop.is_set() and self._node.context.ok():
                if hub.wanted != wanted or hub.clock.now() >= next_look:
                    wanted, next_look = hub.wanted, hub.clock.now() + LOOK_PERIOD_S
                    self._look()
                executor.spin_once(timeout_sec=SPIN_S)
        finally:
            executor.remove_node(self._node)
            executor.shutdown()

    def _look(self) -> None:
        """Subscribe to what is wanted and there, drop the rest, and say how things stand."""
        wanted, topics = self._hub.wanted, self._topics
        offers = self._node.get_publishers_info_by_topic(topics.image)
        kind = IMAGE_TYPES.get(offers[0].topic_type) if offers else None
        if not offers:
            self._forget_mask()  # The next node may widen another camera.
        showing = wanted.image and kind is not None
        self._keep(topics.image, kind, showing, self._on_image)
        if not showing:
            self._pending = self._confidence = None  # Old, when somebody watches again.
        self._keep(topics.mask, Image, showing and self._hub.clock.now() >= self._next_mask,
                   self._on_mask)
        self._keep(topics.confidence, Image, showing and wanted.confidence
                   and self._node.count_publishers(topics.confidence) > 0, self._on_confidence)
        self._keep(topics.status, DiagnosticArray, showing
                   and self._node.count_publishers(topics.status) > 0, self._on_status)
        self._keep(topics.pose, PoseWithCovarianceStamped,
                   showing and self._hub.where.wanted > 0, self._on_pose)
        self._keep('/diagnostics', DiagnosticArray, wanted.image, self._on_diagnostics)
        if self._hub.clock.now() - self._diagnosed > DIAGNOSIS_VALID_S:
            self._state = SourceState(topics.image)
        if offers and kind is None:
            waiting = (f'{topics.image} is a {offers[0].topic_type}; expected an Image or a '
                       'CompressedImage')
        elif not offers:
            waiting = f'waiting for {topics.image}, publishers: 0'
        else:
            waiting = self._complaint
        self._state = replace(self._state, waiting=waiting)
        self._hub.report(self._state)

    def _keep(self, topic: str, kind: type | None, needed: bool,
              callback: Callable[[Any], None]) -> None:
        """Subscribe if needed, else unsubscribe."""
        known = self._subscriptions.get(topic)
        if known is not None and (not needed or known.msg_type is not kind):
            self._node.destroy_subscription(self._subscriptions.pop(topic))
            known = None
        if needed and known is None:
            qos = QoSProfile(depth=10) if kind is DiagnosticArray else NEWEST
            self._subscriptions[topic] = self._node.create_subscription(
                kind, topic, callback, qos)

    def _on_image(self, message: Any) -> None:
        arrived = self._hub.clock.now()
        delay = (self._node.get_clock().now().nanoseconds - stamp_of(message.header)) / NS_PER_S
        timed = EARLIEST_S <= delay <= MOST_DELAY_S
        captured = arrived - max(delay, 0) if timed else arrived
        self._joiner.add_image(stamp_of(message.header), captured, partial(read_pixels, message))
        if self._topics.confidence not in self._subscriptions:
            self._pending = self._confidence = None  # What waited is an old picture now.
            self._publish(message, captured, timed, None)
            return
        if self._pending is not None:
            self._publish(*self._pending, None)  # Its confidence was lost.
        self._pending = message, captured, timed
        self._join()

    def _on_pose(self, message: PoseWithCovarianceStamped) -> None:
        try:
            self._joiner.add_pose(stamp_of(message.header), read_pose(message.pose.pose))
        except GeometryError as error:
            self._complaint = f'cannot read {self._topics.pose}: {error}'

    def _on_confidence(self, message: Image) -> None:
        self._confidence = message
        self._join()

    def _join(self) -> None:
        """Publish the picture that waits once its confidence is there, whichever came first."""
        if self._pending is None or self._confidence is None:
            return
        if stamp_of(self._pending[0].header) == stamp_of(self._confidence.header):
            picture, self._pending = self._pending, None
            self._publish(*picture, self._confidence)

    def _publish(self, message: Any, captured: float, timed: bool,
                 confidence: Image | None) -> None:
        if (size := (getattr(message, 'width', 0), getattr(message, 'height', 0))) != self._size:
            self._size = size
            self._forget_mask()
        try:
            grey: np.ndarray | None = read_grey(confidence) if confidence is not None else None
            self._hub.publish(
                SourcePicture(read_picture(message), captured, timed, grey, self._seen))
            self._complaint = ''
        except ImageRejected as error:
            self._complaint = f'cannot show {self._topics.image}: {error}'

    def _on_mask(self, message: Image) -> None:
        try:
            self._seen = seen_share(read_grey(message))
            self._next_mask = self._hub.clock.now() + MASK_PERIOD_S
        except ImageRejected as error:
            self._complaint = f'cannot read {self._topics.mask}: {error}'

    def _forget_mask(self) -> None:
        self._seen, self._next_mask = None, 0.0

    def _on_status(self, message: DiagnosticArray) -> None:
        self._tell(self._diagnosis.read_frame(message.status))

    def _on_diagnostics(self, message: DiagnosticArray) -> None:
        diagnosis = self._diagnosis.read(message.status)
        if diagnosis:
            self._diagnosed = self._hub.clock.now()
            self._tell(diagnosis)

    def _tell(self, known: Mapping[str, Any]) -> None:
        self._state = replace(self._state, **known)
        self._hub.report(self._state)
