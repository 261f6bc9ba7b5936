"""A record of the journal: parts of patches that are shown no more, or again."""
from collections.abc import Sequence
from dataclasses import dataclass
import struct

from neo_ros.memory.patch import MOST_BATCHES, PARTS, Patch
import numpy as np

_HEAD = struct.Struct('<qI')
# Nanoseconds after which another visit begins: images of before say nothing about now, and what
# was learnt on one visit is one state.
PAUSE_NS = 600 * 10 ** 9


@dataclass(frozen=True, eq=False)
class Turn:
    """
    Things turned out to be in another state, one that was known before.

    parts uint32 (N,), rising: PARTS times the number of the patch in the journal, and the number
    of its part. Those that were shown are hidden from now on, the others are shown again.
    """

    parts: np.ndarray
    stamp_ns: int
    batch: int

    def to_bytes(self) -> bytes:
        """Return what `from_bytes` reads."""
        return _HEAD.pack(self.stamp_ns, self.batch) + self.parts.astype('<u4').tobytes()

    @classmethod
    def from_bytes(cls, content: bytes, patches: int) -> 'Turn':
        """Read one that follows so many patches; raises ValueError or struct.error."""
        stamp_ns, batch = _HEAD.unpack_from(content)
        parts = np.frombuffer(content, '<u4', offset=_HEAD.size)
        if not len(parts) or int(parts[-1]) >= PARTS * patches or (parts[1:] <= parts[:-1]).any():
            raise ValueError('record: it turns parts that are not there')
        if batch >= MOST_BATCHES:
            raise ValueError('record: its batch is out of range')
        return cls(parts, stamp_ns, batch)


Record = Patch | Turn


def turned_by(records: Sequence[Record], patches: int) -> tuple[np.ndarray, np.ndarray]:
    """
    Return for each part of so many patches which record hid it, and which showed it again.

    int64 (PARTS * patches,) each; -1: none.
    """
    hidden, again = np.full((2, PARTS * patches), -1)
    for number, turn in enumerate(records):
        if isinstance(turn, Turn):
            shown = hidden[turn.parts] < 0
            hidden[turn.parts] = np.where(shown, number, -1)
            again[turn.parts] = np.where(shown, -1, number)
    return hidden, again
