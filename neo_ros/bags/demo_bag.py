"""A camera's walk through a scene as a bag: narrow view, its calibration, poses and the truth."""
from collections.abc import Iterable
from itertools import chain
from pathlib import Path
from typing import Any

from neo_ros.bags.qos import LATCHED
from neo_ros.bags.writing import BagWriter
from neo_ros.errors import BagError
from neo_ros.geometry import CameraPose, ViewExpansion
from neo_ros.geometry.camera_pose import (
    quaternion_from_rotation, rotation_vector, T_BODY_OPTICAL)
from neo_ros.messages import camera_info_fields, image_fields
from neo_ros.messages.stamps import NS_PER_S
import numpy as np

IMAGE_TOPIC = '/camera/image_raw'
CAMERA_INFO_TOPIC = '/camera/camera_info'
TRUTH_TOPIC = '/camera/wide/image_raw'
OPTICAL_FRAME = 'camera_optical_frame'


def write_demo_bag(path: Path | str, frames: Iterable[tuple[int, np.ndarray, CameraPose]],
                   expansion: ViewExpansion, camera_height: float = 1.5,
                   compressed: bool = False) -> int:
    """
    Write frames (stamp_ns, wide image uint8 RGB (H, W, 3), pose in the map) as a MCAP bag.

    Topics: /camera/image_raw (the source window of the wide image), /camera/camera_info,
    /camera/wide/image_raw (the wide image as ground truth), /odom, /tf and /tf_static with
    map -> odom -> base_link -> camera_link -> camera_optical_frame (REP-105, REP-103).
    base_link lies `camera_height` metres below the camera. All stamps of a frame are equal to
    its log time. Returns the number of frames; raises BagError for stamps that do not rise, an
    output that exists or cannot be written, and no frames at all.
    """
    T_base_link = np.eye(4)
    T_base_link[2, 3] = camera_height
    T_optical_base = np.linalg.inv(T_base_link @ T_BODY_OPTICAL)
    remaining = iter(frames)
    first = next(remaining, None)
    if first is None:
        raise BagError(f'{path}: expected frames for the bag, got none')
    with BagWriter(path, compressed) as writer:
        messages = _Messages(writer)
        messages.send_static(first[0], T_base_link)
        count, last = 0, None
        for stamp_ns, wide_image, pose in chain([first], remaining):
            T_map_base = pose.T_world_cam @ T_optical_base
            if last is not None and stamp_ns <= last[0]:
                raise BagError(
                    f'stamp_ns: expected rising stamps, got {stamp_ns} after {last[0]}')
            messages.send_pose(stamp_ns, T_map_base, last)
            messages.send_images(stamp_ns, wide_image, expansion)
            last = (stamp_ns, T_map_base)
            count += 1
    return count


class _Messages:
    """The messages of one frame, written with a common stamp."""

    def __init__(self, writer: BagWriter) -> None:
        self._writer = writer
        self._types = writer.typestore.types
        self._topics = {
            name: writer.add_topic(name, msgtype, qos) for name, msgtype, qos in (
                ('/tf_static', 'tf2_msgs/msg/TFMessage', (LATCHED,)),
                ('/tf', 'tf2_msgs/msg/TFMessage', ()),
                ('/odom', 'nav_msgs/msg/Odometry', ()),
                (CAMERA_INFO_TOPIC, 'sensor_msgs/msg/CameraInfo', ()),
                (IMAGE_TOPIC, 'sensor_msgs/msg/Image', ()),
                (TRUTH_TOPIC, 'sensor_msgs/msg/Image', ()))}

    def send_static(self, stamp_ns: int, T_base_link: np.ndarray) -> None:
        self._send_tf('/tf_static', stamp_ns, [
            ('base_link', 'camera_link', T_base_link),
            ('camera_link', OPTICAL_FRAME, T_BODY_OPTICAL)])

    def send_pose(self, stamp_ns: int, T_map_base: np.ndarray,
                  last: tuple[int, np.ndarray] | None) -> None:
        # The demo's odometry does not drift: map and odom are the same.
        self._send_tf('/tf', stamp_ns, [('map', 'odom', np.eye(4)),
                                        ('odom', 'base_link', T_map_base)])
        linear, angular = np.zeros(3), np.zeros(3)
        if last is not None:
            seconds = (stamp_ns - last[0]) / NS_PER_S
            step = np.linalg.inv(last[1]) @ T_map_base
            linear, angular = step[:3, 3] / seconds, rotation_vector(step[:3, :3]) / seconds
        T_pose = self._make('geometry_msgs/msg/Pose', position=self._vector(
            T_map_base[:3, 3], 'Point'), orientation=self._quaternion(T_map_base))
        twist = self._make('geometry_msgs/msg/Twist', linear=self._vector(linear),
                           angular=self._vector(angular))
        self._send('/odom', stamp_ns, 'odom', child_frame_id='base_link',
                   pose=self._make('geometry_msgs/msg/PoseWithCovariance', pose=T_pose,
                                   covariance=np.zeros(36)),
                   twist=self._make('geometry_msgs/msg/TwistWithCovariance', twist=twist,
                                    covariance=np.zeros(36)))

    def send_images(self, stamp_ns: int, wide_image: np.ndarray,
                    expansion: ViewExpansion) -> None:
        whole_sensor = self._make('sensor_msgs/msg/RegionOfInterest', x_offset=0, y_offset=0,
                                  height=0, width=0, do_rectify=False)
        self._send(CAMERA_INFO_TOPIC, stamp_ns, OPTICAL_FRAME, binning_x=0, binning_y=0,
                   roi=whole_sensor, **camera_info_fields(expansion.source))
        self._send(IMAGE_TOPIC, stamp_ns, OPTICAL_FRAME,
                   **image_fields(expansion.crop(wide_image)))
        self._send(TRUTH_TOPIC, stamp_ns, OPTICAL_FRAME, **image_fields(wide_image))

    def _make(self, msgtype: str, **fields: Any) -> Any:
        return self._types[msgtype](**fields)

    def _header(self, stamp_ns: int, frame_id: str) -> Any:
        seconds, nanoseconds = divmod(stamp_ns, NS_PER_S)
        return self._make('std_msgs/msg/Header', frame_id=frame_id, stamp=self._make(
            'builtin_interfaces/msg/Time', sec=seconds, nanosec=nanoseconds))

    def _vector(self, xyz: np.ndarray, kind: str = 'Vector3') -> Any:
        x, y, z = map(float, xyz)
        return self._make(f'geometry_msgs/msg/{kind}', x=x, y=y, z=z)

    def _quaternion(self, T: np.ndarray) -> Any:
        x, y, z, w = map(float, quaternion_from_rotation(T[:3, :3]))
        return self._make('geometry_msgs/msg/Quaternion', x=x, y=y, z=z, w=w)

    def _send_tf(self, topic: str, stamp_ns: int,
                 transforms: list[tuple[str, str, np.ndarray]]) -> None:
        stamped = [self._make(
            'geometry_msgs/msg/TransformStamped', header=self._header(stamp_ns, parent),
            child_frame_id=child, transform=self._make(
                'geometry_msgs/msg/Transform', translation=self._vector(T[:3, 3]),
                rotation=self._quaternion(T))) for parent, child, T in transforms]
        message = self._make('tf2_msgs/msg/TFMessage', transforms=stamped)
        self._writer.write(self._topics[topic], stamp_ns, message)

    def _send(self, topic: str, stamp_ns: int, frame_id: str, **fields: Any) -> None:
        msgtype = self._topics[topic].msgtype
        message = self._make(msgtype, header=self._header(stamp_ns, frame_id), **fields)
        self._writer.write(self._topics[topic], stamp_ns, message)
