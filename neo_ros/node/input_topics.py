"""Names of the camera's topics by image_transport's rules, and what the graph has instead."""
from neo_ros.node.interface import CAMERA_INFO, COMPRESSED_IMAGE, Endpoint, IMAGE
from neo_ros.node.parameters import override_of
from rclpy.node import Node
from rclpy.qos import qos_policy_name_from_kind, QoSPolicyKind
from rclpy.qos_overriding_options import QoSOverridingOptions
from rclpy.topic_endpoint_info import TopicEndpointInfo

ENDPOINTS = {'raw': IMAGE, 'compressed': COMPRESSED_IMAGE}
OVERRIDABLE = (QoSPolicyKind.HISTORY, QoSPolicyKind.DEPTH, QoSPolicyKind.RELIABILITY,
               QoSPolicyKind.DURABILITY)
# How many topics a hint names.
NAMED = 4


class InputTopics:
    """
    Full names of the topics of the camera.

    `image` may be remapped; `image/compressed` and `camera_info` follow it, as image_transport's
    getCameraInfoTopic does, unless they are remapped themselves.
    """

    def __init__(self, node: Node) -> None:
        self._node = node
        self._overridden: dict[str, list[QoSPolicyKind]] = {}

    def image(self, transport: str) -> str:
        """Return the topic of the images in this transport, 'raw' or 'compressed'."""
        base = self._node.resolve_topic_name(IMAGE.name)
        if transport == 'raw':
            return base
        return self._remapped(COMPRESSED_IMAGE) or f'{base}/{transport}'

    def camera_info(self) -> str:
        """Return the topic of the calibration."""
        folder = self._node.resolve_topic_name(IMAGE.name).rpartition('/')[0]
        return self._remapped(CAMERA_INFO) or f'{folder}/{CAMERA_INFO.name}'

    def publishers(self, topic: str, endpoint: Endpoint) -> list[TopicEndpointInfo]:
        """Return who publishes this type there."""
        return [found for found in self._node.get_publishers_info_by_topic(topic)
                if found.topic_type == type_name(endpoint)]

    def describe_crowd(self, topic: str, endpoint: Endpoint) -> str:
        """Name the publishers of a topic that should have one; '' = it has at most one."""
        names = sorted(publisher_name(found) for found in self.publishers(topic, endpoint))
        if len(names) < 2:
            return ''
        return f'{" and ".join(names)} publish {topic}: remap one of them'

    def hint(self, transport: str) -> str:
        """Say what the graph has in the place of the missing image; '' = nothing."""
        topic, wanted = self.image(transport), type_name(ENDPOINTS[transport])
        others = {found.topic_type for found in self._node.get_publishers_info_by_topic(topic)}
        if type_name(COMPRESSED_IMAGE) in others and topic.endswith('/compressed'):
            return (f'{topic} is {type_name(COMPRESSED_IMAGE)}: remap image to '
                    f'{topic.removesuffix("/compressed")} and set the parameter image_transport '
                    'to compressed')
        if others:
            return f'{topic} is {min(others)}, expected {wanted}'
        other = 'compressed' if transport == 'raw' else 'raw'
        if self.publishers(self.image(other), ENDPOINTS[other]):
            return f'there is {self.image(other)}: set the parameter image_transport to {other}'
        images = self._find_images()
        if not images:
            return ''
        return f'there is {", ".join(images[:NAMED])}: remap image to the right one'

    def qos_overrides(self, topic: str) -> QoSOverridingOptions | None:
        """Return what the `qos_overrides` parameters say of a subscription; None: nothing."""
        # Only what was given is declared: rclpy lets no declared one change any more, and
        # `reliable` may.
        if topic not in self._overridden:
            self._overridden[topic] = [
                kind for kind in OVERRIDABLE if override_of(
                    self._node, f'qos_overrides.{topic}.subscription.'
                    f'{qos_policy_name_from_kind(kind).lower()}') is not None]
        kinds = self._overridden[topic]
        return QoSOverridingOptions(kinds) if kinds else None

    def _remapped(self, endpoint: Endpoint) -> str | None:
        resolved = self._node.resolve_topic_name(endpoint.name)
        plain = self._node.resolve_topic_name(endpoint.name, only_expand=True)
        return resolved if resolved != plain else None

    def _find_images(self) -> list[str]:
        """Return the topics where others publish raw images."""
        own = self._node.get_fully_qualified_name()
        return [topic for topic, types in self._node.get_topic_names_and_types()
                if type_name(IMAGE) in types and any(
                    publisher_name(found) != own for found in self.publishers(topic, IMAGE))]


def type_name(endpoint: Endpoint) -> str:
    """Return the type as the graph writes it, such as sensor_msgs/msg/Image."""
    return f'{endpoint.kind.__module__.split(".")[0]}/msg/{endpoint.kind.__name__}'


def publisher_name(found: TopicEndpointInfo) -> str:
    """Return the full name of the node that publishes."""
    return f'{found.node_namespace.rstrip("/")}/{found.node_name}'
