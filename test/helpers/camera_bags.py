"""Bags of one camera with poses in any of the ways that robots record them."""
from pathlib import Path
from typing import Any, Self

import cv2
from neo_ros.bags import BagWriter
from neo_ros.geometry import Intrinsics
from neo_ros.geometry.camera_pose import quaternion_from_rotation
from neo_ros.messages import camera_info_fields, image_fields
import numpy as np
from rosbags.rosbag2 import StoragePlugin, Writer

INFO, IMAGE, TF = 'sensor_msgs/msg/CameraInfo', 'sensor_msgs/msg/Image', 'tf2_msgs/msg/TFMessage'
COMPRESSED = 'sensor_msgs/msg/CompressedImage'


class CameraBag(BagWriter):
    """A bag that is filled message by message; every message's log time is its stamp."""

    def __init__(self, path: Path) -> None:
        super().__init__(path)
        self.log_ns = 0

    def __enter__(self) -> Self:
        return self

    def make(self, msgtype: str, **fields: Any) -> Any:
        return self.typestore.types[msgtype](**fields)

    def header(self, stamp_ns: int, frame_id: str) -> Any:
        seconds, rest = divmod(stamp_ns, 1_000_000_000)
        return self.make('std_msgs/msg/Header', frame_id=frame_id, stamp=self.make(
            'builtin_interfaces/msg/Time', sec=seconds, nanosec=rest))

    def image(self, topic: str, stamp_ns: int, image: np.ndarray, frame_id: str = 'optical',
              compressed: bool = False) -> None:
        header = self.header(stamp_ns, frame_id)
        if compressed:
            data = cv2.imencode('.png', image[..., ::-1])[1].reshape(-1)
            self.send(topic, COMPRESSED, stamp_ns, header=header, format='png', data=data)
        else:
            self.send(topic, IMAGE, stamp_ns, header=header, **image_fields(image))

    def info(self, topic: str, stamp_ns: int, camera: Intrinsics, **changes: Any) -> None:
        roi = self.make('sensor_msgs/msg/RegionOfInterest', x_offset=0, y_offset=0, height=0,
                        width=0, do_rectify=False)
        self.send(topic, INFO, stamp_ns, header=self.header(stamp_ns, 'optical'), binning_x=0,
                  binning_y=0, roi=roi, **{**camera_info_fields(camera), **changes})

    def tf(self, topic: str, stamp_ns: int, parent: str, child: str, T: np.ndarray) -> None:
        transform = self.make('geometry_msgs/msg/Transform', translation=self.vector(T),
                              rotation=self.quaternion(T))
        self.send(topic, TF, stamp_ns, transforms=[self.make(
            'geometry_msgs/msg/TransformStamped', header=self.header(stamp_ns, parent),
            child_frame_id=child, transform=transform)])

    def pose(self, topic: str, stamp_ns: int, T: np.ndarray) -> None:
        self.send(topic, 'geometry_msgs/msg/PoseStamped', stamp_ns,
                  header=self.header(stamp_ns, 'map'), pose=self.make_pose(T))

    def transform(self, topic: str, stamp_ns: int, child: str, T: np.ndarray) -> None:
        self.send(topic, 'geometry_msgs/msg/TransformStamped', stamp_ns,
                  header=self.header(stamp_ns, 'world'), child_frame_id=child,
                  transform=self.make('geometry_msgs/msg/Transform', translation=self.vector(T),
                                      rotation=self.quaternion(T)))

    def pose_path(self, topic: str, stamp_ns: int, poses: dict[int, np.ndarray]) -> None:
        self.send(topic, 'nav_msgs/msg/Path', stamp_ns, header=self.header(stamp_ns, 'map'),
                  poses=[self.make('geometry_msgs/msg/PoseStamped', pose=self.make_pose(T),
                                   header=self.header(stamp, 'map'))
                         for stamp, T in poses.items()])

    def pose_array(self, topic: str, stamp_ns: int, poses: list[np.ndarray]) -> None:
        self.send(topic, 'geometry_msgs/msg/PoseArray', stamp_ns,
                  header=self.header(stamp_ns, 'map'), poses=list(map(self.make_pose, poses)))

    def odometry(self, topic: str, stamp_ns: int, child: str, T: np.ndarray) -> None:
        zero = self.make('geometry_msgs/msg/Vector3', x=0.0, y=0.0, z=0.0)
        self.send(
            topic, 'nav_msgs/msg/Odometry', stamp_ns, header=self.header(stamp_ns, 'odom'),
            child_frame_id=child, pose=self.make(
                'geometry_msgs/msg/PoseWithCovariance', pose=self.make_pose(T),
                covariance=np.zeros(36)),
            twist=self.make('geometry_msgs/msg/TwistWithCovariance', covariance=np.zeros(36),
                            twist=self.make('geometry_msgs/msg/Twist', linear=zero,
                                            angular=zero)))

    def make_pose(self, T: np.ndarray) -> Any:
        return self.make('geometry_msgs/msg/Pose', position=self.vector(T, 'Point'),
                         orientation=self.quaternion(T))

    def vector(self, T: np.ndarray, kind: str = 'Vector3') -> Any:
        x, y, z = map(float, T[:3, 3])
        return self.make(f'geometry_msgs/msg/{kind}', x=x, y=y, z=z)

    def quaternion(self, T: np.ndarray) -> Any:
        x, y, z, w = map(float, quaternion_from_rotation(T[:3, :3]))
        return self.make('geometry_msgs/msg/Quaternion', x=x, y=y, z=z, w=w)

    def send(self, name: str, msgtype: str, stamp_ns: int, **fields: Any) -> None:
        self.log_ns += 1
        self.write(self.add_topic(name, msgtype), self.log_ns, self.make(msgtype, **fields))


def as_sqlite(bag: Path, target: Path) -> Path:
    """Copy a bag into rosbag2's sqlite3 storage."""
    from rosbags.rosbag2 import Reader
    with Reader(bag) as reader, Writer(
            target, version=9, storage_plugin=StoragePlugin.SQLITE3) as writer:
        copies = {entry.id: writer.add_connection(
            entry.topic, entry.msgtype, msgdef=entry.msgdef.data, rihs01=entry.digest)
            for entry in reader.connections}
        for connection, stamp_ns, data in reader.messages():
            writer.write(copies[connection.id], stamp_ns, data)
    return target
