"""Read an MCAP file from front to back: whole, cut off, or damaged in the middle."""
from collections import Counter
from collections.abc import Collection, Iterator
import heapq
from pathlib import Path
from typing import Any

from mcap.opcode import Opcode
from mcap.records import Attachment, Metadata
from neo_ros.bags.damage import Damage
from neo_ros.bags.mcap_layout import McapLayout, McapMessage
from neo_ros.bags.mcap_records import MAX_CHUNK_BYTES

_FOREVER_NS = 1 << 64


class McapFile:
    """
    The messages of one file in the order of their log times.

    A file that was cut off or damaged is read like any other. Chunks whose checksum, size or
    compression does not hold are left out as a whole; of a chunk that is cut off, all whole
    messages are read. `damage` is exact once all messages were read. Raises BagError for files
    that are no MCAP.
    """

    def __init__(self, path: Path, expected: int | None = None) -> None:
        self.path, self._layout = path, McapLayout(path, expected)
        self.schemas, self.channels = self._layout.schemas, self._layout.channels

    def close(self) -> None:
        """Close the file."""
        self._layout.close()

    @property
    def counts(self) -> Counter[int]:
        """How many messages there are by channel id."""
        return sum((part.counts for part in self._layout.parts), Counter())

    @property
    def span_ns(self) -> tuple[int, int] | None:
        """First and last log time; None for a file without messages."""
        parts = [part for part in self._layout.parts if part.counts]
        if not parts:
            return None
        return min(part.first_ns for part in parts), max(part.last_ns for part in parts)

    @property
    def damage(self) -> Damage | None:
        """What is lost, as far as the file was read; None if nothing is."""
        layout, found = self._layout, self.counts.total()
        missing = [(part, (part.claimed or Counter()).total() - part.counts.total())
                   for part in layout.parts]
        bad = [part for part, count in missing if count > 0 or part.damaged]
        known = layout.orphans + sum(max(count, 0) for _, count in missing)
        lost: int | None = known
        if layout.expected is not None and layout.expected >= found:
            lost = layout.expected - found
        elif layout.holes or any(part.damaged and part.claimed is None for part in layout.parts):
            lost = None
        if lost == 0:
            return None
        places = [*layout.holes, *(part.offset for part in bad)]
        return Damage(self.path.name, found, lost, f'byte {min(places)}' if places else '')

    def messages(self, channels: Collection[int], start_ns: int = 0,
                 stop_ns: int = _FOREVER_NS) -> Iterator[McapMessage]:
        """Yield the messages of these channels with a log time in [start_ns, stop_ns)."""
        waiting: list[McapMessage] = []
        held = 0
        for part in sorted(self._layout.parts, key=lambda part: part.first_ns):
            if part.last_ns < start_ns or part.first_ns >= stop_ns or not (
                    part.may_hold(channels, self.channels)):
                continue
            # Chunks may overlap in time, but not so many that memory runs out.
            while waiting and (waiting[0].stamp_ns < part.first_ns or held > MAX_CHUNK_BYTES):
                message = heapq.heappop(waiting)
                held -= len(message.data)
                yield message
            for message in self._layout.load(part):
                if message.channel in channels and start_ns <= message.stamp_ns < stop_ns:
                    heapq.heappush(waiting, message)
                    held += len(message.data)
        while waiting:
            yield heapq.heappop(waiting)

    def attachments(self) -> Iterator[Attachment]:
        """Yield the files that lie beside the messages; damaged ones are left out."""
        yield from self._beside(Opcode.ATTACHMENT, Attachment)

    def metadata(self) -> Iterator[Metadata]:
        """Yield the named tables of words that lie beside the messages."""
        yield from self._beside(Opcode.METADATA, Metadata)

    def _beside(self, opcode: Opcode, kind: Any) -> Iterator[Any]:
        for record in self._layout.others:
            if record.opcode == opcode:
                found = self._layout.parse(kind, record)
                if found is not None:
                    yield found
