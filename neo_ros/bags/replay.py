"""Widen the camera of a bag without a ROS graph, with the extrapolator that the node runs."""
from collections import Counter
from collections.abc import Callable
from dataclasses import dataclass, field
from pathlib import Path
import time
from typing import Any

from neo_ros.bags.reading import BagMessage, BagReader, BagTopic, describe_topics
from neo_ros.bags.writing import BagWriter
from neo_ros.errors import BagError, ImageRejected
from neo_ros.messages import FrameProcessor, image_fields, read_image
from neo_ros.runtime import FovExtrapolator
import numpy as np

IMAGE, CAMERA_INFO = 'sensor_msgs/msg/Image', 'sensor_msgs/msg/CameraInfo'
# Truth and prediction of one stamp lie close together in a bag; unmatched ones are let go.
MAX_UNMATCHED = 64
OnPair = Callable[[int, np.ndarray, np.ndarray], None]


@dataclass
class ReplayResult:
    """What a replay did. Times in seconds; `rejected` counts messages by reason."""

    image_topic: str
    frames: int = 0
    pairs: int = 0
    rejected: Counter[str] = field(default_factory=Counter)
    wall_seconds: float = 0.0
    expand_seconds: float = 0.0
    recovered: str = ''


def replay(bag: Path | str, extrapolator: FovExtrapolator, out: Path | str,
           image_topic: str | None = None, truth_topic: str | None = None, copy: bool = True,
           on_pair: OnPair | None = None,
           on_progress: Callable[[int, int], None] | None = None) -> ReplayResult:
    """
    Write a bag with everything of `bag` (unless `copy` is off) and the wide view of its camera.

    For /camera/image_raw: /camera/wide/image, wide/mask, wide/confidence and wide/camera_info at
    the log time and with the header of each image, as the node makes them from the image and the
    newest message of /camera/camera_info. Topics of these names in `bag` are replaced.
    `image_topic` may be left out when one image topic has the model's size. With `truth_topic`
    (wide images), `on_pair(stamp_ns, truth, wide_image)` gets the images of equal header stamp.
    `on_progress(done, total)` counts messages.
    Images that cannot be used are counted by reason and skipped; raises BagError for bags,
    topics and outputs that cannot be used.
    """
    started = time.perf_counter()
    with BagReader(bag) as reader:
        source = _find_image_topic(reader, extrapolator, image_topic)
        if truth_topic is not None:
            reader.find_topic(truth_topic, IMAGE)
        result = ReplayResult(source.name, recovered=reader.recovered)
        with BagWriter(out) as writer:
            run = _Replay(reader, writer, extrapolator, source, truth_topic, on_pair, result)
            copied = [topic for topic in reader.topics if topic.name not in run.outputs]
            for topic in copied if copy else ():
                writer.copy_topic(topic)
            for done, message in enumerate(reader.messages(), 1):
                if copy and message.topic.name not in run.outputs:
                    writer.write_cdr(message.topic, message.stamp_ns, message.cdr)
                run.take(message)
                if on_progress is not None:
                    on_progress(done, reader.message_count)
    result.wall_seconds = time.perf_counter() - started
    return result


class _Replay:
    """The state of one replay: the outputs, the newest camera_info, images to be paired."""

    def __init__(self, reader: BagReader, writer: BagWriter, extrapolator: FovExtrapolator,
                 source: BagTopic, truth_topic: str | None, on_pair: OnPair | None,
                 result: ReplayResult) -> None:
        camera = source.name.rpartition('/')[0]
        self.outputs = {f'{camera}/wide/{name}': name
                        for name in ('image', 'mask', 'confidence', 'camera_info')}
        self._topics = {
            name: writer.add_topic(topic, CAMERA_INFO if name == 'camera_info' else IMAGE)
            for topic, name in self.outputs.items()}
        self._writer, self._result = writer, result
        self._target = extrapolator.expansion.target
        self._types = writer.typestore.types
        self._image_topic, self._truth_topic = source.name, truth_topic
        self._info_topic = next((topic.name for topic in reader.topics if (
            topic.name, topic.msgtype) == (f'{camera}/camera_info', CAMERA_INFO)), None)
        self._camera_info: Any = None
        self._processor = FrameProcessor(extrapolator)
        self._on_pair = on_pair
        self._unmatched: tuple[dict[int, np.ndarray], dict[int, np.ndarray]] = ({}, {})

    def take(self, message: BagMessage) -> None:
        """Do what the message's topic asks for; count what cannot be used."""
        name = message.topic.name
        try:
            if name == self._image_topic:
                self._take_image(message)
            elif name == self._info_topic:
                self._camera_info = _read(message)
            if name == self._truth_topic:
                self._take_truth(message)
        except ImageRejected as error:
            kind = 'truth_' if name == self._truth_topic else ''
            self._result.rejected[kind + error.reason] += 1

    def _take_image(self, message: BagMessage) -> None:
        """Write the outputs of one image, as the node would publish them."""
        content = _read(message)
        frame = self._processor.process(content, self._camera_info)
        self._result.expand_seconds += frame.stages_ms['infer'] / 1e3
        whole = self._types['sensor_msgs/msg/RegionOfInterest'](
            x_offset=0, y_offset=0, height=0, width=0, do_rectify=False)
        self._write('camera_info', message.stamp_ns, content.header,
                    {'binning_x': 0, 'binning_y': 0, 'roi': whole, **frame.camera_info})
        assert frame.image is not None and frame.confidence is not None
        for name, pixels in (('mask', frame.extrapolated_mask), ('confidence', frame.confidence),
                             ('image', frame.image)):
            self._write(name, message.stamp_ns, content.header, image_fields(pixels))
        self._result.frames += 1
        self._pair(0, _stamp_ns(content.header), frame.image)

    def _take_truth(self, message: BagMessage) -> None:
        content = _read(message)
        truth, target = read_image(content), self._target
        if truth.shape[:2] != (target.height, target.width):
            raise ImageRejected('size', f'truth: expected {target.width}x{target.height}, got '
                                f'{truth.shape[1]}x{truth.shape[0]}')
        self._pair(1, _stamp_ns(content.header), truth)

    def _pair(self, side: int, stamp_ns: int, image: np.ndarray) -> None:
        """Hand over the prediction (side 0) and truth (side 1) of one stamp."""
        if self._truth_topic is None:
            return
        other = self._unmatched[1 - side].pop(stamp_ns, None)
        if other is not None:
            self._result.pairs += 1
            if self._on_pair is not None:
                self._on_pair(stamp_ns, *((image, other) if side else (other, image)))
            return
        waiting = self._unmatched[side]
        waiting[stamp_ns] = image
        if len(waiting) > MAX_UNMATCHED:
            del waiting[next(iter(waiting))]

    def _write(self, name: str, stamp_ns: int, header: Any, fields: dict[str, Any]) -> None:
        topic = self._topics[name]
        self._writer.write(topic, stamp_ns, self._types[topic.msgtype](header=header, **fields))


def _read(message: BagMessage) -> Any:
    try:
        return message.read()
    except BagError as error:
        raise ImageRejected('cdr', str(error)) from error


def _stamp_ns(header: Any) -> int:
    return int(header.stamp.sec) * 1_000_000_000 + int(header.stamp.nanosec)


def _find_image_topic(reader: BagReader, extrapolator: FovExtrapolator,
                      name: str | None) -> BagTopic:
    """Return the named image topic, or the only one whose images have the model's size."""
    if name is not None:
        return reader.find_topic(name, IMAGE)
    source = extrapolator.expansion.source
    sizes: dict[BagTopic, str] = {}
    for topic in reader.topics:
        first = next(reader.messages([topic.name]), None) if topic.msgtype == IMAGE else None
        if first is not None:
            content = first.read()
            sizes[topic] = f'{content.width}x{content.height}'
    fitting = [topic for topic, size in sizes.items() if size == f'{source.width}x{source.height}']
    if len(fitting) == 1:
        return fitting[0]
    found = ', '.join(f'{topic.name} ({size})' for topic, size in sizes.items())
    raise BagError(
        f'{reader.path}: expected one image topic of {source.width}x{source.height} pixels as '
        f'the model takes, got {found or describe_topics(reader.topics)}; name one as image topic')
