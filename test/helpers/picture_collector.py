"""What a source of the viewer gives, by a clock that stands unless the source waits."""
import threading
from typing import Any

from hand_clock import HandClock
from neo_ros.viewer.hub import Source, Wanted
from neo_ros.viewer.whereabouts import Whereabouts


class Collector:
    """Stands for the hub: keeps what it gets, and ends the source after some pictures."""

    def __init__(self, count: int, confidence: bool = True) -> None:
        self.wanted = Wanted(True, confidence)
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


def collect(source: Source, count: int, confidence: bool = True) -> Collector:
    hub: Any = Collector(count, confidence)
    source.run(hub, hub.stop)
    return hub
