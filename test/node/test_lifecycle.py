"""Transitions: again and again, with frames and a scene memory, and while a model loads."""
import ctypes
import gc
import os
import sys
from types import ModuleType, SimpleNamespace

from box_room import box_walk, EXPANSION, view, write_box_model
from camera_messages import noise_image
from diagnostic_msgs.msg import DiagnosticArray
from lifecycle_msgs.msg import Transition
from live_node import change_state, end, started
from neo_ros.memory.scene_memory import SceneMemory
from neo_ros.messages import image_fields
from neo_ros.node.extrapolator_node import ExtrapolatorNode
from neo_ros.runtime import FovExtrapolator
import pytest
from rclpy.lifecycle import TransitionCallbackReturn
from rclpy.parameter import Parameter
from sensor_msgs.msg import Image
from tiny_model import TINY_EXPANSION

CYCLES = 20


def node_of(graph, model, autostart=False, **options):
    return ExtrapolatorNode(context=graph.context, **options, parameter_overrides=[
        Parameter('model', value=str(model)), Parameter('autostart', value=autostart)])


class MallocInformation(ctypes.Structure):
    _fields_ = [(name, ctypes.c_size_t) for name in (
        'arena', 'ordblks', 'smblks', 'hblks', 'hblkhd', 'usmblks', 'fsmblks', 'uordblks',
        'fordblks', 'keepcost')]


def allocated_bytes():
    """Count what is allocated and not freed; resident memory has the gaps of all tests, too."""
    mallinfo = ctypes.CDLL(None).mallinfo2
    mallinfo.restype = MallocInformation
    information = mallinfo()
    return information.uordblks + information.hblkhd


def test_a_stopped_worker_in_the_middle_of_a_frame_is_not_forgotten(graph, model):
    node = node_of(graph, model)
    worker = SimpleNamespace(busy=True, stop=lambda timeout: False)
    node._worker = worker
    for _ in range(2):  # deactivated, then asked again before the process ends
        assert node.stop() is False
    worker.busy = False
    assert node.stop() is True
    node.destroy_node()


def memories():
    return [type(thing) for thing in gc.get_objects()].count(SceneMemory)


def test_cycles_with_frames_and_a_memory_leave_nothing_behind(graph, tmp_path):
    model = write_box_model(tmp_path)
    node = node_of(graph, model)
    graph.executor.add_node(node)
    camera = graph.node.create_publisher(Image, 'image', 10)
    wide = graph.collect(Image, 'wide/image')
    walk = [EXPANSION.crop(view(pose, EXPANSION.target)[0]) for pose in box_walk(3)]
    extrapolator = FovExtrapolator.load(model)
    expected = [extrapolator.expand(image) for image in walk]
    assert all(extrapolation.guided for extrapolation in expected)
    gc.collect()
    others = memories()
    sizes, threads, descriptors = [], [], []
    for _ in range(CYCLES):
        for transition in (node.trigger_configure, node.trigger_activate):
            assert transition() == TransitionCallbackReturn.SUCCESS
        graph.spin_until(lambda: camera.get_subscription_count() and any(
            node._scene.outputs.wanted()))
        for image, extrapolation in zip(walk, expected):
            wide.clear()
            camera.publish(Image(**image_fields(image)))
            graph.spin_until(lambda: wide)
            # Every cycle begins where the first did: what was tracked is forgotten.
            assert wide[0].data.tobytes() == extrapolation.wide_image.tobytes()
        for transition in (node.trigger_deactivate, node.trigger_cleanup):
            assert transition() == TransitionCallbackReturn.SUCCESS
        graph.spin_until(lambda: not camera.get_subscription_count())
        assert memories() == others
        sizes.append(allocated_bytes())
        threads.append(len(os.listdir('/proc/self/task')))
        descriptors.append(len(os.listdir('/proc/self/fd')))
    # The first ten fill caches. A decoded memory that stayed would be 2 MB in every cycle.
    assert sizes[-1] - sizes[9] < 4_000_000, sizes
    assert threads[-1] <= threads[9] and descriptors[-1] <= descriptors[9]
    assert len(list(node.publishers)) < 8 and node.state_label == 'unconfigured'
    graph.executor.remove_node(node)
    node.destroy_node()


def test_cycles_over_the_graph_end_where_they_began(graph, model):
    camera, process = started(graph, model)
    for number in range(3):
        for transition in (Transition.TRANSITION_DEACTIVATE, Transition.TRANSITION_CLEANUP,
                           Transition.TRANSITION_CONFIGURE, Transition.TRANSITION_ACTIVATE):
            assert change_state(graph, transition)
        camera.wait_for_node()
        camera.widen(noise_image(TINY_EXPANSION.source, number), number)
    assert end(process) == 0


def test_diagnostics_go_on_while_a_model_loads(graph, model):
    def load_slowly(*arguments):
        # Another thread than the one that answers the transition: here the graph may be heard.
        heard = len(messages)
        graph.spin_until(lambda: len(messages) >= heard + 3)
        return FovExtrapolator.load(*arguments)

    # In a namespace of its own: nodes of other tests take a while to be forgotten.
    node = node_of(graph, model, load=load_slowly, namespace='loading')
    messages = graph.collect(DiagnosticArray, '/diagnostics')
    graph.spin_until(lambda: node.count_subscribers('/diagnostics'))
    assert node.trigger_configure() == TransitionCallbackReturn.SUCCESS
    result, = node.set_parameters([Parameter('threads', value=2)])
    assert result.successful, result.reason
    words = [message.status[0].message for message in messages]
    assert words.count('configuring: the model is being loaded') >= 3
    assert words.count('inactive: the model is being loaded') >= 3
    node.destroy_node()


class BondOfBondpy:
    """What bondpy 4.1 has: `Bond(node, topic, bond_id)`, whose thread publishes until the end."""

    made: list['BondOfBondpy'] = []

    def __init__(self, node, topic, bond_id, on_broken=None, on_formed=None):
        self.node, self.names, self.calls = node, (topic, bond_id), []
        self.heartbeat_period, self.heartbeat_timeout = 1.0, 4.0
        self.made.append(self)

    def start(self):
        self.calls.append('start')

    def shutdown(self):
        self.calls.append('shutdown')

    def _publish(self, active):
        raise RuntimeError('cannot publish')


@pytest.fixture
def bonds(monkeypatch):
    module = ModuleType('bondpy.bondpy')
    setattr(module, 'Bond', BondOfBondpy)
    monkeypatch.setitem(sys.modules, 'bondpy', ModuleType('bondpy'))
    monkeypatch.setitem(sys.modules, 'bondpy.bondpy', module)
    monkeypatch.setattr(BondOfBondpy, 'made', [])
    return BondOfBondpy.made


def test_a_manager_has_a_bond_with_the_node_while_it_is_active(graph, model, bonds):
    node = node_of(graph, model)
    for number in range(2):
        node.trigger_configure()
        assert len(bonds) == number
        node.trigger_activate()
        bond = bonds[number]
        assert bond.names == ('bond', 'fov_extrapolator') and bond.calls == ['start']
        # Loading a model, in which nothing is heard, must not end it.
        assert bond.heartbeat_period == 0.1 and bond.heartbeat_timeout > 3600
        node.trigger_deactivate()
        assert bond.calls == ['start', 'shutdown']
        node.trigger_cleanup()
    with pytest.raises(RuntimeError):
        bond._publish(True)
    node.destroy_node()
    graph.context.shutdown()
    bond._publish(True)  # Its thread ends after the context.


def test_without_a_manager_or_bondpy_there_is_no_bond(graph, model, bonds, monkeypatch):
    node = node_of(graph, model, autostart=True)
    node.autostart()
    assert node.state_label == 'active' and not bonds
    node.stop()
    node.destroy_node()
    monkeypatch.setitem(sys.modules, 'bondpy', None)
    monkeypatch.setitem(sys.modules, 'bondpy.bondpy', None)
    node = node_of(graph, model)
    node.trigger_configure()
    assert node.trigger_activate() == TransitionCallbackReturn.SUCCESS and not bonds
    node.trigger_deactivate()
    node.destroy_node()
