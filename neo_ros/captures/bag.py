"""A recorded bag as a capture: images, calibration, and poses at the images' stamps."""
from collections.abc import Iterator, Sequence
from dataclasses import dataclass, replace
from pathlib import Path

from neo_ros.bags.camera_choice import CameraSource
from neo_ros.bags.camera_topics import (
    calibrated_topics, find_image_topic, find_info_topic, is_calibrated, read_lens)
from neo_ros.bags.depth_topics import find_depth
from neo_ros.bags.reading import BagReader
from neo_ros.bags.recorded_poses import find_pose_source, find_pose_topics, NO_POSES
from neo_ros.bags.tf_tree import PoseSource
from neo_ros.bags.topic import BagTopic, describe_topics, describe_unread
from neo_ros.captures.bag_depth import with_depth
from neo_ros.captures.bag_pass import ordered_images, Scan, scan_bag
from neo_ros.captures.camera_file import read_camera_file
from neo_ros.captures.capture import Capture, CapturedFrame, ImageStream, origin_of
from neo_ros.errors import BagError, ConfigError, ImageRejected
from neo_ros.geometry import CameraPose
from neo_ros.geometry.camera_pose import rotation_from_vector, T_BODY_OPTICAL
from neo_ros.geometry.lens import Lens
from neo_ros.machine.progress import no_progress, Progress
from neo_ros.messages.depth_image import depth_encoding
from neo_ros.messages.image_reader import ImageReader, is_video
import numpy as np

# Images at whose time the way from a depth camera to them is asked for.
MOST_ASKED = 100


@dataclass(frozen=True)
class BagOptions(CameraSource):
    """
    What the user says of a bag; each is an option of `neo import`.

    pose_topic      /tf or another topic of transforms, or a topic of poses; by default /tf if the
                    camera's body moves in it, else the one pose topic of the bag; none: no poses
    base_to_camera  x y z roll pitch yaw of the frame of the images in the body, metres, radians
    x_forward       the frame of the images looks along x, as Gazebo's do, not along z
    """

    pose_topic: str | None = None
    base_to_camera: str | None = None
    x_forward: bool = False

    def __post_init__(self) -> None:
        super().__post_init__()
        if self.base_to_camera is not None:
            self._numbers()

    @property
    def T_base_camera(self) -> np.ndarray | None:  # noqa: N802
        """The (4, 4) of `base_to_camera`; None where it is not given."""
        if self.base_to_camera is None:
            return None
        *xyz, roll, pitch, yaw = self._numbers()
        T = np.eye(4)
        T[:3, 3] = xyz
        for axis, angle in zip(np.eye(3)[::-1], (yaw, pitch, roll)):
            T[:3, :3] = T[:3, :3] @ rotation_from_vector(axis * angle)
        return T

    def _numbers(self) -> list[float]:
        try:
            numbers = [float(word) for word in (self.base_to_camera or '').split()]
        except ValueError:
            numbers = []
        if len(numbers) != 6 or not np.isfinite(numbers).all():
            raise ConfigError('--base-to-camera: expected six numbers, x y z in metres and roll '
                              f'pitch yaw in radians, got {self.base_to_camera!r}')
        return numbers


def read_bag_capture(path: Path, options: BagOptions = BagOptions(),
                     progress: Progress = no_progress) -> Capture:
    """
    Read the camera of a bag.

    Frames are in the order of their stamps; those without a pose are counted in the notes and
    left out. A bag without poses gives a capture without poses. Raises BagError that names the
    topics for everything that is missing, ambiguous or contradictory.
    """
    with BagReader(path) as reader:
        image = find_image_topic(reader, options.image_topic)
        info = None if options.camera_info else find_info_topic(reader, image, options.info_topic)
        pose_topics = find_pose_topics(reader, options.pose_topic)
        infos = calibrated_topics(reader, image)
        unread = describe_unread(reader.topics)
        scan = scan_bag(reader, image, info, pose_topics, progress)
        notes = [reader.recovered] if reader.recovered else []
        depth, lack = find_depth(reader, image, scan.poses.tree,
                                 [stamp for stamp, _ in scan.images[:MOST_ASKED]],
                                 options.x_forward)
        notes += [lack] if lack else []
        if (encoding := depth_encoding(reader.first(image))) is not None:
            notes.append(f'{image.name} has the encoding {encoding}, which is depth: only an '
                         'import takes it for grey. A model of it is of no use, as replay, node, '
                         'viewer and update refuse such images: publish them as mono16, and '
                         'record again')
    notes += [f'{count} messages of {name} are damaged and are left out'
              for name, count in sorted(scan.damaged.items())]
    lens = _lens(path, scan, image, info, options.camera_info, notes)
    stamps = ordered_images(scan, image, notes)
    choice = find_pose_source(path, scan.poses, scan.camera_frame, options.pose_topic,
                              pose_topics, notes, options.T_base_camera)
    source = None if choice is None else choice.source
    if unread and (source is None or lens is None):
        notes.append(unread)
    if options.x_forward and source is not None:
        # The innermost step: from the optical frame to the frame that looks along x.
        source = PoseSource([('--x-forward', T_BODY_OPTICAL), *source.steps])
        notes.append(f'the frame {scan.camera_frame} looks along x, as --x-forward says')
    frames, places, lost = _posed(stamps, source, lens)
    _check_posed(path, image, frames, lost, notes,
                 '' if source is None else _gaps(source, lost, pose_topics.poses))
    if source is not None and lens is None:
        lack = _lack_of_lens(image, None if scan.info is None else info, infos)
        raise BagError(f'{path}: {lack}give a file with --camera-info FILE, or '
                       f'estimate both with --pose-topic {NO_POSES}')
    depth_as_grey = options.image_topic is not None
    stream = _stream(path, image, places, depth_as_grey)
    if scan.video:
        places, frames = _without_start(path, image, places, frames, notes, stream)
        stream = _stream(path, image, places, depth_as_grey)
    next(stream([0]), None)  # What cannot be decoded at all is refused before anything is written.
    topics = [image.name, image.msgtype, *([] if depth is None else [depth.topic.name])]
    capture = Capture(tuple(frames), tuple(notes), stream, origin_of(path, topics),
                      z_up=source is not None)  # REP-103
    return capture if depth is None else with_depth(capture, path, depth, scan.depths[depth.topic])


def _lens(path: Path, scan: Scan, image: BagTopic, info: BagTopic | None,
          camera_info: Path | None, notes: list[str]) -> Lens | None:
    """Return the calibration, of a file before that of the bag; None where there is none."""
    if camera_info is not None:
        notes.append(f'the camera is the one of {camera_info}')
        return read_camera_file(camera_info, image.name)
    if scan.info is None or info is None:
        notes.append(f'{image.name} has no camera_info beside it: the camera is estimated')
        return None
    if not is_calibrated(scan.info, image):
        notes.append(f'{info.name} is not calibrated: the camera is estimated')
        return None
    return read_lens(scan.info, image, f'{path}: {info.name}')


def _lack_of_lens(image: BagTopic, info: BagTopic | None, infos: Sequence[BagTopic]) -> str:
    """Say what poses need and do not have, and which topics may help."""
    need = (f'expected a camera_info beside {image.name}' if info is None else
            f'{info.name} is not calibrated')
    found = describe_topics(infos) if infos else 'no CameraInfo topic that is calibrated'
    return (f'{need}, the poses need the calibration that belongs to them; the bag has {found}; '
            f'{"choose one with --info-topic, or " if infos else ""}')


def _posed(stamps: Sequence[tuple[int, int]], source: PoseSource | None, lens: Lens | None
           ) -> tuple[list[CapturedFrame], list[int], list[int]]:
    """Return the frames, their places in the topic, and the stamps that have no pose."""
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
    return frames, places, lost


def _check_posed(path: Path, image: BagTopic, frames: Sequence[CapturedFrame],
                 lost: Sequence[int], notes: list[str], gaps: str) -> None:
    """Note how many images have no pose, and why; refuse a bag where none has one."""
    if not frames:
        raise BagError(f'{path}: no image of {image.name} has a pose near its stamp; '
                       f'{gaps or "do images and poses have the same clock?"}')
    if lost:
        notes.append(f'{len(lost)} of {len(frames) + len(lost)} images have no pose near their '
                     f'stamp and are left out{gaps and "; "}{gaps}')


def _gaps(source: PoseSource, lost: Sequence[int], topics: Sequence[BagTopic]) -> str:
    """Say what comes too rarely for images that lack a pose, and which poses there are beside."""
    gaps = source.gaps(lost)
    others = [topic.name for topic in topics if topic.name not in dict(source.steps)]
    return f'{gaps}; other poses: --pose-topic {" or ".join(others)}' if gaps and others else gaps


def _stream(path: Path, image: BagTopic, places: Sequence[int],
            depth_as_grey: bool) -> ImageStream:
    """Return a function that reads images of the bag, in the order of the bag."""
    def read(indices: Sequence[int]) -> Iterator[tuple[int, np.ndarray | None]]:
        wanted = {places[index]: index for index in indices}
        if not wanted:
            return
        images = ImageReader(depth_as_grey)
        with BagReader(path) as reader:
            messages = (message for message in reader.messages({image.name})
                        if message.topic == image)
            for place, message in enumerate(messages):
                try:
                    content = message.read()
                    # A frame of a video builds on those before it, wanted or not.
                    picture = images.read(content) if place in wanted or (
                        is_video(content)) else None
                except BagError:
                    picture = None
                except ImageRejected as error:
                    if error.reason == 'encoding':  # The same for all images of the topic.
                        raise BagError(f'{path}: {image.name}: {error}; convert the images, or '
                                       'record another topic of this camera') from error
                    picture = None
                if place in wanted:
                    yield wanted.pop(place), picture
                if not wanted:
                    return

    return read


def _without_start(path: Path, image: BagTopic, places: list[int], frames: list[CapturedFrame],
                   notes: list[str], stream: ImageStream) -> tuple[list[int], list[CapturedFrame]]:
    """Leave out the frames of a video before its first key frame, and say how many."""
    started = next((index for index, picture in stream(range(len(places)))
                    if picture is not None), None)
    if started is None:
        raise BagError(f'{path}: {image.name}: none of the {len(places)} video frames can be '
                       'decoded; is there no key frame among them?')
    kept = [index for index, place in enumerate(places) if place >= places[started]]
    missing = len(places) - len(kept)
    if missing:
        notes.append(f'{missing} video frames before the first key frame are left out')
    return [places[index] for index in kept], [
        replace(frames[index], name=f'images/{number:06d}.png')
        for number, index in enumerate(kept)]
