"""The subscriptions to the camera."""
from collections.abc import Callable
import functools
from typing import Any

from neo_ros.messages import camera_info_of
from neo_ros.messages.stamps import stamp_of
from neo_ros.node.camera_pairing import CAMERA_INFO_WAIT_S, CameraPairing
from neo_ros.node.input_topics import ENDPOINTS, InputTopics
from neo_ros.node.interface import CAMERA_INFO, Endpoint
from neo_ros.node.stamp_watch import StampWatch
from rclpy.event_handler import SubscriptionEventCallbacks
from rclpy.node import Node
from rclpy.qos import (
    DurabilityPolicy, qos_policy_name_from_kind, QoSPolicyKind, QoSProfile, ReliabilityPolicy)
from rclpy.subscription import Subscription


class CameraInputs:
    """
    Subscribes to the image, raw or compressed, and to its camera_info, latched or not.

    `take` gets every image with what its camera_info says of it, None where there is none; or with
    a calibration that was given instead.
    """

    def __init__(self, node: Node, take: Callable[[Any, Any | None], None]) -> None:
        self._node, self._take = node, take
        self._topics = InputTopics(node)
        self._subscriptions: list[Subscription] = []
        self._fault = ''  # Why the last try to subscribe failed.
        self._pairing = CameraPairing(self._take_pair, self._is_announced)
        self.stamps = StampWatch()
        self.frame_id = ''  # Of the images; '' before the first.
        self.choose('raw', reliable=False)

    @property
    def topic(self) -> str:
        """Full name of the image topic."""
        return self._topics.image(self._transport)

    @property
    def publishers(self) -> int:
        """How many publishers the image topic has."""
        return len(self._topics.publishers(self.topic, ENDPOINTS[self._transport]))

    @property
    def missing(self) -> str:
        """What keeps images away, in words; '' = nothing is known to."""
        if self._pairing.waits:
            return (f'an image came on {self.topic}; it waits up to {CAMERA_INFO_WAIT_S:.0f} s '
                    f'for the camera_info on {self._topics.camera_info()}')
        if self._fault:
            return self._fault
        publishers = self.publishers
        hint = '' if publishers else self._topics.hint(self._transport)
        words = 'waiting for image on' if self.subscribed else 'no image is taken from'
        return (f'{words} {self.topic}, publishers: {publishers}'
                f'{"; " + hint if hint else ""}')

    @property
    def conflict(self) -> str:
        """Which publisher does not fit, in words; '' = none."""
        return '; '.join(filter(None, [
            self._qos_conflict(), self._pairing.mismatch,
            '' if self._now_ns() else 'use_sim_time is true, and nobody publishes /clock', *(
                self._topics.describe_crowd(topic, endpoint)
                for topic, endpoint in self._wanted())]))

    @property
    def remedy(self) -> str:
        """What to do about images that get lost on their way, in words; '' while none is taken."""
        # Before that nobody has asked for the overrides, which would declare a parameter here.
        if not self.subscribed:
            return ''
        if self._is_reliable():
            return 'this computer or the network is too slow for them'
        if any(publisher.qos_profile.reliability == ReliabilityPolicy.BEST_EFFORT
               for publisher in self._topics.publishers(*self._wanted()[0])):
            return ('let the camera driver publish reliably, or give it the Fast DDS profile of '
                    'this package')
        overrides = self._topics.qos_overrides(self.topic)
        if overrides is not None and QoSPolicyKind.RELIABILITY in overrides.policy_kinds:
            return (f'set the parameter qos_overrides.{self.topic}.subscription.reliability to '
                    'reliable')
        return 'set the parameter reliable to true'

    @property
    def subscribed(self) -> bool:
        """Whether images are taken."""
        return bool(self._subscriptions)

    def choose(self, transport: str, reliable: bool, calibration: Any | None = None) -> None:
        """Take no more images; set what the next `subscribe` asks for."""
        self.unsubscribe()
        self._transport, self._reliable, self._fault = transport, reliable, ''
        self._calibration = calibration

    def subscribe(self) -> None:
        """Take images from now on; what keeps them away is logged and said by `missing`."""
        try:
            self._subscribe()
            self._fault = ''
        except Exception as error:  # Such as a typo in a QoS override; it would end the node.
            self.unsubscribe()
            if not self._node.context.ok():
                raise
            self._fault = (f'cannot subscribe to {self.topic} and its camera_info: '
                           f'{type(error).__name__}: {error}')
            self._node.get_logger().error(self._fault)

    def _subscribe(self) -> None:
        for (topic, endpoint), callback in zip(
                self._wanted(), (self._on_image, self._on_info)):
            # The newest only; a frame that waits here is as old as one that waits anywhere.
            qos = QoSProfile(depth=1, reliability=(
                ReliabilityPolicy.RELIABLE if self._reliable else ReliabilityPolicy.BEST_EFFORT))
            self._subscriptions.append(self._node.create_subscription(
                endpoint.kind, topic, callback, qos,
                qos_overriding_options=self._topics.qos_overrides(topic),
                event_callbacks=SubscriptionEventCallbacks(
                    incompatible_qos=functools.partial(self._on_qos_conflict, topic))))
        info_topic = self._topics.camera_info()
        if self._calibration is None and self._topics.qos_overrides(info_topic) is None:
            # A latched camera_info was sent before this node came. A publisher that latches none
            # does not fit and is heard through the other one: nobody is told.
            latched = QoSProfile(depth=1, reliability=ReliabilityPolicy.RELIABLE,
                                 durability=DurabilityPolicy.TRANSIENT_LOCAL)
            self._subscriptions.append(self._node.create_subscription(
                CAMERA_INFO.kind, info_topic, self._on_info, latched,
                event_callbacks=SubscriptionEventCallbacks(use_default_callbacks=False)))

    def unsubscribe(self) -> None:
        """Take no more images."""
        for subscription in self._subscriptions:
            self._node.destroy_subscription(subscription)
        self._subscriptions = []
        self._pairing.forget()
        self.stamps.forget()

    def forget_lost_camera(self) -> None:
        """Drop the camera_info once nobody publishes it: the next camera may be another one."""
        if self._pairing.newest is not None and not self._has_camera_info():
            self._pairing.forget()

    def _wanted(self) -> list[tuple[str, Endpoint]]:
        """Return the topics of the image and of its camera_info, if that is not given."""
        image = self.topic, ENDPOINTS[self._transport]
        if self._calibration is not None:
            return [image]
        return [image, (self._topics.camera_info(), CAMERA_INFO)]

    def _now_ns(self) -> int:
        """Return the time; 0 while the clock is simulated and nobody has told it."""
        now_ns: int = self._node.get_clock().now().nanoseconds
        return now_ns

    def _is_reliable(self) -> bool:
        """Say what holds for the images: the parameter, unless a QoS override says otherwise."""
        if not self._subscriptions:
            return self._reliable
        return self._subscriptions[0].qos_profile.reliability == ReliabilityPolicy.RELIABLE

    def _has_camera_info(self) -> bool:
        return bool(self._topics.publishers(self._topics.camera_info(), CAMERA_INFO))

    def _is_announced(self) -> bool:
        """Say whether a camera_info will come."""
        return (self._calibration is None and self._has_camera_info()
                and not self._qos_conflict())

    def _on_image(self, image: Any) -> None:
        stamp_ns = stamp_of(image.header)
        now_ns = self._now_ns()
        age_ms = (now_ns - stamp_ns) / 1e6 if now_ns else None
        self.stamps.add_image(stamp_ns, age_ms, len(image.data))
        self._pairing.add_image(image)

    def _on_info(self, info: Any) -> None:
        self.stamps.add_info(stamp_of(info.header))
        self._pairing.add_info(info)

    def _take_pair(self, image: Any, camera_info: Any | None) -> None:
        self.frame_id = image.header.frame_id
        camera_info = camera_info or self._calibration
        self._take(image, camera_info and camera_info_of(camera_info, self.topic))

    def _qos_conflict(self) -> str:
        # Asked of the graph, not kept from events: those do not tell when the publisher has gone.
        for (topic, endpoint), subscription in zip(self._wanted(), self._subscriptions):
            asked = subscription.qos_profile
            for offered in (one.qos_profile for one in self._topics.publishers(topic, endpoint)):
                if (asked.reliability == ReliabilityPolicy.RELIABLE
                        and offered.reliability == ReliabilityPolicy.BEST_EFFORT):
                    return (f'the publisher of {topic} is best effort, this node asks for '
                            'reliable; set the parameter reliable to false')
                if (asked.durability == DurabilityPolicy.TRANSIENT_LOCAL
                        and offered.durability == DurabilityPolicy.VOLATILE):
                    return (f'the publisher of {topic} is volatile, this node asks for transient '
                            f'local; take back qos_overrides.{topic}.subscription.durability')
        return ''

    def _on_qos_conflict(self, topic: str, event: Any) -> None:
        policy = qos_policy_name_from_kind(event.last_policy_kind)
        words = f'the publisher of {topic} offers another {policy} than this node asks for'
        if event.last_policy_kind == QoSPolicyKind.RELIABILITY:
            words += (f' ({"reliable" if self._is_reliable() else "best effort"}): change its QoS '
                      'or the parameter reliable')
        else:
            words += ": change its QoS, or this node's with qos_overrides"
        self._node.get_logger().warning(words)
