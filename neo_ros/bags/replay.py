"""Widen the camera of a bag without a ROS graph, with the extrapolator that the node runs."""
from collections import Counter
from collections.abc import Callable, Collection, Iterator
from dataclasses import dataclass, field
from pathlib import Path
import time
from typing import Any, NamedTuple

from neo_ros.bags.background import read_ahead, WriteBehind
from neo_ros.bags.camera_choice import CameraChoice, CameraTopics, find_camera
from neo_ros.bags.camera_topics import as_raw_image, CAMERA_INFO, IMAGE, image_topics
from neo_ros.bags.damage import Damage
from neo_ros.bags.reading import BagMessage, BagReader
from neo_ros.bags.replay_outputs import (
    bag_maker, check_outputs, DEFAULT_OUTPUTS, DIAGNOSTICS, node_name, ReplayOutputs)
from neo_ros.bags.section import Section
from neo_ros.bags.topic import BagTopic
from neo_ros.bags.writing import BagWriter
from neo_ros.errors import BagError, ImageRejected
from neo_ros.geometry import ViewExpansion
from neo_ros.machine.progress import no_progress, Progress
from neo_ros.messages import camera_info_of, FrameProcessor, image_fields, read_image
from neo_ros.messages.camera_fit import assumed_camera
from neo_ros.messages.image_reader import ImageReader
from neo_ros.messages.memory_messages import MEMORY_OUTPUTS, MemorySettings
from neo_ros.messages.scene_outputs import default_scene_frame, STATUS, WIDENING
from neo_ros.messages.stamps import stamp_of
from neo_ros.runtime import FovExtrapolator, ModelCard
import numpy as np

# A replay ends where so many images were rejected for one of these, and none was widened: what a
# calibration says holds for all images of a bag. A driver that is calibrated later is not waited
# for.
MOST_REJECTED, OF_CALIBRATION = 100, ('camera', 'camera_info')
# Truth and prediction of one stamp lie close together in a bag; unmatched ones are let go.
MAX_UNMATCHED = 64
OnImages = Callable[[int, np.ndarray, np.ndarray], None]


@dataclass
class ReplayResult:
    """
    What a replay did. Times in seconds.

    rejected  how many messages, by reason; `words` says why the first one of a reason was
    guided   frames that the scene memory guided
    assumed  what the camera is taken for, where no camera_info says it; else empty
    """

    image_topic: str
    frames: int = 0
    guided: int = 0
    pairs: int = 0
    rejected: Counter[str] = field(default_factory=Counter)
    words: dict[str, str] = field(default_factory=dict)
    wall_seconds: float = 0.0
    expand_seconds: float = 0.0
    damages: list[Damage] = field(default_factory=list)
    assumed: str = ''

    @property
    def is_hopeless(self) -> bool:
        """Whether no image was widened, and many were rejected for their calibration alone."""
        return not self.frames and len(self.rejected) == 1 and any(
            self.rejected[reason] >= MOST_REJECTED for reason in OF_CALIBRATION)


class _Decoded(NamedTuple):
    """A message, and its content where that is needed; else why it cannot be had."""

    message: BagMessage
    content: Any = None
    rejected: ImageRejected | None = None


def replay(bag: Path | str, extrapolator: FovExtrapolator, out: Path | str,
           choice: CameraChoice = CameraChoice(), truth_topic: str | None = None,
           copy: bool = True, section: Section = Section(), on_frame: OnImages | None = None,
           on_pair: OnImages | None = None, on_progress: Progress = no_progress,
           outputs: Collection[str] = DEFAULT_OUTPUTS) -> ReplayResult:
    """
    Write a bag with everything of `bag` (unless `copy` is off) and the wide view of its camera.

    For /camera/image_raw: /camera/wide/image, wide/mask, wide/confidence and wide/camera_info at
    the log time and with the header of each image, as the node makes them from the image and the
    newest message of /camera/camera_info. Topics of these names in `bag` are replaced.
    So are `outputs`, some of MEMORY_OUTPUTS, as wide/pose; /diagnostics gets what the node would
    say, in the place of what it said.
    `choice` may be left out when one camera has the model's size, or one is calibrated. Of what
    lies before a section, the latched topics are kept, with the log time of its start.

    `on_frame(stamp_ns, image, wide_image)` gets the model's input and output, RGB uint8. With
    `truth_topic` (wide images), `on_pair(stamp_ns, truth, wide_image)` gets the images of equal
    header stamp. Both are called from the thread that writes. `on_progress(done, total)` counts
    messages. Images that cannot be used are counted by reason and skipped; the replay ends early
    where the calibration lets none be used. Raises BagError for bags, topics and outputs that
    cannot be used, ConfigError for a calibration.
    """
    started = time.perf_counter()
    check_outputs(outputs)
    with BagReader(bag) as reader:
        camera = find_camera(reader, extrapolator.expansion.source, choice)
        truth = None if truth_topic is None else image_topics(reader, truth_topic)[0]
        result = ReplayResult(camera.image.name)
        start_ns, stop_ns, share = section.stamps(reader)
        custom_data = reader.custom_data if copy else None
        with BagWriter(out, custom_data=custom_data) as writer, WriteBehind() as behind:
            run = _Replay(writer, behind, FrameProcessor(extrapolator, choice.rectify),
                          extrapolator.expansion, camera, truth, result)
            run.write_memory(outputs, extrapolator.card)
            run.camera_info = camera.first_info(reader)
            run.every, run.on_frame, run.on_pair = section.every, on_frame, on_pair
            if copy:
                _copy_all_but_messages(reader, writer, run.outputs)
            total = round(reader.message_count * share)
            messages = _messages(reader, camera, truth, start_ns, stop_ns)
            for done, entry in enumerate(read_ahead(messages), 1):
                if copy:
                    run.copy(entry.message, start_ns)
                run.take(entry)
                if result.is_hopeless:
                    break
                on_progress(done if section.is_all else min(done, total - 1), total)
            if not section.is_all:
                on_progress(total, total)
        result.damages = reader.damages
    result.wall_seconds = time.perf_counter() - started
    return result


def _copy_all_but_messages(reader: BagReader, writer: BagWriter, replaced: Collection[str]
                           ) -> None:
    """Copy the topics that are not replaced, and what lies beside messages in MCAP files."""
    for topic in reader.topics:
        if topic.name not in replaced:
            writer.copy_topic(topic)
    for attachment in reader.attachments():
        writer.add_attachment(attachment)
    for record in reader.metadata():
        writer.add_metadata(record)


def _messages(reader: BagReader, camera: CameraTopics, truth: BagTopic | None, start_ns: int,
              stop_ns: int) -> Iterator[_Decoded]:
    """Yield the messages of a section, behind what of the time before it still holds."""
    wanted = {topic: ImageReader() for topic in (camera.image, camera.info, truth)
              if topic is not None}
    if start_ns:
        before = {topic.name for topic in reader.topics if topic.latched}
        newest: BagMessage | None = None
        names = before if camera.info is None else before | {camera.info.name}
        for message in reader.messages(names, 0, start_ns):
            if message.topic == camera.info:
                newest = message
            elif message.topic.name in before:
                yield _decoded(message, {})
        if newest is not None:
            yield _decoded(newest, wanted)
    for message in reader.messages(None, start_ns, stop_ns):
        yield _decoded(message, wanted)


def _decoded(message: BagMessage, wanted: dict[BagTopic, ImageReader]) -> _Decoded:
    if message.topic not in wanted:
        return _Decoded(message)
    try:
        return _Decoded(message, as_raw_image(
            message.read(), message.topic, wanted[message.topic]))
    except BagError as error:
        return _Decoded(message, rejected=ImageRejected('cdr', str(error)))
    except ImageRejected as error:
        return _Decoded(message, rejected=error)


class _Replay:
    """The state of one replay: the outputs, the newest camera_info, images to be paired."""

    def __init__(self, writer: BagWriter, behind: WriteBehind, processor: FrameProcessor,
                 expansion: ViewExpansion, camera: CameraTopics, truth: BagTopic | None,
                 result: ReplayResult) -> None:
        self.outputs = {f'{camera.wide}/{name}': name
                        for name in ('image', 'mask', 'confidence', 'camera_info')}
        self._topics = {
            name: writer.add_topic(topic, CAMERA_INFO if name == 'camera_info' else IMAGE)
            for topic, name in self.outputs.items()}
        self._writer, self._behind, self._result = writer, behind, result
        self._expansion = expansion
        self._types = writer.typestore.types
        self._camera, self._truth = camera, truth
        self.camera_info: Any = None
        self._processor = processor
        self.every = 1
        self._images = 0
        self._memory: ReplayOutputs | None = None
        self._diagnosed = f'{node_name(camera.wide)}: {WIDENING}\0'.encode()
        self.on_frame: OnImages | None = None
        self.on_pair: OnImages | None = None
        self._unmatched: tuple[dict[int, np.ndarray], dict[int, np.ndarray]] = ({}, {})

    def write_memory(self, names: Collection[str], card: ModelCard) -> None:
        """Also write these of MEMORY_OUTPUTS, and the diagnosis."""
        for name in names:
            topic = f'{self._camera.wide}/{name}'
            self.outputs[topic] = name
            self._topics[name] = self._writer.add_topic(topic, MEMORY_OUTPUTS[name])
        self._topics[DIAGNOSTICS] = self._writer.add_topic(DIAGNOSTICS, STATUS)
        settings = MemorySettings(default_scene_frame(card.arbitrary_scale),
                                  node_name(self._camera.wide))
        self._memory = ReplayOutputs(bag_maker(self._types), names, settings, self._submit,
                                     card.memory is not None)

    def copy(self, message: BagMessage, start_ns: int) -> None:
        """Copy a message, unless it is replaced; from before the section the latched ones."""
        if not self._replaces(message) and (
                message.stamp_ns >= start_ns or message.topic.latched):
            self._behind.submit(self._writer.copy, message, max(message.stamp_ns, start_ns))

    def _replaces(self, message: BagMessage) -> bool:
        """Tell whether a message says what this replay says anew."""
        if message.topic.name == DIAGNOSTICS:
            return self._diagnosed in bytes(message.cdr)
        return message.topic.name in self.outputs

    def take(self, entry: _Decoded) -> None:
        """Do what the message's topic asks for; count what cannot be used."""
        topic = entry.message.topic
        try:
            if entry.rejected is not None:
                raise entry.rejected
            if topic == self._camera.image:
                self._images += 1
                if self._images % self.every == 1 % self.every:
                    self._take_image(entry)
            elif topic == self._camera.info:
                self.camera_info = camera_info_of(entry.content, self._camera.image.name)
            if topic == self._truth:
                self._take_truth(entry.content)
        except ImageRejected as error:
            reason = ('truth_' if topic == self._truth else '') + error.reason
            self._result.rejected[reason] += 1
            self._result.words.setdefault(reason, str(error))

    def _take_image(self, entry: _Decoded) -> None:
        """Write the outputs of one image, as the node would publish them."""
        content, stamp_ns = entry.content, entry.message.stamp_ns
        frame = self._processor.process(content, self.camera_info)
        self._result.expand_seconds += frame.stages_ms['infer'] / 1e3
        assert frame.image is not None and frame.confidence is not None
        whole = self._types['sensor_msgs/msg/RegionOfInterest'](
            x_offset=0, y_offset=0, height=0, width=0, do_rectify=False)
        self._write('camera_info', stamp_ns, content.header,
                    {'binning_x': 0, 'binning_y': 0, 'roi': whole, **frame.camera_info})
        for name, pixels in (('mask', frame.extrapolated_mask), ('confidence', frame.confidence),
                             ('image', frame.image)):
            self._write(name, stamp_ns, content.header, image_fields(pixels))
        if self._memory is not None:
            self._memory.add(stamp_ns, content.header, frame, self._result.rejected)
        self._result.frames += 1
        self._result.guided += frame.guided
        self._result.assumed = assumed_camera(frame.camera_note) or self._result.assumed
        if self.on_frame is not None:
            # The camera's pixels come back unchanged: the crop is what the model saw.
            self._behind.submit(self.on_frame, stamp_of(content.header),
                                self._expansion.crop(frame.image), frame.image)
        self._pair(0, stamp_of(content.header), frame.image)

    def _take_truth(self, content: Any) -> None:
        truth, target = read_image(content), self._expansion.target
        if truth.shape[:2] != (target.height, target.width):
            raise ImageRejected('size', f'truth: expected {target.width}x{target.height}, got '
                                f'{truth.shape[1]}x{truth.shape[0]}')
        self._pair(1, stamp_of(content.header), truth)

    def _pair(self, side: int, stamp_ns: int, image: np.ndarray) -> None:
        """Hand over the prediction (side 0) and truth (side 1) of one stamp."""
        if self._truth is None:
            return
        other = self._unmatched[1 - side].pop(stamp_ns, None)
        if other is not None:
            self._result.pairs += 1
            if self.on_pair is not None:
                self._behind.submit(self.on_pair, stamp_ns,
                                    *((image, other) if side else (other, image)))
            return
        waiting = self._unmatched[side]
        waiting[stamp_ns] = image
        if len(waiting) > MAX_UNMATCHED:
            del waiting[next(iter(waiting))]

    def _write(self, name: str, stamp_ns: int, header: Any, fields: dict[str, Any]) -> None:
        self._submit(name, stamp_ns,
                     self._types[self._topics[name].msgtype](header=header, **fields))

    def _submit(self, name: str, stamp_ns: int, message: Any) -> None:
        self._behind.submit(self._writer.write, self._topics[name], stamp_ns, message)
