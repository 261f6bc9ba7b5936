"""What a robot records as a bag: the camera's images, their calibration, poses and the truth."""
from collections.abc import Iterable, Mapping
from dataclasses import dataclass
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


@dataclass(frozen=True, eq=False)
class RobotFrame:
    """
    What a robot records at one moment.

    stamp_ns; image, camera_info: the fields of the camera's messages below their headers;
    T_map_odom, T_odom_base: (4, 4), what /tf says; truth: the wide image, RGB uint8 (H, W, 3), if
    it is known.
    """

    stamp_ns: int
    image: Mapping[str, Any]
    camera_info: Mapping[str, Any]
    T_map_odom: np.ndarray
    T_odom_base: np.ndarray
    truth: np.ndarray | None = None


def base_to_optical(camera_height: float) -> np.ndarray:
    """Return T_base_optical (4, 4) of a camera so many metres above base_link, looking ahead."""
    return _base_to_link(camera_height) @ T_BODY_OPTICAL


def _base_to_link(camera_height: float) -> np.ndarray:
    T_base_link = np.eye(4)
    T_base_link[2, 3] = camera_height
    return T_base_link


def write_demo_bag(path: Path | str, frames: Iterable[tuple[int, np.ndarray, CameraPose]],
                   expansion: ViewExpansion, camera_height: float = 1.5,
                   compressed: bool = False) -> int:
    """
    Write frames (stamp_ns, wide image uint8 RGB (H, W, 3), pose in the map) as a MCAP bag.

    The camera's image is the source window of the wide one; its odometry does not drift. Else as
    `write_robot_bag`.
    """
    T_optical_base = np.linalg.inv(base_to_optical(camera_height))
    info = camera_info_fields(expansion.source)
    return write_robot_bag(path, (
        RobotFrame(stamp_ns, image_fields(expansion.crop(wide)), info, np.eye(4),
                   pose.T_world_cam @ T_optical_base, wide)
        for stamp_ns, wide, pose in frames), camera_height, compressed)


def write_robot_bag(path: Path | str, frames: Iterable[RobotFrame], camera_height: float = 1.5,
                    compressed: bool = False) -> int:
    """
    Write what a robot recorded as a MCAP bag.

    Topics: /camera/image_raw, /camera/camera_info, /camera/wide/image_raw (the wide image as
    ground truth, where it is known), /odom, /tf and /tf_static with map -> odom -> base_link ->
    camera_link -> camera_optical_frame (REP-105, REP-103). base_link lies `camera_height` metres
    below the camera. All stamps of a frame are equal to its log time. Returns the number of
    frames; raises BagError for stamps that do not rise, an output that exists or cannot be
    written, and no frames at all.
    """
    remaining = iter(frames)
    first = next(remaining, None)
    if first is None:
        raise BagError(f'{path}: expected frames for the bag, got none')
    with BagWriter(path, compressed) as writer:
        messages = _Messages(writer)
        messages.send_static(first.stamp_ns, _base_to_link(camera_height))
        count, last = 0, None
        for frame in chain([first], remaining):
            if last is not None and frame.stamp_ns <= last.stamp_ns:
                raise BagError(f'stamp_ns: expected rising stamps, got {frame.stamp_ns} after '
                               f'{last.stamp_ns}')
            messages.send_pose(frame, last)
            messages.send_images(frame)
            last = frame
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
                (IMAGE_TOPIC, 'sensor_msgs/msg/Image', ()))}

    def send_static(self, stamp_ns: int, T_base_link: np.ndarray) -> None:
        self._send_tf('/tf_static', stamp_ns, [
            ('base_link', 'camera_link', T_base_link),
            ('camera_link', OPTICAL_FRAME, T_BODY_OPTICAL)])

    def send_pose(self, frame: RobotFrame, last: RobotFrame | None) -> None:
        stamp_ns, T = frame.stamp_ns, frame.T_odom_base
        self._send_tf('/tf', stamp_ns, [('map', 'odom', frame.T_map_odom),
                                        ('odom', 'base_link', T)])
        linear, angular = np.zeros(3), np.zeros(3)
        if last is not None:
            seconds = (stamp_ns - last.stamp_ns) / NS_PER_S
            step = np.linalg.inv(last.T_odom_base) @ T
            linear, angular = step[:3, 3] / seconds, rotation_vector(step[:3, :3]) / seconds
        T_pose = self._make('geometry_msgs/msg/Pose', position=self._vector(
            T[:3, 3], 'Point'), orientation=self._quaternion(T))
        twist = self._make('geometry_msgs/msg/Twist', linear=self._vector(linear),
                           angular=self._vector(angular))
        self._send('/odom', stamp_ns, 'odom', child_frame_id='base_link',
                   pose=self._make('geometry_msgs/msg/PoseWithCovariance', pose=T_pose,
                                   covariance=np.zeros(36)),
                   twist=self._make('geometry_msgs/msg/TwistWithCovariance', twist=twist,
                                    covariance=np.zeros(36)))

    def send_images(self, frame: RobotFrame) -> None:
        whole_sensor = self._make('sensor_msgs/msg/RegionOfInterest', x_offset=0, y_offset=0,
                                  height=0, width=0, do_rectify=False)
        stamp_ns = frame.stamp_ns
        self._send(CAMERA_INFO_TOPIC, stamp_ns, OPTICAL_FRAME, binning_x=0, binning_y=0,
                   roi=whole_sensor, **frame.camera_info)
        self._send(IMAGE_TOPIC, stamp_ns, OPTICAL_FRAME, **frame.image)
        if frame.truth is not None:
            if TRUTH_TOPIC not in self._topics:
                self._topics[TRUTH_TOPIC] = self._writer.add_topic(
                    TRUTH_TOPIC, 'sensor_msgs/msg/Image')
            self._send(TRUTH_TOPIC, stamp_ns, OPTICAL_FRAME, **image_fields(frame.truth))

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
