"""A bag and its replay agree message for message in all that was not replaced."""
import json
import math
from pathlib import Path
from typing import Any

from bag_files import START_NS, STRING, string_cdr, write_walk_bag
from camera_bags import as_sqlite
from mcap.reader import make_reader
from mcap.writer import Writer as McapWriter
from neo_ros.bags import BagReader, replay
from neo_ros.bags.bag_info import read_bag_info
from neo_ros.bags.replay_outputs import DIAGNOSTICS
from neo_ros.cli.main import app
from neo_ros.errors import BagError
from neo_ros.geometry import Intrinsics, ViewExpansion
from neo_ros.runtime import FovExtrapolator
import pytest
from tiny_model import write_tiny_model
from typer.testing import CliRunner

EXPANSION = ViewExpansion.to_size(Intrinsics.from_hfov(32, 24, math.pi / 2), 64, 48)
WIDE = '/camera/wide/'
STATE = b'{"mode": "auto"}'


@pytest.fixture(scope='module')
def extrapolator(tmp_path_factory) -> FovExtrapolator:
    path = tmp_path_factory.mktemp('model') / 'm.onnx'
    return FovExtrapolator.load(write_tiny_model(path, EXPANSION), threads=1)


def _write_mixed(path: Path) -> Path:
    """Write all of a walk beside messages of other kinds, an attachment and metadata."""
    with BagReader(write_walk_bag(path.parent / 'walk', EXPANSION, 4)) as bag, path.open(
            'wb') as file:
        writer = McapWriter(file)
        writer.start(profile='ros2')
        state = writer.register_channel('/state', 'json', writer.register_schema(
            'pkg.State', 'jsonschema', b'{"type": "object"}'))
        bare = writer.register_channel('/bare', 'json', 0, {'of': 'nobody'})
        old = writer.register_channel('/old', 'ros1', writer.register_schema(
            'std_msgs/String', 'ros1msg', b'string data'))
        # The same type by DDS's name, with the time of sending apart from the log time.
        plain = writer.register_channel('/text', 'cdr', writer.register_schema(
            'std_msgs::msg::dds_::String_', 'ros2msg', b'string data'))
        channels: dict[Any, int] = {}
        for number, message in enumerate(bag.messages()):
            topic, stamp = message.topic, message.stamp_ns
            assert topic.channel is not None
            if topic not in channels:
                channels[topic] = writer.register_channel(
                    topic.name, 'cdr', writer.register_schema(
                        topic.channel.schema, 'ros2msg', topic.channel.schema_data),
                    dict(topic.channel.metadata))
            writer.add_message(channels[topic], stamp, message.cdr, stamp - 5, number)
            writer.add_message(state, stamp, STATE, stamp - 7, number)
            writer.add_message(plain, stamp + 1, string_cdr(f'{number}'), stamp, number)
        writer.add_message(bare, START_NS + 9, b'null', START_NS + 8)
        writer.add_message(old, START_NS + 9, b'\x00\x00\x00\x00', START_NS + 8)
        writer.add_attachment(START_NS, START_NS + 1, 'calibration.yaml', 'text/yaml', b'fx: 60')
        writer.add_metadata('robot', {'name': 'Karl'})
        writer.finish()
    return path


def _messages(path: Path) -> list[tuple[Any, ...]]:
    # What the replay itself says of the camera is not of the input.
    with BagReader(path) as bag:
        return [(message.topic.name, message.topic.recorded_type, message.topic.encoding,
                 message.topic.qos, message.topic.digest, message.topic.msgdef,
                 message.stamp_ns, message.publish_ns, message.sequence, message.cdr)
                for message in bag.messages() if not message.topic.name.startswith(WIDE)
                and message.topic.name != DIAGNOSTICS
                or message.topic.name == f'{WIDE}image_raw']


def _beside(path: Path) -> tuple[list[Any], list[Any]]:
    with BagReader(path) as bag:
        return list(bag.attachments()), list(bag.metadata())


@pytest.mark.parametrize('kind', ['mcap', 'sqlite', 'mixed'])
def test_a_replay_keeps_all_that_it_does_not_replace(
        tmp_path: Path, kind: str, extrapolator: FovExtrapolator) -> None:
    if kind == 'mixed':
        path = _write_mixed(tmp_path / 'mixed.mcap')
    else:
        path = write_walk_bag(tmp_path / 'walk', EXPANSION, 4)
        path = as_sqlite(path, tmp_path / 'db') if kind == 'sqlite' else path
    replay(path, extrapolator, tmp_path / 'out')
    before = _messages(path)
    assert _messages(tmp_path / 'out') == before
    assert _beside(tmp_path / 'out') == _beside(path)
    names = {message[0] for message in before}
    assert ('/state' in names) == (kind == 'mixed') and '/camera/image_raw' in names
    assert len(_beside(path)[0]) == len(_beside(path)[1]) == (kind == 'mixed')


def test_a_copied_channel_is_told_word_for_word(
        tmp_path: Path, extrapolator: FovExtrapolator) -> None:
    path = _write_mixed(tmp_path / 'mixed.mcap')
    replay(path, extrapolator, tmp_path / 'out')
    found = []
    for file in (path, tmp_path / 'out' / 'out.mcap'):
        with file.open('rb') as content:
            summary = make_reader(content, validate_crcs=True).get_summary()
            assert summary is not None
            found.append({
                channel.topic: (channel.message_encoding, channel.metadata, schema and (
                    schema.name, schema.encoding, schema.data))
                for channel in summary.channels.values()
                for schema in [summary.schemas.get(channel.schema_id)]})
    assert {name: found[1][name] for name in found[0]} == found[0]
    assert found[0]['/bare'] == ('json', {'of': 'nobody'}, None)


def test_words_of_the_recorder_are_kept(tmp_path: Path, extrapolator: FovExtrapolator) -> None:
    path = write_walk_bag(tmp_path / 'walk', EXPANSION, 2)
    file = path / 'metadata.yaml'
    text = file.read_text()
    assert 'custom_data: null' in text
    file.write_text(text.replace('custom_data: null', 'custom_data: {operator: Ann}'))
    replay(path, extrapolator, tmp_path / 'out')
    with BagReader(tmp_path / 'out') as bag:
        assert bag.custom_data == {'operator': 'Ann'}


def test_other_encodings_are_listed_and_counted(tmp_path: Path) -> None:
    path = _write_mixed(tmp_path / 'mixed.mcap')
    info = read_bag_info(path)
    topics = {topic.name: topic for topic in info.topics}
    assert info.messages == 3 * len([0 for entry in _messages(path) if entry[0] == '/state']) + 2
    assert topics['/state'].msgtype == 'pkg.State as json'
    assert topics['/state'].content.startswith('json messages are not read')
    assert topics['/old'].msgtype == 'std_msgs/String as ros1'
    assert 'rosbags-convert' in topics['/old'].content
    assert topics['/bare'].msgtype == 'no type as json' and topics['/bare'].count == 1
    assert topics['/text'].msgtype == STRING
    result = CliRunner().invoke(app, ['bag-info', str(path), '--json'])
    assert json.loads(result.output)['messages'] == info.messages


def test_names_of_types_are_read_however_they_are_written(tmp_path: Path) -> None:
    path = _write_mixed(tmp_path / 'mixed.mcap')
    with BagReader(path) as bag:
        texts = [message.read().data for message in bag.messages(['/text'])]
    assert texts == [str(number) for number in range(len(texts))] and len(texts) > 9


def test_images_of_ros_1_are_named_where_a_camera_is_wanted(tmp_path, extrapolator) -> None:
    with (tmp_path / 'old.mcap').open('wb') as file:
        writer = McapWriter(file)
        writer.start(profile='ros1')
        channel = writer.register_channel('/eye', 'ros1', writer.register_schema(
            'sensor_msgs/CompressedImage', 'ros1msg', b''))
        writer.add_message(channel, START_NS, b'', START_NS)
        writer.finish()
    with pytest.raises(BagError, match='expected camera images, got /eye .*ros1 messages are not '
                                       'read: convert .* with rosbags-convert'):
        replay(tmp_path / 'old.mcap', extrapolator, tmp_path / 'out')
