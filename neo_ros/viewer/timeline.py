"""What is known of the pictures of a bag over its time: guided, agreement, scores, rejects."""
from collections.abc import Mapping
import math
from pathlib import Path
import threading
from typing import Any

from neo_ros.bags import BagReader
from neo_ros.bags.reading import BagMessage
from neo_ros.errors import BagError, ImageRejected
from neo_ros.messages.stamps import NS_PER_S, stamp_of
from neo_ros.viewer.wide_topics import (
    GUIDED, NodeDiagnosis, read_grey, read_pixels, seen_share, WideTopics)
import numpy as np

# Pieces that the bag is cut into: about a pixel of a page each.
PIECES = 600
# Wide image and truth of one stamp lie next to one another in a bag.
MOST_WAITING = 4
MEANS = ('guided', 'agreement', 'unlike', 'psnr')


class Timeline:
    """
    Means of what was said of the pictures in each piece of a bag; any thread may add and look.

    guided        share of images that the scene memory guided
    agreement     of the guided ones, of the camera's image with the memory, 1 = whole
    unlike        how unlike the trained scene, 0 to 1
    psnr          dB of what lies outside of the camera's frame, where the bag has the truth
    rejects       how many images were rejected
    """

    def __init__(self, span_ns: tuple[int, int]) -> None:
        self.done = False
        self._first_ns, self._length_ns = span_ns[0], max(span_ns[1] - span_ns[0], 1)
        self._sums = {name: np.zeros((PIECES, 2)) for name in MEANS}
        self._rejects = np.zeros(PIECES, int)
        self._busy = threading.Lock()

    def piece(self, stamp_ns: int) -> int:
        """Return the piece that a log time is in."""
        share = (stamp_ns - self._first_ns) / self._length_ns
        return min(max(int(share * PIECES), 0), PIECES - 1)

    def add(self, stamp_ns: int, values: Mapping[str, float | None]) -> None:
        """Add what is known of one image, some of MEANS."""
        piece = self.piece(stamp_ns)
        with self._busy:
            for name, value in values.items():
                if value is not None:
                    self._sums[name][piece] += value, 1

    def reject(self, stamp_ns: int, count: int = 1) -> None:
        """Count rejected images."""
        with self._busy:
            self._rejects[self.piece(stamp_ns)] += count

    def has(self, stamp_ns: int, name: str) -> bool:
        """Say whether anything is known of the piece of a log time."""
        return bool(self._sums[name][self.piece(stamp_ns), 1])

    def describe(self) -> dict[str, Any]:
        """Return lists of one value a piece; None where nothing is known, or of nothing at all."""
        with self._busy:
            means = {name: [round(total / count, 4) if count else None
                            for total, count in sums.tolist()] if sums[:, 1].any() else None
                     for name, sums in self._sums.items()}
            return {'seconds': self._length_ns / NS_PER_S, 'done': self.done, **means,
                    'rejects': self._rejects.tolist()}


def read_timeline(bag: Path, timelines: Mapping[str, Timeline], truth: str | None,
                  stop: threading.Event) -> None:
    """
    Add what a bag says of its wide images, and a score for every piece where it has their truth.

    timelines: by the topic of the images. Damaged messages are left out.
    """
    with BagReader(bag) as reader:
        for image, timeline in timelines.items():
            topics = WideTopics(image)
            names = {topics.status, '/diagnostics'}
            if truth is not None:
                names |= {topics.image, topics.mask, truth}
            reading = _Reading(timeline, topics, truth)
            for message in reader.messages(names):
                if stop.is_set():
                    return
                try:
                    reading.take(message)
                except (BagError, ImageRejected):
                    pass
            timeline.done = True


class _Reading:
    """One pass through the bag."""

    def __init__(self, timeline: Timeline, topics: WideTopics, truth: str | None) -> None:
        self._timeline, self._topics, self._truth = timeline, topics, truth
        self._diagnosis = NodeDiagnosis(topics.camera)
        self._rejected: int | None = None
        self._seen: tuple[float, float, float, float] | None = None
        self._waiting: dict[str, dict[int, np.ndarray]] = {topics.image: {}, truth or '': {}}

    def take(self, message: BagMessage) -> None:
        if not self._topics.fits(message.topic):
            return
        name, timeline = message.topic.name, self._timeline
        if name == self._topics.status:
            for status in message.read().status[:1]:
                timeline.add(message.stamp_ns, values_of(
                    {entry.key: entry.value for entry in status.values}))
        elif name == '/diagnostics':
            self._take_diagnosis(message)
        elif name == self._topics.mask:
            self._seen = self._seen or seen_share(read_grey(message.read()))
        elif not timeline.has(message.stamp_ns, 'psnr'):
            self._pair(name, message)

    def _take_diagnosis(self, message: BagMessage) -> None:
        rejected = self._diagnosis.rejected(message.read().status)
        if rejected is None:
            return
        # A node that began anew counts from 0.
        if self._rejected is not None and rejected > self._rejected:
            self._timeline.reject(message.stamp_ns, rejected - self._rejected)
        self._rejected = rejected

    def _pair(self, name: str, message: BagMessage) -> None:
        content = message.read()
        stamp = stamp_of(content.header)
        other, = (waiting for topic, waiting in self._waiting.items() if topic != name)
        pixels = read_pixels(content)
        if pixels is None:
            return
        if (found := other.pop(stamp, None)) is None:
            waiting = self._waiting[name]
            waiting[stamp] = pixels
            while len(waiting) > MOST_WAITING:
                del waiting[next(iter(waiting))]
        elif found.shape == pixels.shape:
            self._timeline.add(message.stamp_ns, {'psnr': ring_psnr(found, pixels, self._seen)})


def values_of(said: Mapping[str, str]) -> dict[str, float | None]:
    """Return some of MEANS of what is said of one image, see `messages.status_lines`."""
    def number(key: str) -> float | None:
        try:
            return float(said[key])
        except (KeyError, ValueError):
            return None

    guided = said.get(GUIDED)
    return {'guided': None if guided is None else float(guided == 'true'),
            'agreement': number('agreement'), 'unlike': number('out of the scene')}


def ring_psnr(truth: np.ndarray, wide: np.ndarray,
              seen: tuple[float, float, float, float] | None) -> float:
    """
    Return dB of what lies outside of the camera's frame, of uint8 RGB images of one size.

    seen: left, top, width, height in shares of the picture; None: of the whole picture.
    """
    errors = (truth.astype(np.float32) - wide) ** 2
    if seen is not None:
        height, width = truth.shape[:2]
        left, top, w, h = (round(share * side) for share, side in
                           zip(seen, (width, height, width, height)))
        ring = np.ones((height, width), bool)
        ring[top:top + h, left:left + w] = False
        errors = errors[ring]
    return 10 * math.log10(255 ** 2 / max(float(errors.mean()), 1e-3))
