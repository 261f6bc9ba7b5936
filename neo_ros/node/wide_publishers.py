"""The topics that the node publishes."""
from array import array
import functools
from typing import Any

from neo_ros.messages import image_fields, jpeg_fields
from neo_ros.messages.frame_processor import WideFrame
from neo_ros.node.frame_worker import Wanted
from neo_ros.node.interface import OUTPUTS
import numpy as np
from rclpy.event_handler import PublisherEventCallbacks
from rclpy.lifecycle import LifecycleNode
from rclpy.qos import qos_policy_name_from_kind, QoSProfile
from rclpy.qos_overriding_options import QoSOverridingOptions
from sensor_msgs.msg import CameraInfo, CompressedImage, Image

# Reliable: Fast DDS loses large best-effort messages. Ten, so that a recorder may fall behind.
DEPTH = 10


class WidePublishers:
    """
    Publishers of the topics in `interface.OUTPUTS`.

    Reliable; every policy can be overridden by the `qos_overrides` parameters. `jpeg_quality`
    may change at any time.
    """

    def __init__(self, node: LifecycleNode, jpeg_quality: int) -> None:
        self.jpeg_quality = jpeg_quality
        self._node = node
        self._publishers = {
            name: node.create_lifecycle_publisher(
                output.kind, output.name, QoSProfile(depth=DEPTH),
                event_callbacks=PublisherEventCallbacks(
                    incompatible_qos=functools.partial(self._on_qos_conflict, output.name)),
                qos_overriding_options=QoSOverridingOptions.with_default_policies())
            for name, output in OUTPUTS.items()}
        self._messages: dict[str, Image] = {}

    def wanted(self) -> Wanted:
        """Say which topics have subscribers."""
        return Wanted(**{name: publisher.get_subscription_count() > 0
                         for name, publisher in self._publishers.items()})

    def publish(self, header: Any, frame: WideFrame, wanted: Wanted) -> None:
        """Send the wanted outputs with the header of their image, unchanged."""
        # The camera first: who joins by stamp has it when the image comes.
        if wanted.camera_info:
            self._publishers['camera_info'].publish(
                CameraInfo(header=header, **frame.camera_info))
        if wanted.mask:
            self._publish_image('mask', header, frame.extrapolated_mask)
        if wanted.confidence and frame.confidence is not None:
            self._publish_image('confidence', header, frame.confidence)
        if wanted.image and frame.image is not None:
            self._publish_image('image', header, frame.image)
        if wanted.compressed and frame.image is not None:
            fields = jpeg_fields(frame.image, self.jpeg_quality)
            self._publishers['compressed'].publish(CompressedImage(
                header=header, format=fields['format'], data=_as_array(fields['data'])))

    def destroy(self) -> None:
        """Take the topics out of the graph."""
        for publisher in self._publishers.values():
            self._node.destroy_lifecycle_publisher(publisher)

    def _publish_image(self, name: str, header: Any, image: np.ndarray) -> None:
        # One message per topic, filled in place: assigning an ndarray to `data` takes 1000 times
        # as long, because rclpy converts it element by element.
        message = self._messages.get(name)
        if message is None or (message.height, message.width) != image.shape[:2]:
            fields = image_fields(image)
            message = Image(**(fields | {'data': _as_array(fields['data'])}))
            self._messages[name] = message
        else:
            np.copyto(np.frombuffer(message.data, np.uint8), image.reshape(-1))
        message.header = header
        self._publishers[name].publish(message)

    def _on_qos_conflict(self, topic: str, event: Any) -> None:
        self._node.get_logger().warning(
            f'a subscriber of {self._node.resolve_topic_name(topic)} asks for another '
            f'{qos_policy_name_from_kind(event.last_policy_kind)} than I offer: change its QoS, '
            'or mine with the qos_overrides parameters')


def _as_array(data: np.ndarray) -> array:
    copy = array('B')
    copy.frombytes(data.tobytes())
    return copy
