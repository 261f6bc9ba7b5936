"""Which topics of a bag are the camera: its images, its calibration."""
from types import SimpleNamespace
from typing import Any, Optional

from neo_ros.bags.reading import BagReader, BagTopic, describe_topics
from neo_ros.errors import BagError, ImageRejected
from neo_ros.messages import read_camera_info
from neo_ros.scenes.lens import Lens
import numpy as np

IMAGE, COMPRESSED = 'sensor_msgs/msg/Image', 'sensor_msgs/msg/CompressedImage'
CAMERA_INFO = 'sensor_msgs/msg/CameraInfo'
_BROWN, _FISHEYE = ('', 'plumb_bob', 'rational_polynomial'), ('equidistant', 'fisheye')
_INFO_FIELDS = ('height', 'width', 'distortion_model', 'd', 'k', 'r', 'p', 'binning_x',
                'binning_y', 'roi')


def find_image_topic(reader: BagReader, name: Optional[str]) -> BagTopic:
    """
    Return the topic of this name, or the one camera of the bag.

    Without a name, topics with a camera_info beside them are preferred, and raw images to
    compressed ones of the same camera. Raises BagError that lists the choice.
    """
    topics = [topic for topic in reader.topics
              if topic.msgtype in (IMAGE, COMPRESSED) and topic.count
              and 'depth' not in topic.name.lower()]
    if name is not None:
        found = [topic for topic in reader.topics
                 if topic.name == name and topic.msgtype in (IMAGE, COMPRESSED)]
        if not found:
            raise BagError(f'{reader.path}: expected images on {name}, the bag has '
                           f'{describe_topics(topics)}')
        return found[0]
    if not topics:
        raise BagError(f'{reader.path}: expected a topic of type {IMAGE} or {COMPRESSED}, the '
                       f'bag has {describe_topics(reader.topics)}')
    calibrated = [topic for topic in topics if find_info_topic(reader, topic) is not None]
    choice = calibrated or topics
    raw = {topic.name for topic in choice if topic.msgtype == IMAGE}
    choice = [topic for topic in choice if topic.msgtype == IMAGE
              or topic.name.rpartition('/')[0] not in raw]
    if len(choice) > 1:
        raise BagError(f'{reader.path}: the bag has {len(choice)} cameras, choose one with '
                       f'--image-topic: {describe_topics(choice)}')
    return choice[0]


def find_info_topic(reader: BagReader, image: BagTopic) -> Optional[BagTopic]:
    """Return the camera_info beside an image topic; '.../image/compressed' counts as its raw."""
    base = image.name.rpartition('/')[0] if image.msgtype == COMPRESSED else image.name
    wanted = {f'{base.rpartition("/")[0]}/camera_info', f'{base}/camera_info'}
    return next((topic for topic in reader.topics if topic.msgtype == CAMERA_INFO
                 and topic.name in wanted and topic.count), None)


def read_lens(message: Any, image: BagTopic, where: str) -> Lens:
    """
    Return the lens of a CameraInfo, ROI and binning folded in.

    Images of a topic named *rect* are straight already: P holds, and D does not. Raises BagError
    for cameras without calibration and for distortion models that are not known.
    """
    fields = SimpleNamespace(**{name: getattr(message, name) for name in _INFO_FIELDS})
    rectified = 'rect' in image.name
    distortion = np.array(fields.d, np.float64).reshape(-1)
    model = fields.distortion_model
    if rectified:
        distortion = np.zeros(0)
        p = np.array(fields.p, np.float64).reshape(3, 4)
        if p.any():
            fields.k = p[:, :3].reshape(-1)
    fields.d = np.zeros(5)
    try:
        intrinsics = read_camera_info(fields)
    except ImageRejected as error:
        raise BagError(f'{where}: {error}') from error
    if not rectified and model in _FISHEYE:
        return Lens(intrinsics, tuple(map(float, distortion[:4])), fisheye=True)
    if distortion.any() and (model not in _BROWN or len(distortion) not in (4, 5, 8)):
        raise BagError(
            f'{where}: distortion_model: expected plumb_bob, rational_polynomial or equidistant, '
            f'got {model!r} with {len(distortion)} coefficients; rectify the images first '
            '(image_proc) and record image_rect')
    return Lens(intrinsics, tuple(map(float, distortion)) if distortion.any() else ())
