"""
message_filters brings all outputs of an image together.

It is not on PyPI, but pure Python, and runs on the wheels: `pip install --no-deps --target DIR` of
the jazzy branch of ros2/message_filters, then PYTHONPATH=DIR.
"""
from importlib.util import find_spec

from box_room import box_walk, EXPANSION, view, write_box_model
from live_node import Camera
from neo_ros.node.interface import OUTPUTS
import pytest

# Without a base_frame there is no pose of it.
HEARD = {name: output for name, output in OUTPUTS.items() if name != 'base_pose'}


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
