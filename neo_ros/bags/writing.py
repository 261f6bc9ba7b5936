"""Write rosbag2 bags (MCAP) that `ros2 bag play` accepts."""
from collections import Counter
from collections.abc import Iterator, Mapping
from contextlib import contextmanager, suppress
from pathlib import Path
from types import TracebackType
from typing import Any

from mcap.records import Attachment, Metadata
from mcap.writer import CompressionType, Writer
from neo_ros.bags.qos import qos_entries, qos_text
from neo_ros.bags.reading import BagMessage, ROSBAG2_METADATA
from neo_ros.bags.topic import BagTopic, Channel
from neo_ros.errors import BagError
from rosbags.interfaces import MessageDefinitionFormat, Qos
from rosbags.typesys import get_typestore, Stores
import yaml

_UNKNOWN_DIGEST = 'RIHS01_' + '0' * 64
_METADATA_VERSION = 9
_Key = tuple[str, str, str]


class BagWriter:
    """
    A new bag folder with one MCAP file and metadata.yaml, as a context manager.

    Chunks carry checksums; `compressed` packs them with zstd. `custom_data` are words for
    metadata.yaml. The folder is made at once: BagError when it exists already or cannot be made.
    When the `with` block ends with an exception, what was written stays, without index;
    BagReader recovers it.
    """

    def __init__(self, path: Path | str, compressed: bool = False,
                 custom_data: Mapping[str, str] | None = None) -> None:
        self.path = Path(path)
        self.typestore = get_typestore(Stores.ROS2_JAZZY)
        self._custom_data = dict(custom_data or {})
        self._topics: dict[_Key, BagTopic] = {}
        self._channels: dict[_Key, int] = {}
        self._schemas: dict[tuple[str, str, bytes], int] = {}
        self._counts: Counter[_Key] = Counter()
        self._first_ns, self._last_ns = 0, 0
        try:
            self.path.mkdir(parents=True)
        except FileExistsError:
            raise BagError(f'{self.path}: the output exists already; remove it or choose '
                           'another folder') from None
        except OSError as error:
            raise BagError(f'{self.path}: cannot write the bag: {error.strerror}') from error
        with self._told():
            self._file = (self.path / f'{self.path.name}.mcap').open('xb')
            self._writer = Writer(self._file, compression=(
                CompressionType.ZSTD if compressed else CompressionType.NONE))
            self._writer.start(profile='ros2', library='neo_ros')

    def __enter__(self) -> 'BagWriter':
        return self

    def __exit__(self, kind: type[BaseException] | None, error: BaseException | None,
                 trace: TracebackType | None) -> None:
        if kind is not None:
            with suppress(OSError):  # A full disk is the likely reason for being here.
                self._writer.flush()
            with suppress(OSError):
                self._file.close()
            return
        try:
            self._finish()
        except OSError as failure:
            with suppress(OSError):
                self._file.close()
            raise BagError(
                f'{self.path}: cannot finish the bag: {failure.strerror}') from failure

    def add_topic(self, name: str, msgtype: str, qos: tuple[Qos, ...] = ()) -> BagTopic:
        """Announce a topic of a type that ROS 2 Jazzy knows."""
        topic = BagTopic(name, msgtype, qos=qos)
        self.copy_topic(topic)
        return topic

    def copy_topic(self, topic: BagTopic) -> None:
        """Announce a topic of another bag, whatever its messages are, with its own definition."""
        key = _key(topic)
        if key in self._channels:
            return
        channel = topic.channel or self._new_channel(topic)
        schema_id = 0
        with self._told():
            if channel.schema or channel.schema_data:
                schema = (channel.schema, channel.schema_encoding, channel.schema_data)
                if schema not in self._schemas:
                    self._schemas[schema] = self._writer.register_schema(*schema)
                schema_id = self._schemas[schema]
            self._channels[key] = self._writer.register_channel(
                topic.name, topic.encoding, schema_id, dict(channel.metadata))
        self._topics[key] = topic

    def write(self, topic: BagTopic, stamp_ns: int, message: Any) -> None:
        """Encode a message of the writer's `typestore` and write it at its log time."""
        self.write_cdr(topic, stamp_ns, self.typestore.serialize_cdr(message, topic.msgtype))

    def write_cdr(self, topic: BagTopic, stamp_ns: int, cdr: bytes | memoryview,
                  publish_ns: int | None = None, sequence: int = 0) -> None:
        """Write the bytes of a message as they are; without `publish_ns` it is the log time."""
        key = _key(topic)
        if not self._counts:
            self._first_ns = stamp_ns
        self._first_ns = min(self._first_ns, stamp_ns)
        self._last_ns = max(self._last_ns, stamp_ns)
        self._counts[key] += 1
        with self._told():
            self._writer.add_message(
                self._channels[key], stamp_ns, cdr,  # type: ignore[arg-type]
                stamp_ns if publish_ns is None else publish_ns, sequence)

    def copy(self, message: BagMessage, stamp_ns: int) -> None:
        """Write a message of another bag at a log time, and else as it is."""
        self.write_cdr(message.topic, stamp_ns, message.cdr, message.publish_ns, message.sequence)

    def add_attachment(self, found: Attachment) -> None:
        """Write a file beside the messages."""
        with self._told():
            self._writer.add_attachment(
                found.create_time, found.log_time, found.name, found.media_type, found.data)

    def add_metadata(self, found: Metadata) -> None:
        """Write a metadata record beside the messages."""
        with self._told():
            self._writer.add_metadata(found.name, found.metadata)

    @contextmanager
    def _told(self) -> Iterator[None]:
        try:
            yield
        except OSError as error:
            raise BagError(f'{self.path}: cannot write the bag: {error.strerror}') from error

    def _new_channel(self, topic: BagTopic) -> Channel:
        """Return the channel of a topic that is new or comes from sqlite3."""
        known = topic.msgtype in self.typestore.types
        definition, idl = topic.msgdef.data, topic.msgdef.format is MessageDefinitionFormat.IDL
        if known and topic.msgdef.format is MessageDefinitionFormat.NONE:
            definition = self.typestore.generate_msgdef(topic.msgtype, ros_version=2)[0]
        return Channel(topic.msgtype, 'ros2idl' if idl else 'ros2msg', definition.encode(), {
            'offered_qos_profiles': qos_text(topic.qos), 'topic_type_hash': self._digest(topic)})

    def _digest(self, topic: BagTopic) -> str:
        if topic.digest or topic.channel is not None:  # A copy says no more than its source.
            return topic.digest
        known = topic.msgtype in self.typestore.types
        return self.typestore.hash_rihs01(topic.msgtype) if known else _UNKNOWN_DIGEST

    def _finish(self) -> None:
        """Close the file behind its index, and write metadata.yaml."""
        metadata = self._metadata()
        self._writer.add_metadata(
            ROSBAG2_METADATA, {'serialized_metadata': yaml.safe_dump(metadata, sort_keys=False)})
        self._writer.finish()
        self._file.close()
        part = self.path / 'metadata.yaml.tmp'
        part.write_text(yaml.safe_dump(
            {'rosbag2_bagfile_information': metadata}, sort_keys=False), encoding='utf-8')
        part.replace(self.path / 'metadata.yaml')

    def _metadata(self) -> dict[str, Any]:
        """Return what rosbag2 wants to know of the bag."""
        span = {'starting_time': {'nanoseconds_since_epoch': self._first_ns},
                'duration': {'nanoseconds': self._last_ns - self._first_ns},
                'message_count': self._counts.total()}
        file = Path(self._file.name).name
        return {
            'version': _METADATA_VERSION,
            'storage_identifier': 'mcap',
            **span,
            'topics_with_message_count': [
                {'topic_metadata': {
                    'name': topic.name,
                    'type': topic.msgtype if topic.channel is None else topic.channel.schema,
                    'serialization_format': topic.encoding,
                    'offered_qos_profiles': qos_entries(topic.qos),
                    'type_description_hash': self._digest(topic)},
                 'message_count': self._counts[key]} for key, topic in self._topics.items()],
            'compression_format': '',
            'compression_mode': '',
            'relative_file_paths': [file],
            'files': [{'path': file, **span}],
            'custom_data': self._custom_data or None,
            'ros_distro': 'jazzy'}


def _key(topic: BagTopic) -> _Key:
    return topic.name, topic.msgtype, topic.encoding
