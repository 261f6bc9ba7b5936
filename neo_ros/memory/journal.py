"""The journal beside a scene memory: what has changed since it was made, record by record."""
from collections.abc import Iterable, Sequence
from contextlib import ExitStack, suppress
import errno
import fcntl
import logging
import os
from pathlib import Path
import struct
import zlib

from neo_ros.errors import ModelError
from neo_ros.machine.files import see_to_disk, whole_file
from neo_ros.machine.regular_file import open_model_file
from neo_ros.memory.patch import BROKEN, Patch
from neo_ros.memory.turn import Record, Turn

logger = logging.getLogger(__name__)
SUFFIX = '.journal'
MAGIC = b'neo_ros journal 2\n'
# Behind them the SHA-256 of the memory that it belongs to.
HEADER_BYTES = len(MAGIC) + 32
# Of a record: bytes of its content, and their CRC-32, which goes on from the record before: so
# none can be taken out, or put elsewhere. Its first byte tells what it holds.
PATCH, TURN = b'P', b'T'
_RECORD = struct.Struct('<2I')
# A journal grows no larger than this share of its memory, or so many bytes if that is more.
SHARE, LEAST_BYTES, MOST_BYTES = 0.2, 1 << 20, 64 << 20
# It is full for good where more than this share of it is left when all was taken out that was
# replaced: else that would be tried again and again, for hardly anything.
STILL_FULL = 0.8
# Turns may go on for so many bytes when it is full: a door is still shown as it was seen last.
TURN_BYTES = 1 << 16
# Of all its pictures together: a few kilobytes can hold very large ones.
MOST_PIXELS = 1 << 25
# Far above what the pictures of a patch take.
MOST_RECORD = 1 << 20


def journal_path(memory: Path) -> Path:
    """Return where the journal of a memory lies."""
    return memory.with_name(memory.name + SUFFIX)


def most_bytes(memory_bytes: int) -> int:
    """Return how large the journal of a memory of this size may grow."""
    return min(max(int(SHARE * memory_bytes), LEAST_BYTES), MOST_BYTES)


def read_journal(path: Path, memory_sha256: str) -> list[Record]:
    """
    Return what a journal holds, up to the last whole record; nothing where there is none.

    One that is of another memory, or no journal, is left aside: the memory works without. Why,
    and what was lost, is logged.
    """
    if not path.exists() or _just_begun(path, memory_sha256):
        return []
    try:
        records, end, size = _read(path, memory_sha256)
    except ModelError as error:
        logger.warning('%s; the memory works without it, neo memory forget deletes it', error)
        return []
    if end < size:
        logger.warning('%s: the last %d bytes are no whole record: they are left out', path,
                       size - end)
    return records


def write_journal(path: Path, memory_sha256: str, records: Iterable[Record]) -> None:
    """Write a journal anew, whole or not at all; raises ModelError."""
    os.close(_write_alone(path, _framed(MAGIC + bytes.fromhex(memory_sha256), records)[0]))


def compact_journal(path: Path, memory_sha256: str, most: int) -> tuple[list[Record], int]:
    """
    Take out what later patches have replaced; return what is left, and how many there were.

    Raises ModelError as `JournalWriter`: nobody may learn meanwhile.
    """
    writer = JournalWriter(path, memory_sha256, most)
    try:
        return list(writer.make_room(writer.records)), len(writer.records)
    finally:
        writer.close()


def delete_learnt(path: Path) -> None:
    """
    Delete a journal, or lights, whatever the file holds, and what a kill left of one.

    Raises ModelError where it cannot, and where another process learns into it, which would go on
    writing what nobody finds.
    """
    try:
        with ExitStack() as held:
            with suppress(FileNotFoundError, PermissionError):  # Nobody here learns into it.
                held.callback(os.close, _open_alone(path, os.O_RDONLY))
            path.unlink(missing_ok=True)
        path.with_name(f'{path.name}.partial').unlink(missing_ok=True)
    except BlockingIOError:
        raise _is_written(path) from None
    except OSError as error:
        raise ModelError(f'{path}: cannot delete: {error.strerror}') from error


class JournalWriter:
    """
    Appends to the journal of one memory; what was cut off at its end is taken away first.

    Raises ModelError where it cannot be written, is no journal of this memory, or another process
    writes it. records: what it held when it was opened; full: it takes no more, and there is
    nothing to take out.
    """

    def __init__(self, path: Path, memory_sha256: str, most: int) -> None:
        self.path, self._most, self._largest = path, most, most
        self._header, self.full = MAGIC + bytes.fromhex(memory_sha256), False
        try:
            self._file = _open_alone(path)
        except BlockingIOError:
            raise _is_written(path) from None
        except OSError as error:
            raise _cannot_write(path, error) from error
        try:
            self.records: list[Record] = []
            if _just_begun(path, memory_sha256):
                os.ftruncate(self._file, 0)
                os.pwrite(self._file, self._header, 0)
                self._end, self._check = HEADER_BYTES, zlib.crc32(self._header)
            else:
                self.records, self._end, _ = _read(path, memory_sha256)
                self._check = _framed(self._header, self.records)[1]
                os.ftruncate(self._file, self._end)
        except OSError as error:
            os.close(self._file)
            raise _cannot_write(path, error) from error
        except ModelError as error:
            os.close(self._file)
            raise ModelError(f'{error}; neo memory forget deletes it') from None
        self._pixels = sum(map(_pixels, self.records))

    def append(self, records: Iterable[Record]) -> list[Record]:
        """Add records as far as there is room, and see them to the disk; returns those added."""
        added = []
        for record in records:
            content, check = _record(record, self._check)
            pixels = self._pixels + _pixels(record)
            most = self._largest + TURN_BYTES if isinstance(record, Turn) else self._most
            if self._end + len(content) > most or pixels > MOST_PIXELS:
                self._most = self._end
                break
            if os.pwrite(self._file, content, self._end) != len(content):
                raise OSError(errno.ENOSPC, os.strerror(errno.ENOSPC))
            self._end, self._check, self._pixels = self._end + len(content), check, pixels
            added.append(record)
        os.fsync(self._file)
        return added

    def make_room(self, records: Sequence[Record]) -> Sequence[Record]:
        """
        Take out what later patches have replaced of records, all that it holds.

        Returns what is left, by whose numbers turns go then; a kill leaves the one or the other.
        Where that is hardly less it is `full`, and says so.
        """
        from neo_ros.memory.changes import without_replaced  # Its loops take a second to load.
        kept = without_replaced(records)
        content, check = _framed(self._header, kept)
        if len(content) < self._end:
            file, self._file = self._file, _write_alone(self.path, content)
            os.close(file)
            self._end, self._check, records = len(content), check, kept
            self._pixels = sum(map(_pixels, kept))
        self._most = self._largest
        self.full = max(self._end / self._largest, self._pixels / MOST_PIXELS) > STILL_FULL
        if self.full:
            logger.warning('%s: the journal is full (%d kB), and little of it was replaced: '
                           'nothing more is learnt; neo memory forget begins anew', self.path,
                           self._end >> 10)
        return records

    def close(self) -> None:
        """Let others write; it may be called twice."""
        if self._file >= 0:
            os.close(self._file)
        self._file = -1


def _write_alone(path: Path, content: bytes) -> int:
    """Write a file anew, whole or not at all; return it open, as `_open_alone` does."""
    try:
        with ExitStack() as opened:
            with whole_file(path) as partial:
                partial.write_bytes(content)
                see_to_disk(partial)  # Else a power cut could leave the name without the content.
                file = os.open(partial, os.O_RDWR)
                opened.callback(os.close, file)
                fcntl.flock(file, fcntl.LOCK_EX)  # Who waits for the name finds it taken.
            see_to_disk(path.parent)
            opened.pop_all()
            return file
    except OSError as error:
        raise _cannot_write(path, error) from error


def _open_alone(path: Path, flags: int = os.O_RDWR | os.O_CREAT) -> int:
    """Open a file that nobody else writes; raises OSError, BlockingIOError where one does."""
    while True:
        file = os.open(path, flags | os.O_NONBLOCK, 0o644)
        try:
            fcntl.flock(file, fcntl.LOCK_EX | fcntl.LOCK_NB)
            # Who had it may have put another in its place meanwhile, or deleted it.
            with suppress(FileNotFoundError):
                if os.path.samestat(os.fstat(file), os.stat(path)):
                    return file
        except BaseException:
            os.close(file)
            raise
        os.close(file)


def _just_begun(path: Path, memory_sha256: str) -> bool:
    """Tell whether a file is new, or a journal whose writer was killed while it began it."""
    try:
        if path.stat().st_size >= HEADER_BYTES or not path.is_file():
            return False
        return (MAGIC + bytes.fromhex(memory_sha256)).startswith(path.read_bytes())
    except OSError:
        return False


def _read(path: Path, memory_sha256: str) -> tuple[list[Record], int, int]:
    """Return records, the end of the last whole record, and the size; raises ModelError."""
    with open_model_file(path, 'journal') as file:
        try:
            total = os.fstat(file.fileno()).st_size
            content = file.read(min(total, MOST_BYTES + TURN_BYTES))
        except OSError as error:
            raise ModelError(f'{path}: cannot read the journal: {error.strerror}') from error
    header = MAGIC + bytes.fromhex(memory_sha256)
    if not content.startswith(MAGIC):
        raise ModelError(f'{path}: expected a journal, got something else, or one of another '
                         'version')
    if content[:HEADER_BYTES] != header:
        raise ModelError(f'{path}: expected the journal of the memory with sha256 '
                         f'{memory_sha256}, got one of another memory')
    records: list[Record] = []
    end, check, pixels, patches = HEADER_BYTES, zlib.crc32(header), 0, 0
    while end + _RECORD.size <= len(content):
        size, expected = _RECORD.unpack_from(content, end)
        start = end + _RECORD.size
        if size > min(MOST_RECORD, len(content) - start):
            break
        body = content[start:start + size]
        if zlib.crc32(body, check) != expected:
            break
        try:
            record = _read_record(body, patches)
            pixels += _pixels(record)
            if pixels > MOST_PIXELS:
                break
            if isinstance(record, Patch):
                record.pictures  # Decoded once, and kept.
                patches += 1
        except BROKEN:
            break
        records.append(record)
        end, check = start + size, expected
    return records, end, total


def _read_record(body: bytes, patches: int) -> Record:
    """Read what follows so many patches; raises one of BROKEN."""
    if body[:1] == TURN:
        return Turn.from_bytes(body[1:], patches)
    if body[:1] != PATCH:
        raise ValueError('record: of an unknown kind')
    return Patch.from_bytes(body[1:])


def _pixels(record: Record) -> int:
    return record.camera.width * record.camera.height if isinstance(record, Patch) else 0


def _record(record: Record, check: int) -> tuple[bytes, int]:
    body = (PATCH if isinstance(record, Patch) else TURN) + record.to_bytes()
    check = zlib.crc32(body, check)
    return _RECORD.pack(len(body), check) + body, check


def _framed(header: bytes, records: Iterable[Record]) -> tuple[bytes, int]:
    """Return the bytes of a whole journal, and the checksum that goes on from it."""
    parts, check = [header], zlib.crc32(header)
    for record in records:
        content, check = _record(record, check)
        parts.append(content)
    return b''.join(parts), check


def _is_written(path: Path) -> ModelError:
    return ModelError(f'{path}: another process learns into this journal; let one node learn, or '
                      'give each a copy of the model')


def _cannot_write(path: Path, error: OSError) -> ModelError:
    return ModelError(f'{path}: cannot write the journal: {error.strerror}; copy model and memory '
                      'to a folder that can be written')
