"""The node's parameters: names, defaults, ranges, and when they may change."""
from collections.abc import Sequence
from dataclasses import dataclass, fields
from importlib.util import find_spec
from pathlib import Path
from typing import Any

from neo_ros.errors import ConfigError, ImageRejected
from neo_ros.messages.camera_info import read_lens
from neo_ros.messages.camera_info_file import read_camera_info_file
from neo_ros.node.file_place import find_file, find_model
from neo_ros.runtime.providers import PROVIDERS
from rcl_interfaces.msg import FloatingPointRange, IntegerRange, ParameterDescriptor
from rclpy.node import Node
from rclpy.parameter import Parameter

# A change of these loads a model, of those subscribes anew, where somebody listens.
MODEL_PARAMETERS = ('model', 'threads', 'providers', 'learn')
INPUT_PARAMETERS = ('image_transport', 'reliable', 'camera_info_url')
# What configure takes.
FRAME_PARAMETERS = ('base_frame', 'odom_frame', 'publish_tf')
TRANSPORTS = ('raw', 'compressed')


@dataclass(frozen=True)
class NodeParameters:
    """
    The values of the parameters; see `parameters` for what they mean.

    model is a path and never empty here; camera_info_url is a path, or empty.
    """

    model: str
    autostart: bool
    threads: int
    providers: Sequence[str]
    learn: bool
    image_transport: str
    reliable: bool
    camera_info_url: str
    rectify: bool
    max_fps: float
    jpeg_quality: int
    scene_frame: str
    base_frame: str
    odom_frame: str
    publish_tf: bool
    points_every: int
    panorama_width: int
    panorama_fps: float


def declare_parameters(node: Node) -> None:
    """Declare every parameter with its description and range; integers do for doubles."""
    for name, default, about in parameters():
        given = override_of(node, name)
        if isinstance(default, float) and type(given) is int:
            node.declare_parameter(name, float(given), about, ignore_override=True)
        else:
            node.declare_parameter(name, default, about)
    node.add_pre_set_parameters_callback(_with_doubles)


def parameters() -> list[tuple[str, Any, ParameterDescriptor]]:
    """Return every parameter's name, default, and what it is."""
    return [
        _row('model', '',
             'The model (ONNX file of "neo train"): a path, ~/PATH, file:///PATH or '
             'package://PACKAGE/PATH; empty: the demo flat that comes with the package. A new one '
             'replaces the old one once it has passed its checks'),
        _row('autostart', True,
             'Configure and activate on start, without a lifecycle manager', read_only=True),
        _row('threads', 0, 'Threads of the network and of the scene memory, 0 = one per core',
             integer_range=[IntegerRange(from_value=0, to_value=64, step=1)]),
        _row('providers', ['cuda', 'cpu'],
             'What the network runs on, best first; what is not there is left out, the CPU is '
             'always the last. TensorRT first builds an engine for minutes',
             additional_constraints=f'some of {", ".join(PROVIDERS)}'),
        _row('learn', False,
             'Learn what has changed in the scene, beside the images on a thread of low priority, '
             'also while nobody subscribes; it is kept in a journal beside the scene memory, '
             'whose folder must be writable'),
        _row('image_transport', 'raw', 'Which image topic is subscribed',
             additional_constraints=' or '.join(TRANSPORTS)),
        _row('reliable', False,
             'Ask the image publisher for reliable delivery instead of best effort'),
        _row('camera_info_url', '',
             'The calibration of a camera that publishes none: the YAML of camera_calibration, as '
             'a path, ~/PATH, file:///PATH or package://PACKAGE/PATH. The topic camera_info is '
             'not heard then'),
        _row('rectify', False,
             'Take the distortion of camera_info out of the images; otherwise distorted images '
             'are rejected'),
        _row('max_fps', 0.0,
             'Most frames widened per second, 0 = as many as come',
             floating_point_range=[FloatingPointRange(from_value=0.0, to_value=1000.0)]),
        _row('jpeg_quality', 80, 'Quality of wide/image/compressed',
             integer_range=[IntegerRange(from_value=1, to_value=100, step=1)]),
        _row('scene_frame', '',
             'Frame of the poses; empty: map, or scene where the scale of the scene is arbitrary'),
        _row('base_frame', '',
             "The robot's frame, such as base_link: then its pose is published, too, and priors "
             'and odometry are of it. Needs tf2_ros; set it before configure, as the next two'),
        _row('odom_frame', 'odom', 'What publish_tf places in scene_frame'),
        _row('publish_tf', False,
             'Send the transform from scene_frame to odom_frame. Needs base_frame and tf2_ros'),
        _row('points_every', 2, 'Of so many pixels and rows one becomes a point',
             integer_range=[IntegerRange(from_value=1, to_value=32, step=1)]),
        _row('panorama_width', 1024, 'Pixels of wide/panorama',
             integer_range=[IntegerRange(from_value=64, to_value=8192, step=2)]),
        _row('panorama_fps', 1.0, 'Most panoramas per second',
             floating_point_range=[FloatingPointRange(from_value=0.01, to_value=30.0)]),
    ]


def read_parameters(node: Node, changed: Sequence[Parameter] = ()) -> NodeParameters:
    """
    Return the values as they stand, or as they would be with changes.

    Raises ConfigError for values that a range cannot exclude.
    """
    # An empty list in a file of parameters leaves one without a value.
    values: dict[str, Any] = {field.name: node.get_parameter_or(field.name).value
                              for field in fields(NodeParameters)}
    values |= {parameter.name: parameter.value for parameter in changed
               if parameter.name in values}
    values['providers'] = values['providers'] or ()
    # As in messages, where frames of ROS 1 have a slash.
    values |= {name: values[name].lstrip('/') for name in
               ('scene_frame', 'base_frame', 'odom_frame')}
    if values['image_transport'] not in TRANSPORTS:
        raise ConfigError(f'image_transport: expected {" or ".join(TRANSPORTS)}, got '
                          f'{values["image_transport"]!r}')
    if unknown := [name for name in values['providers'] if name not in PROVIDERS]:
        raise ConfigError(f'providers: expected some of {", ".join(PROVIDERS)}, got '
                          f'{", ".join(unknown)}')
    if values['publish_tf'] and not values['base_frame']:
        raise ConfigError('publish_tf: expected a base_frame, such as base_link, got none')
    if values['publish_tf'] and values['odom_frame'] in ('', values['scene_frame']):
        raise ConfigError('odom_frame: expected another frame than scene_frame, such as odom, got '
                          f'{values["odom_frame"] or "none"}')
    if values['base_frame'] and find_spec('tf2_ros') is None:
        raise ConfigError(
            f'base_frame: {values["base_frame"]!r} needs tf2_ros, which is missing here (it is '
            'not among the wheels of PyPI); run the node in a ROS installation, or leave it empty')
    values['model'] = find_model(values['model'])
    if values['camera_info_url']:
        values['camera_info_url'] = find_file('camera_info_url', values['camera_info_url'])
    return NodeParameters(**values)


def read_calibration(values: NodeParameters) -> Any | None:
    """Return what camera_info_url says, as a CameraInfo; None: nothing; raises ConfigError."""
    if not values.camera_info_url:
        return None
    try:
        calibration = read_camera_info_file(Path(values.camera_info_url))
        read_lens(calibration)
    except (ConfigError, ImageRejected) as error:
        raise ConfigError(f'camera_info_url: {error}') from error
    return calibration


def refuse_late(node: Node, changed: Sequence[Parameter], state: str) -> None:
    """Raise ConfigError where what only configure takes would change after it."""
    for one in changed:
        if one.name in FRAME_PARAMETERS and one.value != node.get_parameter(one.name).value:
            raise ConfigError(f'{one.name}: expected to be set before the node is configured, it '
                              f'is {state}; clean it up, set it and configure')


def override_of(node: Node, name: str) -> Any | None:
    """Return what was given for a parameter that nobody has declared yet; None: nothing."""
    if node.has_parameter(name):
        return node.get_parameter(name).value
    # rclpy shows overrides only to declarations.
    found = node.declare_parameter(name, None, ParameterDescriptor(dynamic_typing=True)).value
    node.undeclare_parameter(name)
    return found


def _row(name: str, default: Any, description: str, **constraints: Any
         ) -> tuple[str, Any, ParameterDescriptor]:
    return name, default, ParameterDescriptor(description=description, **constraints)


def _with_doubles(changed: list[Parameter]) -> list[Parameter]:
    """Make doubles of the integers that are meant for doubles."""
    doubles = {name for name, default, _ in parameters() if isinstance(default, float)}
    return [Parameter(parameter.name, value=float(parameter.value))
            if parameter.name in doubles and parameter.type_ == Parameter.Type.INTEGER
            else parameter for parameter in changed]
