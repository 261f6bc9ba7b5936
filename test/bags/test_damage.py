"""Cut, flipped and torn bags: what is whole is read, and the counts of the rest are exact."""
from collections.abc import Callable
from pathlib import Path
import random

from bag_files import START_NS, STRING, string_cdr, texts, write_foreign_mcap, write_text_bag
from bag_reading import read_all
from mcap.writer import CompressionType, IndexType
from neo_ros.bags import BagReader, BagWriter, Damage
from neo_ros.bags.mcap_file import McapFile
from neo_ros.bags.mcap_layout import McapLayout
from neo_ros.bags.mcap_records import MAX_CHUNK_BYTES
from neo_ros.errors import BagError
import pytest

COUNT = 40
WHOLE = [string_cdr(text) for text in texts(COUNT)]
MAGIC_BYTES = 8
Make = Callable[[Path], Path]


def _ours(path: Path) -> Path:
    return write_text_bag(path / 'bag', COUNT) / 'bag.mcap'


def _zstd(path: Path) -> Path:
    return write_foreign_mcap(path / 'f.mcap', COUNT, CompressionType.ZSTD)


def _lz4(path: Path) -> Path:
    return write_foreign_mcap(path / 'f.mcap', COUNT, CompressionType.LZ4)


def _plain(path: Path) -> Path:
    return write_foreign_mcap(path / 'f.mcap', COUNT, CompressionType.NONE)


def _without_chunks(path: Path) -> Path:
    return write_foreign_mcap(path / 'f.mcap', COUNT, CompressionType.NONE, use_chunking=False)


MAKERS = [_ours, _zstd, _lz4, _plain, _without_chunks]
# Bags whose chunks carry checksums: nothing that was changed may come through.
CHECKED = [_zstd, _lz4, _plain]


@pytest.mark.parametrize('make', MAKERS)
def test_a_cut_bag_gives_its_whole_messages_before_the_cut(tmp_path: Path, make: Make) -> None:
    content = make(tmp_path).read_bytes()
    cut = tmp_path / 'cut.mcap'
    counts = []
    for size in range(MAGIC_BYTES, len(content), max(1, len(content) // 150)):
        cut.write_bytes(content[:size])
        found, damages = read_all(cut)
        assert found == WHOLE[:len(found)]
        for damage in damages:
            assert (damage.recovered, damage.lost) == (len(found), None)
            assert int(damage.place.removeprefix('byte ')) <= size
        assert damages or len(found) in (0, COUNT)
        counts.append(len(found))
    assert counts == sorted(counts)
    assert counts[0] == 0 and counts[-1] == COUNT
    # A message is never lost far before the cut: half of the file gives about half of them.
    assert 0.3 * COUNT < counts[len(counts) // 2] <= COUNT


@pytest.mark.parametrize('make', MAKERS)
def test_with_metadata_the_loss_of_a_cut_bag_is_known(tmp_path: Path, make: Make) -> None:
    bag = write_text_bag(tmp_path / 'bag', COUNT)
    (tmp_path / 'other').mkdir()
    content = make(tmp_path / 'other').read_bytes()
    seen = set()
    for size in range(len(content) // 3, len(content), max(1, len(content) // 40)):
        (bag / 'bag.mcap').write_bytes(content[:size])
        found, damages = read_all(bag)
        if damages:
            damage, = damages
            assert (damage.recovered, damage.lost) == (len(found), COUNT - len(found))
            assert str(damage) == (f'bag.mcap: {len(found)} messages recovered, '
                                   f'{COUNT - len(found)} lost, from {damage.place}')
            seen.add(damage.lost)
        else:
            assert len(found) == COUNT
    assert len(seen) > 3


@pytest.mark.parametrize('make', CHECKED)
@pytest.mark.parametrize('length', [1, 20], ids=['a bit', '20 bytes'])
def test_damage_in_a_bag_with_checksums_is_skipped_and_counted(
        tmp_path: Path, make: Make, length: int) -> None:
    content = make(tmp_path).read_bytes()
    summary = content.rindex(b'\x0f\x04' + bytes(7))  # Behind it there are no messages.
    damaged = tmp_path / 'damaged.mcap'
    chance = random.Random(length)
    lost = []
    for place in range(MAGIC_BYTES, summary - length, max(1, summary // 120)):
        changed = bytearray(content)
        if length == 1:
            changed[place] ^= 1 << chance.randrange(8)
        else:
            changed[place:place + length] = chance.randbytes(length)
        damaged.write_bytes(changed)
        found, damages = read_all(damaged)
        assert set(found) <= set(WHOLE) and len(set(found)) == len(found)
        assert len(found) > 0.5 * COUNT  # Other chunks are not touched.
        assert [(entry.recovered, entry.lost) for entry in damages] == (
            [(len(found), COUNT - len(found))] if len(found) < COUNT else [])
        lost.append(COUNT - len(found))
        for entry in damages:
            assert int(entry.place.removeprefix('byte ')) < place + length
    assert sum(map(bool, lost)) > 0.8 * len(lost)


def _without_checksums(path: Path) -> Path:
    return write_foreign_mcap(path / 'f.mcap', COUNT, CompressionType.NONE, enable_crcs=False)


@pytest.mark.parametrize('make', [_without_checksums, _without_chunks])
def test_without_checksums_the_counts_still_add_up(tmp_path: Path, make: Make) -> None:
    content = make(tmp_path).read_bytes()
    damaged = tmp_path / 'damaged.mcap'
    starts = [content.index(cdr) - 31 for cdr in WHOLE]
    for start in starts:  # The head of every record: its opcode, length, channel.
        for place in (start, start + 1, start + 2, start + 5, start + 8, start + 9):
            changed = bytearray(content)
            changed[place] ^= 0x21
            damaged.write_bytes(changed)
            found, damages = read_all(damaged)
            whole = [cdr for cdr in found if cdr in WHOLE]
            assert COUNT - 2 <= len(whole) <= COUNT
            assert sum(entry.lost or 0 for entry in damages) == COUNT - len(found)


def test_our_own_bags_carry_checksums(tmp_path: Path) -> None:
    file = write_text_bag(tmp_path / 'bag', 9000) / 'bag.mcap'
    content = bytearray(file.read_bytes())
    chunks = McapLayout(file).parts
    assert len(chunks) > 1
    content[chunks[1].start + 5000] ^= 4
    file.write_bytes(content)
    found, (damage,) = read_all(file)
    assert chunks[1].claimed is not None
    assert damage.lost == 9000 - len(found) == chunks[1].claimed.total()
    assert damage.place == f'byte {chunks[1].offset}'


def test_damage_in_the_middle_does_not_end_the_reading(tmp_path: Path) -> None:
    file = _zstd(tmp_path)
    content = bytearray(file.read_bytes())
    places = [place for place in range(len(content)) if content[place:place + 4] == b'zstd']
    content[places[1] + 40] ^= 1
    file.write_bytes(content)
    with BagReader(file) as bag:
        assert bag.topics[0].count == COUNT  # What the index promises, before anything is read.
        found = [message.cdr for message in bag.messages()]
        damage, = bag.damages
        assert found[-1] == WHOLE[-1] and found[0] == WHOLE[0]
        assert (damage.recovered, damage.lost) == (len(found), COUNT - len(found))
        assert COUNT - 15 < len(found) < COUNT
        assert [message.cdr for message in bag.messages()] == found
        assert bag.damages == [damage]


def test_deleted_bytes_are_a_loss(tmp_path: Path) -> None:
    content = _zstd(tmp_path).read_bytes()
    torn = tmp_path / 'torn.mcap'
    for place in range(MAGIC_BYTES + 200, len(content) - 1500, len(content) // 30):
        torn.write_bytes(content[:place] + content[place + 300:])
        found, damages = read_all(torn)
        assert set(found) <= set(WHOLE)
        assert 0 < len(found) < COUNT and len(damages) == 1
        assert damages[0].recovered == len(found)


@pytest.mark.parametrize('make', MAKERS)
def test_whole_bags_are_not_called_damaged(tmp_path: Path, make: Make) -> None:
    found, damages = read_all(make(tmp_path))
    assert (found, damages) == (WHOLE, [])


def test_a_cut_in_the_index_loses_nothing(tmp_path: Path) -> None:
    file = _ours(tmp_path)
    file.write_bytes(file.read_bytes()[:-60])
    assert read_all(file) == (WHOLE, [])


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
    file = _without_chunks(tmp_path)
    content = file.read_bytes()
    file.write_bytes(content[:len(content) // 2])
    before, (damage,) = read_all(file)
    end = int(damage.place.removeprefix('byte '))
    file.write_bytes(content[:end] + bytes(100_000))
    after, (with_zeros,) = read_all(file)
    assert after == before and len(after) > 10
    assert with_zeros.place == damage.place


@pytest.mark.parametrize('claim', [1 << 62, MAX_CHUNK_BYTES + 1], ids=['huge', 'above the cap'])
@pytest.mark.parametrize('make', [_zstd, _lz4])
def test_a_chunk_that_claims_to_be_huge_is_not_unpacked(
        tmp_path: Path, make: Make, claim: int) -> None:
    file = make(tmp_path)
    content = bytearray(file.read_bytes())
    size_at = content.index(b'zstd' if make is _zstd else b'lz4') - 4 - 4 - 8
    content[size_at:size_at + 8] = claim.to_bytes(8, 'little')
    file.write_bytes(content)
    found, (damage,) = read_all(file)
    assert damage.lost == COUNT - len(found)
    assert COUNT - 15 < len(found) < COUNT


def test_a_chunk_that_unpacks_to_more_than_it_says_is_a_bomb(tmp_path: Path) -> None:
    file = tmp_path / 'bomb.mcap'
    with BagWriter(tmp_path / 'bag', compressed=True) as writer:
        topic = writer.add_topic('/text', STRING)
        writer.write_cdr(topic, START_NS, bytes(50_000_000))
    content = bytearray((tmp_path / 'bag' / 'bag.mcap').read_bytes())
    assert len(content) < 100_000
    size_at = content.index(b'zstd') - 4 - 4 - 8
    content[size_at:size_at + 8] = (1000).to_bytes(8, 'little')
    file.write_bytes(content)
    with pytest.raises(BagError, match='nothing could be recovered|expected messages'):
        with BagReader(file) as bag:
            assert list(bag.messages()) == []
            assert bag.damages == [Damage('bomb.mcap', 0, 1, 'byte 36')]
            bag.span_ns  # noqa: B018


def test_a_file_with_nothing_left_is_refused(tmp_path: Path) -> None:
    file = _ours(tmp_path)
    file.write_bytes(file.read_bytes()[:60])
    with pytest.raises(BagError, match='nothing could be recovered.*0 messages.*from byte 36'):
        BagReader(file)


def test_a_writer_that_died_leaves_a_bag_that_can_be_read(tmp_path: Path) -> None:
    with pytest.raises(RuntimeError):
        with BagWriter(tmp_path / 'bag') as writer:
            topic = writer.add_topic('/text', STRING)
            for i in range(9000):
                writer.write_cdr(topic, START_NS + i, WHOLE[i % COUNT])
            raise RuntimeError('power failure')
    assert not (tmp_path / 'bag' / 'metadata.yaml').exists()
    found, _ = read_all(tmp_path / 'bag')
    assert len(found) > 1000
    assert found[:COUNT] == WHOLE


def test_chunks_that_overlap_come_in_the_order_of_time(tmp_path: Path) -> None:
    with BagWriter(tmp_path / 'bag') as writer:
        topics = [writer.add_topic(name, STRING) for name in ('/even', '/odd')]
        for parity in (0, 1):  # Topic by topic, in several chunks each.
            for i in range(parity, 3000, 2):
                writer.write_cdr(topics[parity], START_NS + i, string_cdr(str(i) * 300))
    with BagReader(tmp_path / 'bag') as bag:
        stamps = [message.stamp_ns for message in bag.messages()]
        assert stamps == [START_NS + i for i in range(3000)]
        window = [message.stamp_ns - START_NS for message in bag.messages(
            ['/odd'], START_NS + 100, START_NS + 110)]
    assert window == [101, 103, 105, 107, 109]


def test_closing_twice_and_garbage_after_the_magic(tmp_path: Path) -> None:
    file = tmp_path / 'garbage.mcap'
    file.write_bytes(b'\x89MCAP0\r\n' + random.Random(3).randbytes(50_000))
    with pytest.raises(BagError, match='nothing could be recovered'):
        BagReader(file)
    whole = McapFile(_ours(tmp_path))
    whole.close()
    whole.close()


def test_records_that_a_later_version_made_longer_are_no_damage(tmp_path: Path) -> None:
    file = tmp_path / 'a.mcap'
    content = write_foreign_mcap(file, 5, CompressionType.NONE, 1 << 20,
                                 index_types=IndexType.MESSAGE).read_bytes()
    # The summary's places move, so it goes: the file ends as one that was never indexed.
    index = content.index(b'\x07' + (6 + 5 * 16).to_bytes(8, 'little'))
    end = index + 9 + 6 + 5 * 16
    length = (6 + 5 * 16 + 3).to_bytes(8, 'little')
    data_end = b'\x0f' + (4).to_bytes(8, 'little') + bytes(4)
    footer = b'\x02' + (20).to_bytes(8, 'little') + bytes(20)
    file.write_bytes(content[:index + 1] + length + content[index + 9:end] + b'\x01\xff\xff'
                     + data_end + footer + content[:8])
    with BagReader(file) as bag:
        assert len(list(bag.messages())) == 5 and bag.damages == []
