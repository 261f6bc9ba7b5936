"""The lifecycle node: wires ROS to the frame worker and keeps the states."""
from collections.abc import Callable
import functools
import time
import traceback
from typing import Any

from diagnostic_msgs.msg import DiagnosticArray
from neo_ros.errors import NeoError
from neo_ros.messages.frame_processor import Extrapolator, FrameProcessor
from neo_ros.node.diagnostics import build_array, build_status, Health
from neo_ros.node.frame_statistics import Statistics
from neo_ros.node.frame_worker import Frame, FrameWorker
from neo_ros.node.parameters import (
    declare_parameters,
    FIXED_WHILE_CONFIGURED,
    NodeParameters,
    read_parameters,
)
from neo_ros.node.wide_publishers import WidePublishers
from neo_ros.runtime import FovExtrapolator
from rcl_interfaces.msg import SetParametersResult
from rclpy.clock import Clock, ClockType
from rclpy.event_handler import SubscriptionEventCallbacks
from rclpy.lifecycle import LifecycleNode, LifecycleState, TransitionCallbackReturn
from rclpy.parameter import Parameter
from rclpy.qos import qos_policy_name_from_kind, QoSProfile, ReliabilityPolicy
from rclpy.subscription import Subscription
from sensor_msgs.msg import CameraInfo, Image
from std_srvs.srv import SetBool

NODE_NAME = 'fov_extrapolator'
# How long a transition waits for the frame in work; its result is thrown away in any case.
STOP_TIMEOUT_S = 0.3
REPORT_PERIOD_S = 5.0


def _logged(transition: Callable) -> Callable:
    """Log what a transition raises (rclpy swallows it) and keep it for the diagnostics."""
    @functools.wraps(transition)
    def wrapper(self: 'ExtrapolatorNode', state: LifecycleState) -> TransitionCallbackReturn:
        try:
            result = transition(self, state)
        except Exception as error:
            self.fault = f'{transition.__name__} failed: {type(error).__name__}: {error}'
            self.get_logger().error(f'{self.fault}\n{traceback.format_exc()}')
            return TransitionCallbackReturn.ERROR
        return result
    return wrapper


class ExtrapolatorNode(LifecycleNode):
    """
    Widens the images of one camera.

    configure loads and checks the model, activate subscribes, deactivate stops taking frames,
    cleanup frees the model. A model that cannot be loaded leaves the node unconfigured with the
    reason in the log and on `/diagnostics`. `load` makes an extrapolator of a path and a number
    of threads.
    """

    def __init__(self, load: Callable[[str, int], Extrapolator] = FovExtrapolator.load,
                 **node_options: Any) -> None:
        super().__init__(NODE_NAME, **node_options)
        self.fault = ''
        self._load = load
        self._statistics = Statistics()
        self._enabled = True
        self._qos_conflict = ''
        self._camera_info: CameraInfo | None = None
        self._values: NodeParameters | None = None
        self._model: dict[str, str] = {}
        self._processor: FrameProcessor | None = None
        self._outputs: WidePublishers | None = None
        self._worker: FrameWorker | None = None
        self._inputs: list[Subscription] = []
        declare_parameters(self)
        self.add_on_set_parameters_callback(self._on_set_parameters)
        self.create_service(SetBool, '~/enable', self._on_enable)
        self._diagnostics = self.create_publisher(DiagnosticArray, '/diagnostics', 10)
        # Steady, so that a paused simulation is still diagnosed.
        self.create_timer(1.0, self._publish_diagnostics,
                          clock=Clock(clock_type=ClockType.STEADY_TIME))

    def autostart(self) -> None:
        """Configure and activate, if the parameter asks for it; failures are logged."""
        if read_parameters(self).autostart:
            if self.trigger_configure() == TransitionCallbackReturn.SUCCESS:
                self.trigger_activate()

    @property
    def state_label(self) -> str:
        """Name of the lifecycle state, such as 'active'."""
        return self._state_machine.current_state[1]

    @_logged
    def on_configure(self, state: LifecycleState) -> TransitionCallbackReturn:
        """Load, check and warm up the model, announce the outputs."""
        self._values = read_parameters(self)
        try:
            extrapolator = self._load(self._values.model, self._values.threads)
        except NeoError as error:
            self.fault = f'cannot load the model: {error}'
            self.get_logger().error(self.fault)
            return TransitionCallbackReturn.FAILURE
        expansion = extrapolator.expansion
        self._processor = FrameProcessor(extrapolator)
        self._outputs = WidePublishers(self, expansion.target)
        self._model = _describe_model(self._values.model, extrapolator)
        self.fault = ''
        self.get_logger().info('configured: ' + ', '.join(
            f'{key} {value}' for key, value in self._model.items()))
        return super().on_configure(state)

    @_logged
    def on_activate(self, state: LifecycleState) -> TransitionCallbackReturn:
        """Take frames."""
        assert self._processor and self._outputs and self._values
        result = super().on_activate(state)
        self._worker = FrameWorker(self._processor, self._outputs, self._statistics,
                                   self._report, self._values.max_fps)
        self._worker.start()
        if self._enabled:
            self._subscribe()
        self.fault = ''
        return result

    @_logged
    def on_deactivate(self, state: LifecycleState) -> TransitionCallbackReturn:
        """Take no more frames; the model stays loaded."""
        self.stop()
        return super().on_deactivate(state)

    @_logged
    def on_cleanup(self, state: LifecycleState) -> TransitionCallbackReturn:
        """Free the model and the outputs."""
        self._free()
        return super().on_cleanup(state)

    @_logged
    def on_shutdown(self, state: LifecycleState) -> TransitionCallbackReturn:
        """Stop and free everything."""
        self._free()
        return super().on_shutdown(state)

    def on_error(self, state: LifecycleState) -> TransitionCallbackReturn:
        """Fall back to unconfigured after a transition that raised."""
        self._free()
        return TransitionCallbackReturn.SUCCESS

    def stop(self) -> bool:
        """Take no more frames; return False when the network is still busy with the last one."""
        self._unsubscribe()
        worker, self._worker = self._worker, None
        return worker is None or worker.stop(STOP_TIMEOUT_S)

    def _free(self) -> None:
        self.stop()
        if self._outputs is not None:
            self._outputs.destroy()
        self._outputs = self._processor = None
        self._model = {}

    def _subscribe(self) -> None:
        assert self._values
        # The newest image only; a frame that waits here is as old as one that waits anywhere.
        qos = QoSProfile(depth=1, reliability=(
            ReliabilityPolicy.RELIABLE if self._values.reliable
            else ReliabilityPolicy.BEST_EFFORT))
        self._qos_conflict = ''
        self._inputs = [
            self.create_subscription(Image, 'image', self._on_image, qos,
                                     event_callbacks=SubscriptionEventCallbacks(
                                         incompatible_qos=self._on_qos_conflict)),
            self.create_subscription(CameraInfo, 'camera_info', self._on_camera_info, qos)]

    def _unsubscribe(self) -> None:
        for subscription in self._inputs:
            self.destroy_subscription(subscription)
        self._inputs = []
        self._camera_info = None

    def _on_image(self, message: Image) -> None:
        if self._worker is not None:
            self._worker.submit(Frame(message, self._camera_info, time.perf_counter()))

    def _on_camera_info(self, message: CameraInfo) -> None:
        self._camera_info = message

    def _on_qos_conflict(self, event: Any) -> None:
        policy = qos_policy_name_from_kind(event.last_policy_kind)
        asked = 'reliable' if self._values and self._values.reliable else 'best effort'
        self._qos_conflict = (
            f'a publisher of {self.resolve_topic_name("image")} offers another {policy} than I '
            f'ask for ({asked}): change its QoS or my parameter "reliable"')
        self.get_logger().warning(self._qos_conflict)

    def _on_enable(self, request: SetBool.Request, response: SetBool.Response
                   ) -> SetBool.Response:
        self._enabled = request.data
        if self._worker is not None:
            self._unsubscribe()
            if self._enabled:
                self._subscribe()
        response.success = True
        response.message = f'{"enabled" if self._enabled else "disabled"}, {self.state_label}'
        return response

    def _on_set_parameters(self, parameters: list[Parameter]) -> SetParametersResult:
        for parameter in parameters:
            if parameter.name in FIXED_WHILE_CONFIGURED and self._processor is not None:
                return SetParametersResult(successful=False, reason=(
                    f'{parameter.name} is read by configure: clean up, set it, configure again'))
        for parameter in parameters:
            if parameter.name == 'max_fps' and self._worker is not None:
                self._worker.max_fps = parameter.value
        return SetParametersResult(successful=True)

    def _report(self, message: str) -> None:
        if self.context.ok():
            self.get_logger().warning(message, throttle_duration_sec=REPORT_PERIOD_S)

    def _publish_diagnostics(self) -> None:
        if self._camera_info is not None and not self.count_publishers(
                self.resolve_topic_name('camera_info')):
            self._camera_info = None  # The next camera must not be judged by the last one.
        topic = self.resolve_topic_name('image')
        health = Health(
            state=self.state_label, fault=self.fault, enabled=self._enabled, topic=topic,
            publishers=self.count_publishers(topic), qos_conflict=self._qos_conflict,
            subscribed=self._outputs is not None and any(self._outputs.wanted()),
            counts=self._statistics.snapshot())
        status = build_status(self.get_fully_qualified_name(), health, self._model)
        self._diagnostics.publish(build_array(self.get_clock().now().to_msg(), status))


def _describe_model(path: str, extrapolator: Extrapolator) -> dict[str, str]:
    source, target = extrapolator.expansion.source, extrapolator.expansion.target
    card = getattr(extrapolator, 'card', None)
    return {'path': path, 'scene': card.scene_id if card else 'unknown',
            'config': card.config_hash if card else 'unknown',
            'widens': f'{source.width}x{source.height} to {target.width}x{target.height}'}
