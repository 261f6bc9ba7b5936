"""What a configured node says of its scene and hears about it, one model after the other."""
from collections.abc import Callable
from contextlib import ExitStack

from neo_ros.node.loaded_model import LoadedModel
from neo_ros.node.map_publisher import MapPublisher
from neo_ros.node.parameters import NodeParameters
from neo_ros.node.pose_inputs import PoseInputs
from neo_ros.node.robot_frames import RobotFrames
from neo_ros.node.wide_publishers import WidePublishers
from rclpy.lifecycle import LifecycleNode


class SceneTopics:
    """
    Publishers of the outputs and the map, subscriptions to poses, and the frames they are in.

    frames: None without base_frame. `audience_changed` is called when somebody begins or ceases to
    listen, `report` with what went wrong.
    """

    def __init__(self, node: LifecycleNode, values: NodeParameters, model: LoadedModel,
                 audience_changed: Callable[[], None], report: Callable[[str], None]) -> None:
        self._node = node
        with ExitStack() as made:  # What cannot be made takes back what was made before it.
            self.frames = RobotFrames(node, values) if values.base_frame else None
            if self.frames is not None:
                made.callback(self.frames.destroy)
            self.outputs = WidePublishers(node, values, model, self.frames, audience_changed)
            made.callback(self.outputs.destroy)
            self.inputs = PoseInputs(node, self.outputs.scene_frame, values.base_frame,
                                     self.frames)
            made.callback(self.inputs.destroy)
            self._map = MapPublisher(node, report)
            made.callback(self._map.destroy)
            self._map.use(model, self.outputs.scene_frame)
            self._tie(values, model)
            self._made = made.pop_all()

    def destroy(self) -> None:
        """Take the topics out of the graph."""
        self._made.close()

    def use(self, values: NodeParameters, model: LoadedModel) -> None:
        """Go by these parameters; map and priors are in the frame of the poses."""
        self.outputs.use(values, model)
        self._map.use(model, self.outputs.scene_frame)
        self.inputs.scene_frame = self.outputs.scene_frame

    def take_over(self, values: NodeParameters, model: LoadedModel) -> None:
        """Be of another model from now on."""
        self.inputs.forget_prior()  # It was meant for the other model's scene.
        self.use(values, model)
        self._tie(values, model)

    def _tie(self, values: NodeParameters, model: LoadedModel) -> None:
        """Let the model's memory hear priors and odometry, where they are in its unit."""
        model.processor.hints = self.inputs.hints
        self.inputs.metric = not model.arbitrary_scale
        if not model.memory and (values.learn or values.publish_tf):
            self._node.get_logger().warning(
                'the model has no scene memory: learn and publish_tf do nothing; train one with '
                'its memory, and leave both files in one folder')
        if model.arbitrary_scale:
            self._node.get_logger().warning(
                'nobody knows the scale of this scene: poses, depth and points are not in metres; '
                f'their frame is {self.outputs.scene_frame}; odometry is not used, and nothing '
                'is said of base_frame and odom_frame')
