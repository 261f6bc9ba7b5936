"""A recorded bag as a capture: images, calibration, and poses at the images' stamps."""
from collections import Counter
from collections.abc import Iterator, Sequence
from dataclasses import dataclass, field
from pathlib import Path
from typing import Any

from neo_ros.bags.camera_topics import COMPRESSED, find_image_topic, find_info_topic, read_lens
from neo_ros.bags.reading import BagReader
from neo_ros.bags.recorded_poses import (
    find_pose_source, find_pose_topics, foreign_tf, RecordedPoses, TF, TF_STATIC)
from neo_ros.bags.topic import BagTopic, describe_topics
from neo_ros.bags.transforms import frame_name, PoseSource
from neo_ros.captures.capture import Capture, CapturedFrame, ImageStream, origin_of
from neo_ros.errors import BagError, ImageRejected
from neo_ros.geometry import CameraPose
from neo_ros.machine.progress import no_progress, Progress
from neo_ros.messages import read_compressed_image, read_image
from neo_ros.messages.stamps import stamp_of
import numpy as np


@dataclass
class _Scan:
    """What one pass over the bag collects; images are not decoded."""

    images: list[tuple[int, int]] = field(default_factory=list)  # (stamp, place in the topic)
    places: int = 0
    damaged: Counter[str] = field(default_factory=Counter)  # messages by topic
    log_times: list[int] = field(default_factory=list)
    camera_frame: str = ''
    info: Any = None
    poses: RecordedPoses = field(default_factory=RecordedPoses)


def read_bag_capture(path: Path, image_topic: str | None = None,
                     pose_topic: str | None = None,
                     progress: Progress = no_progress) -> Capture:
    """
    Read the camera of a bag.

    image_topic  Image or CompressedImage; needed where a bag has several cameras
    pose_topic   /tf, or a PoseStamped, PoseWithCovarianceStamped or Odometry; by default /tf if
                 the camera's body moves in it, else the one pose topic of the bag; none: no poses
    Frames are in the order of their stamps; those without a pose are counted in the notes and
    left out. A bag without poses gives a capture without poses. Raises BagError that names the
    topics for everything that is missing, ambiguous or contradictory.
    """
    with BagReader(path) as reader:
        image = find_image_topic(reader, image_topic)
        info = find_info_topic(reader, image)
        pose_topics = find_pose_topics(reader, pose_topic)
        scan = _scan(reader, image, info, pose_topics, progress)
        notes = [reader.recovered] if reader.recovered else []
    notes += [f'{count} messages of {name} are damaged and are left out'
              for name, count in sorted(scan.damaged.items())]
    lens = None if scan.info is None or info is None else read_lens(
        scan.info, image, f'{path}: {info.name}')
    if lens is None:
        notes.append(f'{image.name} has no camera_info beside it: the camera is estimated')
    stamps = _ordered(scan, image, notes)
    source = find_pose_source(
        path, scan.poses, scan.camera_frame, pose_topic, pose_topics, foreign_tf(reader.topics),
        notes)
    frames: list[CapturedFrame] = []
    places: list[int] = []
    lost: list[int] = []
    for stamp_ns, place in stamps:
        T = None if source is None else source.at(stamp_ns)
        if source is not None and T is None:
            lost.append(stamp_ns)
            continue
        frames.append(CapturedFrame(f'images/{len(frames):06d}.png',
                                    None if T is None else CameraPose(T), lens, 0, stamp_ns))
        places.append(place)
    gaps = '' if source is None else _gaps(source, lost, pose_topics)
    if not frames:
        raise BagError(f'{path}: no image of {image.name} has a pose near its stamp; '
                       f'{gaps or "do images and poses have the same clock?"}')
    if lost:
        notes.append(f'{len(lost)} of {len(stamps)} images have no pose near their stamp and are '
                     f'left out{gaps and "; "}{gaps}')
    if source is not None and lens is None:
        infos = _info_topics(path)
        raise BagError(f'{path}: expected a camera_info beside {image.name}, the poses need the '
                       'calibration that belongs to them; the bag has '
                       f'{describe_topics(infos) if infos else "no CameraInfo topic"}')
    stream = _stream(path, image, places)
    next(stream([0]), None)  # What cannot be decoded at all is refused before anything is written.
    return Capture(tuple(frames), tuple(notes), stream, origin_of(path),
                   z_up=source is not None)  # REP-103


def _scan(reader: BagReader, image: BagTopic, info: BagTopic | None,
          pose_topics: list[BagTopic], progress: Progress) -> _Scan:
    scan = _Scan()
    names = {image.name, TF, TF_STATIC, *(topic.name for topic in pose_topics)} | (
        {info.name} if info else set())
    total = sum(topic.count for topic in reader.topics if topic.name in names)
    for done, message in enumerate(reader.messages(names), start=1):
        topic = message.topic
        # One that cannot be decoded has its place, too.
        place, scan.places = scan.places, scan.places + (topic == image)
        progress(done, total)
        try:
            content = message.read()
        except BagError:
            scan.damaged[topic.name] += 1
            continue
        if topic == image:
            scan.images.append((stamp_of(content.header), place))
            scan.log_times.append(message.stamp_ns)
            _take_frame(scan, frame_name(content.header.frame_id), reader.path, topic)
        elif topic == info:
            _take_info(scan, content, f'{reader.path}: {topic.name}')
        else:
            scan.poses.add(topic, content)
    return scan


def _take_frame(scan: _Scan, frame: str, path: Path, image: BagTopic) -> None:
    if scan.camera_frame and frame and frame != scan.camera_frame:
        raise BagError(f'{path}: {image.name}: expected one frame_id, but it changes from '
                       f'{scan.camera_frame!r} to {frame!r}; two cameras on one topic? Record '
                       'each on a topic of its own')
    scan.camera_frame = scan.camera_frame or frame


def _take_info(scan: _Scan, message: Any, where: str) -> None:
    if scan.info is None:
        scan.info = message
        return
    for name in ('width', 'height', 'k', 'd'):
        if not np.array_equal(getattr(scan.info, name), getattr(message, name)):
            raise BagError(f'{where}: expected one calibration, but {name} changes from '
                           f'{getattr(scan.info, name)} to {getattr(message, name)}; two '
                           'cameras on one topic?')


def _ordered(scan: _Scan, image: BagTopic, notes: list[str]) -> list[tuple[int, int]]:
    """Return (stamp, place) of all images by rising stamp, each stamp once."""
    if not scan.images:
        raise BagError(f'{image.name}: expected images, the topic has none')
    images = scan.images
    if not any(stamp for stamp, _ in images):
        notes.append(f'{image.name} has no stamps: the time of recording is taken')
        images = [(log_time, place) for log_time, (_, place) in zip(scan.log_times, images)]
    ordered = sorted(images)
    if ordered != images:
        back = sum(a[0] > b[0] for a, b in zip(images, images[1:]))
        notes.append(f'{image.name}: stamps go back {back} times; images are taken in the order '
                     'of their stamps')
    unique = [entry for index, entry in enumerate(ordered)
              if index == 0 or entry[0] != ordered[index - 1][0]]
    if len(unique) < len(ordered):
        notes.append(f'{len(ordered) - len(unique)} images repeat the stamp of another one and '
                     'are left out')
    return unique


def _gaps(source: PoseSource, lost: Sequence[int], topics: Sequence[BagTopic]) -> str:
    """Say what comes too rarely for images that lack a pose, and which poses there are beside."""
    gaps = source.gaps(lost)
    others = [topic.name for topic in topics if topic.name not in dict(source.steps)]
    return f'{gaps}; other poses: --pose-topic {" or ".join(others)}' if gaps and others else gaps


def _stream(path: Path, image: BagTopic, places: Sequence[int]) -> ImageStream:
    """Return a function that reads images of the bag, in the order of the bag."""
    def read(indices: Sequence[int]) -> Iterator[tuple[int, np.ndarray | None]]:
        wanted = {places[index]: index for index in indices}
        if not wanted:
            return
        with BagReader(path) as reader:
            messages = (message for message in reader.messages({image.name})
                        if message.topic == image)
            for place, message in enumerate(messages):
                if place in wanted:
                    try:
                        picture = decode_image(message.read(), image.msgtype)
                    except ImageRejected as error:
                        raise BagError(f'{path}: {image.name}: {error}; convert the images, or '
                                       'record another topic of this camera') from error
                    yield wanted.pop(place), picture
                if not wanted:
                    return

    return read


def decode_image(message: Any, msgtype: str) -> np.ndarray | None:
    """Return RGB uint8 (H, W, 3) of an Image or CompressedImage; None if it is damaged."""
    try:
        return (read_compressed_image if msgtype == COMPRESSED else read_image)(message)
    except ImageRejected as error:
        if error.reason == 'encoding':  # The same for all images of the topic.
            raise
        return None


def _info_topics(path: Path) -> list[BagTopic]:
    with BagReader(path) as reader:
        return [topic for topic in reader.topics if topic.msgtype.endswith('CameraInfo')]
