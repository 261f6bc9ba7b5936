"""Photos out of a bag: images of which the scene memory knows where they were taken."""
from collections import Counter
from collections.abc import Iterator
from dataclasses import dataclass, replace
import logging
from pathlib import Path
from typing import cast, NamedTuple

import cv2
from neo_ros.bags import BagReader
from neo_ros.bags.camera_choice import CameraChoice, find_camera
from neo_ros.bags.camera_topics import as_raw_image
from neo_ros.errors import BagError, ImageRejected
from neo_ros.geometry import CameraPose
from neo_ros.machine.progress import no_progress, Progress
from neo_ros.memory.learning import LearningThresholds
from neo_ros.memory.sight import Guide
from neo_ros.messages import camera_info_of, FrameProcessor
from neo_ros.messages.camera_fit import assumed_camera
from neo_ros.messages.frame_processor import WideFrame
from neo_ros.messages.image_reader import ImageReader
from neo_ros.runtime import FovExtrapolator
import numpy as np

logger = logging.getLogger(__name__)
# Of a bag so many photos are kept at most; of a longer one those that are farther apart.
MOST_PHOTOS = 400
# Images without a pose are kept where they differ from the one before by so many grey levels.
LOST_ACROSS, LOST_APART = 16, 3.0


class LostImage(NamedTuple):
    """
    An image that the memory hardly knows, or not at all, uint8 RGB (h, w, 3), and its number.

    pose: where most of the image is something else, before a door that is open now, landmarks may
    tell it nevertheless.
    """

    image: np.ndarray
    number: int
    pose: CameraPose | None = None


@dataclass(frozen=True, eq=False)
class Drive:
    """
    Photos of a bag, uint8 RGB (h, w, 3) each, their poses, and how many images it has.

    numbers: of the photos in the bag; lost: images between them. other_light: photos were taken
    in another light than the training's. assumed: what the camera is taken for, where no
    camera_info says it.
    """

    images: list[np.ndarray]
    poses: list[CameraPose]
    seen: int
    numbers: list[int]
    lost: list[LostImage]
    other_light: bool = False
    assumed: str = ''

    def with_more(self, images: list[np.ndarray], poses: list[CameraPose],
                  numbers: list[int]) -> 'Drive':
        """Return the drive with more photos behind the others."""
        return replace(self, images=self.images + images, poses=self.poses + poses,
                       numbers=self.numbers + numbers)


def drive_through(bag: Path, extrapolator: FovExtrapolator,
                  choice: CameraChoice = CameraChoice(), progress: Progress = no_progress,
                  limits: LearningThresholds = LearningThresholds()) -> Drive:
    """
    Follow a bag's camera through the memory, and keep photos a little apart.

    In another light than the training photos' the bag is gone through twice: the second time the
    light is known, and the photos are brought into theirs. Raises BagError for bags, topics and
    images that cannot be used, and where no image is believed.
    """
    drive = _drive(bag, extrapolator, choice, progress, limits)
    if drive.assumed:
        logger.warning('%s: %s', bag, drive.assumed)
    if drive.other_light:
        drive = _drive(bag, extrapolator, choice, progress, limits)
    return drive


def _drive(bag: Path, extrapolator: FovExtrapolator, choice: CameraChoice, progress: Progress,
           limits: LearningThresholds) -> Drive:
    """Return the drive of a bag that is gone through once."""
    other, photos = False, list[tuple[np.ndarray, CameraPose, int]]()
    assumed, seen, metres, radians = '', 0, limits.metres, limits.radians
    lost, rejected = _LostImages(), Counter[str]()
    extrapolator.reset()
    with BagReader(bag) as reader:
        for frame in _frames(reader, extrapolator, choice, rejected, progress):
            seen += 1
            assumed = assumed_camera(frame.camera_note) or assumed
            guide = cast(Guide | None, frame.guide)
            assert frame.image is not None
            image = np.array(extrapolator.expansion.crop(frame.image))
            if guide is None or guide.agreement < limits.least_agreement:
                lost.add(LostImage(image, seen, None if guide is None else guide.pose))
                continue
            if photos and not guide.pose.is_apart(photos[-1][1], metres, radians):
                continue
            if guide.light is not None:
                other, image = True, _in_photos_light(image, guide.light)
            photos.append((image, guide.pose, seen))
            if len(photos) == MOST_PHOTOS:
                photos, metres, radians = photos[::2], 2 * metres, 2 * radians
    if rejected.total() > seen:
        raise BagError(f'{bag}: {rejected.total()} messages of the camera cannot be used, {seen} '
                       f'can: {rejected.most_common(1)[0][0]}')
    if not photos and not any(one.pose for one in lost.kept):
        raise BagError(f'{bag}: of {seen} images none shows the scene of '
                       f'{extrapolator.card.scene_id}; give bags of the same place and camera')
    images, poses, numbers = map(list, zip(*photos)) if photos else ([], [], [])
    return Drive(images, poses, seen, numbers, lost.kept, other, assumed)


class _LostImages:
    """Keeps images that differ; of too many every second one, and then those that differ more."""

    def __init__(self) -> None:
        self.kept: list[LostImage] = []
        self._apart, self._last = LOST_APART, np.full((LOST_ACROSS, LOST_ACROSS), np.inf)

    def add(self, one: LostImage) -> None:
        small = cv2.resize(cv2.cvtColor(one.image, cv2.COLOR_RGB2GRAY),
                           (LOST_ACROSS, LOST_ACROSS), interpolation=cv2.INTER_AREA).astype(float)
        if np.abs(small - self._last).mean() < self._apart:
            return
        self._last = small
        self.kept.append(one)
        if len(self.kept) == MOST_PHOTOS:
            self.kept, self._apart = self.kept[::2], 2 * self._apart


def _in_photos_light(image: np.ndarray, light: np.ndarray) -> np.ndarray:
    """Bring an image, uint8 RGB (h, w, 3), out of a light, see `Guide.light`."""
    return np.rint(np.clip(image / light, 0, 255)).astype(np.uint8)


def _frames(reader: BagReader, extrapolator: FovExtrapolator, choice: CameraChoice,
            rejected: Counter[str], progress: Progress) -> Iterator[WideFrame]:
    """Yield the WideFrame of each image that can be read; count why others are rejected."""
    topics = find_camera(reader, extrapolator.expansion.source, choice)
    processor, images = FrameProcessor(extrapolator, choice.rectify), ImageReader()
    info = topics.first_info(reader)
    names = [topic.name for topic in (topics.image, topics.info) if topic is not None]
    total = sum(topic.count for topic in (topics.image, topics.info) if topic is not None)
    for done, message in enumerate(reader.messages(names), 1):
        progress(min(done, total), total)
        try:
            content = as_raw_image(message.read(), message.topic, images)
            if message.topic == topics.info:
                info = camera_info_of(content, topics.image.name)
            else:
                yield processor.process(content, info)
        except (BagError, ImageRejected) as error:
            rejected[str(error)] += 1
