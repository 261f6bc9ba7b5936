"""Graphs of tests do not meet."""
import rclpy
from rclpy.context import Context
from ros_graph import ros_graph


def test_a_graph_keeps_away_from_nodes_of_the_one_before():
    with ros_graph() as first:
        domain, left = first.context.get_domain_id(), Context()
        rclpy.init(context=left, domain_id=domain)
        node = rclpy.create_node('fov_extrapolator', namespace='robot', context=left)
    with ros_graph() as second:
        assert second.context.get_domain_id() != domain
        second.spin_for(3.0)  # In one domain they have met by then.
        assert second.node.get_node_names() == ['test']
    node.destroy_node()
    left.shutdown()
