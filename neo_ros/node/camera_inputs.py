"""The subscriptions to the camera."""
from collections.abc import Callable
import functools
from typing import Any

from neo_ros.node.interface import CAMERA_INFO, COMPRESSED_IMAGE, Endpoint, IMAGE
from rclpy.event_handler import SubscriptionEventCallbacks
from rclpy.node import Node
from rclpy.qos import qos_policy_name_from_kind, QoSProfile, ReliabilityPolicy
from rclpy.subscription import Subscription
from sensor_msgs.msg import CameraInfo


class CameraInputs:
    """
    Subscribes to the image, raw or compressed, and to its camera_info.

    `take` gets every image with the newest camera_info, None where there is none. `qos_conflict`
    says in words which topic and policy do not fit, '' = none.
    """

    def __init__(self, node: Node, take: Callable[[Any, CameraInfo | None], None]) -> None:
        self.qos_conflict = ''
        self._node = node
        self._take = take
        self._camera_info: CameraInfo | None = None
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
        self.qos_conflict = ''
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
        self._camera_info = None

    def forget_lost_camera(self) -> None:
        """Drop the camera_info once nobody publishes it: the next camera may be another one."""
        if self._camera_info is not None and not self._node.count_publishers(
                self._node.resolve_topic_name(CAMERA_INFO.name)):
            self._camera_info = None

    def _on_image(self, message: Any) -> None:
        self._take(message, self._camera_info)

    def _on_camera_info(self, message: CameraInfo) -> None:
        self._camera_info = message

    def _on_qos_conflict(self, endpoint: Endpoint, event: Any) -> None:
        policy = qos_policy_name_from_kind(event.last_policy_kind)
        asked = 'reliable' if self._reliable else 'best effort'
        self.qos_conflict = (
            f'a publisher of {self._node.resolve_topic_name(endpoint.name)} offers another '
            f'{policy} than I ask for ({asked}): change its QoS or my parameter "reliable"')
        self._node.get_logger().warning(self.qos_conflict)
