"""
What others listen with, message_filters and the ros2 command, hears everything that is known.

Neither is on PyPI; both are pure Python and run on its wheels: `pip install --no-deps --target
DIR` of the jazzy branches of ros2/message_filters, ros2/ros2cli (ros2cli and ros2topic) and
ros2/rosidl_runtime_py, and of psutil; then PYTHONPATH=DIR.
"""
from importlib.util import find_spec
import re

from box_room import box_walk, EXPANSION, view, write_box_model
from live_node import Camera
from neo_ros.node.interface import OUTPUTS
import pytest

# Without a base_frame there is no pose of it.
HEARD = {name: output for name, output in OUTPUTS.items() if name != 'base_pose'}
ROS2 = 'import sys; from ros2cli.cli import main; sys.exit(main())'


@pytest.fixture
def camera(tmp_path, graph):
    """Give a camera in a room that the node's memory knows; its outputs are subscribed."""
    camera = Camera(graph)
    camera.start_node(write_box_model(tmp_path), 'panorama_width:=128', 'panorama_fps:=30.0')
    camera.wait_for_node()
    return camera


def walk(camera):
    """Send images of a walk; each is answered."""
    for number, pose in enumerate(box_walk(4)):
        camera.widen(view(pose, EXPANSION.source)[0], number * 10 ** 8)


@pytest.mark.skipif(find_spec('message_filters') is None,
                    reason='message_filters is not installed (not on PyPI)')
def test_message_filters_brings_all_outputs_of_an_image_together(camera, graph):
    from message_filters import Subscriber, TimeSynchronizer
    together: list[tuple] = []
    topics = [Subscriber(graph.node, output.kind, f'/robot/{output.name}')
              for output in HEARD.values()]
    TimeSynchronizer(topics, 10).registerCallback(lambda *messages: together.append(messages))
    graph.spin_until(lambda: all(graph.node.count_publishers(topic.getTopic())
                                 for topic in topics))
    graph.spin_for(0.3)
    walk(camera)
    graph.spin_until(lambda: together)
    messages = dict(zip(HEARD, together[0]))
    assert [type(message) for message in messages.values()] == [
        output.kind for output in HEARD.values()]
    stamps = {(message.header.stamp.sec, message.header.stamp.nanosec)
              for message in messages.values()}
    assert len(stamps) == 1 and messages['image'].width == EXPANSION.target.width


def answers(graph, camera, *arguments):
    """Run `ros2` while images go on; return what it prints once it has ended by itself."""
    process = graph.start('-c', ROS2, *arguments)
    graph.spin_until(lambda: walk(camera) or process.poll() is not None)
    printed = process.stdout.read()
    assert process.returncode == 0, printed
    return printed


@pytest.mark.skipif(find_spec('ros2topic') is None or find_spec('rosidl_runtime_py') is None,
                    reason='ros2cli is not installed (not on PyPI)')
def test_ros2_topic_lists_and_echoes_every_output(camera, graph):
    kinds = {output.name: f'{output.kind.__module__.split(".")[0]}/msg/{output.kind.__name__}'
             for output in HEARD.values()}

    def listed():
        """Say whether all are listed; on a busy machine they are found late."""
        lines = answers(graph, camera, 'topic', 'list', '-t', '--no-daemon', '--spin-time', '2')
        return {f'/robot/{name} [{kind}]' for name, kind in kinds.items()} <= set(
            lines.splitlines())

    graph.spin_until(listed)
    for name, kind in kinds.items():
        echoed = answers(graph, camera, 'topic', 'echo', '--once', '--no-daemon',
                         f'/robot/{name}', kind)
        assert re.search(r'header:\n  stamp:\n    sec: 1700000000\n', echoed), echoed
    pose = answers(graph, camera, 'topic', 'echo', '--once', '--no-daemon', '--field',
                   'pose.pose.position', '/robot/wide/pose', kinds['wide/pose'])
    assert re.match(r'x: [\d.e+-]+\ny: [\d.e+-]+\nz: [\d.e+-]+\n', pose), pose
