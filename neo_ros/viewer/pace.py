"""Which of two encodings a viewer gets, chosen by how long its pictures are on their way."""
from dataclasses import dataclass


@dataclass(frozen=True)
class PaceThresholds:
    """
    When pictures become smaller, and when they become full again.

    slow_s        a full picture that takes longer, beyond the round trip of a small message, is
                  half as old as one that counts as stale
    slow_in_row   one alone may be a stall of the machine
    fast_s        a full picture would take less: far enough below slow_s not to go to and fro
    fast_in_row   at 10 pictures a second a second or two of a good link
    """

    slow_s: float = 0.4
    slow_in_row: int = 2
    fast_s: float = 0.2
    fast_in_row: int = 15


class Pace:
    """Watches the confirmations of one viewer; `small` is what it should get."""

    def __init__(self, thresholds: PaceThresholds = PaceThresholds()) -> None:
        self.small = False
        self.round_trip_s = 0.0
        self._thresholds = thresholds
        self._in_row = 0

    def confirm(self, took_s: float, share: float) -> None:
        """
        Count a picture that was confirmed so long after it was sent.

        share: its bytes, as a share of those of the full picture.
        """
        limits = self._thresholds
        full_s = max(took_s - self.round_trip_s, 0.0) / share
        against = full_s < limits.fast_s if self.small else full_s > limits.slow_s
        self._in_row = self._in_row + 1 if against else 0
        if self._in_row >= (limits.fast_in_row if self.small else limits.slow_in_row):
            self.small, self._in_row = not self.small, 0
