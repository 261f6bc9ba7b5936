"""The subscriptions to the camera."""
from collections.abc import Callable
import functools
import time
from typing import Any

from neo_ros.messages import camera_info_of
from neo_ros.node.interface import CAMERA_INFO, COMPRESSED_IMAGE, Endpoint, IMAGE
from rclpy.event_handler import SubscriptionEventCallbacks
from rclpy.node import Node
from rclpy.qos import qos_policy_name_from_kind, QoSProfile, ReliabilityPolicy
from rclpy.subscription import Subscription
from sensor_msgs.msg import CameraInfo

# Drivers send an image before its camera_info: the first images of a camera that publishes one
# wait so long for it, the newest of them.
CAMERA_INFO_WAIT_S = 2.0


class CameraInputs:
    """
    Subscribes to the image, raw or compressed, and to its camera_info.

    `take` gets every image with what the newest camera_info says of it, None where there is none.
    """

    def __init__(self, node: Node, take: Callable[[Any, Any | None], None]) -> None:
        self._node = node
        self._take = take
        self._forget_camera()
        self._image: Endpoint = IMAGE
        self._reliable = False
        self._subscriptions: list[Subscription] = []

    @property
    def topic(self) -> str:
        """Full name of the image topic."""
        return self._node.resolve_topic_name(self._image.name)

    @property
    def publishers(self) -> int:
        """How many publishers the image topic has."""
        return self._node.count_publishers(self.topic)

    @property
    def qos_conflict(self) -> str:
        """Which publisher's QoS does not fit, in words; '' = none."""
        # Asked of the graph, not kept from events: those do not tell when the publisher has gone.
        for endpoint in (self._image, CAMERA_INFO):
            topic = self._node.resolve_topic_name(endpoint.name)
            if self._reliable and self._subscriptions and any(
                    publisher.qos_profile.reliability == ReliabilityPolicy.BEST_EFFORT
                    for publisher in self._node.get_publishers_info_by_topic(topic)):
                return (f'the publisher of {topic} is best effort, this node asks for reliable; '
                        'set the parameter reliable to false')
        return ''

    def choose(self, transport: str, reliable: bool) -> None:
        """Set what the next `subscribe` asks for."""
        self._image = COMPRESSED_IMAGE if transport == 'compressed' else IMAGE
        self._reliable = reliable

    def subscribe(self) -> None:
        """Take images from now on."""
        self.unsubscribe()
        # The newest image only; a frame that waits here is as old as one that waits anywhere.
        qos = QoSProfile(depth=1, reliability=(
            ReliabilityPolicy.RELIABLE if self._reliable else ReliabilityPolicy.BEST_EFFORT))
        self._subscriptions = [
            self._node.create_subscription(
                endpoint.kind, endpoint.name, callback, qos,
                event_callbacks=SubscriptionEventCallbacks(
                    incompatible_qos=functools.partial(self._on_qos_conflict, endpoint)))
            for endpoint, callback in ((self._image, self._on_image),
                                       (CAMERA_INFO, self._on_camera_info))]

    def unsubscribe(self) -> None:
        """Take no more images."""
        for subscription in self._subscriptions:
            self._node.destroy_subscription(subscription)
        self._subscriptions = []
        self._forget_camera()

    def forget_lost_camera(self) -> None:
        """Drop the camera_info once nobody publishes it: the next camera may be another one."""
        if self._camera_info is not None and not self._is_calibrated():
            self._forget_camera()

    def _forget_camera(self) -> None:
        self._camera_info: Any | None = None
        self._waiting: Any | None = None
        self._waiting_since: float | None = None

    def _is_calibrated(self) -> bool:
        """Say whether somebody publishes camera_info."""
        return bool(self._node.count_publishers(self._node.resolve_topic_name(CAMERA_INFO.name)))

    def _on_image(self, message: Any) -> None:
        if (self._camera_info is None and self._is_calibrated()
                and not self.qos_conflict):
            now = time.monotonic()
            self._waiting_since = now if self._waiting_since is None else self._waiting_since
            if now - self._waiting_since < CAMERA_INFO_WAIT_S:
                self._waiting = message
                return
        self._take(message, self._camera_info)

    def _on_camera_info(self, message: CameraInfo) -> None:
        self._camera_info = camera_info_of(message, self.topic)
        waiting, self._waiting = self._waiting, None
        if waiting is not None:
            self._take(waiting, self._camera_info)

    def _on_qos_conflict(self, endpoint: Endpoint, event: Any) -> None:
        topic = self._node.resolve_topic_name(endpoint.name)
        policy = qos_policy_name_from_kind(event.last_policy_kind)
        self._node.get_logger().warning(
            f'the publisher of {topic} offers another {policy} than this node asks for '
            f'({"reliable" if self._reliable else "best effort"}): change its QoS or the '
            'parameter reliable')
