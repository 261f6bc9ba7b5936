"""A bag cut at any byte gives exactly its whole messages before the cut."""
from pathlib import Path
import re

from bag_files import START_NS, string_cdr, texts, write_foreign_mcap, write_text_bag
from mcap.writer import CompressionType
from neo_ros.bags import BagReader, BagWriter
from neo_ros.bags.salvage import SalvagedMcap
from neo_ros.errors import BagError
import pytest

COUNT = 40
WHOLE = [string_cdr(text) for text in texts(COUNT)]
WHOLE_BYTES = sum(map(len, WHOLE))


def _ours(path: Path) -> Path:
    return write_text_bag(path / 'bag', COUNT) / 'bag.mcap'


def _foreign_zstd(path: Path) -> Path:
    return write_foreign_mcap(path / 'f.mcap', COUNT, CompressionType.ZSTD)


def _foreign_lz4(path: Path) -> Path:
    return write_foreign_mcap(path / 'f.mcap', COUNT, CompressionType.LZ4)


def _foreign_without_chunks(path: Path) -> Path:
    return write_foreign_mcap(path / 'f.mcap', COUNT, CompressionType.NONE, use_chunking=False)


MAKERS = [_ours, _foreign_zstd, _foreign_lz4, _foreign_without_chunks]


@pytest.mark.parametrize('make', MAKERS)
def test_whole_messages_before_the_cut_come_back(tmp_path: Path, make) -> None:
    content = make(tmp_path).read_bytes()
    cut = tmp_path / 'cut.mcap'
    counts = []
    for size in range(8, len(content), max(1, len(content) // 150)):
        cut.write_bytes(content[:size])
        salvaged = SalvagedMcap(cut)
        found = [cdr for _, _, cdr in salvaged.messages()]
        assert found == WHOLE[:len(found)]
        assert salvaged.message_count == len(found)
        assert salvaged.cut_at is None or salvaged.cut_at <= size
        counts.append(len(found))
    assert counts == sorted(counts)
    assert counts[0] == 0 and counts[-1] == COUNT
    # A message is never lost far before the cut: half of the file gives about half of them.
    assert 0.3 * COUNT < counts[len(counts) // 2] <= COUNT


@pytest.mark.parametrize('make', MAKERS)
def test_reader_says_what_was_recovered(tmp_path: Path, make) -> None:
    content = make(tmp_path).read_bytes()
    cut = tmp_path / 'cut.mcap'
    cut.write_bytes(content[:len(content) * 6 // 10])
    with BagReader(cut) as bag:
        messages = list(bag.messages())
        assert 0 < len(messages) < COUNT
        assert bag.message_count == len(messages)
        assert f'cut.mcap: {len(messages)} messages recovered, cut at byte ' in bag.recovered
        assert [message.read().data for message in messages] == texts(COUNT)[:len(messages)]
        assert messages[-1].stamp_ns == START_NS + len(messages) - 1


def test_whole_files_are_not_called_cut(tmp_path: Path) -> None:
    for make in MAKERS:
        folder = tmp_path / make.__name__
        folder.mkdir()
        salvaged = SalvagedMcap(make(folder))
        assert salvaged.cut_at is None and salvaged.message_count == COUNT


@pytest.mark.parametrize(('size', 'recovered'), [
    (WHOLE_BYTES // 2, r'bag\.mcap: \d+ messages recovered, cut at byte \d+'), (-60, '')],
    ids=['in the messages', 'in the index'])
def test_a_cut_file_under_good_metadata_is_recovered(tmp_path: Path, size, recovered) -> None:
    file = _ours(tmp_path)
    file.write_bytes(file.read_bytes()[:size])
    with BagReader(file.parent) as bag:
        found = [message.cdr for message in bag.messages()]
        assert re.fullmatch(recovered, bag.recovered)
    assert found == WHOLE[:len(found)]
    assert len(found) == COUNT if size < 0 else 0 < len(found) < COUNT


def test_a_large_compressed_chunk_is_unpacked_as_far_as_it_goes(tmp_path: Path) -> None:
    count = 6000
    file = write_text_bag(tmp_path / 'bag', count, compressed=True) / 'bag.mcap'
    content = file.read_bytes()
    chunk = content.index(b'zstd')  # of more than 1 MB, in blocks of 128 kB
    file.write_bytes(content[:chunk + 300_000])
    with BagReader(file) as bag:
        found = [message.cdr for message in bag.messages()]
    assert 1000 < len(found) < count
    assert found == [string_cdr(text) for text in texts(len(found))]


def test_zeros_at_the_end_are_a_cut(tmp_path: Path) -> None:
    file = _foreign_without_chunks(tmp_path)
    content = file.read_bytes()
    size = len(content) // 2
    file.write_bytes(content[:size])
    recovered = SalvagedMcap(file)
    assert recovered.cut_at is not None
    file.write_bytes(content[:recovered.cut_at] + bytes(100_000))
    with_zeros = SalvagedMcap(file)
    assert with_zeros.message_count == recovered.message_count > 0
    assert with_zeros.cut_at == recovered.cut_at


def test_a_length_beyond_the_file_is_a_cut(tmp_path: Path) -> None:
    file = _foreign_without_chunks(tmp_path)
    content = bytearray(file.read_bytes())
    start = content.index(WHOLE[20]) - 22 - 9
    content[start + 1:start + 9] = (1 << 60).to_bytes(8, 'little')
    file.write_bytes(content)
    salvaged = SalvagedMcap(file)
    assert (salvaged.message_count, salvaged.cut_at) == (20, start)


def test_a_chunk_that_claims_to_be_huge_is_not_believed(tmp_path: Path) -> None:
    file = _foreign_zstd(tmp_path)
    content = bytearray(file.read_bytes()[:-60])
    size_at = content.index(b'zstd') - 4 - 4 - 8
    content[size_at:size_at + 8] = (1 << 62).to_bytes(8, 'little')
    file.write_bytes(content)
    assert SalvagedMcap(file).message_count == COUNT


def test_a_file_with_nothing_left_is_refused(tmp_path: Path) -> None:
    file = _ours(tmp_path)
    file.write_bytes(file.read_bytes()[:60])
    with pytest.raises(BagError, match='nothing could be recovered.*0 messages.*cut at byte'):
        BagReader(file)


def test_a_writer_that_died_leaves_a_bag_that_can_be_read(tmp_path: Path) -> None:
    with pytest.raises(RuntimeError):
        with BagWriter(tmp_path / 'bag') as writer:
            topic = writer.add_topic('/text', 'std_msgs/msg/String')
            for i in range(9000):
                writer.write_cdr(topic, START_NS + i, WHOLE[i % COUNT])
            raise RuntimeError('power failure')
    assert not (tmp_path / 'bag' / 'metadata.yaml').exists()
    with BagReader(tmp_path / 'bag') as bag:
        found = [message.cdr for message in bag.messages()]
    assert len(found) > 1000
    assert found[:COUNT] == WHOLE
