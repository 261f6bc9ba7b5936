"""Message classes by the names that bags and the graph use."""
import importlib


def find_message_class(msgtype: str) -> type | None:
    """Return the class of a type such as 'sensor_msgs/msg/Image'; None if not installed."""
    parts = msgtype.split('/')
    if len(parts) != 3 or parts[1] != 'msg':
        return None
    try:
        return getattr(importlib.import_module(f'{parts[0]}.msg'), parts[2], None)
    except ImportError:
        return None
