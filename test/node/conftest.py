"""What tests of the node share: a ROS graph, and a model for it to run."""
import pytest


@pytest.fixture
def graph():
    """Give a graph of the test's own; what it started ends with it."""
    from ros_graph import ros_graph
    with ros_graph() as graph:
        yield graph


@pytest.fixture
def model(tmp_path):
    """Write a model that the test may replace or delete."""
    from tiny_model import write_tiny_model
    return write_tiny_model(tmp_path / 'tiny.onnx')
