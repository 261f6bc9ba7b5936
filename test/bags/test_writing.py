"""New bags are what `ros2 bag` expects; outputs that cannot be are refused at once."""
import os
from pathlib import Path

from bag_files import START_NS, STRING, string_cdr, write_text_bag
from mcap.reader import make_reader
from neo_ros.bags import BagReader, BagTopic, BagWriter
from neo_ros.bags.qos import LATCHED, qos_entries, qos_text, read_qos
from neo_ros.errors import BagError
import pytest
from ruamel.yaml import YAML


@pytest.mark.parametrize('compressed', [False, True], ids=['plain', 'zstd'])
def test_folder_has_metadata_and_an_indexed_mcap(tmp_path: Path, compressed: bool) -> None:
    bag = write_text_bag(tmp_path / 'bag', 30, compressed)
    metadata = YAML(typ='safe').load((bag / 'metadata.yaml').read_text())
    info = metadata['rosbag2_bagfile_information']
    assert info['storage_identifier'] == 'mcap'
    assert info['relative_file_paths'] == ['bag.mcap']
    assert info['message_count'] == 30
    assert info['starting_time']['nanoseconds_since_epoch'] == START_NS
    assert info['duration']['nanoseconds'] == 29
    topic = info['topics_with_message_count'][0]['topic_metadata']
    assert (topic['name'], topic['type']) == ('/text', STRING)
    assert topic['type_description_hash'].startswith('RIHS01_')
    with (bag / 'bag.mcap').open('rb') as file:
        reader = make_reader(file, validate_crcs=True)
        assert reader.get_header().profile == 'ros2'
        summary = reader.get_summary()
        assert summary is not None and summary.statistics is not None
        assert summary.statistics.message_count == 30
        assert summary.schemas[1].encoding == 'ros2msg'
        kinds = {chunk.compression for chunk in summary.chunk_indexes}
        assert kinds == {'zstd' if compressed else ''}
        assert len(list(reader.iter_messages())) == 30


def test_copied_messages_keep_bytes_types_and_qos(tmp_path: Path) -> None:
    cdr = string_cdr('as it is') + b'\x00\x00'  # Padding that encoding again would drop.
    with BagWriter(tmp_path / 'first') as writer:
        topic = writer.add_topic('/latched', STRING, (LATCHED,))
        writer.write_cdr(topic, START_NS, cdr)
    with BagReader(tmp_path / 'first') as bag, BagWriter(tmp_path / 'second') as writer:
        for topic in bag.topics:
            writer.copy_topic(topic)
        for message in bag.messages():
            writer.write_cdr(message.topic, message.stamp_ns, message.cdr)
    with BagReader(tmp_path / 'first') as first, BagReader(tmp_path / 'second') as second:
        (old,), (new,) = first.messages(), second.messages()
        assert (new.cdr, new.stamp_ns) == (cdr, START_NS)
        assert new.topic.qos == old.topic.qos == (LATCHED,)
        assert new.topic.msgdef == old.topic.msgdef
        assert new.topic.digest == old.topic.digest


def test_topics_without_a_definition_are_copied_all_the_same(tmp_path: Path) -> None:
    topic = BagTopic('/secret', 'their_msgs/msg/Secret')
    with BagWriter(tmp_path / 'bag') as writer:
        writer.copy_topic(topic)
        writer.write_cdr(topic, START_NS, b'\x00\x01\x00\x00\x07')
    with BagReader(tmp_path / 'bag') as bag:
        message, = bag.messages()
        assert (message.topic, message.cdr) == (topic, b'\x00\x01\x00\x00\x07')


def test_existing_outputs_stay_untouched(tmp_path: Path) -> None:
    (tmp_path / 'file').write_text('precious')
    bag = write_text_bag(tmp_path / 'bag', 3)
    before = (bag / 'bag.mcap').read_bytes()
    for path in (tmp_path / 'file', bag):
        with pytest.raises(BagError, match='exists already'):
            BagWriter(path)
    assert (tmp_path / 'file').read_text() == 'precious'
    assert (bag / 'bag.mcap').read_bytes() == before


def test_a_folder_that_cannot_be_made_is_refused(tmp_path: Path, monkeypatch) -> None:
    (tmp_path / 'file').write_text('x')
    with pytest.raises(BagError, match='cannot write the bag: Not a directory'):
        BagWriter(tmp_path / 'file' / 'bag')

    def mkdir(self: Path, *args: object, **kwargs: object) -> None:
        raise PermissionError(13, 'Permission denied')

    monkeypatch.setattr(Path, 'mkdir', mkdir)  # Tests may run as root, who may write everywhere.
    with pytest.raises(BagError, match='cannot write the bag: Permission denied'):
        BagWriter(tmp_path / 'bag')


def test_a_full_disk_is_a_bag_error(tmp_path: Path) -> None:
    if not os.path.exists('/dev/full'):
        pytest.skip('no /dev/full here')
    with pytest.raises(BagError, match='No space left on device'):
        with BagWriter(tmp_path / 'bag') as writer:
            topic = writer.add_topic('/text', STRING)
            os.dup2(os.open('/dev/full', os.O_WRONLY), writer._file.fileno())
            for i in range(100):
                writer.write_cdr(topic, START_NS + i, bytes(100_000))


def test_rosbags_still_has_what_qos_profiles_are_read_and_written_with() -> None:
    entry, = qos_entries([LATCHED])
    assert set(entry) >= {'history', 'depth', 'reliability', 'durability'}, (
        'rosbags.rosbag2.metadata.dump_qos_v9 changed: mend neo_ros/bags/qos.py')
    assert read_qos(qos_text([LATCHED])) == read_qos([entry]) == (LATCHED,), (
        'rosbags.rosbag2.metadata.parse_qos changed: mend neo_ros/bags/qos.py')
    assert read_qos('no: [') == ()
