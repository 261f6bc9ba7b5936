"""Message classes by the names that bags and the graph use."""
from array import array
from functools import lru_cache
import importlib
from typing import Any

import numpy as np


@lru_cache
def find_message_class(msgtype: str) -> type | None:
    """Return the class of a type such as 'sensor_msgs/msg/Image'; None if not installed."""
    parts = msgtype.split('/')
    if len(parts) != 3 or parts[1] != 'msg':
        return None
    try:
        return getattr(importlib.import_module(f'{parts[0]}.msg'), parts[2], None)
    except ImportError:
        return None


def make_message(msgtype: str, **fields: Any) -> Any:
    """Build a message for rclpy: see `messages.scene_outputs`."""
    kind = find_message_class(msgtype)
    assert kind is not None, msgtype
    return kind(**{name: _as_rclpy(name, value) for name, value in fields.items()})


def as_array(data: np.ndarray) -> array:
    """Copy bytes to what rclpy takes at once: an ndarray it converts element by element."""
    copy = array('B')
    copy.frombytes(data.data)
    return copy


def as_int8(data: np.ndarray) -> array:
    """Copy int8 numbers to what rclpy takes at once."""
    copy = array('b')
    copy.frombytes(np.ascontiguousarray(data, np.int8).data)
    return copy


def _as_rclpy(name: str, value: Any) -> Any:
    if isinstance(value, np.ndarray) and value.dtype == np.uint8:
        return as_array(value)
    return bytes([value]) if name == 'level' else value
