"""Pictures from a bag, with the timing that it was recorded with, over and over."""
from collections import deque
from dataclasses import replace
from functools import partial
from pathlib import Path
import threading
from typing import Any

from neo_ros.bags import BagReader, BagTopic
from neo_ros.bags.camera_topics import COMPRESSED, find_camera, IMAGE
from neo_ros.bags.reading import BagMessage
from neo_ros.errors import BagError, ConfigError, GeometryError, ImageRejected
from neo_ros.messages import camera_info_of, FrameProcessor, SceneWatch
from neo_ros.messages.stamps import NS_PER_S, stamp_of
from neo_ros.runtime import FovExtrapolator
from neo_ros.viewer.hub import Hub
from neo_ros.viewer.pictures import SourcePicture, SourceState
from neo_ros.viewer.whereabouts import Place, PoseJoiner
from neo_ros.viewer.wide_topics import (
    NodeDiagnosis, read_grey, read_picture, read_pixels, read_pose, seen_share, WideTopics)
import numpy as np

WIDE = '/wide/image'
# A picture that would come later than this after its time is left out for a newer one.
LATE_S = 0.2
# The scores for the scene are a mean over so long, as the node's.
SCORES_S = 5.0
# A bag of one picture has no duration, and must not be opened again at once.
LEAST_ROUND_S = 0.5


class BagSource:
    """
    Shows the wide pictures of a bag, or those that a model makes of its camera.

    A bag with a topic .../wide/image, as `neo replay` and `neo record` write it, is shown as it
    is; else the camera (`topic`, or the only one) is widened with the model of `model`. Raises
    BagError for bags and topics that cannot be used, ModelError for the model.
    """

    def __init__(self, bag: Path, topic: str | None, model: Path, rate: float = 1.0) -> None:
        if not rate > 0:
            raise ConfigError(f'rate: expected a number > 0, got {rate}')
        self._bag, self._rate = bag, rate
        # The model that its camera is widened with; None where it has wide images.
        self.model: Path | None = None
        self._processor: FrameProcessor | None = None
        with BagReader(bag) as reader:
            wide = _find_wide(reader, topic)
            start_ns, end_ns = reader.span_ns
            if wide is not None:
                self._image, self._info_topic = wide, ''
                self._topics = WideTopics(wide.name)
            else:
                extrapolator = FovExtrapolator.load(model)
                self.model = model
                self._memory = extrapolator.card.memory is not None
                self._processor = FrameProcessor(extrapolator)
                camera = find_camera(reader, extrapolator.expansion.source, topic)
                self._image = camera.image
                self._topics = WideTopics(f'{camera.wide}/image')
                self._info_topic = camera.info.name if camera.info is not None else ''
        self._read = {self._image.name, self._info_topic, '/diagnostics'}
        if self._processor is None:
            self._read |= {self._topics.mask, self._topics.confidence, self._topics.status,
                           self._topics.pose}
        # Pictures are skipped while nobody watches; what else is read may be said only once.
        self._skipped = {self._image.name, self._topics.mask, self._topics.confidence}
        self._state = SourceState(f'{bag.name} {self._image.name}',
                                  span=(start_ns / NS_PER_S, end_ns / NS_PER_S))
        # A recording that starts again is the same place: what was said of it stays.
        self._scores: deque[tuple[float, float]] = deque()
        self._scene_watch = SceneWatch()
        self._diagnosis = NodeDiagnosis(self._topics.camera)

    def run(self, hub: Hub, stop: threading.Event) -> None:
        """Play the bag again and again until `stop` is set."""
        while not stop.is_set():
            self._camera_info: Any = None
            self._confidence: Any = None
            self._seen: tuple[float, float, float, float] | None = None
            if self._processor is not None:
                self._processor.reset()
            hub.where.forget()
            self._joiner = PoseJoiner(hub.where)
            hub.report(self._state)
            ends = hub.clock.now() + LEAST_ROUND_S
            if not self._play(hub, stop):
                raise BagError(f'{self._bag}: no picture of {self._image.name} can be read')
            hub.clock.pause(ends - hub.clock.now(), stop)

    def _play(self, hub: Hub, stop: threading.Event) -> bool:
        """Play the bag once; return whether there was a picture in it."""
        clock, first_ns, pictures = hub.clock, None, 0
        started = clock.now()
        with BagReader(self._bag) as reader:
            for message in reader.messages(self._read):
                first_ns = message.stamp_ns if first_ns is None else first_ns
                due = started + (message.stamp_ns - first_ns) / NS_PER_S / self._rate
                if clock.pause(due - clock.now(), stop):
                    return True
                pictures += message.topic.name == self._image.name
                if message.topic.name in self._skipped and (
                        not hub.wanted.image or clock.now() - due > LATE_S):
                    continue
                try:
                    self._take(message, due, hub)
                    hub.report(self._state)
                except (ImageRejected, GeometryError, BagError) as error:
                    hub.report(replace(self._state, level=1, message=str(error)))
        return pictures > 0

    def _take(self, message: BagMessage, due: float, hub: Hub) -> None:
        name, content = message.topic.name, message.read()
        if name == '/diagnostics':
            known = self._diagnosis.read(content.status)
            # Pictures that are made here are not those that the recorded node spoke of.
            self._state = replace(self._state, **{
                key: value for key, value in known.items()
                if self._processor is None or key in ('level', 'message')})
        elif name == self._topics.status:
            self._state = replace(self._state, **self._diagnosis.read_frame(content.status))
        elif name == self._info_topic:
            self._camera_info = camera_info_of(content, self._image.name)
        elif name == self._topics.mask:
            self._seen = self._seen or seen_share(read_grey(content))
        elif name == self._topics.confidence:
            self._confidence = content
        elif name == self._topics.pose:
            self._joiner.add_pose(stamp_of(content.header), read_pose(content))
        else:
            image, confidence = (self._recorded(content, due, hub) if self._processor is None
                                 else self._widen(self._processor, content, due, hub))
            hub.publish(SourcePicture(image, due, True, confidence, self._seen,
                                      message.stamp_ns / NS_PER_S))

    def _recorded(self, content: Any, due: float, hub: Hub
                  ) -> tuple[np.ndarray | bytes, np.ndarray | None]:
        self._joiner.add_image(stamp_of(content.header), due, partial(read_pixels, content))
        confidence = None
        # The node and the replay write the confidence before the image of the same stamp.
        if (hub.wanted.confidence and self._confidence is not None
                and stamp_of(self._confidence.header) == stamp_of(content.header)):
            confidence = read_grey(self._confidence)
        return read_picture(content), confidence

    def _widen(self, processor: FrameProcessor, content: Any, due: float, hub: Hub
               ) -> tuple[np.ndarray, np.ndarray | None]:
        frame = processor.process(content, self._camera_info)
        assert frame.image is not None
        if frame.out_of_scene is not None:
            self._scores.append((due, frame.out_of_scene))
            while self._scores[0][0] < due - SCORES_S:
                self._scores.popleft()
            mean = float(np.mean([score for _, score in self._scores]))
            self._state = replace(self._state, out_of_scene=self._scene_watch.update(mean))
        if self._memory:
            self._state = replace(self._state, recognised=frame.guided)
        self._seen = self._seen or seen_share(frame.extrapolated_mask)
        if frame.guide is not None:
            hub.where.put(Place(frame.guide.pose, due, lambda: frame.image))
        return frame.image, frame.confidence


def _find_wide(reader: BagReader, name: str | None) -> BagTopic | None:
    """Return the wide images of this name, or the only ones; None where there are none."""
    wide = [topic for topic in reader.topics if topic.msgtype in (IMAGE, COMPRESSED)
            and topic.name.removesuffix('/compressed').endswith(WIDE) and topic.count
            and name in (None, topic.name)]
    raw = [topic for topic in wide if topic.msgtype == IMAGE]
    if len(raw or wide) > 1:
        raise BagError(f'{reader.path}: expected one topic *{WIDE}, the bag has '
                       f'{", ".join(topic.name for topic in wide)}; name one with --topic')
    return (raw or wide)[0] if wide else None
