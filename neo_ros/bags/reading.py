"""Read rosbag2 bags (MCAP or sqlite3), also those that were cut off."""
from collections.abc import Collection, Iterable, Iterator
from dataclasses import dataclass, field, replace
from pathlib import Path
import re
from types import TracebackType
from typing import Any

from neo_ros.bags.salvage import SalvagedMcap
from neo_ros.errors import BagError
from rosbags.interfaces import (
    Connection, ConnectionExtRosbag2, MessageDefinition, MessageDefinitionFormat, Qos)
from rosbags.rosbag2 import Reader
from rosbags.rosbag2.metadata import parse_qos
from rosbags.typesys import get_types_from_msg, get_typestore, Stores
from rosbags.typesys.store import Typestore

MCAP, SQLITE = '.mcap', '.db3'
_MSG_FORMATS = {'ros2msg': MessageDefinitionFormat.MSG, 'ros2idl': MessageDefinitionFormat.IDL}


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

    Takes a rosbag2 folder with or without metadata.yaml, a bare .mcap or a bare .db3. An MCAP
    file without its end, as a crash leaves it, gives all whole messages before the cut;
    `recovered` then says how many and where. Raises BagError for everything else.
    """

    def __init__(self, path: Path | str) -> None:
        self.path = Path(path)
        self.recovered = ''
        self._typestore = get_typestore(Stores.ROS2_JAZZY)
        self._readers: list[Reader] = []
        self._sources: list[Reader | SalvagedMcap] = []
        try:
            self._open()
        except BaseException:
            self.close()
            raise
        merged: dict[BagTopic, BagTopic] = {}
        for source in self._sources:
            for topic in _topics_of(source).values():
                known = merged.get(topic)
                merged[topic] = topic if known is None else replace(
                    known, count=known.count + topic.count)
        self.topics = sorted(merged.values(), key=lambda topic: (topic.name, topic.msgtype))

    def __enter__(self) -> 'BagReader':
        return self

    def __exit__(self, kind: type[BaseException] | None, error: BaseException | None,
                 trace: TracebackType | None) -> None:
        self.close()

    def close(self) -> None:
        """Close all files."""
        while self._readers:
            self._readers.pop().close()

    @property
    def message_count(self) -> int:
        """How many messages can be read."""
        return sum(topic.count for topic in self.topics)

    def find_topic(self, name: str, msgtype: str) -> BagTopic:
        """Return a topic; raises BagError that lists what the bag has instead."""
        for topic in self.topics:
            if (topic.name, topic.msgtype) == (name, msgtype):
                return topic
        raise BagError(f'{self.path}: expected a topic {name} of type {msgtype}, the bag has '
                       f'{describe_topics(self.topics)}')

    def messages(self, names: Collection[str] | None = None) -> Iterator[BagMessage]:
        """Yield the messages of the named topics, or of all, in the order of the bag."""
        for source in self._sources:
            topics = {key: topic for key, topic in _topics_of(source).items()
                      if names is None or topic.name in names}
            count = 0
            try:
                for key, stamp_ns, cdr in _messages_of(source, topics):
                    yield BagMessage(topics[key], stamp_ns, bytes(cdr), self._typestore)
                    count += 1
            except BagError:
                raise
            except Exception as error:  # Damaged chunks end in whatever error comes first.
                raise BagError(f'{source.path}: damaged after {count} messages: '
                               f'{error!r}') from error

    def _open(self) -> None:
        if not self.path.exists():
            raise BagError(f'{self.path}: no such bag')
        if (self.path / 'metadata.yaml').is_file() and self._open_indexed(self.path) is None:
            return
        for file in _storage_files(self.path):
            error = self._open_indexed(file)
            if error is None:
                continue
            if file.suffix != MCAP:
                raise BagError(f'{file}: not a readable sqlite3 bag: {error}') from error
            salvaged = SalvagedMcap(file)
            self._sources.append(salvaged)
            if salvaged.cut_at is not None:
                self.recovered += (f'{file.name}: {salvaged.message_count} messages recovered, '
                                   f'cut at byte {salvaged.cut_at}\n')
        self.recovered = self.recovered.strip()
        if self.recovered and not any(map(_topics_of, self._sources)):
            raise BagError(f'{self.path}: nothing could be recovered, {self.recovered}')

    def _open_indexed(self, path: Path) -> Exception | None:
        """Open an undamaged bag or file, or return why that cannot be."""
        try:
            reader = Reader(path)
            reader.open()
        except Exception as error:  # Garbage makes rosbags raise nearly anything.
            return error
        self._readers.append(reader)
        self._sources.append(reader)
        return None


def describe_topics(topics: Iterable[BagTopic]) -> str:
    """List topics with their types for an error message."""
    return ', '.join(f'{topic.name} ({topic.msgtype})' for topic in topics) or 'no topics'


def _storage_files(path: Path) -> list[Path]:
    if path.is_file():
        if path.suffix not in (MCAP, SQLITE):
            raise BagError(f'{path}: expected a bag folder, a {MCAP} or a {SQLITE} file')
        return [path]
    for suffix in (MCAP, SQLITE):
        # bag_2.mcap comes before bag_10.mcap.
        files = sorted(path.glob(f'*{suffix}'), key=lambda file: [
            int(part) if part.isdigit() else part for part in re.split(r'(\d+)', file.name)])
        if files:
            return files
    raise BagError(f'{path}: expected a rosbag2 folder, there is no {MCAP} or {SQLITE} in it')


def _topics_of(source: Reader | SalvagedMcap) -> dict[int, BagTopic]:
    """Return the topics by connection or channel id."""
    if isinstance(source, Reader):
        return {connection.id: _topic_of_connection(connection)
                for connection in source.connections}
    topics = {}
    for channel in source.channels.values():
        schema = source.schemas.get(channel.schema_id)
        if schema is None or channel.message_encoding != 'cdr':
            continue
        msgdef = MessageDefinition(
            _MSG_FORMATS.get(schema.encoding, MessageDefinitionFormat.NONE),
            schema.data.decode(errors='replace'))
        qos = tuple(parse_qos(channel.metadata.get('offered_qos_profiles', '')) or ())
        topics[channel.id] = BagTopic(
            channel.topic, schema.name, source.counts[channel.id], msgdef,
            channel.metadata.get('topic_type_hash', ''), qos)
    return topics


def _topic_of_connection(connection: Connection) -> BagTopic:
    assert isinstance(connection.ext, ConnectionExtRosbag2)
    return BagTopic(connection.topic, connection.msgtype, connection.msgcount, connection.msgdef,
                    connection.digest, tuple(connection.ext.offered_qos_profiles))


def _messages_of(source: Reader | SalvagedMcap,
                 topics: Collection[int]) -> Iterator[tuple[int, int, bytes]]:
    if isinstance(source, SalvagedMcap):
        yield from (message for message in source.messages() if message[0] in topics)
        return
    connections = [entry for entry in source.connections if entry.id in topics]
    if connections:  # rosbags takes an empty list for all topics.
        for connection, stamp_ns, cdr in source.messages(connections):
            yield connection.id, stamp_ns, cdr
