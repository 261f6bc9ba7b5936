"""The tables of topics, parameters, services and keys in docs/reference/node.md, from the code."""
from collections.abc import Iterable, Mapping
from typing import Any

from neo_ros.node.diagnostics import CAMERA_KEYS, KEYS
from neo_ros.node.interface import DIAGNOSTICS, Endpoint, INPUTS, MAP, OUTPUTS, SERVICES
from neo_ros.node.parameters import parameters
from rcl_interfaces.msg import ParameterDescriptor


def interface_tables() -> dict[str, str]:
    """Return the tables in Markdown, by their names."""
    topics = [*_rows('in, ', INPUTS), *_rows('out, ', OUTPUTS.values()),
              *_rows('out, ', [MAP, DIAGNOSTICS])]
    return {'topics': _table('| topic | type | |', topics),
            'parameters': _table('| parameter | default | |', [
                _parameter_row(*parameter) for parameter in parameters()]),
            'widening': _keys(KEYS),
            'camera': _keys(CAMERA_KEYS),
            'services': _table('| service | type | |', _rows('', SERVICES))}


def _parameter_row(name: str, default: Any, about: ParameterDescriptor) -> str:
    words = [about.description, *_ranges(about), about.additional_constraints]
    if about.read_only:
        words.append('read-only')
    shown = str(default).lower() if isinstance(default, bool) else repr(default)
    return f'| `{name}` | {shown} | {"; ".join(filter(None, words))} |'


def _keys(keys: Mapping[str, str]) -> str:
    return _table('| key | meaning |', [f'| `{key}` | {words} |' for key, words in keys.items()])


def _ranges(about: ParameterDescriptor) -> list[str]:
    return [f'{found.from_value} to {found.to_value}'
            for found in (*about.integer_range, *about.floating_point_range)]


def _rows(direction: str, endpoints: Iterable[Endpoint]) -> list[str]:
    return [f'| `{name}` | {direction}{_type_name(kind)} | {words} |'
            for name, kind, words in endpoints]


def _type_name(kind: type) -> str:
    # sensor_msgs.msg._image.Image -> sensor_msgs/Image
    return f'{kind.__module__.split(".")[0]}/{kind.__name__}'


def _table(head: str, rows: list[str]) -> str:
    return '\n'.join([head, '|---' * head.count(' |') + '|', *rows]) + '\n'
