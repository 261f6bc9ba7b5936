"""The node's parameters: names, defaults, ranges, and when they may change."""
from collections.abc import Sequence
from dataclasses import dataclass, fields
from typing import Any

from neo_ros.errors import ConfigError
from neo_ros.machine.files import share_dir
from neo_ros.runtime.providers import PROVIDERS
from rcl_interfaces.msg import FloatingPointRange, IntegerRange, ParameterDescriptor
from rclpy.node import Node
from rclpy.parameter import Parameter

# A change of these loads a model, of those subscribes anew.
MODEL_PARAMETERS = ('model', 'threads', 'providers')
INPUT_PARAMETERS = ('transport', 'reliable')
TRANSPORTS = ('raw', 'compressed')


@dataclass(frozen=True)
class NodeParameters:
    """
    The values of the parameters; see `declare_parameters` for what they mean.

    model is a path and never empty here.
    """

    model: str
    autostart: bool
    threads: int
    providers: Sequence[str]
    transport: str
    reliable: bool
    rectify: bool
    max_fps: float
    jpeg_quality: int


def declare_parameters(node: Node) -> None:
    """Declare every parameter with its description and range."""
    _declare(node, 'model', '',
             'Path of the model (ONNX file of "neo train"); empty: the demo flat that comes '
             'with the package. A new one replaces the old one once it has passed its checks')
    _declare(node, 'autostart', True,
             'Configure and activate on start, without a lifecycle manager', read_only=True)
    _declare(node, 'threads', 0, 'Threads of the network, 0 = one per core',
             integer_range=[IntegerRange(from_value=0, to_value=64, step=1)])
    _declare(node, 'providers', ['cuda', 'cpu'],
             'What the network runs on, best first; what is not there is left out, the CPU is '
             'always the last. TensorRT first builds an engine for minutes',
             additional_constraints=f'some of {", ".join(PROVIDERS)}')
    _declare(node, 'transport', 'raw', 'Which image topic is subscribed',
             additional_constraints=' or '.join(TRANSPORTS))
    _declare(node, 'reliable', False,
             'Ask the image publisher for reliable delivery instead of best effort')
    _declare(node, 'rectify', False,
             'Take the distortion of camera_info out of the images; otherwise distorted images '
             'are rejected')
    _declare(node, 'max_fps', 0.0,
             'Most frames widened per second, 0 = as many as come',
             floating_point_range=[FloatingPointRange(from_value=0.0, to_value=1000.0)])
    _declare(node, 'jpeg_quality', 80, 'Quality of wide/image/compressed',
             integer_range=[IntegerRange(from_value=1, to_value=100, step=1)])


def read_parameters(node: Node, changed: Sequence[Parameter] = ()) -> NodeParameters:
    """
    Return the values as they stand, or as they would be with changes.

    Raises ConfigError for values that a range cannot exclude.
    """
    values: dict[str, Any] = {field.name: node.get_parameter(field.name).value
                              for field in fields(NodeParameters)}
    values |= {parameter.name: parameter.value for parameter in changed
               if parameter.name in values}
    if values['transport'] not in TRANSPORTS:
        raise ConfigError(f'transport: expected {" or ".join(TRANSPORTS)}, got '
                          f'{values["transport"]!r}')
    if unknown := [name for name in values['providers'] if name not in PROVIDERS]:
        raise ConfigError(f'providers: expected some of {", ".join(PROVIDERS)}, got '
                          f'{", ".join(unknown)}')
    values['model'] = values['model'] or str(share_dir() / 'models' / 'demo_flat.onnx')
    return NodeParameters(**values)


def _declare(node: Node, name: str, default: Any, description: str, **constraints: Any) -> None:
    node.declare_parameter(
        name, default, ParameterDescriptor(description=description, **constraints))
