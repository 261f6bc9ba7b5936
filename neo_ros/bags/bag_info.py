"""What is in a bag, what of it can serve the training or the replay, and what to do next."""
from dataclasses import dataclass
import math
from pathlib import Path
import shlex

from neo_ros.bags.bag_folder import bag_name
from neo_ros.bags.bag_scan import BagCamera, BagScan, TopicInfo
from neo_ros.bags.camera_topics import (
    calibrated_topics, find_info_topic, find_truth_topic, IMAGE, read_lens, same_frame)
from neo_ros.bags.depth_topics import find_depth
from neo_ros.bags.reading import BagReader
from neo_ros.bags.recorded_poses import (
    find_pose_source, find_pose_topics, NO_POSES, POSE_TYPES, SPARE_TYPES, TF_TYPE)
from neo_ros.bags.topic import BagTopic, describe_topics
from neo_ros.errors import BagError
from neo_ros.geometry import ViewExpansion
from neo_ros.machine.progress import no_progress, Progress
from neo_ros.messages.stamps import stamp_of

IMAGE_ROLE, POSE_ROLE, DEPTH_ROLE, TRUTH_ROLE = 'image', 'pose', 'depth', 'truth'


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


def read_bag_info(path: Path, model: Path | None = None, expansion: ViewExpansion | None = None,
                  progress: Progress = no_progress) -> BagInfo:
    """
    Read a whole bag and describe it.

    With `model`, a model file, and its `expansion` the command to run next is a replay, else an
    import. Raises BagError for bags that cannot be read.
    """
    with BagReader(path) as reader:
        scan = BagScan(reader)
        for done, message in enumerate(reader.messages(), 1):
            scan.take(message)
            progress(done, reader.message_count)
        first_ns, last_ns = scan.span_ns
        for info in scan.infos.values():
            info.first_s, info.last_s = info.first_s - first_ns / 1e9, info.last_s - first_ns / 1e9
        choices = _Choices(reader, scan)
        image = choices.find_image(expansion)
        pose, pose_option = choices.find_pose(image)
        truth = choices.find_truth(image, expansion)
        depth = choices.find_depth(image)
        for topic, role in ((pose, POSE_ROLE), (depth, DEPTH_ROLE), (truth, TRUTH_ROLE)):
            if topic is not None:
                scan.infos[topic].roles.append(role)
        command = _next_command(path, model, scan, image, pose, pose_option, truth)
        return BagInfo(
            str(path), first_ns, (last_ns - first_ns) / 1e9,
            sum(info.count for info in scan.infos.values()), list(map(str, reader.damages)),
            choices.notes, [scan.infos[topic] for topic in reader.topics], command)


class _Choices:
    """What of a scanned bag can serve, and in `notes` what stands in the way."""

    def __init__(self, reader: BagReader, scan: BagScan) -> None:
        self._reader, self._scan = reader, scan
        self.notes: list[str] = []

    def find_image(self, expansion: ViewExpansion | None) -> BagCamera | None:
        """Return the camera to be used: of the model's size, calibrated, raw before compressed."""
        readable = [camera for camera in self._scan.cameras.values() if camera.size is not None]
        for camera in readable:
            self._scan.infos[camera.topic].roles.append(IMAGE_ROLE)
        for camera in self._scan.cameras.values():
            if camera.size is None:
                self.notes.append(f'{camera.topic.name} cannot be read: '
                                  f'{self._scan.infos[camera.topic].content}')
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

    def _tell_lack_of_info(self, image: BagCamera) -> None:
        beside = find_info_topic(self._reader, image.topic)
        infos = calibrated_topics(self._reader, image.topic)
        near = same_frame(self._reader, image.topic, infos)
        if len(near) == 1:
            image.info_option = near[0].name
            image.distorted = self._is_distorted(near[0], image.topic)
        others = (f', as {describe_topics(infos)} with --info-topic, or a file with --camera-info'
                  if infos else '; give a file with --camera-info')
        estimated = 'an import without poses estimates the camera'
        if beside is not None and beside not in infos:
            self.notes.append(f'{beside.name} is not calibrated: an import with poses and a '
                              f'replay need a calibration{others}; {estimated}')
            return
        self.notes.append(f'{image.topic.name} has no camera_info beside it: an import with poses '
                          f'needs it{others}; {estimated}, a replay trusts the size of the images')

    def _is_distorted(self, info: BagTopic, image: BagTopic) -> bool:
        first = self._reader.first(info)
        try:
            return first is not None and not read_lens(first, image, info.name).is_pinhole
        except BagError:  # An import says so.
            return False

    def find_pose(self, image: BagCamera | None) -> tuple[BagTopic | None, str]:
        """
        Return where an import takes the poses from, and what --pose-topic must say for that.

        The rule is the import's own. Where it wants a choice, its words become a note, and the
        topic with most messages that it would take is proposed.
        """
        if image is None:
            return None, ''
        found = sorted((topic for topic in self._scan.infos if topic.count and topic.msgtype in (
            TF_TYPE, *POSE_TYPES, *SPARE_TYPES)), key=lambda topic: -self._scan.infos[topic].count)
        for wanted in (None, *(topic.name for topic in found)):
            try:
                choice = find_pose_source(
                    self._reader.path, self._scan.poses, image.frame, wanted,
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

    def find_depth(self, image: BagCamera | None) -> BagTopic | None:
        """Return the depth that an import takes with these images, by the import's own rule."""
        if image is None:
            return None
        stamp_ns = stamp_of(self._reader.first(image.topic).header)
        choice, lack = find_depth(self._reader, image.topic, self._scan.poses.tree, [stamp_ns])
        self.notes += [lack] if lack else []
        return None if choice is None else choice.topic

    def find_truth(self, image: BagCamera | None,
                   expansion: ViewExpansion | None) -> BagTopic | None:
        """Return what a replay scores against; without a model, larger images of one frame."""
        if image is None or image.size is None:
            return None
        if expansion is not None:
            return find_truth_topic(self._reader, image.topic,
                                    (expansion.target.width, expansion.target.height))
        for camera in self._scan.cameras.values():
            if camera.frame == image.frame and camera.size not in (None, image.size) and all(
                    a >= b for a, b in zip(camera.size, image.size)):
                return camera.topic
        return None


def _next_command(path: Path, model: Path | None, scan: BagScan, image: BagCamera | None,
                  pose: BagTopic | None, pose_option: str, truth: BagTopic | None) -> str:
    """Return the command line, with topics named where there is a choice."""
    if image is None:
        return ''
    name = bag_name(path.resolve())
    info = ['--info-topic', image.info_option] if image.info_option else []
    # A replay looks for images of the model's size, or with a camera_info beside them.
    choose = len(scan.cameras) > 1 or (model is not None and bool(info))
    several = ['--image-topic', image.topic.name] if choose else []
    if model is not None:
        score = ['--truth-topic', truth.name] if truth is not None else ['--score']
        words = ['replay', str(path), '--model', str(model), '--out', f'out/{name}_wide',
                 *several, *info, *(['--rectify'] if image.distorted else []), *score]
    else:
        if pose is not None and not image.calibrated and not image.info_option:
            pose_option = NO_POSES
        chosen = ['--pose-topic', pose_option] if pose_option else []
        words = ['import', str(path), f'out/scenes/{name}', *several, *info, *chosen]
    return shlex.join(['neo', *words])
