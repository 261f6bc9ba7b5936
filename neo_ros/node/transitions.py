"""What rclpy leaves open of a lifecycle node: failures that it hides, requests it drops."""
from collections.abc import Callable
import functools
import traceback
from typing import Any

from lifecycle_msgs.srv import ChangeState
from rclpy.impl.implementation_singleton import rclpy_implementation
from rclpy.lifecycle import LifecycleNode, LifecycleState, TransitionCallbackReturn


def logged(transition: Callable) -> Callable:
    """Log what a transition raises (rclpy swallows it) and keep it as the node's `fault`."""
    @functools.wraps(transition)
    def wrapper(self: Any, state: LifecycleState) -> TransitionCallbackReturn:
        try:
            result = transition(self, state)
        except Exception as error:
            if not self.context.ok():
                raise KeyboardInterrupt from error  # The node is ending: not the model's fault.
            self.fault = f'{transition.__name__} failed: {type(error).__name__}: {error}'
            self.get_logger().error(f'{self.fault}\n{traceback.format_exc()}')
            return TransitionCallbackReturn.ERROR
        return result
    return wrapper


def answer_every_request(node: LifecycleNode) -> None:
    """
    Let the node answer a request for a transition that is not possible now: no success.

    rclpy raises from the callback of its service instead, so the client waits in vain.
    """
    service = node._service_change_state
    answer = service.callback

    def callback(request: ChangeState.Request, response: ChangeState.Response
                 ) -> ChangeState.Response:
        machine = node._state_machine
        state, possible = machine.current_state[1], machine.available_transitions
        try:
            return answer(request, response)
        except rclpy_implementation.RCLError:
            asked = request.transition.label or f'the transition {request.transition.id}'
            # Only those from 1 to 8 can be asked for; the others are outcomes.
            names = sorted({label for number, label, *_ in possible if number < 10})
            node.get_logger().warning(
                f'{asked} refused: the node is {state}, possible: {", ".join(names) or "none"}; '
                'under a lifecycle manager set the parameter autostart to false')
            response.success = False
            return response

    service.callback = callback
