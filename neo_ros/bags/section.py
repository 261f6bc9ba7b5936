"""Which part of a bag is replayed."""
from dataclasses import dataclass

from neo_ros.bags.reading import BagReader, FOREVER_NS
from neo_ros.errors import BagError
from neo_ros.messages.stamps import NS_PER_S


@dataclass(frozen=True)
class Section:
    """
    Which part of a bag is replayed.

    start_s, end_s  seconds from its first message; None = to its end
    every           widen only every so many-th image
    """

    start_s: float = 0.0
    end_s: float | None = None
    every: int = 1

    def __post_init__(self) -> None:
        end_s = float('inf') if self.end_s is None else self.end_s
        if not 0 <= self.start_s < end_s:
            raise BagError(f'start, end: expected 0 <= start < end in seconds, got '
                           f'{self.start_s} and {self.end_s}')
        if self.every < 1:
            raise BagError(f'every: expected a number >= 1, got {self.every}')

    @property
    def is_all(self) -> bool:
        """Whether no message is left out."""
        return self.start_s == 0 and self.end_s is None

    def stamps(self, reader: BagReader) -> tuple[int, int, float]:
        """Return log times [start, stop) in ns and the share of the bag; BagError if empty."""
        if self.is_all:
            return 0, FOREVER_NS, 1.0
        first_ns, last_ns = reader.span_ns
        start_ns = first_ns + round(self.start_s * NS_PER_S)
        stop_ns = FOREVER_NS if self.end_s is None else first_ns + round(self.end_s * NS_PER_S)
        if start_ns > last_ns:
            raise BagError(f'{reader.path}: start: expected less than the '
                           f'{(last_ns - first_ns) / NS_PER_S:.3f} s of the bag, got '
                           f'{self.start_s}')
        share = (min(stop_ns, last_ns) - start_ns) / max(last_ns - first_ns, 1)
        return start_ns, stop_ns, share
