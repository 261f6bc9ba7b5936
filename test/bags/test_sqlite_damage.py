"""Damaged sqlite3 bags: what is left of them is read, and what is lost is counted."""
from collections.abc import Iterator
from contextlib import contextmanager
from pathlib import Path
import random
import signal
import sqlite3
from typing import Any

from bag_files import START_NS, string_cdr, texts, write_sqlite_bag
from bag_reading import read_all
from neo_ros.bags import BagReader
from neo_ros.errors import BagError
import pytest


@pytest.mark.parametrize('part', [0.3, 0.5, 0.8])
def test_a_truncated_sqlite_bag_gives_what_is_left(tmp_path: Path, part: float) -> None:
    bag = write_sqlite_bag(tmp_path / 'bag', 400)
    database = bag / 'bag.db3'
    content = database.read_bytes()
    database.write_bytes(content[:int(part * len(content))])
    expected = {string_cdr(text) for text in texts(400)}
    found, (damage,) = read_all(bag)
    assert set(found) <= expected and len(set(found)) == len(found)
    assert 400 * (part - 0.2) < len(found) < 400 * part  # Tables and indices are mixed.
    assert (damage.recovered, damage.lost) == (len(found), 400 - len(found))


def test_a_damaged_page_of_a_sqlite_bag_is_skipped(tmp_path: Path) -> None:
    database = write_sqlite_bag(tmp_path / 'bag', 400) / 'bag.db3'
    content = bytearray(database.read_bytes())
    place = content.index(string_cdr(texts(400)[200])) // 4096 * 4096
    content[place:place + 4096] = b'\xff' * 4096
    database.write_bytes(content)
    found, (damage,) = read_all(database)
    assert set(found) <= {string_cdr(text) for text in texts(400)}
    assert (damage.recovered, damage.lost) == (len(found), 400 - len(found))
    assert 360 < len(found) < 400 and damage.place.startswith('row ')


@contextmanager
def at_most(seconds: int) -> Iterator[None]:
    """Raise TimeoutError in what takes longer."""
    def stop(*_: Any) -> None:
        raise TimeoutError

    before = signal.signal(signal.SIGALRM, stop)
    signal.alarm(seconds)
    try:
        yield
    finally:
        signal.alarm(0)
        signal.signal(signal.SIGALRM, before)


def _table_page(content: bytearray, wanted: bytes) -> int:
    """Return where the page of this message begins, a leaf of the table."""
    page = content.index(wanted) // 4096 * 4096
    assert content[page] == 13
    return page


@pytest.mark.parametrize('count', [0xeb, 0xe5])
def test_a_page_that_claims_too_many_rows_is_read_once(tmp_path: Path, count: int) -> None:
    database = write_sqlite_bag(tmp_path / 'bag', 400) / 'bag.db3'
    content = bytearray(database.read_bytes())
    content[_table_page(content, string_cdr(texts(400)[100])) + 4] = count
    database.write_bytes(content)
    with at_most(20):
        found, _ = read_all(database)
    assert sorted(found) == sorted(string_cdr(text) for text in texts(400))


@pytest.mark.parametrize('byte', [0, 1, 0xff])
def test_a_last_row_with_a_wrong_number_takes_no_others_along(
        tmp_path: Path, byte: int) -> None:
    database = write_sqlite_bag(tmp_path / 'bag', 400) / 'bag.db3'
    content = bytearray(database.read_bytes())
    last = content.index(string_cdr(texts(400)[399]))
    content[content.rindex((0x8310).to_bytes(2, 'big'), 0, last)] = byte  # 400 as a varint.
    content[_table_page(content, string_cdr(texts(400)[100])) + 4] = 0xeb
    database.write_bytes(content)
    with at_most(20):
        found, _ = read_all(database)
    assert len(set(found)) == len(found) >= 398


def test_no_damaged_byte_of_a_sqlite_bag_hangs_or_doubles(tmp_path: Path) -> None:
    database = write_sqlite_bag(tmp_path / 'bag', 400) / 'bag.db3'
    content = database.read_bytes()
    chance = random.Random(0)
    for _ in range(250):
        changed = bytearray(content)
        # The head of a page tells what all its other bytes mean.
        place = 4096 * chance.randrange(len(content) // 4096) + (
            chance.randrange(16) if chance.random() < 0.7 else chance.randrange(4096))
        changed[place] = chance.randrange(256)
        database.write_bytes(changed)
        with at_most(20):
            try:
                with BagReader(database) as bag:
                    found = [(message.stamp_ns, message.cdr) for message in bag.messages()]
                    first, last = bag.span_ns
            except BagError:
                continue
        assert len(set(found)) == len(found) <= 400 and first <= last, place


@pytest.mark.parametrize('change', [
    'UPDATE messages SET timestamp = NULL WHERE id = 3',
    "UPDATE messages SET timestamp = 'x' WHERE id = 3",
    "UPDATE messages SET topic_id = 'x' WHERE id = 3",
    'UPDATE messages SET data = NULL WHERE id = 3'])
@pytest.mark.parametrize('indexed', [True, False])
def test_a_row_of_other_values_is_lost_alone(
        tmp_path: Path, change: str, indexed: bool) -> None:
    database = write_sqlite_bag(tmp_path / 'bag', 40) / 'bag.db3'
    recorder = sqlite3.connect(database)
    # As damage does: what keeps such values out is no part of the rows.
    schema = ', '.join(column.replace('NOT NULL', '') for column in (
        'id INTEGER PRIMARY KEY', 'topic_id', 'timestamp', 'data'))
    recorder.executescript(
        f'CREATE TABLE other({schema}); INSERT INTO other SELECT * FROM messages; '
        'DROP TABLE messages; ALTER TABLE other RENAME TO messages;' + (
            'CREATE INDEX timestamp_idx ON messages (timestamp ASC);' if indexed else '') + change)
    recorder.commit()
    recorder.close()
    with BagReader(database.parent) as bag:
        assert bag.span_ns == (START_NS, START_NS + 39)
        found = [message.cdr for message in bag.messages()]
        assert bag.span_ns == (START_NS, START_NS + 39)
        damage, = bag.damages
    assert found == [string_cdr(text) for place, text in enumerate(texts(40)) if place != 2]
    assert (damage.recovered, damage.lost) == (39, 1)


def test_an_index_that_leads_astray_loses_nothing(tmp_path: Path) -> None:
    database = write_sqlite_bag(tmp_path / 'bag', 400) / 'bag.db3'
    recorder = sqlite3.connect(database)
    recorder.execute('PRAGMA writable_schema = ON')
    # The index holds only a part of the rows.
    recorder.executescript(
        'DROP INDEX timestamp_idx; '
        f'CREATE INDEX timestamp_idx ON messages (timestamp ASC) WHERE timestamp < {START_NS + 9};'
        "UPDATE sqlite_master SET sql = 'CREATE INDEX timestamp_idx ON messages (timestamp ASC)' "
        "WHERE name = 'timestamp_idx'")
    recorder.close()
    found, damages = read_all(database)
    assert found == [string_cdr(text) for text in texts(400)] and not damages


def test_topics_that_are_lost_take_their_messages_along(tmp_path: Path) -> None:
    database = write_sqlite_bag(tmp_path / 'bag', 40) / 'bag.db3'
    recorder = sqlite3.connect(database)
    recorder.executescript(
        'CREATE TABLE other AS SELECT * FROM topics; DROP TABLE topics; '
        'ALTER TABLE other RENAME TO topics; UPDATE topics SET name = NULL')
    recorder.close()
    with pytest.raises(BagError, match='nothing could be recovered.*40 lost'):
        BagReader(database)


def test_definitions_of_other_columns_are_passed_over(tmp_path: Path) -> None:
    database = write_sqlite_bag(tmp_path / 'bag', 40) / 'bag.db3'
    recorder = sqlite3.connect(database)
    recorder.execute('ALTER TABLE message_definitions RENAME COLUMN topic_type TO topic_typd')
    recorder.close()
    found, damages = read_all(database)
    assert len(found) == 40 and not damages


def test_the_log_of_a_crashed_sqlite_recorder_is_read(tmp_path: Path) -> None:
    database = write_sqlite_bag(tmp_path / 'bag', 10) / 'bag.db3'
    recorder = sqlite3.connect(database)
    recorder.execute('PRAGMA journal_mode = WAL')
    recorder.execute('INSERT INTO messages (topic_id, timestamp, data) VALUES (1, ?, ?)',
                     (START_NS + 99, string_cdr('the last one')))
    recorder.commit()
    crashed = tmp_path / 'crashed'
    crashed.mkdir()
    for file in database.parent.glob('bag.db3*'):
        (crashed / file.name).write_bytes(file.read_bytes())
    recorder.close()
    with BagReader(crashed) as bag:
        *_, last = bag.messages()
        assert last.read().data == 'the last one' and bag.recovered == ''


def test_a_flipped_bit_in_the_type_of_a_row_loses_nothing(tmp_path: Path) -> None:
    database = write_sqlite_bag(tmp_path / 'bag', 40) / 'bag.db3'
    wanted = string_cdr(texts(40)[20])
    content = bytearray(database.read_bytes())
    # The row's header ends with the type of the data: 12 + 2 n for a blob, 13 + 2 n for a text.
    kind = 12 + 2 * len(wanted)
    varint = bytes([kind >> 7 | 0x80, kind & 0x7f])
    place = content.rindex(varint, 0, content.index(wanted)) + 1
    content[place] ^= 1
    database.write_bytes(content)
    found, damages = read_all(database)
    assert found == [string_cdr(text) for text in texts(40)] and not damages
