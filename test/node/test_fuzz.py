"""Broken messages end in a refusal under a known reason; `make fuzz` sends many more."""
from box_room import write_box_model
from message_fuzzer import fuzz_layer, fuzz_node, REASONS
from neo_ros.node.extrapolator_node import ExtrapolatorNode
from pose_fuzzer import fuzz_poses
import pytest
from rclpy.parameter import Parameter
from ros_graph import ros_graph
from tiny_model import write_tiny_model


def test_message_layer_widens_or_refuses_for_a_reason():
    ways = fuzz_layer(4_000, seed=0)
    assert sum(ways.values()) == 4_000
    # Not a fuzzer that never gets past the first check.
    assert set(ways) == REASONS | {'widened'} and min(ways.values()) > 20


@pytest.mark.parametrize('transport', ['raw', 'compressed'])
def test_live_node_counts_every_broken_message_and_widens_the_good_ones(tmp_path, transport):
    model = write_tiny_model(tmp_path / 'tiny.onnx')
    with ros_graph() as graph:
        node = ExtrapolatorNode(context=graph.context, parameter_overrides=[
            Parameter('model', value=str(model)), Parameter('image_transport', value=transport),
            Parameter('reliable', value=True), Parameter('rectify', value=True)])
        node.autostart()
        ways = fuzz_node(graph, node, 150, seed=0)
        node.stop()
        node.destroy_node()
    assert sum(ways.values()) == 150 and 15 <= ways['widened'] < 100 and len(ways) > 4


def test_no_prior_and_no_odometry_makes_a_guided_node_say_what_is_not_true(tmp_path):
    with ros_graph() as graph:
        node = ExtrapolatorNode(context=graph.context, parameter_overrides=[
            Parameter('model', value=str(write_box_model(tmp_path))),
            Parameter('reliable', value=True), Parameter('panorama_width', value=64),
            Parameter('panorama_fps', value=30.0)])
        node.autostart()
        ways = fuzz_poses(graph, node, 120, seed=0)
        node.stop()
        node.destroy_node()
    assert ways['guided'] > 100 and ways['wide/pose'] == ways['guided']
