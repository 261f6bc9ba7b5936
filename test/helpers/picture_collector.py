"""What a source of the viewer gives, by a clock that stands unless the source waits."""
import threading
from typing import Any

from hand_clock import HandClock
from neo_ros.viewer.hub import Source, Wanted
from neo_ros.viewer.whereabouts import Whereabouts


class Collector:
    """Stands for the hub: keeps what it gets, and ends the source after some pictures."""

    def __init__(self, count: int, again: bool = False) -> None:
        self.wanted = Wanted(True, True)
        self.playback: Any = None
        self.changes, self._again = 0, again
        self.where = Whereabouts()
        self.pictures: list = []
        self.times: list[float] = []
        self.states: list = []
        # What was said last until the next picture came, by the picture's number.
        self.at_pictures: dict[int, Any] = {}
        self.stop = threading.Event()
        self.clock, self.work_s = HandClock(), 0.0
        self._count = count

    def publish(self, picture) -> None:
        self.pictures.append(picture)
        self.times.append(self.clock.now())
        self.clock.turn(self.work_s)
        if len(self.pictures) >= self._count:
            self.stop.set()

    def report(self, state) -> None:
        self.at_pictures[len(self.pictures) - 1] = state
        self.states.append(state)
        if self._again and state.playback and state.playback['ended']:
            self.playback.command({'play': True})

    @property
    def numbers(self) -> list[float]:
        """When the pictures were recorded, in seconds from the start."""
        return [round(picture.recorded - self.states[0].span[0], 3) for picture in self.pictures]


def collect(source: Source, count: int, again: bool = False) -> Collector:
    """Take so many pictures; `again`: at the end of a bag begin anew."""
    hub: Any = Collector(count, again)
    source.run(hub, hub.stop)
    return hub
