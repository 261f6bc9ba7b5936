"""Photos out of a bag: images of which the scene memory knows where they were taken."""
from collections.abc import Iterator
from dataclasses import dataclass
from pathlib import Path
from typing import cast

import cv2
from neo_ros.bags import BagReader
from neo_ros.bags.camera_topics import as_raw_image, find_camera
from neo_ros.errors import BagError, ImageRejected
from neo_ros.geometry import CameraPose, Intrinsics
from neo_ros.geometry.camera_pose import rotation_angle
from neo_ros.machine.progress import no_progress, Progress
from neo_ros.memory.contradiction import contradicted, contradiction
from neo_ros.memory.learning import LearningThresholds
from neo_ros.memory.rendering import MemoryRenderer
from neo_ros.memory.scene_memory import SceneMemory
from neo_ros.memory.sight import Guide
from neo_ros.messages import camera_info_of, FrameProcessor
from neo_ros.messages.frame_processor import WideFrame
from neo_ros.messages.image_reader import ImageReader
from neo_ros.pictures.exposure import exposure_gain
from neo_ros.runtime import FovExtrapolator
import numpy as np

# Of a bag so many photos are kept at most; of a longer one those that are farther apart.
MOST_PHOTOS = 400


@dataclass(frozen=True, eq=False)
class DrivenPhoto:
    """
    An image uint8 RGB (h, w, 3), its pose, and how it compares with the memory.

    depth float32, z in metres, 0 = unknown, and off bool, contradicted: both of `small_camera`.
    """

    image: np.ndarray
    pose: CameraPose
    depth: np.ndarray
    off: np.ndarray


@dataclass(frozen=True, eq=False)
class Drive:
    """The photos of a bag, of how many images, and the camera of their `depth` and `off`."""

    photos: list[DrivenPhoto]
    images: int
    small_camera: Intrinsics


def drive_through(bag: Path, extrapolator: FovExtrapolator, image_topic: str | None = None,
                  info_topic: str | None = None, rectify: bool = False,
                  progress: Progress = no_progress,
                  limits: LearningThresholds = LearningThresholds()) -> Drive:
    """
    Follow a bag's camera through the memory, and keep photos a little apart.

    Raises BagError for bags and topics that cannot be used, and where no image is believed.
    """
    source = extrapolator.expansion.source
    camera = source.scaled(min(1.0, limits.widest / source.width))
    photos: list[DrivenPhoto] = []
    seen, metres, radians = 0, limits.metres, limits.radians
    extrapolator.reset()
    with BagReader(bag) as reader:
        for frame in _frames(reader, extrapolator, image_topic, info_topic, rectify, progress):
            seen += 1
            guide = cast(Guide | None, frame.guide)
            if guide is None or guide.agreement < limits.least_agreement or (
                    photos and not _moved(guide.pose, photos[-1].pose, metres, radians)):
                continue
            photo = _compared(frame, guide, extrapolator, camera)
            if photo.off.mean() > limits.most_contradicted:
                continue
            photos.append(photo)
            if len(photos) == MOST_PHOTOS:
                photos, metres, radians = photos[::2], 2 * metres, 2 * radians
    if not photos:
        raise BagError(f'{bag}: of {seen} images none shows the scene of '
                       f'{extrapolator.card.scene_id}; give bags of the same place and camera')
    return Drive(photos, seen, camera)


def compared_with_memory(images: np.ndarray, T_world_cam: np.ndarray, camera: Intrinsics,
                         memory: SceneMemory, width: int) -> Drive:
    """Compare photos uint8 (N, H, W, 3) at known poses with what the memory shows there."""
    camera = camera.scaled(min(1.0, width / camera.width))
    renderer, photos = MemoryRenderer(memory), []
    for image, T in zip(images, T_world_cam):
        pose = CameraPose(T)
        view = renderer.render(pose, camera)
        depth = np.where(view.stretched, 0, view.depth).astype(np.float32)
        now = cv2.resize(image, (camera.width, camera.height),
                         interpolation=cv2.INTER_AREA).astype(np.float32)
        known = depth > 0
        shown = view.image * (exposure_gain(view.image[known], now[known]) if known.any() else 1)
        off = contradicted(contradiction(now, shown.astype(np.float32), known))
        photos.append(DrivenPhoto(image, pose, depth, off))
    return Drive(photos, len(photos), camera)


def _frames(reader: BagReader, extrapolator: FovExtrapolator, image_topic: str | None,
            info_topic: str | None, rectify: bool, progress: Progress) -> Iterator[WideFrame]:
    """Yield the WideFrame of each image that can be read."""
    topics = find_camera(reader, extrapolator.expansion.source, image_topic, info_topic)
    processor, images, info = FrameProcessor(extrapolator, rectify), ImageReader(), None
    names = [topic.name for topic in (topics.image, topics.info) if topic is not None]
    total = sum(topic.count for topic in (topics.image, topics.info) if topic is not None)
    for done, message in enumerate(reader.messages(names), 1):
        progress(min(done, total), total)
        try:
            content = as_raw_image(message.read(), message.topic, images)
            if message.topic == topics.info:
                info = camera_info_of(content, topics.image.name)
            elif message.topic == topics.image:
                yield processor.process(content, info)
        except (BagError, ImageRejected):
            continue


def _moved(pose: CameraPose, other: CameraPose, metres: float, radians: float) -> bool:
    T = other.inverse() @ pose.T_world_cam
    return bool(np.linalg.norm(T[:3, 3]) > metres or rotation_angle(T[:3, :3]) > radians)


def _compared(frame: WideFrame, guide: Guide, extrapolator: FovExtrapolator,
              camera: Intrinsics) -> DrivenPhoto:
    """Compare an image with what the memory shows there."""
    crop = extrapolator.expansion.crop
    assert frame.image is not None
    image = np.ascontiguousarray(crop(frame.image))
    size = (camera.width, camera.height)
    now, shown = (cv2.resize(np.ascontiguousarray(one, np.float32), size,
                             interpolation=cv2.INTER_AREA) for one in (image, crop(guide.image)))
    depth = cv2.resize(np.nan_to_num(crop(guide.depth())), size,
                       interpolation=cv2.INTER_NEAREST_EXACT)
    off = contradicted(contradiction(now, shown, depth > 0))
    return DrivenPhoto(image, guide.pose, depth, off)
