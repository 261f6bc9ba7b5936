"""Small bags for tests, written with other people's writers where that is the point."""
from pathlib import Path
from typing import Any

from box_room import box_walk, EXPANSION, view, write_box_model
from mcap.writer import CompressionType, Writer as McapWriter
from neo_ros.bags import BagWriter, replay, write_demo_bag
from neo_ros.geometry import CameraPose, ViewExpansion
from neo_ros.runtime import FovExtrapolator
import numpy as np
from rosbags.rosbag2 import StoragePlugin, Writer
from rosbags.typesys import get_typestore, Stores

STORE = get_typestore(Stores.ROS2_JAZZY)
STRING = 'std_msgs/msg/String'
START_NS = 1_700_000_000_000_000_000


def string_cdr(text: str) -> bytes:
    return bytes(STORE.serialize_cdr(STORE.types[STRING](data=text), STRING))


def texts(count: int) -> list[str]:
    """Return texts of several lengths that compress differently."""
    rng = np.random.default_rng(7)
    return [f'{i} ' + rng.bytes(int(rng.integers(20, 200))).hex() for i in range(count)]


def write_sqlite_bag(path: Path, count: int) -> Path:
    with Writer(path, version=9, storage_plugin=StoragePlugin.SQLITE3) as writer:
        connection = writer.add_connection('/text', STRING, typestore=STORE)
        for i, text in enumerate(texts(count)):
            writer.write(connection, START_NS + i, string_cdr(text))
    return path


def write_text_bag(path: Path, count: int, compressed: bool = False) -> Path:
    with BagWriter(path, compressed) as writer:
        topic = writer.add_topic('/text', STRING)
        for i, text in enumerate(texts(count)):
            writer.write_cdr(topic, START_NS + i, string_cdr(text))
    return path


def write_foreign_mcap(path: Path, count: int, compression: CompressionType,
                       chunk_size: int = 2000, **options: Any) -> Path:
    """Write with Foxglove's own writer: other chunking, other compressions, CRCs."""
    with path.open('wb') as file:
        writer = McapWriter(file, chunk_size=chunk_size, compression=compression, **options)
        writer.start(profile='ros2', library='test')
        schema = writer.register_schema(STRING, 'ros2msg', b'string data')
        channel = writer.register_channel('/text', 'cdr', schema)
        for i, text in enumerate(texts(count)):
            writer.add_message(channel, START_NS + i, string_cdr(text), START_NS + i, i)
        writer.finish()
    return path


def walk_frames(expansion: ViewExpansion,
                count: int) -> list[tuple[int, np.ndarray, CameraPose]]:
    """Return frames of a camera that walks and turns: smooth pictures, 10 Hz."""
    rows, columns = np.indices((expansion.target.height, expansion.target.width))
    return [(START_NS + i * 100_000_000,
             np.stack([rows * 3 + i, columns * 2 + 5 * i, rows + columns], -1).astype(np.uint8),
             CameraPose.from_planar(0.1 * i, 0.5, 1.5, 0.05 * i)) for i in range(count)]


def write_walk_bag(path: Path, expansion: ViewExpansion, count: int = 5) -> Path:
    write_demo_bag(path, walk_frames(expansion, count), expansion)
    return path


def write_box_bags(folder: Path, frames: int, step_s: float) -> None:
    """Write a walk through the box room with its truth, `camera`, and its replay, `wide`."""
    model = write_box_model(folder)
    write_demo_bag(folder / 'camera', [
        (START_NS + round(i * step_s * 1e9), view(pose, EXPANSION.target)[0], pose)
        for i, pose in enumerate(box_walk(frames))], EXPANSION)
    replay(folder / 'camera', FovExtrapolator.load(model), folder / 'wide')
