"""A topic of a bag: its type, how its messages are encoded, and what a copy of it needs."""
from collections.abc import Iterable, Mapping
from dataclasses import dataclass, field
from importlib.util import find_spec
import re
from typing import Any

from neo_ros.bags.qos import read_qos
from rosbags.interfaces import MessageDefinition, MessageDefinitionFormat, Qos, QosDurability

CDR, JSON, PROTOBUF = 'cdr', 'json', 'protobuf'
# Foxglove's own types, and the ROS type that each is read as.
FOXGLOVE = {
    'CompressedImage': 'sensor_msgs/msg/CompressedImage',
    'RawImage': 'sensor_msgs/msg/Image',
    'CameraCalibration': 'sensor_msgs/msg/CameraInfo',
    'FrameTransform': 'tf2_msgs/msg/TFMessage',
    'FrameTransforms': 'tf2_msgs/msg/TFMessage',
}
_MSG_FORMATS = {'ros2msg': MessageDefinitionFormat.MSG, 'ros2idl': MessageDefinitionFormat.IDL,
                'omgidl': MessageDefinitionFormat.IDL}
_WHAT_TO_DO = {
    'ros1': 'convert the ROS 1 bag that they come from with rosbags-convert',
    PROTOBUF: "of them Foxglove's images, calibrations and transforms are read, with pip install "
              "'neo_ros[foxglove]'",
    JSON: "of them only Foxglove's images, calibrations and transforms are read",
}


@dataclass(frozen=True)
class Channel:
    """What a file says of a channel, word for word; a copy says the same."""

    schema: str
    schema_encoding: str
    schema_data: bytes
    metadata: Mapping[str, str]


@dataclass(frozen=True)
class BagTopic:
    """
    A topic of one type in a bag, with all that is needed to copy it into another bag.

    msgtype   the ROS type that its messages are read as; where they cannot be read, the recorded
              name of the type and the encoding, such as 'sensor_msgs/Image as ros1'
    encoding  of the messages: cdr for ROS 2, else json, protobuf, ros1 or any other word
    channel   what an MCAP file says of it; None for other bags and new topics
    """

    name: str
    msgtype: str
    count: int = field(default=0, compare=False)
    msgdef: MessageDefinition = field(
        default=MessageDefinition(MessageDefinitionFormat.NONE, ''), compare=False, repr=False)
    digest: str = field(default='', compare=False, repr=False)
    qos: tuple[Qos, ...] = field(default=(), compare=False, repr=False)
    encoding: str = CDR
    channel: Channel | None = field(default=None, compare=False, repr=False)

    @property
    def latched(self) -> bool:
        """Whether late subscribers get what was sent before."""
        return self.name == '/tf_static' or any(
            qos.durability is QosDurability.TRANSIENT_LOCAL for qos in self.qos)

    @property
    def recorded_type(self) -> str:
        """The type as a user should see it: where it is no ROS 2 type, with its encoding."""
        if self.encoding == CDR or self.channel is None:
            return self.msgtype
        return _foreign_type(self.channel.schema, self.encoding)

    @property
    def unread(self) -> str:
        """Why the messages cannot be read, and what to do; empty where they can."""
        if self.encoding == CDR or self.msgtype in FOXGLOVE.values():
            return ''
        advice = _WHAT_TO_DO.get(self.encoding, 'only ROS 2 messages (cdr) are')
        return f'{self.encoding or "unnamed"} messages are not read: {advice}'


def describe_topics(topics: Iterable[BagTopic]) -> str:
    """List topics with their types for an error message."""
    return ', '.join(f'{topic.name} ({topic.recorded_type})' for topic in topics) or 'no topics'


def describe_unread(topics: Iterable[BagTopic]) -> str:
    """Say which topics cannot be read and what to do about them; empty where all can."""
    found: dict[str, list[BagTopic]] = {}
    for topic in topics:
        if topic.unread and topic.count:
            found.setdefault(topic.unread, []).append(topic)
    return '; '.join(f'{describe_topics(entries)}: {reason}' for reason, entries in found.items())


def topic_of_channel(name: str, encoding: str, channel: Channel, count: int,
                     listed: Mapping[str, Any]) -> BagTopic:
    """Return the topic of an MCAP channel; `listed` is its entry in metadata.yaml."""
    about = channel.metadata
    qos = read_qos(about.get('offered_qos_profiles') or listed.get('offered_qos_profiles') or '')
    if encoding != CDR:
        return BagTopic(name, _ros_type(channel.schema, encoding), count, qos=qos,
                        encoding=encoding, channel=channel)
    digest = about.get('topic_type_hash') or listed.get('type_description_hash') or ''
    return BagTopic(
        name, plain_type(channel.schema), count, _definition(
            channel.schema_encoding, channel.schema_data.decode(errors='replace')),
        str(digest), qos, CDR, channel)


def topic_of_row(row: Mapping[str, Any], count: int, definition: Mapping[str, Any],
                 listed: Mapping[str, Any]) -> BagTopic:
    """Return the topic of a row of sqlite's table; `listed` is its entry in metadata.yaml."""
    name, encoding = row['name'], row['serialization_format']
    qos = read_qos(row.get('offered_qos_profiles') or listed.get('offered_qos_profiles') or '')
    if encoding != CDR:
        return BagTopic(name, _foreign_type(row['type'], encoding), count, qos=qos,
                        encoding=encoding, channel=Channel(row['type'], '', b'', {}))
    digest = row.get('type_description_hash') or listed.get('type_description_hash') or ''
    return BagTopic(
        name, plain_type(row['type']), count, _definition(
            definition.get('encoding', ''), definition.get('encoded_message_definition', '')),
        str(digest), qos)


def plain_type(name: str) -> str:
    """Return a ROS 2 type as 'package/msg/Name', also of DDS's and IDL's ways to write it."""
    plain = name.replace('::', '/').replace('/dds_/', '/')
    if plain != name:
        plain = plain.removesuffix('_')
    return re.sub(r'^(\w+)/(\w+)$', r'\1/msg/\2', plain)


def has_protobuf() -> bool:
    """Say whether the extra that reads protobuf is installed."""
    return find_spec('mcap_protobuf') is not None


def _ros_type(schema: str, encoding: str) -> str:
    """Return the ROS type that messages which are not CDR are read as, or their own name."""
    package, _, name = schema.rpartition('.')
    readable = encoding == JSON or (encoding == PROTOBUF and has_protobuf())
    if package == 'foxglove' and name in FOXGLOVE and readable:
        return FOXGLOVE[name]
    return _foreign_type(schema, encoding)


def _foreign_type(schema: str, encoding: str) -> str:
    return f'{schema or "no type"} as {encoding or "unnamed"}'


def _definition(encoding: str, text: str) -> MessageDefinition:
    kind = _MSG_FORMATS.get(encoding, MessageDefinitionFormat.NONE)
    return MessageDefinition(kind, text if kind is not MessageDefinitionFormat.NONE else '')
