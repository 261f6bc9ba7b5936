"""What is in a bag, what of it can serve the training or the replay, and what to do next."""
from dataclasses import dataclass, field
import math
from pathlib import Path
import shlex
from typing import Any

from neo_ros.bags.camera_topics import (
    base_name, CAMERA_INFO, COMPRESSED, find_info_topic, IMAGE, image_topics, info_topics,
    made_topics, read_lens, same_frame)
from neo_ros.bags.depth_topics import find_depth
from neo_ros.bags.reading import BagReader
from neo_ros.bags.recorded_poses import (
    find_pose_source, find_pose_topics, NO_POSES, POSE_TYPES, RecordedPoses, SPARE_TYPES, TF_TYPE)
from neo_ros.bags.tf_tree import frame_name
from neo_ros.bags.topic import BagTopic, describe_topics
from neo_ros.errors import BagError, ImageRejected, SceneError
from neo_ros.geometry import ViewExpansion
from neo_ros.machine.progress import no_progress, Progress
from neo_ros.messages.depth_image import depth_encoding, read_depth_image
from neo_ros.messages.image_reader import ImageReader
from neo_ros.messages.stamps import stamp_of

# A key frame comes every few seconds, or there is none.
MOST_TRIED = 1000
IMAGE_ROLE, POSE_ROLE, DEPTH_ROLE, TRUTH_ROLE = 'image', 'pose', 'depth', 'truth'


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
class BagInfo:
    """
    A whole bag. Times of topics count from `start_ns`, the first log time.

    damages  a line per damaged file: how much was recovered and lost, and where
    notes    what stands in the way, in words
    next     the command to run next
    """

    path: str
    start_ns: int
    seconds: float
    messages: int
    damages: list[str]
    notes: list[str]
    topics: list[TopicInfo]
    next: str  # noqa: A003


@dataclass
class _Camera:
    """What is known of an image topic."""

    topic: BagTopic
    size: tuple[int, int] | None = None
    frame: str = ''
    calibrated: bool = False
    distorted: bool = False
    images: ImageReader = field(default_factory=ImageReader)
    info_option: str = ''


def read_bag_info(path: Path, model: Path | None = None, expansion: ViewExpansion | None = None,
                  progress: Progress = no_progress) -> BagInfo:
    """
    Read a whole bag and describe it.

    With `model`, a model file, and its `expansion` the command to run next is a replay, else an
    import. Raises BagError for bags that cannot be read.
    """
    with BagReader(path) as reader:
        scan = _Scan(reader)
        for done, message in enumerate(reader.messages(), 1):
            scan.take(message.topic, message.stamp_ns, message)
            progress(done, reader.message_count)
        first_ns, last_ns = scan.span_ns
        for info in scan.infos.values():
            info.first_s, info.last_s = info.first_s - first_ns / 1e9, info.last_s - first_ns / 1e9
        image = scan.find_image(expansion)
        pose, pose_option = scan.find_pose(image)
        truth = scan.find_truth(image, expansion)
        depth = scan.find_depth(image)
        for topic, role in ((pose, POSE_ROLE), (depth, DEPTH_ROLE), (truth, TRUTH_ROLE)):
            if topic is not None:
                scan.infos[topic].roles.append(role)
        command = _next_command(path, model, scan, image, pose, pose_option, truth)
        return BagInfo(
            str(path), first_ns, (last_ns - first_ns) / 1e9,
            sum(info.count for info in scan.infos.values()), list(map(str, reader.damages)),
            scan.notes, [scan.infos[topic] for topic in reader.topics], command)


class _Scan:
    """What one pass over the bag collects; images are not decoded."""

    def __init__(self, reader: BagReader) -> None:
        self._reader = reader
        self.infos = {topic: TopicInfo(topic.name, topic.recorded_type, content=topic.unread)
                      for topic in reader.topics}
        self.cameras = {topic: _Camera(topic) for topic in image_topics(reader, None)}
        self._made = made_topics(reader)
        self._calibrations = {
            info: camera for camera in self.cameras.values()
            if (info := find_info_topic(reader, camera.topic)) is not None}
        self._stamps: dict[BagTopic, tuple[int, int, int]] = {}  # first, last, longest gap
        self.poses = RecordedPoses()
        self._pose_names = find_pose_topics(reader, None).names
        self.notes: list[str] = []

    @property
    def span_ns(self) -> tuple[int, int]:
        """First and last log time; BagError for a bag without messages."""
        if not self._stamps:
            raise BagError(f'{self._reader.path}: expected messages, the bag has none')
        return (min(first for first, _, _ in self._stamps.values()),
                max(last for _, last, _ in self._stamps.values()))

    def take(self, topic: BagTopic, stamp_ns: int, message: Any) -> None:
        """Count a message, and look into it where that tells something new."""
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

    def find_image(self, expansion: ViewExpansion | None) -> _Camera | None:
        """Return the camera to be used: of the model's size, calibrated, raw before compressed."""
        readable = [camera for camera in self.cameras.values() if camera.size is not None]
        for camera in readable:
            self.infos[camera.topic].roles.append(IMAGE_ROLE)
        for camera in self.cameras.values():
            if camera.size is None:
                self.notes.append(f'{camera.topic.name} cannot be read: '
                                  f'{self.infos[camera.topic].content}')
        if not readable:
            self.notes.append('no images: neither training nor replay is possible')
            return None
        wanted = None if expansion is None else (expansion.source.width, expansion.source.height)
        ranked = sorted(readable, key=lambda camera: (
            camera.size != wanted, not camera.calibrated, camera.topic.msgtype != IMAGE,
            math.prod(camera.size or (0, 0)), camera.topic.name))
        if not ranked[0].calibrated:
            self._tell_lack_of_info(ranked[0])
        if expansion is not None and ranked[0].size != wanted:
            source = expansion.source
            self.notes.append(f'no images of {source.width}x{source.height} pixels as the model '
                              'takes; a calibrated camera that sees all of that view is resampled')
        return ranked[0]

    def _tell_lack_of_info(self, image: _Camera) -> None:
        infos = info_topics(self._reader)
        near = same_frame(self._reader, image.topic, infos)
        image.info_option = near[0].name if len(near) == 1 else ''
        others = (f', as {describe_topics(infos)} with --info-topic, or a file with --camera-info'
                  if infos else '; give a file with --camera-info')
        self.notes.append(f'{image.topic.name} has no camera_info beside it: an import with poses '
                          f'needs it{others}; an import without poses estimates the camera, a '
                          'replay trusts the size of the images')

    def find_pose(self, image: _Camera | None) -> tuple[BagTopic | None, str]:
        """
        Return where an import takes the poses from, and what --pose-topic must say for that.

        The rule is the import's own. Where it wants a choice, its words become a note, and the
        topic with most messages that it would take is proposed.
        """
        if image is None:
            return None, ''
        found = sorted((topic for topic in self.infos if topic.count and topic.msgtype in (
            TF_TYPE, *POSE_TYPES, *SPARE_TYPES)), key=lambda topic: -self.infos[topic].count)
        for wanted in (None, *(topic.name for topic in found)):
            try:
                choice = find_pose_source(
                    self._reader.path, self.poses, image.frame, wanted,
                    find_pose_topics(self._reader, wanted), [])
            except BagError as error:
                if wanted is None:
                    self.notes.append(str(error).removeprefix(f'{self._reader.path}: '))
                continue
            if choice is None:
                self.notes.append('no poses: an import computes them from the photos (structure '
                                  'from motion), at an unknown scale')
                return None, ''
            topic = next(topic for topic in found if topic.name == choice.topic)
            return topic, '' if wanted is None else wanted
        return None, NO_POSES

    def find_depth(self, image: _Camera | None) -> BagTopic | None:
        """Return the depth that an import takes with these images, by the import's own rule."""
        if image is None:
            return None
        stamp_ns = stamp_of(self._reader.first(image.topic).header)
        choice, lack = find_depth(self._reader, image.topic, self.poses.tree, [stamp_ns])
        self.notes += [lack] if lack else []
        return None if choice is None else choice.topic

    def find_truth(self, image: _Camera | None,
                   expansion: ViewExpansion | None) -> BagTopic | None:
        """Return images of the same frame that are larger: those of the model's wide size."""
        if image is None or image.size is None:
            return None
        for camera in self.cameras.values():
            if camera.size is None or camera.frame != image.frame:
                continue
            larger = camera.size != image.size and all(
                a >= b for a, b in zip(camera.size, image.size))
            if camera.size == (expansion.target.width, expansion.target.height) if (
                    expansion is not None) else larger:
                return camera.topic
        return None

    def _describe(self, topic: BagTopic, message: Any) -> str:
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
            lens = read_lens(message.read(), camera.topic if camera else topic, topic.name)
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


def _next_command(path: Path, model: Path | None, scan: _Scan, image: _Camera | None,
                  pose: BagTopic | None, pose_option: str, truth: BagTopic | None) -> str:
    """Return the command line, with topics named where there is a choice."""
    if image is None:
        return ''
    name = path.resolve().stem
    several = ['--image-topic', image.topic.name] if len(scan.cameras) > 1 else []
    if model is not None:
        score = ['--truth-topic', truth.name] if truth is not None else ['--score']
        words = ['replay', str(path), '--model', str(model), '--out', f'out/{name}_wide',
                 *several, *(['--rectify'] if image.distorted else []), *score]
    else:
        if pose is not None and not image.calibrated and not image.info_option:
            pose_option = NO_POSES
        chosen = ['--pose-topic', pose_option] if pose_option else []
        info = ['--info-topic', image.info_option] if image.info_option else []
        words = ['import', str(path), f'out/scenes/{name}', *several, *info, *chosen]
    return shlex.join(['neo', *words])
