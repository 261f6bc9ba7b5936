"""Give the frames of a bag the depth images that were taken at their time."""
from collections.abc import Iterator, Sequence
from dataclasses import replace
from pathlib import Path

from neo_ros.bags.depth_topics import DepthChoice
from neo_ros.bags.reading import BagReader
from neo_ros.bags.topic import BagTopic
from neo_ros.captures.capture import Capture, DepthSource, ImageStream
from neo_ros.captures.stamped_poses import NEAREST_NS, nearest_within
from neo_ros.errors import BagError, ImageRejected
from neo_ros.messages.depth_image import read_depth_image
import numpy as np

# Stamp and place in its topic of each depth image.
Entries = Sequence[tuple[int, int]]


def with_depth(capture: Capture, path: Path, choice: DepthChoice, entries: Entries) -> Capture:
    """Give each frame the depth image with the nearest stamp, and say how many have one."""
    entries = sorted(entries)
    source = DepthSource(choice.unit, lens=choice.lens, T_image_depth=choice.T_image_depth)
    found = [nearest_within(entries, frame.stamp_ns or 0) for frame in capture.frames]
    paired = sum(place is not None for place in found)
    note = (f'depth from {choice.topic.name}, {choice.words}: {paired} of {len(found)} images '
            f'have one within {NEAREST_NS // 1_000_000} ms')
    if not paired:
        note += '; are both on one clock?'
    return replace(
        capture, notes=(*capture.notes, note), frames=tuple(
            replace(frame, depth=None if place is None else source)
            for frame, place in zip(capture.frames, found)),
        depth_stream=_stream(path, choice.topic, found))


def _stream(path: Path, topic: BagTopic, places: Sequence[int | None]) -> ImageStream:
    """Return a function that reads depth images of the bag, in the order of the bag."""
    def read(indices: Sequence[int]) -> Iterator[tuple[int, np.ndarray | None]]:
        # Two frames may have the same depth image.
        wanted: dict[int, list[int]] = {}
        for index in indices:
            place = places[index]
            if place is not None:
                wanted.setdefault(place, []).append(index)
        if not wanted:
            return
        with BagReader(path) as reader:
            messages = (message for message in reader.messages({topic.name})
                        if message.topic == topic)
            for place, message in enumerate(messages):
                if place not in wanted:
                    continue
                try:
                    numbers = read_depth_image(message.read())
                except (BagError, ImageRejected):
                    numbers = None
                yield from ((index, numbers) for index in wanted.pop(place))
                if not wanted:
                    return

    return read
