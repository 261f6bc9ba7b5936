"""The node in a process of its own for tests, and a camera in front of it."""
from array import array
from contextlib import contextmanager
import math
import re
import signal
import time

from diagnostic_msgs.msg import DiagnosticArray
from lifecycle_msgs.msg import Transition
from lifecycle_msgs.srv import ChangeState, GetState
from neo_ros.messages import camera_info_fields, image_fields
from neo_ros.messages.scene_outputs import WIDENING
from neo_ros.node.extrapolator_node import ExtrapolatorNode
from rcl_interfaces.srv import SetParameters
from rclpy.parameter import Parameter
from ros_graph import WAIT_S
from sensor_msgs.msg import CameraInfo, Image
from tiny_model import TINY_EXPANSION

SOURCE = TINY_EXPANSION.source
NODE = '/robot/fov_extrapolator'


class Camera:
    """A camera driver in the namespace /robot, and what the node makes of its frames."""

    def __init__(self, graph):
        self.graph = graph
        self.images = graph.node.create_publisher(Image, '/robot/image', 10)
        self.infos = None
        self.wide = {name: graph.collect(kind, f'/robot/wide/{name}') for name, kind in (
            ('image', Image), ('mask', Image), ('confidence', Image),
            ('camera_info', CameraInfo))}
        self.diagnostics = graph.collect(DiagnosticArray, '/diagnostics')

    def start_node(self, model, *parameters, rules=()):
        """Start the node with parameters such as 'reliable:=true', rules such as 'image:=eye'."""
        arguments = [part for parameter in (f'model:={model}', *parameters)
                     for part in ('-p', parameter)]
        arguments += [part for rule in rules for part in ('-r', rule)]
        return self.graph.start('-m', 'neo_ros.node.main', '--ros-args', '-r', '__ns:=/robot',
                                *arguments)

    def wait_for_node(self):
        """Wait until images go in and come out."""
        self.graph.spin_until(lambda: self.images.get_subscription_count() and all(
            self.graph.node.count_publishers(f'/robot/wide/{name}') for name in self.wide))
        self.graph.spin_for(0.3)  # The node's publishers see our subscriptions a moment later.

    def publish(self, image, number, **changes):
        """Send an image with a stamp of its number and wrong fields, if any."""
        fields = image_fields(image) | changes
        fields['data'] = array('B', bytes(fields['data']))
        message = Image(**fields)
        message.header.stamp.sec, message.header.stamp.nanosec = 1_700_000_000, number
        message.header.frame_id = f'camera_{number}'
        self.images.publish(message)
        return message

    def publish_info(self, camera=SOURCE, **changes):
        """Send a camera_info with wrong fields, if any."""
        if self.infos is None:
            self.infos = self.graph.node.create_publisher(CameraInfo, '/robot/camera_info', 10)
            self.graph.spin_until(self.infos.get_subscription_count)
            self.graph.spin_for(0.3)  # The node sees our publisher a moment later.
        self.infos.publish(CameraInfo(**(camera_info_fields(camera) | changes)))
        self.graph.spin_for(0.1)

    def widen(self, image, number):
        """Publish a frame and wait for all four answers."""
        sent = []
        self.send_until(
            lambda: sent.append(self.publish(image, number).header),
            lambda: all(kept and kept[-1].header == sent[0] for kept in self.wide.values()))
        return {name: kept[-1] for name, kept in self.wide.items()}

    def send_until(self, send, condition):
        """Send until the condition holds, return its value: on a busy machine one may get lost."""
        sent = -math.inf

        def found():
            nonlocal sent
            if time.monotonic() > sent + 5:
                sent = time.monotonic()
                send()
            return condition()

        return self.graph.spin_until(found)

    def wait_for_diagnosis(self, level, words, task=WIDENING):
        """Wait for a verdict on the widening, or on the 'camera'; return its lines."""
        try:
            return self.graph.spin_until(lambda: self.diagnosis(level, words, task))
        except AssertionError as error:
            last = [(status.level, status.message) for entry in self.diagnostics[-1:]
                    for status in entry.status if status.name.endswith(f': {task}')]
            raise AssertionError(f'{error}: {words!r}, the last was {last}') from error

    def diagnosis(self, level, words, task=WIDENING):
        """Return the lines of a verdict that came, or None."""
        for status in (status for entry in self.diagnostics for status in entry.status
                       if status.name.endswith(f': {task}')):
            if status.level == level and re.search(words, status.message):
                return {pair.key: pair.value for pair in status.values}
        return None


def started(graph, model, *parameters):
    """Start the node behind a camera and wait for it; return camera and process."""
    camera = Camera(graph)
    process = camera.start_node(model, *parameters)
    camera.wait_for_node()
    return camera, process


@contextmanager
def node_beside(graph, model, *arguments, **options):
    """Give an active node in the test's own process, with ROS arguments such as '-r', 'a:=b'."""
    node = ExtrapolatorNode(
        context=graph.context, namespace='robot',
        cli_args=['--ros-args', '-p', f'model:={model}', *arguments], **options)
    graph.executor.add_node(node)
    try:
        node.autostart()
        yield node
    finally:
        graph.executor.remove_node(node)
        node.stop()
        node.destroy_node()


def change_state(graph, transition, label=''):
    """Ask for a transition; return whether it succeeded."""
    request = ChangeState.Request(transition=Transition(id=transition, label=label))
    return graph.call(ChangeState, f'{NODE}/change_state', request).success


def state_of(graph):
    """Return the lifecycle state."""
    return graph.call(GetState, f'{NODE}/get_state', GetState.Request()).current_state.label


def end(process, number=signal.SIGTERM):
    """Send a signal; return the exit code."""
    process.send_signal(number)
    return process.wait(WAIT_S)


def set_parameter(graph, name, value):
    """Set a parameter of the node; return the result with its reason."""
    request = SetParameters.Request(parameters=[
        Parameter(name, value=value).to_parameter_msg()])
    return graph.call(SetParameters, f'{NODE}/set_parameters', request).results[0]
