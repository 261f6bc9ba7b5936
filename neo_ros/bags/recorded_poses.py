"""The poses that a bag recorded, and which of them say where the camera was."""
from collections import Counter
from dataclasses import dataclass, field
import logging
from pathlib import Path
from typing import Any, NamedTuple

from neo_ros.bags.reading import BagReader
from neo_ros.bags.tf_tree import frame_name, PoseSource, PoseTrack, read_pose, TransformTree
from neo_ros.bags.topic import BagTopic, CDR, describe_topics, describe_unread
from neo_ros.errors import BagError
from neo_ros.machine.names import listed
from neo_ros.messages.stamps import stamp_of
import numpy as np

logger = logging.getLogger(__name__)
TF, TF_STATIC = '/tf', '/tf_static'
TF_TYPE = 'tf2_msgs/msg/TFMessage'
POSE_TYPES = ('geometry_msgs/msg/PoseStamped', 'geometry_msgs/msg/PoseWithCovarianceStamped',
              'nav_msgs/msg/Odometry', 'geometry_msgs/msg/TransformStamped')
PATH, POSE_ARRAY = 'nav_msgs/msg/Path', 'geometry_msgs/msg/PoseArray'
# Plans and particles have these types, too: taken only where nothing else tells of poses.
SPARE_TYPES = (PATH, POSE_ARRAY)
BASE = 'base_link'
# What --pose-topic says for structure from motion; no topic has this name.
NO_POSES = 'none'
_STOOD_STILL = (
    '%s: %s never moves in %s, and there is no other pose: the bag is taken for one without '
    'poses; if the camera stood still all the time, --pose-topic %s')


@dataclass(frozen=True)
class PoseTopics:
    """
    Which topics of a bag may say where the camera was.

    tf, static  the transforms that are read: /tf and /tf_static, or those of another name
    poses       topics of poses
    foreign     topics of transforms that are not read, such as /robot1/tf beside /tf
    foxglove    names of Foxglove's transforms: they belong together whatever they are called
    """

    tf: str
    static: str
    poses: list[BagTopic]
    foreign: list[BagTopic]
    foxglove: frozenset[str] = frozenset()

    @property
    def names(self) -> set[str]:
        """The names of all topics that are read."""
        return {self.tf, self.static, *self.foxglove, *(topic.name for topic in self.poses)}


class PoseChoice(NamedTuple):
    """Where T_world_cam comes from, and the topic that --pose-topic would name."""

    topic: str
    source: PoseSource


@dataclass
class RecordedPoses:
    """
    What the transforms and pose topics of a bag say.

    tracks   poses by topic; complete after `finish`
    bodies   whose poses they are, where the topic says so
    invalid  counts what was no pose
    crowded  arrays with more or fewer poses than one, by topic
    """

    tree: TransformTree = field(default_factory=TransformTree)
    tracks: dict[str, PoseTrack] = field(default_factory=dict)
    bodies: dict[str, str] = field(default_factory=dict)
    invalid: int = 0
    crowded: Counter[str] = field(default_factory=Counter)
    _paths: dict[str, Any] = field(default_factory=dict)

    def add(self, topic: BagTopic, message: Any) -> None:
        """Take a message of transforms or a pose topic; others are passed over."""
        if topic.msgtype == TF_TYPE:
            self.tree.add(message, _is_static(topic.name), held=topic.encoding != CDR)
        elif topic.msgtype == PATH:
            self._take_path(topic.name, message)
        elif topic.msgtype == POSE_ARRAY:
            if len(message.poses) == 1:
                self._take(topic.name, message.header, message.poses[0])
            else:
                self.crowded[topic.name] += 1
        elif topic.msgtype in POSE_TYPES:
            pose = message.transform if hasattr(message, 'transform') else message.pose
            self._take(topic.name, message.header, getattr(pose, 'pose', pose))
            self.bodies[topic.name] = frame_name(getattr(message, 'child_frame_id', ''))

    def finish(self) -> None:
        """Take the poses of the newest paths."""
        for name in list(self._paths):
            self._read_path(name, self._paths.pop(name))

    def _take(self, name: str, header: Any, pose: Any) -> None:
        found = (read_pose(pose.translation, pose.rotation) if hasattr(pose, 'translation')
                 else read_pose(pose.position, pose.orientation))
        if found is None:
            self.invalid += 1
        else:
            self.tracks.setdefault(name, PoseTrack()).add(stamp_of(header), found)

    def _take_path(self, name: str, message: Any) -> None:
        """Keep a path: one that begins as early as the last one replaces it, else it adds."""
        if not message.poses:
            return
        first, last = (stamp_of(message.poses[place].header) for place in (0, -1))
        if first == last:  # No stamps of their own: the newest pose is the one of now.
            self._take(name, message.header, message.poses[-1].pose)
            return
        kept = self._paths.get(name)
        if kept is not None and first > stamp_of(kept.poses[0].header):
            self._read_path(name, kept)
        self._paths[name] = message

    def _read_path(self, name: str, message: Any) -> None:
        for entry in message.poses:
            self._take(name, entry.header, entry.pose)


def find_pose_topics(reader: BagReader, wanted: str | None) -> PoseTopics:
    """Return the topics that may say where the camera was, or the wanted one. Raises BagError."""
    recorded = [topic for topic in reader.topics if topic.count]
    transforms = [topic for topic in recorded if topic.msgtype == TF_TYPE]
    foxglove = frozenset(topic.name for topic in transforms if topic.encoding != CDR)
    transforms = [topic for topic in transforms if topic.name not in foxglove]
    moving = [topic.name for topic in transforms if not _is_static(topic.name)]
    tf = TF
    if wanted in moving:
        tf = str(wanted)
    elif TF not in moving and len(moving) == 1 and wanted != TF:
        tf = moving[0]
    elif not moving and foxglove and TF not in foxglove:
        tf = min(foxglove)
    names = {topic.name for topic in transforms}
    static = f'{tf}_static' if f'{tf}_static' in names else TF_STATIC
    foreign = [topic for topic in transforms if topic.name not in (tf, static)]
    poses = [topic for topic in recorded if topic.msgtype in POSE_TYPES]
    spare = [topic for topic in recorded if topic.msgtype in SPARE_TYPES]
    if wanted is None or wanted in (TF, tf, NO_POSES):
        return PoseTopics(tf, static, [] if wanted == NO_POSES else poses or spare, foreign,
                          foxglove)
    found = [topic for topic in (*poses, *spare) if topic.name == wanted]
    if not found:
        unread = describe_unread(topic for topic in reader.topics if topic.name == wanted)
        raise BagError(f'{reader.path}: expected poses on {wanted}{unread and ", got "}{unread}'
                       f'{_choice([*poses, *spare])}')
    return PoseTopics(tf, static, found, foreign, foxglove)


def find_pose_source(path: Path, recorded: RecordedPoses, camera: str, wanted: str | None,
                     topics: PoseTopics, notes: list[str],
                     T_base_camera: np.ndarray | None = None) -> PoseChoice | None:
    """
    Return where T_world_cam at a stamp comes from; None for a bag without poses.

    camera         the frame of the images
    topics         what `find_pose_topics` returns for the `wanted` one
    T_base_camera  (4, 4): where the camera is on the body, whatever the bag says
    Raises BagError that names the choice where there is more than one, and what is missing.
    """
    if wanted == NO_POSES:
        notes.append('no poses are taken from the bag: structure from motion')
        return None
    recorded.finish()
    tree, tf = recorded.tree, topics.tf
    poses = _readable(topics.poses, recorded, notes)
    by_tf = wanted in (TF, tf)
    if T_base_camera is not None:
        _mount(path, recorded, camera, T_base_camera, poses, by_tf or wanted is None, notes)
    chain, fault = tree.ancestors(camera)
    if fault and (by_tf or wanted is None and tree.moving):
        raise BagError(f'{path}: {tf}: {fault}{_choice(poses)}')
    on_tf = any(frame in tree.moving for frame in chain)
    bodies = {topic.name: _body(recorded, topic.name, chain, fault) for topic in poses}
    # What moves below the body, as a pan joint does, does not say where the body is.
    top = max((chain.index(body) for body in bodies.values() if body in chain), default=0)
    if on_tf and (by_tf or wanted is None and tree.moves(chain[top:])):
        still = '' if tree.moves(chain) else ', where it never moves'
        notes.append(f'poses from {tf}: {camera} in {chain[-1]}{still}')
        return PoseChoice(tf, PoseSource(tree.steps(chain)))
    if by_tf or not poses:
        _refuse_lost_transforms(path, tree, camera, chain, topics, by_tf, poses)
        if on_tf:
            logger.warning(_STOOD_STILL, path, camera, tf, tf)
        notes.append('the bag has no poses: structure from motion')
        return None
    if len(poses) > 1:
        raise BagError(f'{path}: {tf} does not move the frame {chain[top]!r}{_choice(poses)}')
    (name, body), = bodies.items()
    if body not in chain:
        lack = f'{tf}: {fault}' if fault else (
            f'{name} gives poses of {body!r}; expected {topics.static} from it to the frame of '
            f'the images, {camera!r}, got {_way(chain)}{_not_read(topics.foreign)}; give the '
            f'transform with --base-to-camera')
        raise BagError(f'{path}: {lack}{_choice([])}')
    notes.append(f'poses from {name}, taken as poses of {body or "the camera"}')
    return PoseChoice(name, _mounted_on(name, body, recorded, chain))


def _readable(poses: list[BagTopic], recorded: RecordedPoses, notes: list[str]) -> list[BagTopic]:
    """Return the topics of one pose a message; note which are not, and what was no pose."""
    notes += [f'{topic.name} is not read: expected one pose a message, got arrays of others'
              for topic in poses if recorded.crowded[topic.name]]
    lost = recorded.tree.invalid + recorded.invalid
    if lost:
        notes.append(f'{lost} poses are not finite or no rotation and are left out')
    return [topic for topic in poses if not recorded.crowded[topic.name]]


def _mounted_on(name: str, body: str, recorded: RecordedPoses, chain: list[str]) -> PoseSource:
    """Lead from the camera up its chain to a body, and from there by the body's poses."""
    below = chain[:chain.index(body) + 1]
    return PoseSource(
        [*recorded.tree.steps(below), (name, recorded.tracks.get(name, PoseTrack()))])


def _is_static(name: str) -> bool:
    return name.endswith('_static')


def _mount(path: Path, recorded: RecordedPoses, camera: str, T_base_camera: np.ndarray,
           poses: list[BagTopic], tf_allowed: bool, notes: list[str]) -> None:
    """Fix the camera to the body that the poses are of."""
    tree = recorded.tree
    if len(poses) == 1 and not (tf_allowed and tree.moving):
        body = recorded.bodies.get(poses[0].name) or BASE
    elif BASE in tree.moving or BASE in tree.static:
        body = BASE
    else:
        leaves = sorted(set(tree.moving) - set(tree.parents.values()) - {camera})
        if len(leaves) != 1:
            raise BagError(f'{path}: --base-to-camera: expected transforms of {BASE!r}, or of one '
                           f'other body, got {listed(leaves, 5) or "none"}')
        body, = leaves
    tree.mount(camera, body, T_base_camera)
    notes.append(f'the camera, {camera}, is where --base-to-camera says in {body}')


def _refuse_lost_transforms(path: Path, tree: TransformTree, camera: str, chain: list[str],
                            topics: PoseTopics, by_tf: bool, poses: list[BagTopic]) -> None:
    """Raise BagError where transforms are there that do not reach the frame of the images."""
    lack = missing_way(tree, camera, topics)
    if by_tf and not lack:
        lack = (f'{topics.tf}: expected transforms that move the frame of the images, '
                f'{camera!r}, got {_way(chain)}')
    if lack:
        raise BagError(f'{path}: {lack}{_choice(poses)}')


def missing_way(tree: TransformTree, camera: str, topics: PoseTopics) -> str:
    """Say which transforms do not reach the frame of the images; empty where there are none."""
    chain, _ = tree.ancestors(camera)
    apart = tree.moving_apart(chain)
    if apart:
        return (f'{topics.tf} moves {listed(apart, 3)}; expected {topics.static} from there to '
                f'the frame of the images, {camera!r}, got {_way(chain)}'
                f'{_not_read(topics.foreign)}; give the transform with --base-to-camera')
    moving = [topic for topic in topics.foreign if not _is_static(topic.name)]
    if moving:
        return (f'expected transforms on {TF} and {TF_STATIC}, got {describe_topics(moving)}; '
                f'choose one, as with --pose-topic {moving[0].name}')
    return ''


def _way(chain: list[str]) -> str:
    return ' -> '.join(chain) if len(chain) > 1 else 'none'


def _not_read(foreign: list[BagTopic]) -> str:
    return f' ({describe_topics(foreign)} is not read)' if foreign else ''


def _choice(topics: list[BagTopic]) -> str:
    """Say what --pose-topic can be instead."""
    names = f'{describe_topics(topics)} or ' if topics else ''
    return f'; choose the poses with --pose-topic: {names}{NO_POSES} (structure from motion)'


def _body(recorded: RecordedPoses, topic: str, chain: list[str], fault: str) -> str:
    """Return whose poses a topic gives, if need be a guess: one of the frames of the chain."""
    if recorded.bodies.get(topic) or fault:  # Above a fault nobody knows what is fixed.
        return recorded.bodies.get(topic) or BASE
    fixed = [frame for index, frame in enumerate(chain) if not recorded.tree.moves(chain[:index])]
    return BASE if BASE in chain else fixed[-1]
