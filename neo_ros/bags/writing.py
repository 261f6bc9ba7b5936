"""Write rosbag2 bags (MCAP) that `ros2 bag play` accepts."""
from contextlib import suppress
from pathlib import Path
from types import TracebackType
from typing import Any
from zlib import crc32

from neo_ros.bags.reading import BagTopic
from neo_ros.errors import BagError
from rosbags.interfaces import (
    Connection, MessageDefinitionFormat, Qos, QosDurability, QosHistory, QosLiveliness,
    QosReliability, QosTime)
from rosbags.rosbag2 import CompressionFormat, CompressionMode, StoragePlugin, Writer, WriterError
from rosbags.rosbag2.storage_mcap import McapWriter
from rosbags.typesys import get_typestore, Stores

_FOREVER = QosTime(2147483647, 4294967295)
# What static transforms are published with: late subscribers still get them.
LATCHED = Qos(QosHistory.KEEP_LAST, 1, QosReliability.RELIABLE, QosDurability.TRANSIENT_LOCAL,
              _FOREVER, _FOREVER, QosLiveliness.AUTOMATIC, _FOREVER, False)
# Opcode, length, two times and the size stand before it.
_CRC_IN_CHUNK = 1 + 8 + 8 + 8 + 8
_UNKNOWN_DIGEST = 'RIHS01_' + '0' * 64


class _CheckedMcapWriter(McapWriter):
    """Fills in the checksum of every chunk, which rosbags leaves at 0 (none)."""

    def close_chunk(self) -> None:
        checksum, start = crc32(self.chunk.bio.getbuffer()), self.bio.tell()
        super().close_chunk()
        end = self.bio.tell()
        self.bio.seek(start + _CRC_IN_CHUNK)
        self.bio.write(checksum.to_bytes(4, 'little'))
        self.bio.seek(end)


class _CheckedWriter(Writer):
    STORAGE_PLUGINS = {**Writer.STORAGE_PLUGINS, StoragePlugin.MCAP: _CheckedMcapWriter}


class BagWriter:
    """
    A new bag folder with one MCAP file and metadata.yaml, as a context manager.

    Chunks carry checksums; `compressed` packs them with zstd. The folder is made at once: BagError
    when it exists already or cannot be made. When the `with` block ends with an exception, what
    was written stays, without index; BagReader recovers it.
    """

    def __init__(self, path: Path | str, compressed: bool = False) -> None:
        self.path = Path(path)
        self.typestore = get_typestore(Stores.ROS2_JAZZY)
        self._connections: dict[tuple[str, str], Connection] = {}
        try:
            self._writer = _CheckedWriter(
                self.path, version=Writer.VERSION_LATEST, storage_plugin=StoragePlugin.MCAP)
            if compressed:
                self._writer.set_compression(CompressionMode.STORAGE, CompressionFormat.ZSTD)
            self._writer.open()
        except WriterError:
            raise BagError(f'{self.path}: the output exists already; remove it or choose '
                           'another folder') from None
        except OSError as error:
            raise BagError(
                f'{self.path}: cannot write the bag: {error.strerror}') from error

    def __enter__(self) -> 'BagWriter':
        return self

    def __exit__(self, kind: type[BaseException] | None, error: BaseException | None,
                 trace: TracebackType | None) -> None:
        if kind is not None:
            with suppress(OSError):  # A full disk is the likely reason for being here.
                self._writer.abort()
            return
        try:
            self._writer.close()
        except OSError as failure:
            with suppress(OSError):
                self._writer.abort()
            raise BagError(
                f'{self.path}: cannot finish the bag: {failure.strerror}') from failure

    def add_topic(self, name: str, msgtype: str, qos: tuple[Qos, ...] = ()) -> BagTopic:
        """Announce a topic of a type that ROS 2 Jazzy knows."""
        topic = BagTopic(name, msgtype, qos=qos)
        self.copy_topic(topic)
        return topic

    def copy_topic(self, topic: BagTopic) -> None:
        """Announce a topic of another bag with its own definition of the type."""
        key = (topic.name, topic.msgtype)
        if key in self._connections:
            return
        known = topic.msgtype in self.typestore.types
        msgdef, digest = topic.msgdef.data, topic.digest
        if known and topic.msgdef.format is MessageDefinitionFormat.NONE:
            msgdef = self.typestore.generate_msgdef(topic.msgtype, ros_version=2)[0]
        if known and not digest:
            digest = self.typestore.hash_rihs01(topic.msgtype)
        self._connections[key] = self._writer.add_connection(
            topic.name, topic.msgtype, msgdef=msgdef, rihs01=digest or _UNKNOWN_DIGEST,
            offered_qos_profiles=topic.qos)

    def write(self, topic: BagTopic, stamp_ns: int, message: Any) -> None:
        """Encode a message of the writer's `typestore` and write it at its log time."""
        self.write_cdr(topic, stamp_ns, self.typestore.serialize_cdr(message, topic.msgtype))

    def write_cdr(self, topic: BagTopic, stamp_ns: int, cdr: bytes | memoryview) -> None:
        """Write the bytes of a message as they are."""
        try:
            self._writer.write(self._connections[topic.name, topic.msgtype], stamp_ns, cdr)
        except OSError as error:
            raise BagError(
                f'{self.path}: cannot write the bag: {error.strerror}') from error
