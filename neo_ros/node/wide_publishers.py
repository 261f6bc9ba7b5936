"""The topics that the node publishes."""
from collections.abc import Callable
import functools
from time import monotonic
from typing import Any

from neo_ros.messages import image_fields, jpeg_fields
from neo_ros.messages.frame_processor import WideFrame
from neo_ros.messages.memory_messages import MEMORY_OUTPUTS, MemoryMessages, MemorySettings
from neo_ros.messages.scene_outputs import default_scene_frame, pose_message
from neo_ros.messages.stamps import stamp_of
from neo_ros.node.frame_worker import Wanted
from neo_ros.node.interface import OUTPUTS
from neo_ros.node.loaded_model import LoadedModel
from neo_ros.node.message_types import as_array, make_message
from neo_ros.node.parameters import NodeParameters
from neo_ros.node.robot_frames import RobotFrames
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

    Reliable; every policy can be overridden by the `qos_overrides` parameters. `frames` tell
    where the camera is on the robot. `audience_changed` is called when somebody begins or ceases
    to listen.
    """

    def __init__(self, node: LifecycleNode, values: NodeParameters, model: LoadedModel,
                 frames: RobotFrames | None = None,
                 audience_changed: Callable[[], None] = lambda: None) -> None:
        self._node, self._frames = node, frames
        self.use(values, model)
        self._publishers = {
            name: node.create_lifecycle_publisher(
                output.kind, output.name, QoSProfile(depth=DEPTH),
                event_callbacks=PublisherEventCallbacks(
                    matched=lambda _: audience_changed(),
                    incompatible_qos=functools.partial(self._on_qos_conflict, output.name)),
                qos_overriding_options=QoSOverridingOptions.with_default_policies())
            for name, output in OUTPUTS.items()}
        self._messages: dict[str, Image] = {}

    def use(self, values: NodeParameters, model: LoadedModel) -> None:
        """Go by these parameters, and by what the model knows of its scene, from now on."""
        self._jpeg_quality, self._learn = values.jpeg_quality, values.learn and model.memory
        self._metric, self._has_memory = not model.arbitrary_scale, model.memory
        self.scene_frame = values.scene_frame or default_scene_frame(model.arbitrary_scale)
        self._memory = MemoryMessages(make_message, MemorySettings(
            self.scene_frame, self._node.get_fully_qualified_name(), values.points_every,
            values.panorama_width, values.panorama_fps), monotonic)

    def wanted(self) -> Wanted:
        """Say which topics have subscribers, and what else images are widened for."""
        sends = (self._frames is not None and self._frames.sends and self._metric
                 and self._has_memory)
        return Wanted(transform=sends, learn=self._learn, **{
            name: publisher.get_subscription_count() > 0
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
            fields = jpeg_fields(frame.image, self._jpeg_quality)
            self._publishers['compressed'].publish(CompressedImage(
                header=header, format=fields['format'], data=as_array(fields['data'])))

        names = {name for name in MEMORY_OUTPUTS if getattr(wanted, name)}
        if names:
            for name, message in self._memory.of(header, frame, names, self._age_ms(header)):
                self._publishers[name].publish(message)
        if wanted.base_pose or wanted.transform:
            self._publish_base(header, frame, wanted)

    def destroy(self) -> None:
        """Take the topics out of the graph."""
        for publisher in self._publishers.values():
            self._node.destroy_lifecycle_publisher(publisher)

    def _age_ms(self, header: Any) -> float:
        now = self._node.get_clock().now().nanoseconds
        return (now - stamp_of(header)) / 1e6

    def _publish_base(self, header: Any, frame: WideFrame, wanted: Wanted) -> None:
        guide = frame.guide
        if guide is None or self._frames is None or not self._metric or header.stamp.sec < 0:
            return  # Time cannot be negative, to tf.
        found = self._frames.base_pose(header, guide.pose, guide.covariance)
        if found is None:
            return
        if wanted.base_pose:
            self._publishers['base_pose'].publish(
                pose_message(make_message, header, *found, self.scene_frame))
        if wanted.transform:
            self._frames.send_transform(header, self.scene_frame, found[0])

    def _publish_image(self, name: str, header: Any, image: np.ndarray) -> None:
        # One message per topic, filled in place: assigning an ndarray to `data` takes 1000 times
        # as long, because rclpy converts it element by element.
        message = self._messages.get(name)
        if message is None or (message.height, message.width) != image.shape[:2]:
            fields = image_fields(image)
            message = Image(**(fields | {'data': as_array(fields['data'])}))
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
