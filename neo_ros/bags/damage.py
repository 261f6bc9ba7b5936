"""What could not be read of a bag."""
from dataclasses import dataclass


@dataclass(frozen=True)
class Damage:
    """
    What one file of a bag lost.

    recovered  messages that can be read
    lost       messages that cannot; None where nobody wrote down how many there were
    place      where the damage begins, such as 'byte 1234'; empty where that is not known
    unread     why the file is not read at all; empty where it is
    """

    file: str
    recovered: int
    lost: int | None
    place: str
    unread: str = ''

    def __str__(self) -> str:
        if self.unread:
            return f'{self.file}: {self.unread}'
        lost = 'an unknown number' if self.lost is None else str(self.lost)
        place = f', from {self.place}' if self.place else ''
        return f'{self.file}: {self.recovered} messages recovered, {lost} lost{place}'
