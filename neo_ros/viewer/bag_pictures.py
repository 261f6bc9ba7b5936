"""The wide pictures of one topic of a bag: as they were recorded, or as a model makes them."""
from collections import deque
from dataclasses import replace
from functools import partial
from typing import Any

from neo_ros.bags import BagTopic
from neo_ros.bags.reading import BagMessage
from neo_ros.messages import camera_info_of, FrameProcessor, SceneWatch
from neo_ros.messages.hints import read_pose
from neo_ros.messages.scene_outputs import status_lines
from neo_ros.messages.stamps import NS_PER_S, stamp_of
from neo_ros.viewer.hub import Hub
from neo_ros.viewer.pictures import SourcePicture, SourceState
from neo_ros.viewer.timeline import Timeline, values_of
from neo_ros.viewer.whereabouts import Place, PoseJoiner
from neo_ros.viewer.wide_topics import (
    NodeDiagnosis, read_grey, read_picture, read_pixels, seen_share, WideTopics)
import numpy as np

# The scores for the scene are a mean over so long, as the node's.
SCORES_S = 5.0


class BagPictures:
    """
    Makes pictures of messages, and keeps what else they say in `state`.

    image: the topic of the pictures. topics: the wide image and what lies beside it. processor:
    what widens them, `memory`: with a scene memory; None where they are wide. info: the camera's
    calibration, a topic and its first message.
    """

    def __init__(self, image: BagTopic, topics: WideTopics, state: SourceState,
                 timeline: Timeline, processor: FrameProcessor | None = None,
                 memory: bool = False, info: tuple[str, Any] = ('', None)) -> None:
        self.image, self.topics, self.state = image, topics, state
        self._timeline, self._processor, self._memory = timeline, processor, memory
        self._info_topic, self._camera_info = info
        self.read = {image.name, self._info_topic, '/diagnostics'}
        if processor is None:
            self.read |= {topics.mask, topics.confidence, topics.status, topics.pose}
        # Pictures are skipped while they are late; what else is read may be said only once.
        self.skipped = {image.name, topics.mask, topics.confidence}
        self._scores: deque[tuple[float, float]] = deque()
        self._scene_watch = SceneWatch()
        self._diagnosis = NodeDiagnosis(topics.camera)
        self._seen: tuple[float, float, float, float] | None = None
        # Of the header of the newest picture.
        self.stamp_ns = 0

    def forget(self, hub: Hub) -> None:
        """Begin anew: what comes next is of another time."""
        self._confidence: Any = None
        if self._processor is not None:
            self._processor.reset()
        hub.where.forget()
        self._joiner = PoseJoiner(hub.where)

    def take(self, message: BagMessage, due: float, hub: Hub) -> SourcePicture | None:
        """
        Return the picture of an image; of other messages take note.

        due: when it is shown, by the hub's clock. Raises ImageRejected, GeometryError and
        BagError for what cannot be used.
        """
        if not self.topics.fits(message.topic):
            return None
        name, content = message.topic.name, message.read()
        if name == '/diagnostics':
            known = self._diagnosis.read(content.status)
            # Pictures that are made here are not those that the recorded node spoke of.
            self.state = replace(self.state, **{
                key: value for key, value in known.items()
                if self._processor is None or key in ('level', 'message')})
        elif name == self.topics.status:
            self.state = replace(self.state, **self._diagnosis.read_frame(content.status))
        elif name == self._info_topic:
            self._camera_info = camera_info_of(content, self.image.name)
        elif name == self.topics.mask:
            self._seen = self._seen or seen_share(read_grey(content))
        elif name == self.topics.confidence:
            self._confidence = content
        elif name == self.topics.pose:
            self._joiner.add_pose(stamp_of(content.header), read_pose(content.pose.pose))
        else:
            self.stamp_ns = stamp_of(content.header)
            image, confidence = (
                self._recorded(content, due, hub) if self._processor is None
                else self._widen(self._processor, message, content, due, hub))
            return SourcePicture(image, due, True, confidence, self._seen,
                                 message.stamp_ns / NS_PER_S)
        return None

    def _recorded(self, content: Any, due: float, hub: Hub
                  ) -> tuple[np.ndarray | bytes, np.ndarray | None]:
        stamp_ns, confidence = stamp_of(content.header), None
        self._joiner.add_image(stamp_ns, due, partial(read_pixels, content))
        # The node and the replay write the confidence before the image of the same stamp.
        if self._confidence is not None and stamp_of(self._confidence.header) == stamp_ns:
            confidence = read_grey(self._confidence)
        return read_picture(content), confidence

    def _widen(self, processor: FrameProcessor, message: BagMessage, content: Any, due: float,
               hub: Hub) -> tuple[np.ndarray, np.ndarray | None]:
        frame = processor.process(content, self._camera_info)
        assert frame.image is not None
        if frame.out_of_scene is not None:
            self._scores.append((due, frame.out_of_scene))
            while self._scores[0][0] < due - SCORES_S:
                self._scores.popleft()
            mean = float(np.mean([score for _, score in self._scores]))
            self.state = replace(self.state, out_of_scene=self._scene_watch.update(mean))
        if self._memory:
            self.state = replace(self.state, recognised=frame.guided)
        self._timeline.add(message.stamp_ns, values_of(status_lines(frame)))
        self._seen = self._seen or seen_share(frame.extrapolated_mask)
        if frame.guide is not None:
            hub.where.put(Place(frame.guide.pose, due, lambda: frame.image))
        return frame.image, frame.confidence
