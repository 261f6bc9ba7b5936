"""What the node uses of tf2_ros (Jazzy), which PyPI has not: the same names, the same calls."""
from importlib.machinery import ModuleSpec
import sys
from types import ModuleType

from geometry_msgs.msg import TransformStamped
from neo_ros.geometry.camera_pose import quaternion_from_rotation
import numpy as np
from rclpy.duration import Duration
from rclpy.node import Node
from rclpy.time import Time


class TransformException(Exception):
    """As of tf2_py, which tf2_ros gives on."""


class Buffer:
    """
    Transforms that a test says: T_target_source (4, 4) by (target, source).

    known: the fixed ones; moving: by their stamps, too, nanoseconds.
    """

    known: dict[tuple[str, str], np.ndarray] = {}
    moving: dict[tuple[str, str], dict[int, np.ndarray]] = {}

    def __init__(self, cache_time: Duration | None = None, node: Node | None = None) -> None:
        self.asked: list[tuple[str, str, int]] = []

    def lookup_transform(self, target_frame: str, source_frame: str, time: Time,
                         timeout: Duration = Duration()) -> TransformStamped:
        """Give a transform; raise for one that nobody said."""
        self.asked.append((target_frame, source_frame, time.nanoseconds))
        moving = self.moving.get((target_frame, source_frame), {})
        stamp_ns = time.nanoseconds or max(moving, default=0)
        T = self.known.get((target_frame, source_frame), moving.get(stamp_ns))
        if T is None:
            raise TransformException(f'no {source_frame} in {target_frame}')
        message = TransformStamped()
        at, turn = message.transform.translation, message.transform.rotation
        at.x, at.y, at.z = T[:3, 3].tolist()
        turn.x, turn.y, turn.z, turn.w = quaternion_from_rotation(T[:3, :3]).tolist()
        return message

    def clear(self) -> None:
        """Forget all but the fixed ones."""
        self.moving.clear()


class TransformListener:
    """Listens, until it is unregistered."""

    listening = 0

    def __init__(self, buffer: Buffer, node: Node) -> None:
        assert isinstance(buffer, Buffer) and isinstance(node, Node)
        TransformListener.listening += 1

    def unregister(self) -> None:
        """Listen no more."""
        TransformListener.listening -= 1


class TransformBroadcaster:
    """Keeps what is sent; as there, publishes on /tf (any type does here)."""

    sent: list[TransformStamped] = []

    def __init__(self, node: Node) -> None:
        self.pub_tf = node.create_publisher(TransformStamped, '/tf', 100)

    def sendTransform(self, transform: TransformStamped) -> None:  # noqa: N802
        """Keep a transform."""
        assert isinstance(transform, TransformStamped)
        self.sent.append(transform)


def install(monkeypatch) -> None:
    """Let `import tf2_ros` find this, knowing nothing yet."""
    module = ModuleType('tf2_ros')
    module.__spec__ = ModuleSpec('tf2_ros', None)
    for thing in (TransformException, Buffer, TransformListener, TransformBroadcaster):
        setattr(module, thing.__name__, thing)
    monkeypatch.setitem(sys.modules, 'tf2_ros', module)
    monkeypatch.setattr(Buffer, 'known', {})
    monkeypatch.setattr(Buffer, 'moving', {})
    monkeypatch.setattr(TransformListener, 'listening', 0)
    monkeypatch.setattr(TransformBroadcaster, 'sent', [])
