"""The poses that a bag recorded, and which of them say where the camera was."""
from collections.abc import Callable
from dataclasses import dataclass, field
import logging
from pathlib import Path
from typing import Any, Optional

from neo_ros.bags.reading import BagReader, BagTopic, describe_topics
from neo_ros.bags.transforms import frame_name, PoseTrack, read_transform, TransformTree
from neo_ros.errors import BagError
from neo_ros.messages.stamps import stamp_of
import numpy as np

logger = logging.getLogger(__name__)
TF, TF_STATIC = '/tf', '/tf_static'
TF_TYPE = 'tf2_msgs/msg/TFMessage'
POSE_TYPES = ('geometry_msgs/msg/PoseStamped', 'geometry_msgs/msg/PoseWithCovarianceStamped',
              'nav_msgs/msg/Odometry')
BASE = 'base_link'
PoseAt = Callable[[int], Optional[np.ndarray]]


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


def find_pose_topics(reader: BagReader, wanted: Optional[str]) -> list[BagTopic]:
    topics = [topic for topic in reader.topics if topic.msgtype in POSE_TYPES and topic.count]
    if wanted is None or wanted == TF:
        return topics
    found = [topic for topic in topics if topic.name == wanted]
    if not found:
        raise BagError(f'{reader.path}: expected poses on {wanted}, the bag has '
                       f'{describe_topics(topics)}')
    return found


def find_pose_source(path: Path, recorded: RecordedPoses, camera: str, wanted: Optional[str],
                     topics: list[BagTopic], notes: list[str]) -> Optional[PoseAt]:
    """Return where T_world_cam at a stamp comes from; None for a bag without poses."""
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
        return lambda stamp_ns: tree.transform(chain, stamp_ns)
    if wanted == TF:
        raise BagError(f'{path}: {TF}: expected transforms of the frame of the images, '
                       f'{camera!r}, got {" -> ".join(chain)}')
    if len(topics) > 1:
        raise BagError(f'{path}: {TF} does not move the frame {chain[top]!r}{_choice(topics)}')
    if not topics:
        if on_tf:
            logger.warning(
                '%s: %s never moves in %s, and there is no other pose: the bag is taken for one '
                'without poses; if the camera stood still all the time, --pose-topic %s',
                path, camera, TF, TF)
        return None
    (name, body), = bodies.items()
    if body not in chain and fault:
        raise BagError(f'{path}: {TF}: {fault}; {name} needs the way from its body to {camera!r}')
    if body not in chain:
        raise BagError(f'{path}: {name} gives poses of {body!r}; expected {TF_STATIC} from it to '
                       f'the image\'s frame {camera!r}, got {" -> ".join(chain)}')
    notes.append(f'poses from {name}, taken as poses of {body or "the camera"}')
    below = chain[:chain.index(body) + 1]
    track = recorded.tracks.get(name, PoseTrack())

    def pose_at(stamp_ns: int) -> Optional[np.ndarray]:
        T_world_body = track.at(stamp_ns)
        T_body_camera = tree.transform(below, stamp_ns)
        if T_world_body is None or T_body_camera is None:
            return None
        return T_world_body @ T_body_camera

    return pose_at


def _choice(topics: list[BagTopic]) -> str:
    return f'; choose the poses with --pose-topic: {describe_topics(topics)}' if topics else ''


def _body(recorded: RecordedPoses, topic: str, chain: list[str], fault: str) -> str:
    """Return whose poses a topic gives, if need be a guess: one of the frames of the chain."""
    if recorded.bodies.get(topic) or fault:  # Above a fault nobody knows what is fixed.
        return recorded.bodies.get(topic) or BASE
    fixed = [frame for index, frame in enumerate(chain) if not recorded.tree.moves(chain[:index])]
    return BASE if BASE in chain else fixed[-1]
