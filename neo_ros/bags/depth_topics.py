"""Which topic of a bag has the depth of a camera's images, and how the two lie to one another."""
from collections.abc import Sequence
from typing import NamedTuple

from neo_ros.bags.camera_topics import (
    base_name, COMPRESSED, find_info_topic, first_frame, IMAGE, made_topics, read_lens,
    without_copies)
from neo_ros.bags.reading import BagReader
from neo_ros.bags.tf_tree import PoseSource, TransformTree
from neo_ros.bags.topic import BagTopic
from neo_ros.errors import BagError
from neo_ros.geometry.camera_pose import T_BODY_OPTICAL
from neo_ros.geometry.lens import Lens
from neo_ros.messages.depth_image import depth_encoding, UNITS
import numpy as np


class DepthChoice(NamedTuple):
    """
    The depth of a camera's images.

    unit           metres of one step of its numbers
    lens           the camera that measured it; None: it shows what the image shows
    T_image_depth  (4, 4), where that camera stands in the image's; None: in the same place
    words          how it comes to the image
    """

    topic: BagTopic
    unit: float
    lens: Lens | None
    T_image_depth: np.ndarray | None
    words: str


def depth_topics(reader: BagReader, image: BagTopic) -> list[BagTopic]:
    """
    Return the topics of depth, told by their encoding, that may belong to an image topic.

    Depth that a model made is left out, and the compressed copy of what is there raw.
    """
    made = made_topics(reader)
    found = [topic for topic in reader.topics
             if topic.msgtype in (IMAGE, COMPRESSED) and topic.count and topic != image
             and base_name(topic) not in made
             and depth_encoding(reader.first(topic)) is not None]
    return without_copies(found)


def find_depth(reader: BagReader, image: BagTopic, tree: TransformTree, stamps: Sequence[int],
               x_forward: bool = False) -> tuple[DepthChoice | None, str]:
    """
    Return the depth of an image topic, or None and why there is none; '' where a bag has none.

    In the frame of the images it is registered to them; else the nearest camera of depth is taken
    that has a camera_info, and transforms that do not change. stamps: of some images.
    """
    topics = depth_topics(reader, image)
    camera = first_frame(reader, image)
    same = [topic for topic in topics if first_frame(reader, topic) == camera]
    if same:
        # Of several, the one that most images may have.
        topic = max(same, key=lambda one: one.count)
        lens = _lens(reader, topic)
        return DepthChoice(topic, _unit(reader, topic), lens, None,
                           'in the frame of the images'), ''
    choices: list[tuple[float, DepthChoice]] = []
    lacks = []
    for topic in topics:
        frame, lens = first_frame(reader, topic), _lens(reader, topic)
        T = _between(tree, camera, frame, stamps, x_forward)
        if T is None:
            lacks.append(f'{topic.name}: no transforms that stay from its frame, {frame!r}, to '
                         f'that of the images, {camera!r}')
        elif lens is None:
            lacks.append(f'{topic.name}: no camera_info beside it')
        else:
            words = f'registered from the frame {frame} by its camera_info and transforms'
            choices.append((float(np.linalg.norm(T[:3, 3])), DepthChoice(
                topic, _unit(reader, topic), lens, T, words)))
    if not choices:
        return None, f'depth is not read: {"; ".join(lacks)}' if lacks else ''
    return min(choices, key=lambda one: one[0])[1], ''


def _unit(reader: BagReader, topic: BagTopic) -> float:
    return UNITS[str(depth_encoding(reader.first(topic)))]


def _lens(reader: BagReader, topic: BagTopic) -> Lens | None:
    """Return the camera of a depth topic; None where the bag has none that can be used."""
    info = find_info_topic(reader, topic)
    message = None if info is None else reader.first(info)
    try:
        return None if info is None or message is None else read_lens(message, topic, info.name)
    except BagError:
        return None


def _between(tree: TransformTree, camera: str, depth: str, stamps: Sequence[int],
             x_forward: bool) -> np.ndarray | None:
    """Return the pose (4, 4) of one frame in another; None where it is not known or changes."""
    ours, fault = tree.ancestors(camera)
    theirs, other_fault = tree.ancestors(depth)
    top = next((frame for frame in ours if frame in theirs), None)
    if top is None or fault or other_fault:
        return None
    ours, theirs = (chain[:chain.index(top) + 1] for chain in (ours, theirs))
    if tree.moves([*ours[:-1], *theirs[:-1]]):
        return None
    for stamp_ns in stamps:
        T_top = [PoseSource(tree.steps(chain)).at(stamp_ns) for chain in (ours, theirs)]
        if T_top[0] is not None and T_top[1] is not None:
            T = np.linalg.inv(T_top[0]) @ T_top[1]
            return np.linalg.inv(T_BODY_OPTICAL) @ T @ T_BODY_OPTICAL if x_forward else T
    return None
