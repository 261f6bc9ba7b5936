"""Which camera of a bag is widened."""
from dataclasses import dataclass
from pathlib import Path
from typing import Any

from neo_ros.bags.camera_topics import (
    base_name, find_info_topic, first_size, image_topics, info_topics, without_copies)
from neo_ros.bags.reading import BagReader
from neo_ros.bags.topic import BagTopic, describe_topics, describe_unread
from neo_ros.errors import BagError, ConfigError
from neo_ros.geometry import Intrinsics
from neo_ros.messages import camera_info_of
from neo_ros.messages.camera_info_file import read_camera_info_file


@dataclass(frozen=True)
class CameraSource:
    """
    Where a bag has the images of a camera, and what says its calibration; each is an option.

    image_topic  Image or CompressedImage; needed where a bag has several cameras
    info_topic   the CameraInfo of its images; by default the one beside them
    camera_info  a file with the calibration instead
    """

    image_topic: str | None = None
    info_topic: str | None = None
    camera_info: Path | None = None

    def __post_init__(self) -> None:
        if self.info_topic is not None and self.camera_info is not None:
            raise ConfigError('--info-topic, --camera-info: expected one of them, got both')


@dataclass(frozen=True)
class CameraChoice(CameraSource):
    """
    The camera that is widened, as a user names it.

    Without image_topic it is the only one with images of the model's size, or a calibration.
    rectify: take the distortion out of its images first.
    """

    rectify: bool = False


@dataclass(frozen=True)
class CameraTopics:
    """
    The camera that is widened.

    image  its images
    info   its calibration, if the bag has it and no file says it
    wide   where the wide topics go: '/camera/wide' for /camera/image_raw
    given  the calibration of a file, with the fields of a CameraInfo
    """

    image: BagTopic
    info: BagTopic | None
    wide: str
    given: Any | None = None

    def first_info(self, reader: BagReader) -> Any | None:
        """Return what the file, or the first camera_info, says of images, those before it, too."""
        first = self.given if self.info is None else reader.first(self.info)
        return None if first is None else camera_info_of(first, self.image.name)


def find_camera(reader: BagReader, source: Intrinsics, choice: CameraChoice = CameraChoice()
                ) -> CameraTopics:
    """
    Return the camera that was chosen, or the only one with images of the size of `source`.

    Where no topic has this size, the only camera with a calibration is taken: its images may be
    resampled. Of raw and compressed images of one camera, the raw ones are taken. Raises
    BagError that lists the choice, and, to rectify, where nothing says the distortion;
    ConfigError for a file that cannot be used.
    """
    wanted, name = (source.width, source.height), choice.image_topic
    sizes = {topic: first_size(reader, topic) for topic in image_topics(reader, name)}
    fitting = [topic for topic, size in sizes.items() if size == wanted or name is not None]
    fitting = fitting or [topic for topic in sizes if find_info_topic(reader, topic) is not None]
    fitting = without_copies(fitting)
    if not sizes:
        raise BagError(f'{reader.path}: expected camera images, got '
                       f'{describe_unread(reader.topics) or describe_topics(reader.topics)}')
    if len(fitting) != 1:
        listed = ', '.join(f'{topic.name} ({size[0]}x{size[1]})' if size else topic.name
                           for topic, size in sizes.items())
        raise BagError(
            f'{reader.path}: expected one image topic of {source.width}x{source.height} pixels '
            f'as the model takes, got {listed}; name one with --image-topic')
    image, = fitting
    info = find_info_topic(reader, image, choice.info_topic)
    camera = (info.name if info is not None else base_name(image)).rpartition('/')[0]
    given = None if choice.camera_info is None else _read(choice.camera_info)
    found = CameraTopics(image, info if given is None else None, f'{camera}/wide', given)
    if choice.rectify and found.first_info(reader) is None:
        infos = info_topics(reader)
        remedy = (f'choose one with --info-topic: {describe_topics(infos)}' if infos else
                  'give a file with --camera-info')
        raise BagError(f'{reader.path}: --rectify: expected a camera_info beside {image.name}, '
                       f'which says the distortion; {remedy}, or leave the option out where the '
                       'images are straight')
    return found


def _read(path: Path) -> Any:
    try:
        return read_camera_info_file(path)
    except ConfigError as error:
        raise ConfigError(f'--camera-info {error}') from error
