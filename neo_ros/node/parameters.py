"""The node's parameters: names, defaults, ranges, and when they may change."""
from dataclasses import dataclass
from typing import Any

from neo_ros.paths import share_dir
from rcl_interfaces.msg import FloatingPointRange, IntegerRange, ParameterDescriptor
from rclpy.node import Node

# Read when the node configures; to change them, clean up first.
FIXED_WHILE_CONFIGURED = ('model', 'threads', 'reliable')


@dataclass(frozen=True)
class NodeParameters:
    """
    The values of the parameters.

    model: path of the ONNX file, never empty here. autostart: configure and activate without a
    manager. threads: of the network, 0 = all cores. reliable: ask the camera for reliable
    instead of best effort. max_fps: most frames widened per second, 0 = no limit.
    """

    model: str
    autostart: bool
    threads: int
    reliable: bool
    max_fps: float


def declare_parameters(node: Node) -> None:
    """Declare every parameter with its description and range."""
    _declare(node, 'model', '',
             'Path of the model (ONNX file of "neo train"); empty: the demo flat that comes '
             'with the package')
    _declare(node, 'autostart', True,
             'Configure and activate on start, without a lifecycle manager', read_only=True)
    _declare(node, 'threads', 0, 'Threads of the network, 0 = one per core',
             integer_range=[IntegerRange(from_value=0, to_value=64, step=1)])
    _declare(node, 'reliable', False,
             'Ask the image publisher for reliable delivery instead of best effort')
    _declare(node, 'max_fps', 0.0,
             'Most frames widened per second, 0 = as many as come; may change at any time',
             floating_point_range=[FloatingPointRange(from_value=0.0, to_value=1000.0)])


def read_parameters(node: Node) -> NodeParameters:
    """Return the values as they stand."""
    def value(name: str) -> Any:
        return node.get_parameter(name).value

    return NodeParameters(
        model=value('model') or str(share_dir() / 'models' / 'demo_flat.onnx'),
        autostart=value('autostart'), threads=value('threads'), reliable=value('reliable'),
        max_fps=value('max_fps'))


def _declare(node: Node, name: str, default: Any, description: str, **constraints: Any) -> None:
    node.declare_parameter(
        name, default, ParameterDescriptor(description=description, **constraints))
