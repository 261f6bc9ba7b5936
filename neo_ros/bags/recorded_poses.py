"""The poses that a bag recorded, and which of them say where the camera was."""
from collections.abc import Iterable
from dataclasses import dataclass, field
import logging
from pathlib import Path
from typing import Any

from neo_ros.bags.reading import BagReader
from neo_ros.bags.topic import BagTopic, describe_topics
from neo_ros.bags.transforms import (
    frame_name, PoseSource, PoseTrack, read_transform, TransformTree)
from neo_ros.errors import BagError
from neo_ros.machine.names import listed
from neo_ros.messages.stamps import stamp_of

logger = logging.getLogger(__name__)
TF, TF_STATIC = '/tf', '/tf_static'
TF_TYPE = 'tf2_msgs/msg/TFMessage'
POSE_TYPES = ('geometry_msgs/msg/PoseStamped', 'geometry_msgs/msg/PoseWithCovarianceStamped',
              'nav_msgs/msg/Odometry')
BASE = 'base_link'
# What --pose-topic says for structure from motion; no topic has this name.
NO_POSES = 'none'


@dataclass
class RecordedPoses:
    """
    What /tf and the pose topics of a bag say.

    tracks   poses by topic
    bodies   whose poses they are, where the topic says so
    invalid  counts what was no pose
    """

    tree: TransformTree = field(default_factory=TransformTree)
    tracks: dict[str, PoseTrack] = field(default_factory=dict)
    bodies: dict[str, str] = field(default_factory=dict)
    invalid: int = 0

    def add(self, topic: BagTopic, message: Any) -> None:
        """Take a message of /tf, /tf_static or a pose topic; others are passed over."""
        if topic.msgtype == TF_TYPE:
            self.tree.add(message, topic.name == TF_STATIC)
        elif topic.msgtype in POSE_TYPES:
            pose = message.pose if hasattr(message.pose, 'position') else message.pose.pose
            T = read_transform(pose.position, pose.orientation)
            if T is None:
                self.invalid += 1
                return
            self.tracks.setdefault(topic.name, PoseTrack()).add(stamp_of(message.header), T)
            self.bodies[topic.name] = frame_name(getattr(message, 'child_frame_id', ''))


def find_pose_topics(reader: BagReader, wanted: str | None) -> list[BagTopic]:
    """Return the pose topic of this name, or all that may be taken. Raises BagError."""
    topics = [topic for topic in reader.topics if topic.msgtype in POSE_TYPES and topic.count]
    if wanted is None or wanted == TF:
        return topics
    found = [topic for topic in topics if topic.name == wanted]
    if not found and wanted != NO_POSES:
        raise BagError(f'{reader.path}: expected poses on {wanted}{_choice(topics)}')
    return found


def foreign_tf(topics: Iterable[BagTopic]) -> list[BagTopic]:
    """Return the topics of transforms that are not read, such as /robot1/tf."""
    return [topic for topic in topics if topic.msgtype == TF_TYPE and topic.count
            and topic.name not in (TF, TF_STATIC)]


def find_pose_source(path: Path, recorded: RecordedPoses, camera: str, wanted: str | None,
                     topics: list[BagTopic], foreign: list[BagTopic],
                     notes: list[str]) -> PoseSource | None:
    """
    Return where T_world_cam at a stamp comes from; None for a bag without poses.

    camera   the frame of the images
    topics   what `find_pose_topics` returns for the `wanted` one
    foreign  what `foreign_tf` returns
    """
    if wanted == NO_POSES:
        notes.append('no poses are taken from the bag: structure from motion')
        return None
    tree = recorded.tree
    chain, fault = tree.ancestors(camera)
    if fault and (wanted == TF or wanted is None and tree.moving):
        raise BagError(f'{path}: {TF}: {fault}{_choice(topics)}')
    lost = tree.invalid + recorded.invalid
    if lost:
        notes.append(f'{lost} poses are not finite or no rotation and are left out')
    on_tf = any(frame in tree.moving for frame in chain)
    bodies = {topic.name: _body(recorded, topic.name, chain, fault) for topic in topics}
    # What moves below the body, as a pan joint does, does not say where the body is.
    top = max((chain.index(body) for body in bodies.values() if body in chain), default=0)
    if on_tf and (wanted == TF or wanted is None and tree.moves(chain[top:])):
        still = '' if tree.moves(chain) else ', where it never moves'
        notes.append(f'poses from {TF}: {camera} in {chain[-1]}{still}')
        return PoseSource(tree.steps(chain))
    if wanted == TF or not topics:
        lack = missing_way(tree, camera, foreign)
        if wanted == TF and not lack:
            lack = (f'{TF}: expected transforms that move the frame of the images, {camera!r}, '
                    f'got {_way(chain)}')
        if lack:
            raise BagError(f'{path}: {lack}{_choice(topics)}')
        if on_tf:
            logger.warning(
                '%s: %s never moves in %s, and there is no other pose: the bag is taken for one '
                'without poses; if the camera stood still all the time, --pose-topic %s',
                path, camera, TF, TF)
        notes.append('the bag has no poses: structure from motion')
        return None
    if len(topics) > 1:
        raise BagError(f'{path}: {TF} does not move the frame {chain[top]!r}{_choice(topics)}')
    (name, body), = bodies.items()
    if body not in chain:
        lack = f'{TF}: {fault}' if fault else (
            f'{name} gives poses of {body!r}; expected {TF_STATIC} from it to the frame of the '
            f'images, {camera!r}, got {_way(chain)}{_not_read(foreign)}')
        raise BagError(f'{path}: {lack}{_choice([])}')
    notes.append(f'poses from {name}, taken as poses of {body or "the camera"}')
    below = chain[:chain.index(body) + 1]
    return PoseSource([*tree.steps(below), (name, recorded.tracks.get(name, PoseTrack()))])


def missing_way(tree: TransformTree, camera: str, foreign: list[BagTopic]) -> str:
    """Say which transforms do not reach the frame of the images; empty where there are none."""
    chain, _ = tree.ancestors(camera)
    apart = tree.moving_apart(chain)
    if apart:
        return (f'{TF} moves {listed(apart, 3)}; expected {TF_STATIC} from there to the frame of '
                f'the images, {camera!r}, got {_way(chain)}{_not_read(foreign)}')
    if foreign:
        return (f'expected transforms on {TF} and {TF_STATIC}, got {describe_topics(foreign)}; '
                f'record them again with ros2 bag play --remap {foreign[0].name}:={TF}')
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
