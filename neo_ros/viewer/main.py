"""The executable `viewer`: the page for a wide topic of the ROS graph."""
from collections.abc import Sequence
from dataclasses import fields
from pathlib import Path
import sys
from typing import Any

from neo_ros.errors import NeoError
from neo_ros.machine.processes import end_if_busy
from neo_ros.node.file_place import find_model
from neo_ros.viewer.settings import read_token, ViewerSettings
from rcl_interfaces.msg import ParameterDescriptor
import rclpy
from rclpy.exceptions import InvalidParameterTypeException, InvalidParameterValueException
from rclpy.node import Node
from rclpy.signals import SignalHandlerOptions

NODE_NAME = 'viewer'
DESCRIPTIONS = {
    'host': 'Address to listen on; on any other than loopback viewers need a token',
    'port': 'Port to listen on, 0 = any free one',
    'token_file': 'File with the token that viewers have to know; empty: the variable '
                  'NEO_VIEWER_TOKEN, else a fresh one where one is needed',
    'cert': 'PEM file with the certificate for TLS',
    'key': 'PEM file with the key of the certificate',
    'max_viewers': 'How many may watch at a time',
    'max_mbit': 'Most megabit per second for each viewer, 0 = no limit',
    'quality': 'JPEG quality of the pictures, 1 to 100',
    'stale_after': 'Seconds until a picture counts as stale',
    'public_origin': 'What viewers open where a proxy stands before the server, such as '
                     'https://robot.example; empty: no proxy',
    'model': "Model whose memory shows the map and looks around, named as the node's; empty: "
             'neither',
    'floor': "A walkable.json, or a map's YAML, whose outlines lie under the map",
}


def main(arguments: Sequence[str] | None = None) -> None:
    """Serve the page until SIGINT or SIGTERM."""
    rclpy.init(args=list(arguments) if arguments is not None else None,
               signal_handler_options=SignalHandlerOptions.NO)
    node = Node(NODE_NAME)
    try:
        serve_topic(node, 'wide/image', read_settings(node))
    except (NeoError, InvalidParameterTypeException, InvalidParameterValueException) as error:
        sys.exit(f'viewer: {error}')
    except ModuleNotFoundError as error:
        if error.name != 'aiohttp':
            raise
        sys.exit("viewer: aiohttp is not installed: make setup, or pip install '.[viewer]', in a "
                 'checkout')
    finally:
        rclpy.try_shutdown()
    end_if_busy()


def read_settings(node: Node) -> ViewerSettings:
    """Declare the parameters and return their values; raises ConfigError."""
    defaults: dict[str, Any] = {field.name: field.default for field in fields(ViewerSettings)}
    values: dict[str, Any] = {}
    for name, description in DESCRIPTIONS.items():
        default = defaults.get(name) or ''
        values[name] = node.declare_parameter(
            name, default, ParameterDescriptor(description=description, read_only=True)).value
    token_file = values.pop('token_file')
    if values['model']:
        values['model'] = find_model(values['model'])
    for name in ('cert', 'key', 'model', 'floor'):
        values[name] = Path(values[name]) if values[name] else None
    return ViewerSettings(token=read_token(Path(token_file) if token_file else None), **values)


def serve_topic(node: Node, image: str, settings: ViewerSettings) -> None:
    """Serve a wide image topic until SIGINT or SIGTERM."""
    from neo_ros.viewer.ros_source import RosSource
    from neo_ros.viewer.server import serve

    serve(RosSource(node, image), settings, lambda line: print(line, flush=True))


if __name__ == '__main__':
    main()
