"""The records of an MCAP file or chunk one after the other, also past damaged places."""
from collections.abc import Callable, Container, Iterator
import re
import struct
from typing import NamedTuple
from zlib import crc32

import lz4.frame
from mcap.opcode import Opcode
import zstandard

MAGIC = b'\x89MCAP0\r\n'
# A chunk says itself how large it is when unpacked. The largest image that is read has 192 MiB.
MAX_CHUNK_BYTES = 1 << 28
HOLE = 0
RECORD_HEAD = struct.Struct('<BQ')
MESSAGE_HEAD = struct.Struct('<HIQQ')
_CHUNK_HEAD = struct.Struct('<QQQII')  # times, size, CRC, length of the compression's name
_INDEX_HEAD = struct.Struct('<HI')
_LENGTHS = {Opcode.DATA_END: 4, Opcode.FOOTER: 20}
# Records that tell their length twice.
_CHECKED = {Opcode.CHUNK, Opcode.MESSAGE_INDEX}
_KNOWN = {int(opcode) for opcode in Opcode}
_PRIVATE = 0x80
# Where reading goes on behind damage: the heads of chunks and messages, found by their bytes.
_CHUNK_SIGHT = re.compile(
    rb'\x06.{36}(?:\x00{4}|\x03\x00{3}lz4|\x04\x00{3}zstd)', re.DOTALL)
_MESSAGE_SIGHT = re.compile(rb'\x05.{5}\x00{3}', re.DOTALL)
_BLOCK, _SIGHT_BYTES = 1 << 20, 64
_MOST_EXTRA_BYTES = 16

Read = Callable[[int, int], bytes]  # (offset, count) -> as many bytes as there are


class Record(NamedTuple):
    """A record from `offset` to `end`, its content from `body`; or a HOLE that is none."""

    offset: int
    opcode: int
    body: int
    end: int


class ChunkHead(NamedTuple):
    """What stands before the data of a chunk; `data` is where they begin in its body."""

    first_ns: int
    last_ns: int
    unpacked_size: int
    crc: int
    compression: str
    data: int
    data_size: int


class Damaged(Exception):
    """A chunk whose checksum, size or compression does not hold."""


def walk(read: Read, start: int, stop: int, chunked: bool,
         channels: Container[int]) -> Iterator[Record]:
    """
    Yield the records in [start, stop) and the HOLEs between them.

    A length that is wrong leads to a place where no record begins. Reading then goes on at the
    next chunk (`chunked`), or else at the next message of one of the `channels`.
    """
    position, last = start, None
    while position < stop:
        record = _record_at(read, position, stop)
        if record is not None:
            if last is not None:
                yield last
            last, position = record, record.end
            continue
        found = _search(read, position + 1 if last is None else last.offset + 1, stop, chunked,
                        channels)
        hole = position
        if last is not None:
            inside = found is not None and found < position
            if not inside and (last.opcode in _CHECKED or _is_rest(read, position, stop)):
                yield last
            else:  # Its length was wrong: it is the damaged one.
                hole = last.offset
        last, position = None, stop if found is None else found
        yield Record(hole, HOLE, hole, position)
    if last is not None:
        yield last


def read_chunk_head(body: bytes) -> ChunkHead | None:
    """Return the head of a chunk's body; None if it cannot be one."""
    if len(body) < _CHUNK_HEAD.size:
        return None
    first, last, size, crc, name_length = _CHUNK_HEAD.unpack_from(body)
    data = _CHUNK_HEAD.size + name_length + 8
    if name_length > 16 or len(body) < data:
        return None
    name = body[_CHUNK_HEAD.size:data - 8].decode('ascii', 'replace')
    return ChunkHead(first, last, size, crc, name, data,
                     int.from_bytes(body[data - 8:data], 'little'))


def unpack_chunk(body: bytes) -> bytes:
    """
    Return the records in a chunk's body.

    Raises Damaged where checksum, size or compression do not hold. A body that is cut off gives
    what can be unpacked of it.
    """
    head = read_chunk_head(body)
    if head is None:
        raise Damaged('cut in its head')
    if head.unpacked_size > MAX_CHUNK_BYTES:
        raise Damaged(f'claims to unpack to {head.unpacked_size} bytes, more than '
                      f'{MAX_CHUNK_BYTES}')
    data = memoryview(body)[head.data:head.data + head.data_size]
    cut = len(data) < head.data_size
    if len(data) > MAX_CHUNK_BYTES:
        raise Damaged(f'has {len(data)} bytes, more than {MAX_CHUNK_BYTES}')
    try:
        content = _unpack(data, head.compression, head.unpacked_size)
    except (zstandard.ZstdError, RuntimeError, EOFError) as error:
        if cut:
            return b''
        raise Damaged(str(error)) from error
    if cut and len(content) <= head.unpacked_size:
        return content
    if len(content) != head.unpacked_size:
        raise Damaged(f'expected {head.unpacked_size} bytes, got {len(content)}')
    if head.crc and crc32(content) != head.crc:
        raise Damaged('checksum does not hold')
    return content


def read_index(body: bytes) -> tuple[int, int]:
    """Return channel id and number of messages from the start of a message index."""
    channel, size = _INDEX_HEAD.unpack_from(body)
    return channel, size // 16


def _unpack(data: memoryview, compression: str, size: int) -> bytes:
    # One byte more than promised, so that too much is noticed and never held.
    if compression == '':
        return bytes(data[:size + 1])
    if compression == 'zstd':
        return zstandard.ZstdDecompressor().stream_reader(data).read(size + 1)
    if compression == 'lz4':
        return lz4.frame.LZ4FrameDecompressor().decompress(data, max_length=size + 1)
    raise Damaged(f'unknown compression {compression!r}')


def _record_at(read: Read, position: int, stop: int) -> Record | None:
    """Return the record at a place if one can be there, as a whole."""
    head = read(position, RECORD_HEAD.size)
    if len(head) < RECORD_HEAD.size:
        return None
    opcode, length = RECORD_HEAD.unpack(head)
    body = position + RECORD_HEAD.size
    if body + length > stop or length != _LENGTHS.get(opcode, length):
        return None
    if opcode not in _KNOWN and opcode < _PRIVATE:
        return None
    if opcode == Opcode.MESSAGE and length < MESSAGE_HEAD.size:
        return None
    if opcode == Opcode.CHUNK:
        chunk = read_chunk_head(read(body, min(length, _SIGHT_BYTES)))
        if chunk is None or chunk.data + chunk.data_size != length:
            return None
    if opcode == Opcode.MESSAGE_INDEX:
        index = read(body, _INDEX_HEAD.size)
        if length < _INDEX_HEAD.size:
            return None
        # A record may be longer than what is known of it, but hardly by much.
        if not 0 <= length - len(index) - _INDEX_HEAD.unpack(index)[1] < _MOST_EXTRA_BYTES:
            return None
    return Record(position, opcode, body, body + length)


def _is_rest(read: Read, position: int, stop: int) -> bool:
    """Whether this is what a cut leaves of a record, or a record with a wrong opcode only."""
    head = read(position, RECORD_HEAD.size)
    if len(head) < RECORD_HEAD.size:
        return head[0] in _KNOWN
    if not any(head):  # The zeros that a crashed machine leaves at the end.
        return True
    opcode, length = RECORD_HEAD.unpack(head)
    end = position + RECORD_HEAD.size + length
    if opcode in _KNOWN:
        return end > stop
    return end == stop or (end < stop and _record_at(read, end, stop) is not None)


def _search(read: Read, start: int, stop: int, chunked: bool,
            channels: Container[int]) -> int | None:
    """Return where the next chunk or message begins that has another record behind it."""
    sight = _CHUNK_SIGHT if chunked else _MESSAGE_SIGHT
    for block in range(start, stop, _BLOCK):
        content = read(block, min(_BLOCK + _SIGHT_BYTES, stop - block))
        at = -1
        # Candidates may overlap.
        while (match := sight.search(content, at + 1)) is not None and match.start() < _BLOCK:
            at = match.start()
            record = _record_at(read, block + at, stop)
            if record is None:
                continue
            if record.end != stop and _record_at(read, record.end, stop) is None:
                continue
            if not chunked and int.from_bytes(read(record.body, 2), 'little') not in channels:
                continue
            return record.offset
    return None
