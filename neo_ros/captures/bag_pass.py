"""One pass over a bag, before an image is decoded: stamps, frame, calibration, poses."""
from collections import Counter
from dataclasses import dataclass, field
from pathlib import Path
from typing import Any

from neo_ros.bags.depth_topics import depth_topics
from neo_ros.bags.reading import BagReader
from neo_ros.bags.recorded_poses import PoseTopics, RecordedPoses
from neo_ros.bags.tf_tree import frame_name
from neo_ros.bags.topic import BagTopic
from neo_ros.errors import BagError, ImageRejected
from neo_ros.machine.progress import Progress
from neo_ros.messages.image_reader import is_video
from neo_ros.messages.stamps import stamp_of
import numpy as np


@dataclass
class Scan:
    """What one pass over the bag collects; images are not decoded."""

    images: list[tuple[int, int]] = field(default_factory=list)  # (stamp, place in the topic)
    depths: dict[BagTopic, list[tuple[int, int]]] = field(default_factory=dict)  # likewise
    places: Counter[BagTopic] = field(default_factory=Counter)
    damaged: Counter[str] = field(default_factory=Counter)  # messages by topic
    log_times: list[int] = field(default_factory=list)
    camera_frame: str = ''
    video: bool = False
    info: Any = None
    poses: RecordedPoses = field(default_factory=RecordedPoses)


def scan_bag(reader: BagReader, image: BagTopic, info: BagTopic | None, pose_topics: PoseTopics,
             progress: Progress) -> Scan:
    """Read stamps, frames, calibration and poses; raises BagError where two cameras share one."""
    scan = Scan(depths={topic: [] for topic in depth_topics(reader, image)})
    names = {image.name, *pose_topics.names, *(topic.name for topic in scan.depths)} | (
        {info.name} if info else set())
    total = sum(topic.count for topic in reader.topics if topic.name in names)
    for done, message in enumerate(reader.messages(names), start=1):
        topic = message.topic
        # One that cannot be decoded has its place, too.
        place = scan.places[topic]
        scan.places[topic] += 1
        progress(done, total)
        try:
            content = message.read()
        except BagError:
            scan.damaged[topic.name] += 1
            continue
        if topic == image:
            scan.images.append((stamp_of(content.header), place))
            scan.log_times.append(message.stamp_ns)
            scan.video = scan.video or _says_video(content)
            _take_frame(scan, frame_name(content.header.frame_id), reader.path, topic)
        elif topic in scan.depths:
            scan.depths[topic].append((stamp_of(content.header) or message.stamp_ns, place))
        elif topic == info:
            _take_info(scan, content, f'{reader.path}: {topic.name}')
        else:
            scan.poses.add(topic, content)
    return scan


def ordered_images(scan: Scan, image: BagTopic, notes: list[str]) -> list[tuple[int, int]]:
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


def _says_video(content: Any) -> bool:
    try:
        return is_video(content)
    except ImageRejected:  # Of a codec that is not known; the images say so when they are read.
        return False


def _take_frame(scan: Scan, frame: str, path: Path, image: BagTopic) -> None:
    if scan.camera_frame and frame and frame != scan.camera_frame:
        raise BagError(f'{path}: {image.name}: expected one frame_id, but it changes from '
                       f'{scan.camera_frame!r} to {frame!r}; two cameras on one topic? Record '
                       'each on a topic of its own')
    scan.camera_frame = scan.camera_frame or frame


def _take_info(scan: Scan, message: Any, where: str) -> None:
    if scan.info is None:
        scan.info = message
        return
    for name in ('width', 'height', 'k', 'd'):
        if not np.array_equal(getattr(scan.info, name), getattr(message, name)):
            raise BagError(f'{where}: expected one calibration, but {name} changes from '
                           f'{getattr(scan.info, name)} to {getattr(message, name)}; two '
                           'cameras on one topic?')
