"""Bags come back as they were written, in every form that a bag has; the rest is refused."""
from collections import Counter
from pathlib import Path
import shutil
import sqlite3
import tracemalloc
from typing import Any

from bag_files import (
    START_NS, STORE, STRING, string_cdr, texts, write_sqlite_bag, write_text_bag)
from neo_ros.bags import BagReader, BagTopic, BagWriter
from neo_ros.bags.bag_folder import read_bag_folder
from neo_ros.bags.mcap_file import McapFile
from neo_ros.bags.qos import LATCHED
from neo_ros.bags.sqlite_file import _Numbers
from neo_ros.errors import BagError
import pytest
from rosbags.interfaces import MessageDefinition, MessageDefinitionFormat
from rosbags.rosbag2 import CompressionFormat, CompressionMode, Writer
import zstandard

COUNT = 12


def _with_metadata(path: Path) -> Path:
    return write_text_bag(path / 'bag', COUNT)


def _compressed(path: Path) -> Path:
    return write_text_bag(path / 'bag', COUNT, compressed=True)


def _without_metadata(path: Path) -> Path:
    bag = write_text_bag(path / 'bag', COUNT)
    (bag / 'metadata.yaml').unlink()
    return bag


def _bare_mcap(path: Path) -> Path:
    return write_text_bag(path / 'bag', COUNT) / 'bag.mcap'


def _sqlite(path: Path) -> Path:
    return write_sqlite_bag(path / 'bag', COUNT)


def _sqlite_without_metadata(path: Path) -> Path:
    bag = write_sqlite_bag(path / 'bag', COUNT)
    (bag / 'metadata.yaml').unlink()
    return bag


@pytest.mark.parametrize('make', [
    _with_metadata, _compressed, _without_metadata, _bare_mcap, _sqlite,
    _sqlite_without_metadata])
def test_every_form_of_a_bag_gives_the_same_messages(tmp_path: Path, make) -> None:
    with BagReader(make(tmp_path)) as bag:
        assert bag.topics == [BagTopic('/text', STRING)]
        assert bag.message_count == COUNT and bag.topics[0].count == COUNT
        assert bag.recovered == ''
        messages = list(bag.messages())
    assert [message.read().data for message in messages] == texts(COUNT)
    assert [message.stamp_ns for message in messages] == [START_NS + i for i in range(COUNT)]


def test_split_bags_without_metadata_are_read_in_the_order_of_their_numbers(
        tmp_path: Path) -> None:
    folder = tmp_path / 'split'
    folder.mkdir()
    # A superscript is a digit to Python and no number.
    for stamp, name in enumerate(('b_10', 'b_2', 'b_1', 'b_4²5')):
        with BagWriter(tmp_path / name) as writer:
            topic = writer.add_topic('/text', STRING)
            writer.write(topic, stamp, writer.typestore.types[STRING](data=name))
        shutil.move(tmp_path / name / f'{name}.mcap', folder)
    with BagReader(folder) as bag:
        assert [message.read().data for message in bag.messages()] == [
            'b_1', 'b_2', 'b_4²5', 'b_10']
        assert bag.topics[0].count == 4


def test_only_the_wanted_topics_come(tmp_path: Path) -> None:
    with BagWriter(tmp_path / 'bag') as writer:
        for name in ('/a', '/b', '/c'):
            topic = writer.add_topic(name, STRING)
            writer.write(topic, START_NS, writer.typestore.types[STRING](data=name))
    with BagReader(tmp_path / 'bag') as bag:
        assert [m.read().data for m in bag.messages(['/c', '/a'])] == ['/a', '/c']
        assert list(bag.messages([])) == []
        assert list(bag.messages(['/d'])) == []


def test_messages_are_counted_as_often_whatever_the_topics(tmp_path: Path, monkeypatch) -> None:
    counted, times = [], []
    counts: Any = vars(McapFile)['counts']

    def count(file: McapFile) -> Counter[int]:
        counted.append(file)
        return counts.fget(file)

    monkeypatch.setattr(McapFile, 'counts', property(count))
    for topics in (1, 30):
        with BagWriter(tmp_path / str(topics)) as writer:
            for number in range(topics):
                topic = writer.add_topic(f'/text_{number}', STRING)
                writer.write_cdr(topic, START_NS, string_cdr('a'))
        counted.clear()
        with BagReader(tmp_path / str(topics)) as bag:
            assert [topic.count for topic in bag.topics] == [1] * topics
        times.append(len(counted))
    assert times[0] == times[1]


def test_a_type_that_jazzy_does_not_know_is_decoded_with_its_own_definition(
        tmp_path: Path) -> None:
    msgtype = 'my_robot_msgs/msg/Battery'
    msgdef = MessageDefinition(MessageDefinitionFormat.MSG, 'float32 volts\nstring name\n')
    topic = BagTopic('/battery', msgtype, msgdef=msgdef)
    cdr = b'\x00\x01\x00\x00' + b'\x00\x00\x48\x41' + b'\x03\x00\x00\x00ab\x00'
    with BagWriter(tmp_path / 'bag') as writer:
        writer.copy_topic(topic)
        writer.write_cdr(topic, START_NS, cdr)
    with BagReader(tmp_path / 'bag') as bag:
        message, = bag.messages()
        assert message.cdr == cdr
        assert (message.read().volts, message.read().name) == (12.5, 'ab')


def test_a_type_that_nobody_defines_is_named(tmp_path: Path) -> None:
    database = write_sqlite_bag(tmp_path / 'bag', 1) / 'bag.db3'
    recorder = sqlite3.connect(database)
    recorder.execute("UPDATE topics SET type = 'my_robot_msgs/msg/Battery'")
    recorder.commit()
    recorder.close()
    with BagReader(database) as bag:
        message, = bag.messages()
        with pytest.raises(BagError, match='^/text: the bag holds no definition of '
                           'my_robot_msgs/msg/Battery$'):
            message.read()


def test_bytes_that_are_no_message_are_an_error_only_when_read(tmp_path: Path) -> None:
    with BagWriter(tmp_path / 'bag') as writer:
        topic = writer.add_topic('/text', STRING)
        writer.write_cdr(topic, START_NS, b'\x00\x01\x00\x00\xff\xff\xff\x00ab')
    with BagReader(tmp_path / 'bag') as bag:
        message, = bag.messages()
        with pytest.raises(BagError, match=f'/text: the message at {START_NS} ns'):
            message.read()


@pytest.mark.parametrize(('name', 'content', 'message'), [
    ('nowhere', None, 'no such bag'),
    ('empty.mcap', b'', 'expected an MCAP file'),
    ('picture.mcap', b'\x89PNG\r\n\x1a\n' * 30, 'expected an MCAP file'),
    ('notes.txt', b'hello', 'expected a bag folder'),
    ('empty.db3', b'', 'not a readable sqlite3 bag'),
    ('text.db3', b'no database' * 50, 'not a readable sqlite3 bag'),
    ('folder/readme.md', b'hello', 'there is no .mcap or .db3'),
    ('folder/metadata.yaml', b'rosbag2_bagfile_information: 7', 'there is no .mcap or .db3'),
])
def test_other_files_are_refused(tmp_path: Path, name, content, message) -> None:
    path = tmp_path / name
    if content is not None:
        path.parent.mkdir(exist_ok=True)
        path.write_bytes(content)
    with pytest.raises(BagError, match=message):
        BagReader(path.parent if path.parent != tmp_path else path)


def _message_packed(path: Path) -> Path:
    return _packed(path, CompressionMode.MESSAGE)


def _file_packed(path: Path) -> Path:
    return _packed(path, CompressionMode.FILE)


def _packed(path: Path, mode: CompressionMode) -> Path:
    writer = Writer(path / 'bag', version=9)
    writer.set_compression(mode, CompressionFormat.ZSTD)
    with writer:
        connection = writer.add_connection('/text', STRING, typestore=STORE)
        for i, text in enumerate(texts(COUNT)):
            writer.write(connection, START_NS + i, string_cdr(text))
    return path / 'bag'


@pytest.mark.parametrize('make', [_message_packed, _file_packed])
def test_bags_compressed_by_rosbag2_are_unpacked(tmp_path: Path, make) -> None:
    path = make(tmp_path)
    with BagReader(path) as bag:
        assert [message.read().data for message in bag.messages()] == texts(COUNT)
    for file in path.glob('*.zstd'):  # Cut: what comes out of it is read.
        file.write_bytes(file.read_bytes()[:-40])
        with pytest.raises(BagError, match='nothing could be recovered|not a readable sqlite3'):
            BagReader(path)


@pytest.mark.parametrize('bare', [False, True])
def test_compressed_messages_are_known_without_metadata(tmp_path: Path, bare: bool) -> None:
    path = _message_packed(tmp_path)
    (path / 'metadata.yaml').unlink()  # A recorder that is killed has not written it.
    with BagReader(next(path.glob('*.db3')) if bare else path) as bag:
        assert [message.read().data for message in bag.messages()] == texts(COUNT)
        assert not bag.damages


def test_a_message_that_cannot_be_unpacked_is_lost_and_counted_once(tmp_path: Path) -> None:
    good, packed = string_cdr('good'), zstandard.compress(string_cdr('bad'))
    with BagWriter(tmp_path / 'bag') as writer:
        topic = writer.add_topic('/text', STRING)
        for index, cdr in enumerate((zstandard.compress(good), packed[:6] + b'\xff' * 9, good)):
            writer.write_cdr(topic, START_NS + index, cdr)
    with BagReader(tmp_path / 'bag') as bag:
        for _ in range(2):
            assert [message.cdr for message in bag.messages()] == [good, good]
            assert bag.recovered == (
                'bag.mcap (messages that cannot be unpacked): 2 messages recovered, 1 lost')


def test_quality_of_service_and_type_hash_survive(tmp_path: Path) -> None:
    with BagWriter(tmp_path / 'bag') as writer:
        writer.add_topic('/latched', STRING, (LATCHED,))
    for path in (tmp_path / 'bag', tmp_path / 'bag' / 'bag.mcap'):
        with BagReader(path) as bag:
            topic, = bag.topics
            assert topic.qos == (LATCHED,)
    with BagReader(tmp_path / 'bag') as bag:
        assert bag.topics[0].digest == STORE.hash_rihs01(STRING)


@pytest.mark.parametrize('content', [
    b'', b'not: [yaml', b'rosbag2_bagfile_information: {relative_file_paths: 3, files: 4}',
    b'rosbag2_bagfile_information: {files: [{path: bag.mcap, message_count: x}]}',
    b'\xff\xfe'], ids=['empty', 'no yaml', 'numbers', 'words', 'no text'])
def test_damaged_metadata_is_passed_over(tmp_path: Path, content: bytes) -> None:
    bag = write_text_bag(tmp_path / 'bag', COUNT)
    (bag / 'metadata.yaml').write_bytes(content)
    with BagReader(bag) as reader:
        assert len(list(reader.messages())) == COUNT


def test_metadata_may_end_anywhere(tmp_path: Path) -> None:
    bag = write_text_bag(tmp_path / 'bag', 1)
    content = (bag / 'metadata.yaml').read_bytes()
    topic = content.index(b'topic_metadata')
    for length in range(topic, topic + 120):
        (bag / 'metadata.yaml').write_bytes(content[:length])
        read_bag_folder(bag)


def test_the_span_is_that_of_the_log_times(tmp_path: Path) -> None:
    for write in (write_text_bag, write_sqlite_bag):
        path = write(tmp_path / write.__name__, COUNT)
        with BagReader(path) as bag:
            assert bag.span_ns == (START_NS, START_NS + COUNT - 1)
    with BagWriter(tmp_path / 'empty') as writer:
        writer.add_topic('/text', STRING)
    with BagReader(tmp_path / 'empty') as bag, pytest.raises(BagError, match='the bag has none'):
        bag.span_ns  # noqa: B018


def test_a_missing_part_of_a_split_bag_is_a_loss(tmp_path: Path) -> None:
    bag = write_text_bag(tmp_path / 'bag', COUNT)
    metadata = (bag / 'metadata.yaml').read_text()
    listed = metadata.replace('- bag.mcap', '- bag.mcap\n  - bag_1.mcap')
    (bag / 'metadata.yaml').write_text(listed)
    with BagReader(bag) as reader:
        assert len(list(reader.messages())) == COUNT
        assert reader.recovered == (
            'bag_1.mcap (missing): 0 messages recovered, an unknown number lost')


@pytest.mark.parametrize('write', [write_text_bag, write_sqlite_bag])
def test_a_file_that_metadata_does_not_list_is_named_and_not_read(tmp_path: Path, write) -> None:
    bag = write(tmp_path / 'bag', COUNT)
    file = next(path for path in bag.iterdir() if path.suffix in ('.mcap', '.db3'))
    copies = [f'{file.stem}_recovered{file.suffix}', 'converted.mcap']
    for copy in copies:
        shutil.copy(file, bag / copy)
    with BagReader(bag) as reader:
        assert len(list(reader.messages())) == reader.message_count == COUNT
        assert reader.recovered.splitlines() == [
            f'{copy}: not of this bag, as metadata.yaml does not list it, and is not read; to '
            'read it, give this file as the bag' for copy in sorted(copies)]
        assert sum(damage.lost or 0 for damage in reader.damages) == 0
    shutil.copy(file, bag / 'renamed_0.mcap')
    file.unlink()  # None of the list is there: the files were renamed.
    assert not read_bag_folder(bag).foreign and read_bag_folder(bag).missing


def test_hidden_files_are_no_part_of_a_bag(tmp_path: Path) -> None:
    bag = write_text_bag(tmp_path / 'bag', COUNT)
    (bag / 'metadata.yaml').unlink()
    for name in ('._bag.mcap', '._bag.db3', '._bag.mcap.zstd'):
        (bag / name).write_bytes(b'\0\5\x16\7' + bytes(4092))  # As macOS adds them.
    with BagReader(bag) as reader:
        assert len(list(reader.messages())) == COUNT and not reader.damages


@pytest.mark.parametrize('content', [b'', b'no bag at all' * 100], ids=['empty', 'other'])
@pytest.mark.parametrize('suffix, write', [('.mcap', write_text_bag), ('.db3', write_sqlite_bag)])
def test_an_unreadable_part_of_a_split_bag_does_not_keep_the_others(
        tmp_path: Path, suffix: str, write, content: bytes) -> None:
    bag = write(tmp_path / 'bag', COUNT)
    (bag / 'metadata.yaml').unlink()  # It lists one part.
    (bag / f'bag_1{suffix}').write_bytes(content)
    with BagReader(bag) as reader:
        assert len(list(reader.messages())) == COUNT
        assert reader.recovered.startswith(f'bag_1{suffix} (')
        assert reader.recovered.endswith('0 messages recovered, an unknown number lost')


@pytest.mark.parametrize('suffix, write', [('.mcap', write_text_bag), ('.db3', write_sqlite_bag)])
def test_a_part_that_the_disk_does_not_give_does_not_keep_the_others(
        tmp_path: Path, suffix: str, write) -> None:
    bag = write(tmp_path / 'bag', COUNT)
    (bag / 'metadata.yaml').unlink()  # It lists one part.
    (bag / f'bag_1{suffix}').mkdir()  # It can be found, but not read: as a file of another user.
    with BagReader(bag) as reader:
        assert len(list(reader.messages())) == COUNT
        assert f'bag_1{suffix} (' in reader.recovered and 'read' in reader.recovered


def test_a_recorder_that_was_killed_leaves_packed_and_plain_files(tmp_path: Path) -> None:
    bag = tmp_path / 'bag'
    bag.mkdir()
    for number in range(3):
        part, = write_text_bag(tmp_path / str(number), number + 1).glob('*.mcap')
        content = part.read_bytes()
        packed = zstandard.compress(content)
        if number < 2:
            (bag / f'bag_{number}.mcap.zstd').write_bytes(packed[:9 * number] or packed)
        if number > 0:  # The second was being packed.
            (bag / f'bag_{number}.mcap').write_bytes(content)
    with BagReader(bag) as reader:
        assert len(list(reader.messages())) == 1 + 2 + 3 and not reader.damages


def test_numbers_of_rows_take_little_memory() -> None:
    tracemalloc.start()
    numbers = _Numbers(10_000_000)
    for number in range(0, 10_000_000, 100):
        numbers.add(number)
    assert tracemalloc.get_traced_memory()[1] < 2_000_000
    tracemalloc.stop()
    for number in (-3, 1 << 62):  # As a damaged page may say.
        assert number not in numbers
        numbers.add(number)
        assert number in numbers
    assert len(numbers) == 100_002 and 100 in numbers and 101 not in numbers
    assert 5 not in _Numbers(None)
