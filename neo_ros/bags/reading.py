"""Read rosbag2 bags (MCAP or sqlite3), also those that were cut off or damaged."""
from collections import Counter
from collections.abc import Callable, Collection, Iterator
from contextlib import ExitStack
from dataclasses import dataclass, field, replace
from pathlib import Path
from types import TracebackType
from typing import Any

from mcap.records import Attachment, Metadata
from neo_ros.bags.bag_folder import BagFolder, MCAP, plain_name, read_bag_folder, unpacked
from neo_ros.bags.damage import Damage
from neo_ros.bags.foxglove import reader_of, VIDEO, with_header
from neo_ros.bags.mcap_file import McapFile
from neo_ros.bags.mcap_records import MAX_CHUNK_BYTES
from neo_ros.bags.sqlite_file import SqliteFile
from neo_ros.bags.topic import (
    BagTopic, CDR, Channel, describe_topics, topic_of_channel, topic_of_row)
from neo_ros.errors import BagError
from rosbags.interfaces import MessageDefinitionFormat
from rosbags.typesys import get_types_from_idl, get_types_from_msg, get_typestore, Stores
from rosbags.typesys.store import Typestore
import zstandard

FOREVER_NS = 1 << 64
# Nothing is recorded for so long: where more lies between messages, the clock was set.
LONGEST_GAP_NS = 86_400 * 10 ** 9
# The record in which rosbag2 keeps a copy of metadata.yaml.
ROSBAG2_METADATA = 'rosbag2'
PACKET = 'ffmpeg_image_transport_msgs/msg/FFMPEGPacket'
# Jazzy does not know the types of videos, and sqlite3 bags from before Iron define nothing.
_VIDEO_FIELDS = {
    VIDEO: 'builtin_interfaces/Time timestamp\nstring frame_id\nuint8[] data\nstring format\n',
    PACKET: ('std_msgs/Header header\nint32 width\nint32 height\nstring encoding\n'
             'uint64 pts\nuint8 flags\nbool is_bigendian\nuint8[] data\n'),
}


@dataclass(frozen=True)
class BagMessage:
    """
    One message; decoded only when asked.

    cdr         its bytes as they were recorded, in the encoding of the topic
    publish_ns  when it was sent; the log time where the bag does not tell
    sequence    its number by its publisher; 0 where the bag does not tell
    """

    topic: BagTopic
    stamp_ns: int
    cdr: bytes
    decoder: '_Decoder' = field(repr=False)
    publish_ns: int = 0
    sequence: int = 0

    def read(self) -> Any:
        """
        Decode the message; Foxglove's get the fields of the ROS message.

        Raises BagError when the bytes do not fit the type, or the type is not read.
        """
        topic = self.topic
        if topic.unread:
            raise BagError(f'{describe_topics([topic])}: {topic.unread}')
        try:
            return self.decoder.read(topic, self.cdr)
        except BagError:
            raise
        except Exception as error:  # The decoders raise whatever numpy or struct do.
            raise BagError(
                f'{topic.name}: the message at {self.stamp_ns} ns is no {topic.recorded_type}: '
                f'{error}') from error


class _Decoder:
    """Decodes the messages of one bag; what it learned of a type is kept."""

    def __init__(self) -> None:
        self._typestore: Typestore = get_typestore(Stores.ROS2_JAZZY)
        self._foxglove: dict[BagTopic, Callable[[bytes], Any]] = {}

    def read(self, topic: BagTopic, data: bytes) -> Any:
        if topic.encoding != CDR:
            return self._read_foxglove(topic, data)
        if topic.msgtype not in self._typestore.types:
            kind, fields = topic.msgdef.format, topic.msgdef.data
            if not fields:  # A copy of such a bag has an empty definition.
                fields = _VIDEO_FIELDS.get(topic.msgtype, '')
            if not fields and kind is MessageDefinitionFormat.NONE:
                raise BagError(f'{topic.name}: the bag holds no definition of {topic.msgtype}')
            self._typestore.register(
                get_types_from_idl(fields) if kind is MessageDefinitionFormat.IDL
                else get_types_from_msg(fields, topic.msgtype))
        message = self._typestore.deserialize_cdr(data, topic.msgtype)
        return with_header(message) if topic.msgtype == VIDEO else message

    def _read_foxglove(self, topic: BagTopic, data: bytes) -> Any:
        assert topic.channel is not None
        read = self._foxglove.get(topic)
        if read is None:
            read = self._foxglove[topic] = reader_of(topic.encoding, topic.channel)
        return read(data)


class BagReader:
    """
    A bag to iterate over, as a context manager.

    Takes a rosbag2 folder with or without metadata.yaml, a bare .mcap or a bare .db3, compressed
    in any of rosbag2's ways. What can be read of a cut-off or damaged bag is read; `damages`
    says how much is lost, exactly so once all messages were read. Raises BagError for everything
    else. The iterators may run in another thread than the one that opened the bag.
    """

    def __init__(self, path: Path | str) -> None:
        self.path = Path(path)
        self._decoder = _Decoder()
        self._stack = ExitStack()
        self._files: list[tuple[McapFile | SqliteFile, dict[int, BagTopic]]] = []
        # File, topic and stamp of messages that cannot be unpacked.
        self._packed: set[tuple[str, int, int]] = set()
        self._first: dict[BagTopic, Any] = {}
        try:
            self._open()
        except BaseException:
            self.close()
            raise

    def __enter__(self) -> 'BagReader':
        return self

    def __exit__(self, kind: type[BaseException] | None, error: BaseException | None,
                 trace: TracebackType | None) -> None:
        self.close()

    def close(self) -> None:
        """Close all files."""
        self._stack.close()

    @property
    def message_count(self) -> int:
        """How many messages there are, as far as is known before they are read."""
        return sum(topic.count for topic in self.topics)

    @property
    def damages(self) -> list[Damage]:
        """What was lost, a line per damaged file, as far as the bag was read."""
        packed = Counter(name for name, _, _ in self._packed)
        return [*(file.damage for file, _ in self._files if file.damage is not None), *self._lost,
                *(Damage(f'{file.path.name} (messages that cannot be unpacked)',
                         file.counts.total() - count, count, '')
                  for file, _ in self._files if (count := packed[file.path.name]))]

    @property
    def recovered(self) -> str:
        """The damages as text, a line each; empty for a bag that is whole."""
        return '\n'.join(map(str, self.damages))

    @property
    def span_ns(self) -> tuple[int, int]:
        """First and last log time; raises BagError for a bag without messages."""
        spans = [span for file, _ in self._files if (span := file.span_ns) is not None]
        if not spans:
            raise BagError(f'{self.path}: expected messages, the bag has none')
        return min(first for first, _ in spans), max(last for _, last in spans)

    def messages(self, names: Collection[str] | None = None, start_ns: int = 0,
                 stop_ns: int = FOREVER_NS) -> Iterator[BagMessage]:
        """
        Yield the messages of the named topics, or of all, in the order of the bag.

        Only those with a log time in [start_ns, stop_ns).
        """
        for file, all_topics in self._files:
            topics = {key: topic for key, topic in all_topics.items()
                      if names is None or topic.name in names}
            for key, stamp_ns, cdr, publish_ns, sequence in _entries(
                    file, topics.keys(), start_ns, stop_ns) if topics else ():
                # Of rosbag2's bags with compressed messages only metadata.yaml says that they are;
                # CDR begins with another byte.
                if cdr[:4] == zstandard.FRAME_HEADER and topics[key].encoding == CDR:
                    try:
                        cdr = _unpack_message(cdr)
                    except ValueError:
                        self._packed.add((file.path.name, key, stamp_ns))
                        continue
                yield BagMessage(topics[key], stamp_ns, cdr, self._decoder, publish_ns, sequence)

    def attachments(self) -> Iterator[Attachment]:
        """Yield the files that MCAP files carry beside the messages."""
        for file, _ in self._files:
            if isinstance(file, McapFile):
                yield from file.attachments()

    def metadata(self) -> Iterator[Metadata]:
        """Yield the metadata records of MCAP files, without the one that rosbag2 makes itself."""
        for file, _ in self._files:
            if isinstance(file, McapFile):
                yield from (record for record in file.metadata()
                            if record.name != ROSBAG2_METADATA)

    def first(self, topic: BagTopic) -> Any:
        """Return the first message of a topic that can be decoded; None where none can."""
        if topic not in self._first:
            self._first[topic] = self._find_first(topic)
        return self._first[topic]

    def _find_first(self, topic: BagTopic) -> Any:
        for message in self.messages([topic.name]):
            if message.topic == topic:
                try:
                    return message.read()
                except BagError:
                    continue
        return None

    def _open(self) -> None:
        folder = read_bag_folder(self.path)
        self.custom_data = folder.custom_data
        self._lost = [Damage(f'{name} (missing)', 0, count, '')
                      for name, count in folder.missing.items()]
        self._lost += [Damage(name, 0, 0, '', 'not of this bag, as metadata.yaml does not list '
                              'it, and is not read; to read it, give this file as the bag')
                       for name in folder.foreign]
        for path in folder.files:
            try:
                self._open_file(path, folder)
            except BagError as error:
                if len(folder.files) == 1:
                    raise
                # One of several: the others are read.
                count = folder.counts.get(plain_name(path.name))
                self._lost.append(Damage(f'{path.name} ({error})', 0, count, ''))
        merged: dict[BagTopic, BagTopic] = {}
        for _, topics in self._files:
            for topic in topics.values():
                known = merged.get(topic)
                merged[topic] = topic if known is None else replace(
                    known, count=known.count + topic.count)
        self.topics = sorted(merged.values(), key=lambda topic: (topic.name, topic.msgtype))
        if self.damages and not self.message_count:
            raise BagError(f'{self.path}: nothing could be recovered, {self.recovered}')

    def _open_file(self, packed: Path, folder: BagFolder) -> None:
        path = unpacked(packed, self._stack)
        kind = McapFile if path.suffix == MCAP else SqliteFile
        try:
            file = kind(path, folder.counts.get(path.name))
        except OSError as error:
            raise BagError(f'{path}: cannot read the bag: {error.strerror}') from error
        self._stack.callback(file.close)
        self._files.append((file, _topics_of(file, folder)))


def _entries(file: McapFile | SqliteFile, keys: Collection[int], start_ns: int,
             stop_ns: int) -> Iterator[tuple[int, int, bytes, int, int]]:
    """Yield (channel or row id, log time, bytes, publish time, sequence) of a file's messages."""
    if isinstance(file, McapFile):
        for message in file.messages(keys, start_ns, stop_ns):
            yield (message.channel, message.stamp_ns, message.data, message.publish_ns,
                   message.sequence)
    else:
        for key, stamp_ns, cdr in file.messages(keys, start_ns, stop_ns):
            yield key, stamp_ns, cdr, stamp_ns, 0


def _topics_of(file: McapFile | SqliteFile, folder: BagFolder) -> dict[int, BagTopic]:
    """Return the topics by channel or row id."""
    if isinstance(file, SqliteFile):
        return {key: topic_of_row(row, file.counts[key], file.definitions.get(row['type'], {}),
                                  folder.topics.get(row['name'], {}))
                for key, row in file.topics.items()}
    topics: dict[int, BagTopic] = {}
    counts = file.counts  # A sum over all chunks, which may be many.
    for found in file.channels.values():
        schema = file.schemas.get(found.schema_id)
        # Channels without a schema have the id 0; what is lost by damage tells no type.
        if schema is None and found.schema_id:
            continue
        channel = Channel('', '', b'', found.metadata) if schema is None else Channel(
            schema.name, schema.encoding, schema.data, found.metadata)
        topics[found.id] = topic_of_channel(
            found.topic, found.message_encoding, channel, counts[found.id],
            folder.topics.get(found.topic, {}))
    return topics


def _unpack_message(data: bytes) -> bytes:
    """Unpack one message of a bag whose messages are compressed one by one, else ValueError."""
    try:
        content = zstandard.ZstdDecompressor().stream_reader(data).read(MAX_CHUNK_BYTES + 1)
    except zstandard.ZstdError as error:
        raise ValueError(str(error)) from error
    if len(content) > MAX_CHUNK_BYTES:
        raise ValueError(f'larger than {MAX_CHUNK_BYTES} bytes')
    return content
