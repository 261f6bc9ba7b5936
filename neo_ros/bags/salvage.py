"""What is left of an MCAP file that was cut off: all complete messages up to the cut."""
from collections import Counter
from collections.abc import Iterator
from io import BytesIO
from pathlib import Path
import struct
from typing import BinaryIO, NamedTuple

import lz4.frame
from mcap.data_stream import ReadDataStream
from mcap.exceptions import McapError
from mcap.opcode import Opcode
from mcap.records import Channel, Schema
from neo_ros.errors import BagError
import zstandard

MAGIC = b'\x89MCAP0\r\n'
# A chunk says itself how large it is when unpacked; nobody records chunks of a gigabyte.
MAX_CHUNK_BYTES = 1 << 30
_RECORD_HEAD = struct.Struct('<BQ')
_MESSAGE_HEAD = struct.Struct('<HIQQ')
_CHUNK_SIZE_AT, _CHUNK_COMPRESSION_AT = 16, 28


class _Record(NamedTuple):
    offset: int
    opcode: int
    body: bytes
    complete: bool


class SalvagedMcap:
    """
    Read an MCAP file from its front, without index and summary.

    The readers of mcap and rosbags want both, and mcap's stream reader hands out the message at
    the cut with part of its bytes; here a record counts only when it is whole. Chunks that are
    cut are unpacked as far as they go.
    """

    def __init__(self, path: Path) -> None:
        self.path = path
        self.schemas: dict[int, Schema] = {}
        self.channels: dict[int, Channel] = {}
        self.counts: Counter[int] = Counter()
        # Offset of the first record that is not whole; None where the data section is complete.
        self.cut_at: int | None = None
        for channel_id, _, _ in self.messages():
            self.counts[channel_id] += 1

    @property
    def message_count(self) -> int:
        """How many messages there are before the cut."""
        return self.counts.total()

    def messages(self) -> Iterator[tuple[int, int, bytes]]:
        """Yield (channel id, log time in ns, CDR) in the order of the file."""
        size = self.path.stat().st_size
        with self.path.open('rb') as file:
            if file.read(len(MAGIC)) != MAGIC:
                raise BagError(f'{self.path}: expected an MCAP file, its first bytes are not')
            cut_at: int | None = size
            for record in _records(file, size):
                if record.opcode in (Opcode.DATA_END, Opcode.FOOTER):
                    cut_at = None
                    break
                if record.opcode == Opcode.CHUNK:
                    content = _unpack_chunk(record.body)
                    for inner in _records(BytesIO(content), len(content)):
                        yield from self._take(inner)
                else:
                    yield from self._take(record)
                if not record.complete:
                    cut_at = record.offset
            self.cut_at = cut_at

    def _take(self, record: _Record) -> Iterator[tuple[int, int, bytes]]:
        if not record.complete:
            return
        try:
            if record.opcode == Opcode.SCHEMA:
                schema = Schema.read(ReadDataStream(BytesIO(record.body)))
                self.schemas[schema.id] = schema
            elif record.opcode == Opcode.CHANNEL:
                channel = Channel.read(ReadDataStream(BytesIO(record.body)))
                self.channels[channel.id] = channel
        except (McapError, struct.error, UnicodeDecodeError):
            return
        if record.opcode == Opcode.MESSAGE and len(record.body) >= _MESSAGE_HEAD.size:
            channel_id, _, log_time, _ = _MESSAGE_HEAD.unpack_from(record.body)
            if channel_id in self.channels:
                yield channel_id, log_time, record.body[_MESSAGE_HEAD.size:]


def _records(file: BinaryIO, size: int) -> Iterator[_Record]:
    """Yield the records from here on; only the last one may be incomplete."""
    complete = True
    while complete:
        offset = file.tell()
        head = file.read(_RECORD_HEAD.size)
        # Opcode 0 does not exist: it is the zeros that a crashed machine leaves at the end.
        if len(head) < _RECORD_HEAD.size or head[0] == 0:
            yield _Record(offset, 0, b'', False)
            return
        opcode, length = _RECORD_HEAD.unpack(head)
        body = file.read(min(length, size - file.tell()))
        complete = len(body) == length
        yield _Record(offset, opcode, body, complete)


def _unpack_chunk(body: bytes) -> bytes:
    """Return the records inside a chunk, or the first part of them when the chunk is cut."""
    try:
        size, = struct.unpack_from('<Q', body, _CHUNK_SIZE_AT)
        name_length, = struct.unpack_from('<I', body, _CHUNK_COMPRESSION_AT)
    except struct.error:
        return b''
    start = _CHUNK_COMPRESSION_AT + 4 + name_length
    compression, data = body[_CHUNK_COMPRESSION_AT + 4:start], body[start + 8:]
    limit = min(size, MAX_CHUNK_BYTES)
    try:
        if compression == b'zstd':
            return zstandard.ZstdDecompressor().stream_reader(data).read(limit)
        if compression == b'lz4':
            return lz4.frame.LZ4FrameDecompressor().decompress(data, max_length=limit)
    except (zstandard.ZstdError, RuntimeError, EOFError):
        return b''
    return data if compression == b'' else b''
