"""Stamps of ROS headers as integers."""
from typing import Any

NS_PER_S = 1_000_000_000


def stamp_of(header: Any) -> int:
    """Return the stamp of a header in nanoseconds."""
    return int(header.stamp.sec) * NS_PER_S + int(header.stamp.nanosec)
