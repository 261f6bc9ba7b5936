"""The lifecycle node: wires ROS to the frame worker and keeps the states."""
import time
from typing import Any

from neo_ros.errors import NeoError
from neo_ros.node.camera_inputs import CameraInputs
from neo_ros.node.diagnosing import Diagnosing, NodeState
from neo_ros.node.frame_statistics import Statistics
from neo_ros.node.frame_worker import Frame, FrameWorker
from neo_ros.node.interface import ENABLE, NODE_NAME, RELOAD_MODEL, RELOCALIZE
from neo_ros.node.loaded_model import Load, LoadedModel
from neo_ros.node.loading import ModelLoader, take_waiting
from neo_ros.node.manager_bond import form_bond
from neo_ros.node.memory_warnings import MemoryWarnings
from neo_ros.node.parameters import (
    declare_parameters,
    INPUT_PARAMETERS,
    MODEL_PARAMETERS,
    NodeParameters,
    read_calibration,
    read_parameters,
    refuse_late,
)
from neo_ros.node.scene_topics import SceneTopics
from neo_ros.node.transitions import answer_every_request, logged
from neo_ros.runtime import FovExtrapolator
from rcl_interfaces.msg import SetParametersResult
from rclpy.lifecycle import LifecycleNode, LifecycleState, TransitionCallbackReturn
from rclpy.parameter import Parameter
from std_srvs.srv import SetBool, Trigger

# How long a transition waits for the frame in work; its result is thrown away in any case.
STOP_TIMEOUT_S = 0.3
REPORT_PERIOD_S = 5.0


def _reason(error: Exception) -> str:
    return str(error) if isinstance(error, NeoError) else f'{type(error).__name__}: {error}'


class ExtrapolatorNode(LifecycleNode):
    """
    Widens the images of one camera.

    configure loads and checks the model, activate lets it subscribe to the camera while somebody
    listens, deactivate stops that, cleanup frees the model. A model that cannot be loaded leaves
    the node unconfigured with the reason in the log and on `/diagnostics`. While it is configured,
    another model takes over once it has passed its checks; until then the old one goes on. `load`
    makes an extrapolator of a path, a number of threads and ONNX Runtime's providers.
    """

    def __init__(self, load: Load = FovExtrapolator.load, **node_options: Any) -> None:
        super().__init__(NODE_NAME, **node_options)
        self.fault = ''
        self._statistics = Statistics()
        self._enabled = True
        self._model: LoadedModel | None = None
        self._candidate: LoadedModel | None = None
        # Of a camera that publishes none, and what it becomes if the parameters are accepted.
        self._calibration: Any | None = None
        self._next_calibration: Any | None = None
        self._scene: SceneTopics | None = None
        self._worker: FrameWorker | None = None
        self._bond: Any | None = None
        self._lingering: list[FrameWorker] = []  # stopped, but in the middle of a frame
        self._warnings = MemoryWarnings(self._report_memory)
        self._inputs = CameraInputs(self, self._on_image)
        answer_every_request(self)
        declare_parameters(self)
        self.add_on_set_parameters_callback(self._check_parameters)
        self.add_post_set_parameters_callback(self._use_parameters)
        self.create_service(ENABLE.kind, ENABLE.name, self._on_enable)
        self.create_service(RELOAD_MODEL.kind, RELOAD_MODEL.name, self._on_reload_model)
        self.create_service(RELOCALIZE.kind, RELOCALIZE.name, self._on_relocalize)
        self._diagnosing = Diagnosing(self, self._inputs, self._statistics, self._look)
        self._loader = ModelLoader(load, self._go_on, lambda: not self.context.ok())

    def autostart(self) -> None:
        """Configure and activate, if the parameter asks for it; failures are logged."""
        if self.get_parameter('autostart').value:
            if self.trigger_configure() == TransitionCallbackReturn.SUCCESS:
                self.trigger_activate()

    @property
    def state_label(self) -> str:
        """Name of the lifecycle state, such as 'active'."""
        return self._state_machine.current_state[1]

    @logged
    def on_configure(self, state: LifecycleState) -> TransitionCallbackReturn:
        """Load, check and warm up the model, announce the outputs."""
        try:
            values = read_parameters(self)
            self._calibration = read_calibration(values)
            self._model = self._loader.load(values)
        except NeoError as error:
            self.fault = f'cannot configure: {error}'
            self.get_logger().error(self.fault)
            return TransitionCallbackReturn.FAILURE
        self._scene = SceneTopics(self, values, self._model, self._attend, self._report)
        self.fault = ''
        self._log_model('configured')
        return super().on_configure(state)

    @logged
    def on_activate(self, state: LifecycleState) -> TransitionCallbackReturn:
        """Take frames."""
        assert self._model and self._scene
        result = super().on_activate(state)
        values = read_parameters(self)
        self._worker = FrameWorker(self._model.processor, self._scene.outputs, self._statistics,
                                   self._report, values.max_fps)
        self._worker.start()
        self._inputs.choose(values.image_transport, values.reliable, self._calibration)
        self._attend()
        if not values.autostart:  # Somebody else activates it.
            self._bond = form_bond(self)
        self.fault = ''
        return result

    @logged
    def on_deactivate(self, state: LifecycleState) -> TransitionCallbackReturn:
        """Take no more frames; the model stays loaded."""
        self._break_bond()
        self.stop()
        return super().on_deactivate(state)

    @logged
    def on_cleanup(self, state: LifecycleState) -> TransitionCallbackReturn:
        """Free the model and the outputs."""
        self._free()
        return super().on_cleanup(state)

    @logged
    def on_shutdown(self, state: LifecycleState) -> TransitionCallbackReturn:
        """Stop and free everything."""
        self._free()
        return super().on_shutdown(state)

    def on_error(self, state: LifecycleState) -> TransitionCallbackReturn:
        """Fall back to unconfigured after a transition that raised."""
        self._free()
        return TransitionCallbackReturn.SUCCESS

    def stop(self) -> bool:
        """Take no more frames; return False while a frame is in work or a model is loaded."""
        self._inputs.unsubscribe()
        worker, self._worker = self._worker, None
        if worker is not None and not worker.stop(STOP_TIMEOUT_S):
            self._lingering.append(worker)
        self._lingering = [worker for worker in self._lingering if worker.busy]
        return not self._lingering and not self._loader.busy

    def end(self) -> bool:
        """Stop for good, and keep what was learnt; return what `stop` does."""
        idle = self.stop()
        if idle and self._model is not None:
            self._model.stop_learning()
        return idle

    def destroy_node(self) -> None:
        """Take it out of the graph."""
        self._warnings.close()
        super().destroy_node()

    def _break_bond(self) -> None:
        if self._bond is not None:
            self._bond.shutdown()
        self._bond = None

    def _free(self) -> None:
        self._break_bond()
        self.stop()
        if self._scene is not None:
            self._scene.destroy()
        if self._model is not None:
            self._model.stop_learning()
        self._scene = self._model = self._candidate = None
        self._warnings.forget()

    def _attend(self) -> None:
        """Be subscribed to the camera exactly while the node is active and somebody listens."""
        if self._worker is None or not self._enabled or not self._has_audience():
            self._inputs.unsubscribe()
        elif not self._inputs.subscribed:
            self._worker.forget()  # The camera may have been carried elsewhere.
            self._statistics.begin()
            self._diagnosing.begin()
            self._inputs.subscribe()

    def _go_on(self) -> None:
        """Hear all topics, tf and the clock, too, while the executor waits for another model."""
        take_waiting(self.subscriptions)
        self._diagnosing.keep_up()

    def _has_audience(self) -> bool:
        return self._scene is not None and any(self._scene.outputs.wanted())

    def _on_image(self, message: Any, camera_info: Any | None) -> None:
        if self._scene is not None:
            self._scene.inputs.see_camera(message.header.frame_id.lstrip('/'))
        if self._worker is not None:
            self._worker.submit(Frame(message, camera_info, time.perf_counter()))

    def _on_enable(self, request: SetBool.Request, response: SetBool.Response
                   ) -> SetBool.Response:
        self._enabled = request.data
        self._attend()
        response.success = True
        response.message = f'{"enabled" if self._enabled else "disabled"}, {self.state_label}'
        return response

    def _on_relocalize(self, request: Trigger.Request, response: Trigger.Response
                       ) -> Trigger.Response:
        response.success = False
        if self._worker is None:
            response.message = f'{self.state_label}: no image is taken'
        elif self._model is not None and not self._model.memory:
            response.message = 'the model has no scene memory to search in'
        else:
            self._worker.forget()
            response.success = True
            response.message = 'the next image is searched for in the whole scene'
        return response

    def _on_reload_model(self, request: Trigger.Request, response: Trigger.Response
                         ) -> Trigger.Response:
        try:
            if self._model is None:
                raise NeoError(f'{self.state_label}: configure loads the model')
            self._take_over(self._loader.load(read_parameters(self)))
        except Exception as error:  # What leaves a callback ends the node.
            response.message = f'the model stays as it is: {_reason(error)}'
            self.get_logger().error(response.message)
            return response
        assert self._model
        response.success = True
        response.message = f'loaded {self._model.description["path"]}'
        return response

    def _check_parameters(self, parameters: list[Parameter]) -> SetParametersResult:
        """Refuse values that cannot be used; load a model before it is accepted."""
        self._candidate = None
        try:
            values: NodeParameters = read_parameters(self, parameters)
            if self._model is not None:
                refuse_late(self, parameters, self.state_label)
            if any(parameter.name == 'camera_info_url' for parameter in parameters):
                self._next_calibration = read_calibration(values)
            changes_model = any(parameter.name in MODEL_PARAMETERS for parameter in parameters)
            if self._model is not None and changes_model:
                self._candidate = self._loader.load(values)
        except Exception as error:  # What leaves a callback ends the node.
            return SetParametersResult(successful=False, reason=_reason(error))
        return SetParametersResult(successful=True)

    def _use_parameters(self, parameters: list[Parameter]) -> None:
        """Put accepted values to use."""
        candidate, self._candidate = self._candidate, None
        if candidate is not None:
            self._take_over(candidate)
        if any(parameter.name == 'camera_info_url' for parameter in parameters):
            self._calibration = self._next_calibration
        values = read_parameters(self)
        if self._model is not None:
            self._model.processor.rectify = values.rectify
        if self._scene is not None:
            assert self._model
            self._scene.use(values, self._model)
        if self._worker is not None:
            self._worker.max_fps = values.max_fps
            if any(parameter.name in INPUT_PARAMETERS for parameter in parameters):
                self._inputs.choose(values.image_transport, values.reliable, self._calibration)
            # Not whenever anything changes: to subscribe declares parameters of its own.
            if any(parameter.name in (*INPUT_PARAMETERS, 'learn') for parameter in parameters):
                self._attend()

    def _take_over(self, model: LoadedModel) -> None:
        """Let the next frame go through this model."""
        if self._model is not None:
            self._model.stop_learning()  # Both may have one journal.
            model.forget_light()  # It was read before the other model wrote it.
        self._model = model
        self._statistics.forget_model()
        self._warnings.forget()
        self._diagnosing.begin()
        if self._scene is not None:
            self._scene.take_over(read_parameters(self), model)
        if self._worker is not None:
            self._worker.processor = model.processor
        self._log_model('the model is now')

    def _log_model(self, words: str) -> None:
        assert self._model
        self.get_logger().info(f'{words}: ' + ', '.join(
            f'{key} {value}' for key, value in self._model.description.items()))

    def _report(self, message: str) -> None:
        if self.context.ok():
            self.get_logger().warning(message, throttle_duration_sec=REPORT_PERIOD_S)

    def _report_memory(self, message: str) -> None:
        if self.context.ok():
            self.get_logger().warning(message)

    def _look(self) -> NodeState:
        return NodeState(self.state_label, self.fault, self._loader.busy, self._enabled,
                         self._has_audience(), self._model,
                         self._scene.frames.missing if self._scene and self._scene.frames else '',
                         self._warnings.last)
