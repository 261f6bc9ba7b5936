"""Which topics of a bag are a camera: its images, its calibration, its wide truth."""
from types import SimpleNamespace
from typing import Any

from neo_ros.bags.foxglove import VIDEO
from neo_ros.bags.reading import BagReader, PACKET
from neo_ros.bags.tf_tree import frame_name
from neo_ros.bags.topic import BagTopic, CDR, describe_topics, describe_unread
from neo_ros.errors import BagError, ImageRejected
from neo_ros.geometry.lens import Lens
from neo_ros.messages import camera_info_of, image_fields
from neo_ros.messages.camera_info import read_lens as info_lens
from neo_ros.messages.depth_image import COMPRESSED_DEPTH, depth_encoding
from neo_ros.messages.image_reader import ImageReader
from neo_ros.messages.stamps import stamp_of

IMAGE, COMPRESSED = 'sensor_msgs/msg/Image', 'sensor_msgs/msg/CompressedImage'
IMAGE_TYPES = (IMAGE, COMPRESSED, VIDEO, PACKET)
# Images that are taken at once share a stamp early: after so many of each nobody looks further.
MOST_STAMPS = 1000
CAMERA_INFO = 'sensor_msgs/msg/CameraInfo'


def find_image_topic(reader: BagReader, name: str | None) -> BagTopic:
    """
    Return the topic of this name, or the one camera of the bag.

    Without a name, topics with a camera_info beside them are preferred, and raw images to
    compressed ones of the same camera. Raises BagError that lists the choice.
    """
    topics = image_topics(reader, name)
    if name is not None:
        return topics[0]
    if not topics:
        depth = [topic for topic in reader.topics if topic.msgtype in (IMAGE, COMPRESSED)
                 and topic.count]
        found = (f'only depth: {describe_topics(depth)}' if depth else
                 describe_unread(reader.topics) or describe_topics(reader.topics))
        raise BagError(f'{reader.path}: expected a topic of type {IMAGE} or {COMPRESSED}, the '
                       f'bag has {found}')
    calibrated = [topic for topic in topics if find_info_topic(reader, topic) is not None]
    choice = calibrated or topics
    choice = without_copies(choice)
    if len(choice) > 1:
        raise BagError(f'{reader.path}: the bag has {len(choice)} cameras, choose one with '
                       f'--image-topic: {describe_topics(choice)}')
    return choice[0]


def made_topics(reader: BagReader) -> set[str]:
    """
    Return the names of what a model made of a camera, raw or compressed: it is no camera itself.

    They are told by one another: an image in a name space `wide`, and the mask of what is made up,
    or the camera beside that name space.
    """
    bases = {base_name(topic) for topic in reader.topics if topic.msgtype in IMAGE_TYPES}
    parents = {base.rpartition('/')[0] for base in bases}
    spaces = {base.removesuffix('/image') for base in bases if base.endswith('/wide/image')}
    spaces = {space for space in spaces
              if f'{space}/mask' in bases or space.removesuffix('/wide') in parents}
    return {f'{space}/{name}' for space in spaces
            for name in ('image', 'mask', 'confidence', 'depth', 'panorama', 'panorama_mask')}


def find_truth_topic(reader: BagReader, camera: BagTopic, size: tuple[int, int] | None
                     ) -> BagTopic | None:
    """
    Return the one topic that shows what `camera` does in this width and height; no model made it.

    It has the frame of the camera: another camera of the robot may have this size. And an image
    of each must have one stamp, which alone decides where drivers name no frame.
    """
    frame = first_frame(reader, camera)
    found = [topic for topic in image_topics(reader, None)
             if topic != camera and first_frame(reader, topic) == frame
             and first_size(reader, topic) == size]
    found = without_copies(found)
    return found[0] if len(found) == 1 and _share_a_stamp(reader, camera, found[0]) else None


def first_frame(reader: BagReader, topic: BagTopic) -> str:
    """Return the frame of a topic's first message; empty where there is none."""
    first = reader.first(topic)
    return '' if first is None else frame_name(first.header.frame_id)


def _share_a_stamp(reader: BagReader, one: BagTopic, other: BagTopic) -> bool:
    """Tell whether any of the first images of two topics were taken at once."""
    seen: dict[BagTopic, set[int]] = {one: set(), other: set()}
    for message in reader.messages([one.name, other.name]):
        if message.topic not in seen:
            continue
        try:
            stamp_ns = stamp_of(message.read().header)
        except BagError:
            continue
        seen[message.topic].add(stamp_ns)
        if all(stamp_ns in stamps for stamps in seen.values()):
            return True
        if all(len(stamps) >= min(MOST_STAMPS, topic.count)
               for topic, stamps in seen.items()):
            break
    return False


def image_topics(reader: BagReader, name: str | None) -> list[BagTopic]:
    """
    Return the topics with images of this name, or all that are not depth by their encoding.

    Without a name, what a model made is left out. Raises BagError for a wrong name.
    """
    images = [topic for topic in reader.topics if topic.msgtype in IMAGE_TYPES]
    if name is None:
        made = made_topics(reader)
        return [topic for topic in images if topic.count and base_name(topic) not in made
                and not _is_depth(reader.first(topic))]
    topics = [topic for topic in images if topic.name == name]
    if not topics:
        unread = describe_unread(topic for topic in reader.topics if topic.name == name)
        raise BagError(f'{reader.path}: expected images on {name}, '
                       f'{f"got {unread}" if unread else "the bag has "}'
                       f'{"" if unread else describe_topics(images or reader.topics)}')
    return topics


def _is_depth(message: Any) -> bool:
    return depth_encoding(message) is not None or (
        COMPRESSED_DEPTH in getattr(message, 'format', ''))


def first_size(reader: BagReader, topic: BagTopic) -> tuple[int, int] | None:
    """Return width and height of the topic's first image that can be read."""
    images = ImageReader(depth_as_grey=True)
    for message in reader.messages([topic.name]):
        if message.topic != topic:
            continue
        try:
            height, width = images.read(message.read()).shape[:2]
            return width, height
        except ImageRejected as rejection:
            if rejection.reason == 'encoding':  # The same for all images of the topic.
                return None
        except BagError:
            continue
    return None


def as_raw_image(message: Any, topic: BagTopic, images: ImageReader) -> Any:
    """
    Return an image that is compressed in any way with the fields of an Image; others as they are.

    images: of this topic; a video needs every message in its order. Raises ImageRejected as
    `ImageReader.read` does.
    """
    if topic.msgtype not in IMAGE_TYPES or topic.msgtype == IMAGE:
        return message
    return SimpleNamespace(header=message.header, **image_fields(images.read(message)))


def find_info_topic(reader: BagReader, image: BagTopic,
                    name: str | None = None) -> BagTopic | None:
    """
    Return the camera_info of this name, or the one beside an image topic.

    '.../image/compressed' counts as its raw topic. Foxglove's calibrations have no usual name:
    the one of the images' frame is taken. Raises BagError for a wrong name.
    """
    infos = info_topics(reader)
    if name is not None:
        named = [topic for topic in infos if topic.name == name]
        if not named:
            raise BagError(f'{reader.path}: --info-topic: expected a {CAMERA_INFO} on {name}, '
                           f'the bag has {describe_topics(infos or reader.topics)}')
        return named[0]
    base = base_name(image)
    wanted = {f'{base.rpartition("/")[0]}/camera_info', f'{base}/camera_info'}
    beside = [topic for topic in infos if topic.name in wanted]
    if not beside and image.encoding != CDR:
        beside = same_frame(reader, image, infos)
        beside = beside if len(beside) == 1 else []
    return beside[0] if beside else None


def info_topics(reader: BagReader) -> list[BagTopic]:
    """Return all calibrations of a bag."""
    return [topic for topic in reader.topics if topic.msgtype == CAMERA_INFO and topic.count]


def same_frame(reader: BagReader, image: BagTopic, infos: list[BagTopic]) -> list[BagTopic]:
    """Return the calibrations whose frame is the one of the images."""
    wanted = first_frame(reader, image)
    return [topic for topic in infos if wanted and first_frame(reader, topic) == wanted]


def is_calibrated(message: Any, image: BagTopic) -> bool:
    """Tell whether a CameraInfo says a camera at all: usb_cam publishes one of zeros."""
    info = camera_info_of(message, image.name)
    return bool(info.width and info.height and any(info.k[:1]))


def calibrated_topics(reader: BagReader, image: BagTopic) -> list[BagTopic]:
    """Return the calibrations of a bag that say a camera."""
    return [topic for topic in info_topics(reader)
            if (first := reader.first(topic)) is None or is_calibrated(first, image)]


def read_lens(message: Any, image: BagTopic, where: str) -> Lens:
    """
    Return the lens of a CameraInfo for these images, ROI and binning folded in.

    Raises BagError for cameras without calibration and for distortion models that are not known.
    """
    try:
        return info_lens(camera_info_of(message, image.name))
    except ImageRejected as error:
        raise BagError(f'{where}: {error}') from error


def without_copies(topics: list[BagTopic]) -> list[BagTopic]:
    """Leave out the compressed images that are there raw, too."""
    raw = {topic.name for topic in topics if topic.msgtype == IMAGE}
    return [topic for topic in topics if topic.msgtype == IMAGE or base_name(topic) not in raw]


def base_name(image: BagTopic) -> str:
    """Return the name of the raw image topic that a compressed one belongs to."""
    return image.name if image.msgtype == IMAGE else image.name.rpartition('/')[0]
