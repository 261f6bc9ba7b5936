"""Read rosbag2 bags (MCAP or sqlite3), also those that were cut off or damaged."""
from collections import Counter
from collections.abc import Collection, Iterable, Iterator
from contextlib import ExitStack
from dataclasses import dataclass, field, replace
from pathlib import Path
from types import TracebackType
from typing import Any

from neo_ros.bags.bag_folder import BagFolder, MCAP, plain_name, read_bag_folder, unpacked
from neo_ros.bags.damage import Damage
from neo_ros.bags.mcap_file import McapFile
from neo_ros.bags.mcap_records import MAX_CHUNK_BYTES
from neo_ros.bags.sqlite_file import SqliteFile
from neo_ros.errors import BagError
from rosbags.interfaces import MessageDefinition, MessageDefinitionFormat, Qos, QosDurability
from rosbags.rosbag2.metadata import parse_qos
from rosbags.typesys import get_types_from_msg, get_typestore, Stores
from rosbags.typesys.store import Typestore
import zstandard

FOREVER_NS = 1 << 64
_MSG_FORMATS = {'ros2msg': MessageDefinitionFormat.MSG, 'ros2idl': MessageDefinitionFormat.IDL,
                'omgidl': MessageDefinitionFormat.IDL}


@dataclass(frozen=True)
class BagTopic:
    """A topic of one type in a bag, with all that is needed to copy it into another bag."""

    name: str
    msgtype: str
    count: int = field(default=0, compare=False)
    msgdef: MessageDefinition = field(
        default=MessageDefinition(MessageDefinitionFormat.NONE, ''), compare=False, repr=False)
    digest: str = field(default='', compare=False, repr=False)
    qos: tuple[Qos, ...] = field(default=(), compare=False, repr=False)

    @property
    def latched(self) -> bool:
        """Whether late subscribers get what was sent before."""
        return self.name == '/tf_static' or any(
            qos.durability is QosDurability.TRANSIENT_LOCAL for qos in self.qos)


@dataclass(frozen=True)
class BagMessage:
    """One message: its topic, its log time in ns and its bytes; decoded only when asked."""

    topic: BagTopic
    stamp_ns: int
    cdr: bytes
    typestore: Typestore = field(repr=False)

    def read(self) -> Any:
        """Decode the message; raises BagError when the bytes do not fit the type."""
        topic = self.topic
        try:
            if topic.msgtype not in self.typestore.types:
                self.typestore.register(get_types_from_msg(topic.msgdef.data, topic.msgtype))
            return self.typestore.deserialize_cdr(self.cdr, topic.msgtype)
        except Exception as error:  # rosbags raises whatever numpy or struct do.
            raise BagError(
                f'{topic.name}: the message at {self.stamp_ns} ns is no {topic.msgtype}: '
                f'{error}') from error


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
        self._typestore = get_typestore(Stores.ROS2_JAZZY)
        self._stack = ExitStack()
        self._files: list[tuple[McapFile | SqliteFile, dict[int, BagTopic]]] = []
        # File, topic and stamp of messages that cannot be unpacked.
        self._packed: set[tuple[str, int, int]] = set()
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
            for key, stamp_ns, cdr in file.messages(
                    topics.keys(), start_ns, stop_ns) if topics else ():
                # Of rosbag2's bags with compressed messages only metadata.yaml says that they are;
                # CDR begins with another byte.
                if cdr[:4] == zstandard.FRAME_HEADER:
                    try:
                        cdr = _unpack_message(cdr)
                    except ValueError:
                        self._packed.add((file.path.name, key, stamp_ns))
                        continue
                yield BagMessage(topics[key], stamp_ns, cdr, self._typestore)

    def _open(self) -> None:
        folder = read_bag_folder(self.path)
        self._lost = [Damage(f'{name} (missing)', 0, count, '')
                      for name, count in folder.missing.items()]
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


def describe_topics(topics: Iterable[BagTopic]) -> str:
    """List topics with their types for an error message."""
    return ', '.join(f'{topic.name} ({topic.msgtype})' for topic in topics) or 'no topics'


def _topics_of(file: McapFile | SqliteFile, folder: BagFolder) -> dict[int, BagTopic]:
    """Return the topics by channel or row id."""
    topics: dict[int, BagTopic] = {}
    if isinstance(file, McapFile):
        for channel in file.channels.values():
            schema = file.schemas.get(channel.schema_id)
            if schema is not None and channel.message_encoding == 'cdr':
                topics[channel.id] = _topic(
                    channel.topic, schema.name, file.counts[channel.id], schema.encoding,
                    schema.data.decode(errors='replace'), channel.metadata, folder)
        return topics
    for key, row in file.topics.items():
        if row['serialization_format'] == 'cdr':
            definition = file.definitions.get(row['type'], {})
            topics[key] = _topic(
                row['name'], row['type'], file.counts[key], definition.get('encoding', ''),
                definition.get('encoded_message_definition', ''), row, folder)
    return topics


def _topic(name: str, msgtype: str, count: int, encoding: str, definition: str,
           about: dict[str, Any], folder: BagFolder) -> BagTopic:
    """Put a topic together; `about` and metadata.yaml name QoS and hash alike."""
    listed = folder.topics.get(name, {})
    qos = about.get('offered_qos_profiles') or listed.get('offered_qos_profiles') or ''
    digest = (about.get('topic_type_hash') or about.get('type_description_hash')
              or listed.get('type_description_hash') or '')
    kind = _MSG_FORMATS.get(encoding, MessageDefinitionFormat.NONE)
    try:
        profiles = tuple(parse_qos(qos))
    except Exception:  # A damaged YAML text; rosbags raises whatever YAML and its enums do.
        profiles = ()
    return BagTopic(name, msgtype, count, MessageDefinition(
        kind, definition if kind is not MessageDefinitionFormat.NONE else ''),
        str(digest), profiles)


def _unpack_message(data: bytes) -> bytes:
    """Unpack one message of a bag whose messages are compressed one by one, else ValueError."""
    try:
        content = zstandard.ZstdDecompressor().stream_reader(data).read(MAX_CHUNK_BYTES + 1)
    except zstandard.ZstdError as error:
        raise ValueError(str(error)) from error
    if len(content) > MAX_CHUNK_BYTES:
        raise ValueError(f'larger than {MAX_CHUNK_BYTES} bytes')
    return content
