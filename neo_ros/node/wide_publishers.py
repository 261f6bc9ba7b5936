"""The four topics that the node publishes."""
from array import array
from typing import Any

from neo_ros.geometry import Intrinsics
from neo_ros.messages import image_fields
from neo_ros.messages.frame_processor import WideFrame
from neo_ros.node.frame_worker import Wanted
import numpy as np
from rclpy.lifecycle import LifecycleNode
from rclpy.qos import QoSProfile
from rclpy.qos_overriding_options import QoSOverridingOptions
from sensor_msgs.msg import CameraInfo, Image

# Reliable: Fast DDS loses large best-effort messages. Ten, so that a recorder may fall behind.
DEPTH = 10


class WidePublishers:
    """
    Publishers of `wide/image`, `wide/mask`, `wide/confidence` and `wide/camera_info`.

    Reliable; every policy can be overridden by the `qos_overrides` parameters.
    """

    def __init__(self, node: LifecycleNode, target: Intrinsics) -> None:
        self._node = node
        self._publishers = {
            name: node.create_lifecycle_publisher(
                kind, f'wide/{name}', QoSProfile(depth=DEPTH),
                qos_overriding_options=QoSOverridingOptions.with_default_policies())
            for name, kind in (('image', Image), ('mask', Image), ('confidence', Image),
                               ('camera_info', CameraInfo))}
        shape = (target.height, target.width)
        self._messages = {
            'image': _blank_message(np.zeros(shape + (3,), np.uint8)),
            'mask': _blank_message(np.zeros(shape, np.uint8)),
            'confidence': _blank_message(np.zeros(shape, np.uint8))}

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

    def destroy(self) -> None:
        """Take the topics out of the graph."""
        for publisher in self._publishers.values():
            self._node.destroy_lifecycle_publisher(publisher)

    def _publish_image(self, name: str, header: Any, image: np.ndarray) -> None:
        # One message per topic, filled in place: assigning an ndarray to `data` takes 1000 times
        # as long, because rclpy converts it element by element.
        message = self._messages[name]
        message.header = header
        np.copyto(np.frombuffer(message.data, np.uint8), image.reshape(-1))
        self._publishers[name].publish(message)


def _blank_message(image: np.ndarray) -> Image:
    fields = image_fields(image)
    data = array('B')
    data.frombytes(fields['data'].tobytes())
    return Image(**(fields | {'data': data}))
