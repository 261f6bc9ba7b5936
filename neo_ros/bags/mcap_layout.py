"""What an MCAP file consists of: its parts, definitions, index, and the holes in it."""
from collections import Counter
from collections.abc import Collection
from dataclasses import dataclass
from io import BytesIO
import os
from pathlib import Path
import struct
from typing import Any, NamedTuple
from zlib import crc32

from mcap.data_stream import ReadDataStream
from mcap.exceptions import McapError
from mcap.opcode import Opcode
from mcap.records import Channel, Schema, Statistics
from neo_ros.bags.mcap_records import (
    Damaged, HOLE, MAGIC, MESSAGE_HEAD, Read, read_chunk_head, read_index, Record, RECORD_HEAD,
    unpack_chunk, walk)
from neo_ros.errors import BagError

_FOOTER = struct.Struct('<BQQQI')
# Messages outside of chunks are taken together in stretches of this size.
_STRETCH_BYTES = 1 << 20
_UNREADABLE = (McapError, struct.error, UnicodeDecodeError, ValueError, IndexError)


class McapMessage(NamedTuple):
    """One message; `offset` and `place` say where the part lies, and the message in it."""

    stamp_ns: int
    offset: int
    place: int
    channel: int
    sequence: int
    publish_ns: int
    data: bytes


@dataclass
class Part:
    """
    A chunk, or a stretch of messages outside of chunks.

    start, end  bytes of the file: the body of a chunk, or whole records
    claimed     messages by channel, as the index behind the chunk says; None without one
    found       messages by channel that were read; None before the part was read
    """

    offset: int
    start: int
    end: int
    is_chunk: bool
    first_ns: int
    last_ns: int
    claimed: Counter[int] | None
    found: Counter[int] | None = None
    damaged: bool = False

    @property
    def counts(self) -> Counter[int]:
        """The best that is known of what is in it."""
        return self.found if self.found is not None else self.claimed or Counter()

    def may_hold(self, wanted: Collection[int], known: Collection[int]) -> bool:
        """Whether there may be messages of the wanted channels in it."""
        # An index that names unknown channels is damaged itself.
        sure = self.claimed is not None and all(channel in known for channel in self.claimed)
        return not sure or any(channel in wanted for channel in self.counts)


class McapLayout:
    """
    The layout of one file, taken from the records themselves, not from the index at the end.

    A file that was cut off or damaged is read like any other. The checksum of the summary is
    checked, that of the data section is not. Raises BagError for other files.

    parts     chunks, and stretches of messages outside of chunks, as they lie in the file
    holes     where bytes begin that are no record
    others    attachments and metadata
    orphans   messages that an index tells of, but whose chunk is not there
    expected  how many messages there should be; None where nobody says
    """

    def __init__(self, path: Path, expected: int | None = None) -> None:
        self.path = path
        self.schemas: dict[int, Schema] = {}
        self.channels: dict[int, Channel] = {}
        self.parts: list[Part] = []
        self.holes: list[int] = []
        self.others: list[Record] = []
        self.orphans = 0
        self.expected = expected
        self._descriptor = os.open(path, os.O_RDONLY)
        try:
            self._size = os.fstat(self._descriptor).st_size
            if self._read(0, len(MAGIC)) != MAGIC:
                raise BagError(f'{path}: expected an MCAP file, its first bytes are not')
            chunked = self._read_summary()
            summary = self._scan(chunked)
            self._load_undefined()
            # What no checksum vouches for defines only what nothing else does.
            known = len(self.channels) + len(self.schemas)
            for record in summary:
                self._define(self._read, record)
            if len(self.channels) + len(self.schemas) > known:
                self._load_undefined(again=True)
        except BaseException:
            self.close()
            raise

    def close(self) -> None:
        """Close the file."""
        if self._descriptor >= 0:
            os.close(self._descriptor)
            self._descriptor = -1

    def parse(self, kind: Any, record: Record) -> Any:
        """Return a record as this kind of mcap's; None if it is none."""
        return _parse(kind, self._read(record.body, record.end - record.body))

    def load(self, part: Part) -> list[McapMessage]:
        """Return the messages of a part and note how many they are."""
        messages: list[McapMessage] = []
        part.found = Counter()
        body = self._read(part.start, part.end - part.start)
        if part.is_chunk:
            try:
                body = unpack_chunk(body)
            except Damaged:
                part.damaged = True
                return messages

        def read(offset: int, count: int) -> bytes:
            return body[offset:offset + count]

        for record in walk(read, 0, len(body), False, self.channels):
            if record.opcode != Opcode.MESSAGE:
                self._define(read, record)
                continue
            channel, sequence, stamp_ns, publish_ns = MESSAGE_HEAD.unpack_from(body, record.body)
            if channel in self.channels:
                part.found[channel] += 1
                messages.append(McapMessage(
                    stamp_ns, part.offset, record.offset, channel, sequence, publish_ns,
                    body[record.body + MESSAGE_HEAD.size:record.end]))
        return messages

    def _read(self, offset: int, count: int) -> bytes:
        try:
            return os.pread(self._descriptor, count, offset)
        except OSError as error:  # of a bad sector, at any time
            raise BagError(f'{self.path}: cannot read the bag: {error.strerror}') from error

    def _read_summary(self) -> bool:
        """Take schemas, channels and counts from the file's end; return whether it has chunks."""
        end = self._size - _FOOTER.size - len(MAGIC)
        tail = self._read(max(end, 0), _FOOTER.size + len(MAGIC))
        if end < 0 or tail[_FOOTER.size:] != MAGIC:
            return True
        opcode, length, start, _, crc = _FOOTER.unpack_from(tail)
        if (opcode, length) != (Opcode.FOOTER, 20) or not 0 < start <= end:
            return True
        if crc and crc32(self._read(start, end + _FOOTER.size - 4 - start)) != crc:
            return True
        chunked = True
        for record in walk(self._read, start, end, False, ()):
            if record.opcode == Opcode.STATISTICS:
                statistics = self.parse(Statistics, record)
                if statistics is None:
                    continue
                chunked = statistics.chunk_count > 0
                total = statistics.message_count
                by_channel = statistics.channel_message_counts
                if not by_channel or sum(by_channel.values()) == total:
                    self.expected = total
            else:
                self._define(self._read, record)
        return chunked

    def _load_undefined(self, again: bool = False) -> None:
        """Read the parts that nothing is known of, or whose channels are not defined yet."""
        for part in self.parts:
            if part.claimed is None or (again and part.found is not None) or not all(
                    map(self._is_defined, part.claimed)):
                self.load(part)

    def _scan(self, chunked: bool) -> list[Record]:
        """
        Find the parts of the data section; a file cut off has no summary to say `chunked`.

        Returns the records of the summary.
        """
        summary: list[Record] = []
        chunk: Part | None = None
        complete = False
        for record in walk(self._read, len(MAGIC), self._size, chunked, self.channels):
            if record.opcode == Opcode.FOOTER:
                break
            if complete or record.opcode == Opcode.DATA_END:
                complete = True
                summary.append(record)
                continue
            if record.opcode == Opcode.MESSAGE_INDEX:
                self._take_index(record, chunk)
                continue
            chunk = None
            if record.opcode == Opcode.CHUNK:
                chunk = self._add_chunk(record.offset, record.end)
            elif record.opcode == Opcode.MESSAGE:
                self._add_message(record)
            elif record.opcode == HOLE:
                self.holes.append(record.offset)
                if self._read(record.offset, 1) == b'\x06':  # What there is of a chunk.
                    self._add_chunk(record.offset, record.end)
            elif record.opcode in (Opcode.ATTACHMENT, Opcode.METADATA):
                self.others.append(record)
            else:
                self._define(self._read, record)
        if not complete and not self.holes:
            self.holes.append(self._size)
        for part in self.parts:
            if part.claimed is not None and not part.is_chunk:
                part.found = part.claimed
        return summary

    def _add_chunk(self, offset: int, end: int) -> Part | None:
        body = offset + RECORD_HEAD.size
        head = read_chunk_head(self._read(body, 64))
        if head is None:
            return None
        self.parts.append(Part(offset, body, end, True, head.first_ns, head.last_ns, None))
        return self.parts[-1]

    def _add_message(self, record: Record) -> None:
        head = self._read(record.body, MESSAGE_HEAD.size)
        channel, _, stamp_ns, _ = MESSAGE_HEAD.unpack(head)
        last = self.parts[-1] if self.parts else None
        if last is None or last.is_chunk or last.end != record.offset or (
                record.end - last.start > _STRETCH_BYTES):
            self.parts.append(Part(record.offset, record.offset, record.end, False, stamp_ns,
                                   stamp_ns, Counter()))
            last = self.parts[-1]
        last.end = record.end
        last.first_ns, last.last_ns = min(last.first_ns, stamp_ns), max(last.last_ns, stamp_ns)
        assert last.claimed is not None
        last.claimed[channel] += 1

    def _take_index(self, record: Record, chunk: Part | None) -> None:
        channel, count = read_index(self._read(record.body, 6))
        if chunk is None:
            self.orphans += count
            self.holes.append(record.offset)
            return
        if chunk.claimed is None:
            chunk.claimed = Counter()
        if count:
            chunk.claimed[channel] += count

    def _is_defined(self, channel: int) -> bool:
        found = self.channels.get(channel)
        return found is not None and (not found.schema_id or found.schema_id in self.schemas)

    def _define(self, read: Read, record: Record) -> None:
        """Take a schema or a channel; the first one of an id holds."""
        if record.opcode not in (Opcode.SCHEMA, Opcode.CHANNEL):
            return
        known: dict[int, Schema] | dict[int, Channel] = (
            self.schemas if record.opcode == Opcode.SCHEMA else self.channels)
        kind = Schema if record.opcode == Opcode.SCHEMA else Channel
        found = _parse(kind, read(record.body, record.end - record.body))
        if found is not None:
            known.setdefault(found.id, found)


def _parse(kind: Any, body: bytes) -> Any:
    """Return the mcap record in these bytes; None if they are none."""
    try:
        return kind.read(ReadDataStream(BytesIO(body)))
    except _UNREADABLE:
        return None
