"""One pass over a bag: how much each topic has, and what its first message shows."""
from dataclasses import dataclass, field
import math
from typing import Any

from neo_ros.bags.camera_topics import (
    base_name, CAMERA_INFO, COMPRESSED, find_info_topic, IMAGE, image_topics, is_calibrated,
    made_topics, read_lens)
from neo_ros.bags.reading import BagMessage, BagReader
from neo_ros.bags.recorded_poses import (
    find_pose_topics, POSE_TYPES, RecordedPoses, SPARE_TYPES, TF_TYPE)
from neo_ros.bags.tf_tree import frame_name
from neo_ros.bags.topic import BagTopic
from neo_ros.errors import BagError, ImageRejected, SceneError
from neo_ros.messages.depth_image import depth_encoding, read_depth_image
from neo_ros.messages.image_reader import ImageReader

# A key frame comes every few seconds, or there is none.
MOST_TRIED = 1000


@dataclass
class TopicInfo:
    """
    A topic as it was recorded.

    rate_hz, longest_gap_s  by log time; None with fewer than two messages
    content  what its first message shows: size and encoding, camera, frames
    roles    what it can serve as: image, pose, depth or truth
    """

    name: str
    msgtype: str
    count: int = 0
    bytes: int = 0  # noqa: A003
    first_s: float = 0.0
    last_s: float = 0.0
    rate_hz: float | None = None
    longest_gap_s: float | None = None
    content: str = ''
    roles: list[str] = field(default_factory=list)


@dataclass
class BagCamera:
    """What is known of an image topic."""

    topic: BagTopic
    size: tuple[int, int] | None = None
    frame: str = ''
    calibrated: bool = False
    distorted: bool = False
    images: ImageReader = field(default_factory=ImageReader)
    info_option: str = ''


class BagScan:
    """What one pass over the bag collects; images are decoded until one shows its size."""

    def __init__(self, reader: BagReader) -> None:
        self._reader = reader
        self.infos = {topic: TopicInfo(topic.name, topic.recorded_type, content=topic.unread)
                      for topic in reader.topics}
        self.cameras = {topic: BagCamera(topic) for topic in image_topics(reader, None)}
        self._made = made_topics(reader)
        self._calibrations = {
            info: camera for camera in self.cameras.values()
            if (info := find_info_topic(reader, camera.topic)) is not None}
        self._stamps: dict[BagTopic, tuple[int, int, int]] = {}  # first, last, longest gap
        self.poses = RecordedPoses()
        self._pose_names = find_pose_topics(reader, None).names

    @property
    def span_ns(self) -> tuple[int, int]:
        """First and last log time; BagError for a bag without messages."""
        if not self._stamps:
            raise BagError(f'{self._reader.path}: expected messages, the bag has none')
        return (min(first for first, _, _ in self._stamps.values()),
                max(last for _, last, _ in self._stamps.values()))

    def take(self, message: BagMessage) -> None:
        """Count a message, and look into it where that tells something new."""
        topic, stamp_ns = message.topic, message.stamp_ns
        info = self.infos[topic]
        info.count += 1
        info.bytes += len(message.cdr)
        first, last, gap = self._stamps.get(topic, (stamp_ns, stamp_ns, 0))
        first, last, gap = min(first, stamp_ns), max(last, stamp_ns), max(gap, stamp_ns - last)
        self._stamps[topic] = first, last, gap
        info.first_s, info.last_s = first / 1e9, last / 1e9
        if info.count > 1:
            info.longest_gap_s = gap / 1e9
            info.rate_hz = (info.count - 1) / ((last - first) / 1e9) if last > first else None
        try:
            if topic.msgtype == TF_TYPE or topic.msgtype in (*POSE_TYPES, *SPARE_TYPES):
                self._take_pose(topic, message.read(), info)
            elif not info.content:
                info.content = self._describe(topic, message)
        except (BagError, ImageRejected, SceneError) as error:
            info.content = info.content or str(error)
            # The start of a recorded video builds on frames that are not there.
            if isinstance(error, ImageRejected) and error.reason == 'key_frame' and (
                    info.count < MOST_TRIED):
                info.content = ''

    def _describe(self, topic: BagTopic, message: BagMessage) -> str:
        """Say what the first message of a topic shows."""
        if topic in self.cameras:
            content, seen = message.read(), self.cameras[topic]
            seen.frame = frame_name(content.header.frame_id)
            height, width = seen.images.read(content).shape[:2]
            seen.size = width, height
            form = getattr(content, 'format', None) or content.encoding
            return f'{seen.size[0]}x{seen.size[1]} {form}, frame {seen.frame}'
        if topic.msgtype in (IMAGE, COMPRESSED):
            content = message.read()
            if base_name(topic) in self._made:
                return 'made by a model'
            height, width = read_depth_image(content).shape
            return (f'{width}x{height} {depth_encoding(content)} depth, frame '
                    f'{frame_name(content.header.frame_id)}')
        if topic.msgtype == CAMERA_INFO:
            camera = self._calibrations.get(topic)
            content, of = message.read(), camera.topic if camera else topic
            if not is_calibrated(content, of):
                return 'not calibrated'
            lens = read_lens(content, of, topic.name)
            view = lens.intrinsics
            if camera is not None:
                camera.calibrated, camera.distorted = True, not lens.is_pinhole
            kind = 'fisheye' if lens.fisheye else 'pinhole' if lens.is_pinhole else 'distorted'
            return (f'{view.width}x{view.height} {kind}, {math.degrees(view.hfov):.1f} x '
                    f'{math.degrees(view.vfov):.1f} deg, fx {view.fx:.1f} fy {view.fy:.1f} '
                    f'cx {view.cx:.1f} cy {view.cy:.1f}')
        return ''

    def _take_pose(self, topic: BagTopic, content: Any, info: TopicInfo) -> None:
        if topic.name in self._pose_names or topic.msgtype != TF_TYPE:
            self.poses.add(topic, content)
        if topic.msgtype != TF_TYPE and not info.content:
            child = getattr(content, 'child_frame_id', '')
            info.content = f'{f"{child} " if child else ""}in {content.header.frame_id}'
