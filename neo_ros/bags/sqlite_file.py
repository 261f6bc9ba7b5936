"""Read the sqlite3 storage of rosbag2, also one that was cut off or damaged."""
from collections import Counter
from collections.abc import Collection, Container, Iterator
from pathlib import Path
import shutil
import sqlite3
import tempfile
from typing import Any
from urllib.parse import quote

from neo_ros.bags.damage import Damage
from neo_ros.errors import BagError

# The largest number of sqlite.
_LAST = (1 << 63) - 1
# Rows behind a damaged page are looked for one by one. Where it is known how many there are, the
# damage may be a page that many others hang on.
_MAX_MISSES, _MAX_KNOWN_MISSES = 10_000, 1_000_000
_HEADER_BYTES = 100
_TOPIC_COLUMNS = {'id': int, 'name': str, 'type': str, 'serialization_format': str}
Row = tuple[int, int, int, bytes]  # id, topic id, log time in ns, CDR
# Numbers of rows are kept as bits up to this one: 128 MiB, of which only what is used is taken.
_MOST_BITS = 1 << 30


class SqliteFile:
    """
    The messages of one .db3 file in the order of their log times.

    Damage is met in two ways: rows are read by their number where the index by time fails, and
    a file shorter than it says is opened all the same. There are no checksums in this format.
    A file that was being written to is read with its write-ahead log. `damage` is exact once
    all messages were read. Raises BagError for files that are no such database.
    """

    def __init__(self, path: Path, expected: int | None = None) -> None:
        self.path = path
        self._expected = expected
        self._damaged_at: int | None = None
        self._database = _open(path)
        try:
            # topic id -> column name -> value, and type -> (encoding, definition)
            self.topics = {row['id']: row for row in self._table('topics') if all(
                isinstance(row.get(name), kind) for name, kind in _TOPIC_COLUMNS.items())}
            self.definitions = {row.get('topic_type'): row for row in self._table(
                'message_definitions', must=False)}
            self.counts: Counter[int] = Counter()
            try:
                counts = Counter(dict(self._rows(
                    'SELECT topic_id, COUNT(*) FROM messages GROUP BY topic_id')))
                if expected is None:
                    self._expected = counts.total()
                self.counts = self._known(counts)
            except sqlite3.Error:
                self._recount()
        except sqlite3.Error as error:
            self.close()
            raise BagError(f'{path}: not a readable sqlite3 bag: {error}') from error

    def close(self) -> None:
        """Close the file."""
        self._database.close()

    @property
    def span_ns(self) -> tuple[int, int] | None:
        """First and last log time; None where that cannot be read."""
        try:
            (first, last), = self._rows('SELECT MIN(timestamp), MAX(timestamp) FROM messages '
                                        "WHERE typeof(timestamp) = 'integer'")
        except sqlite3.Error:
            stamps = [row[2] for row in self._rows_by_number(set())]
            return (min(stamps), max(stamps)) if stamps else None
        return None if first is None else (first, last)

    @property
    def damage(self) -> Damage | None:
        """What is lost, as far as the file was read; None if nothing is."""
        found = self.counts.total()
        if self._damaged_at is None and (self._expected is None or self._expected <= found):
            return None
        lost = None if self._expected is None else max(self._expected - found, 0)
        if lost == 0:
            return None
        place = '' if self._damaged_at is None else f'row {self._damaged_at}'
        return Damage(self.path.name, found, lost, place)

    def messages(self, topics: Collection[int], start_ns: int = 0,
                 stop_ns: int = _LAST) -> Iterator[tuple[int, int, bytes]]:
        """Yield (topic id, log time in ns, CDR) of these topics in [start_ns, stop_ns)."""
        marks = ','.join('?' * len(topics))
        seen = _Numbers(self._highest())
        try:
            # Not by topic: the planner must stay with the index by time.
            for row in self._database.execute(
                    'SELECT id, topic_id, timestamp, CAST(data AS BLOB) FROM messages '
                    f'WHERE +topic_id IN ({marks}) AND timestamp >= ? AND timestamp < ? '
                    'ORDER BY timestamp, id', (*topics, start_ns, min(stop_ns, _LAST))):
                if row[0] in seen or not _is_whole(row):
                    raise sqlite3.DatabaseError('the index by time is damaged')
                seen.add(row[0])
                yield row[1], row[2], row[3]
            if start_ns <= 0 and stop_ns >= _LAST and (
                    len(seen) < sum(self.counts[topic] for topic in topics)):
                raise sqlite3.DatabaseError('the index by time leaves rows out')
        except sqlite3.Error:
            for number, topic, stamp_ns, data in self._rows_by_number(seen):
                if topic in topics and start_ns <= stamp_ns < stop_ns:
                    yield topic, stamp_ns, data
            self._recount()

    def _recount(self) -> None:
        """Count what can be read, and of all that was written as far as that is known."""
        highest = self._highest()
        if self._expected is None:
            self._expected = highest
        self.counts = self._known(Counter(row[1] for row in self._rows_by_number(set())))

    def _known(self, counts: Counter[int]) -> Counter[int]:
        """Return the counts without those of topics that are lost."""
        return Counter({topic: count for topic, count in counts.items() if topic in self.topics})

    def _rows_by_number(self, seen: Container[int]) -> Iterator[Row]:
        """Yield all rows that can be read, each once, but those that were seen."""
        number, misses = 1, 0
        highest = self._highest()
        most = _MAX_MISSES if highest is None else _MAX_KNOWN_MISSES
        last = _LAST if highest is None else highest
        while misses < most and number <= last:
            # Behind damage one number at a time, until there is a row again.
            where = 'id = ?' if misses else 'id >= ? ORDER BY id'
            try:
                rows = self._database.execute(
                    'SELECT id, topic_id, timestamp, CAST(data AS BLOB) FROM messages '
                    f'WHERE {where}', (number,))
                if not misses:
                    for row in rows:
                        # A damaged page may hold any numbers, also those of rows before it.
                        if not number <= row[0] <= last:
                            continue
                        number = row[0] + 1
                        if row[0] not in seen and _is_whole(row):
                            yield row
                    return
                row = rows.fetchone()
                number, misses = number + 1, 0 if row else misses + 1
                if row and row[0] not in seen and _is_whole(row):
                    yield row
            except sqlite3.Error:
                if not misses:
                    self._damaged_at = min(self._damaged_at or number, number)
                number, misses = number + (1 if misses else 0), misses + 1

    def _highest(self) -> int | None:
        """Return the number of the last row; None where it cannot be read."""
        try:
            # The last row itself may be damaged; there are as many numbers as rows at least.
            return max(self._rows('SELECT MAX(id) FROM messages')[0][0] or 0, self._expected or 0)
        except sqlite3.Error:
            return self._expected

    def _rows(self, query: str) -> list[Any]:
        return self._database.execute(query).fetchall()

    def _table(self, name: str, must: bool = True) -> list[dict[str, Any]]:
        try:
            columns = [row[1] for row in self._rows(f'PRAGMA table_info({name})')]
            return [dict(zip(columns, row)) for row in self._rows(f'SELECT * FROM {name}')]
        except sqlite3.Error:
            if must:
                raise
            return []  # Bags before Iron have no definitions.


class _Numbers(Container[int]):
    """
    Numbers of rows, to which more are added.

    A bit for each up to `highest`, as a set would take gigabytes for ten million; a set for those
    that a damaged page makes up.
    """

    def __init__(self, highest: int | None) -> None:
        self._bits = bytearray(min(highest or 0, _MOST_BITS) // 8 + 1)
        self._others: set[int] = set()
        self._count = 0

    def __len__(self) -> int:
        return self._count

    def __contains__(self, number: object) -> bool:
        assert isinstance(number, int)
        if 0 <= number < 8 * len(self._bits):
            return bool(self._bits[number >> 3] >> (number & 7) & 1)
        return number in self._others

    def add(self, number: int) -> None:
        """Add a number that is not among them yet."""
        self._count += 1
        if 0 <= number < 8 * len(self._bits):
            self._bits[number >> 3] |= 1 << (number & 7)
        else:
            self._others.add(number)


def _is_whole(row: tuple[Any, ...]) -> bool:
    """Whether the values are those of a message; damage makes NULL or a text of a number."""
    return isinstance(row[1], int) and isinstance(row[2], int) and isinstance(row[3], bytes)


def _open(path: Path) -> sqlite3.Connection:
    """Open a database for reading only, with its log if it has one."""
    try:
        if not _is_torn(path):
            return _open_pages(path)
        # A copy without the last page: sqlite would read what is cut off as zeros. Once open, a
        # file needs no name.
        with tempfile.TemporaryDirectory(prefix='neo_ros_bag_') as folder:
            return _open_pages(_copy_whole_pages(path, Path(folder)))
    except (OSError, sqlite3.Error) as error:
        raise BagError(f'{path}: not a readable sqlite3 bag: {error}') from error


def _open_pages(path: Path) -> sqlite3.Connection:
    # A log can only be read where a file can be made beside it; without it, nothing is touched.
    if Path(f'{path}-wal').exists():
        try:
            return _connect(path, 'mode=ro')
        except sqlite3.Error:
            pass
    return _connect(path, 'mode=ro&immutable=1')


def _copy_whole_pages(path: Path, folder: Path) -> Path:
    copy = folder / 'bag.db3'
    shutil.copyfile(path, copy)
    with copy.open('r+b') as file:
        page = _page_bytes(file.read(_HEADER_BYTES))
        file.truncate(copy.stat().st_size // page * page)
    if Path(f'{path}-wal').exists():
        shutil.copyfile(f'{path}-wal', f'{copy}-wal')
    return copy


def _connect(path: Path, option: str) -> sqlite3.Connection:
    database = sqlite3.connect(f'file:{quote(str(path))}?{option}', uri=True,
                               isolation_level=None, check_same_thread=False)
    try:
        # Otherwise sqlite refuses a file that is shorter than its header says.
        database.execute('PRAGMA writable_schema = ON')
        database.execute('SELECT name FROM sqlite_master').fetchall()
    except sqlite3.Error:
        database.close()
        raise
    return database


def _page_bytes(header: bytes) -> int:
    size = int.from_bytes(header[16:18], 'big')
    return 65536 if size <= 1 else size  # 1 stands for what two bytes cannot hold.


def _is_torn(path: Path) -> bool:
    with path.open('rb') as file:
        header = file.read(_HEADER_BYTES)
    size = path.stat().st_size
    return size > _HEADER_BYTES and size % _page_bytes(header) != 0
