"""What others say of where the camera is: priors and odometry, for the hints of the next image."""
import math
import time
from typing import Any

from geometry_msgs.msg import PoseWithCovarianceStamped
from nav_msgs.msg import Odometry
from neo_ros.errors import GeometryError
from neo_ros.geometry import CameraPose
from neo_ros.geometry.camera_pose import T_BODY_OPTICAL
from neo_ros.messages.hints import PoseHints, PRIOR_VALID_S, read_pose
from neo_ros.node.interface import ODOMETRY, PRIOR
from neo_ros.node.robot_frames import RobotFrames
import numpy as np
from rclpy.node import Node
from rclpy.qos import qos_profile_sensor_data, QoSProfile

REPORT_PERIOD_S = 5.0


class PoseInputs:
    """
    Subscribes to PRIOR and ODOMETRY and turns them into `hints` of the camera's optical frame.

    scene_frame: what priors are in; camera_frame: of the images, None before the first; both may
    change. base_frame: what the messages are of, where `frames` tells how the camera sits on it. A
    prior waits until that is known.
    """

    def __init__(self, node: Node, scene_frame: str, base_frame: str,
                 frames: RobotFrames | None) -> None:
        self.hints, self.metric = PoseHints(), True
        self.scene_frame = scene_frame
        self.camera_frame: str | None = None
        self._node, self._frames, self._base_frame = node, frames, base_frame
        self._told: dict[str, float] = {}
        self._waiting: tuple[PoseWithCovarianceStamped, float] | None = None  # And when it came.
        self._subscriptions = [
            node.create_subscription(PRIOR.kind, PRIOR.name, self._on_prior, QoSProfile(depth=1)),
            node.create_subscription(ODOMETRY.kind, ODOMETRY.name, self._on_odometry,
                                     qos_profile_sensor_data)]

    def destroy(self) -> None:
        """Take the subscriptions back."""
        for subscription in self._subscriptions:
            self._node.destroy_subscription(subscription)

    def see_camera(self, frame: str) -> None:
        """Be told of an image in this frame, before it is widened."""
        self.camera_frame = frame
        self._read_prior()

    def forget_prior(self) -> None:
        """Drop a prior that waits."""
        self._waiting = None
        self.hints.take_prior()

    def _on_prior(self, message: PoseWithCovarianceStamped) -> None:
        frame = message.header.frame_id.lstrip('/')
        if frame not in ('', self.scene_frame):
            self._tell('prior', f'{PRIOR.name}: expected a pose in {self.scene_frame} '
                       f'(scene_frame), got {frame}: dropped')
            return
        self._waiting = message, time.monotonic()
        self._read_prior()

    def _read_prior(self) -> None:
        if self._waiting is None:
            return
        message, came = self._waiting
        T_camera: np.ndarray | None = T_BODY_OPTICAL
        if self._base_frame:
            T_camera = self._camera_in_base() if self.camera_frame else None
        if T_camera is None and time.monotonic() - came <= PRIOR_VALID_S:
            return
        self._waiting = None
        if T_camera is None:
            self._tell('prior', f'{PRIOR.name}: waited {PRIOR_VALID_S:g} s for the camera and its '
                       'transform: dropped')
        pose = self._read(PRIOR.name, message.pose.pose, T_camera)
        if pose is not None:
            self.hints.set_prior(pose, came)

    def _on_odometry(self, message: Odometry) -> None:
        if self.camera_frame is None or not self.metric:  # Its metres say nothing of the scene.
            return
        if not self.camera_frame:
            self._tell('odometry', f'{ODOMETRY.name}: expected images with a frame_id, to know '
                       'how the camera sits on the robot, got none: dropped')
            return
        child = message.child_frame_id.lstrip('/')
        T_camera: np.ndarray | None = np.eye(4)
        if child == self.camera_frame:
            pass  # As it is.
        elif self._base_frame and child in ('', self._base_frame):
            T_camera = self._camera_in_base()
        else:
            self._tell('odometry', f'{ODOMETRY.name}: is of {child or "no frame"}; to use it, set '
                       f'base_frame to that, or send it of {self.camera_frame}')
            return
        pose = self._read(ODOMETRY.name, message.pose.pose, T_camera)
        if pose is not None:
            self.hints.add_odometry(message.header, pose)

    def _camera_in_base(self) -> np.ndarray | None:
        assert self.camera_frame
        T = None if self._frames is None else self._frames.camera_in_base(self.camera_frame)
        if T is None:
            self._tell('transform', f'no transform from {self._base_frame} to '
                       f'{self.camera_frame}: odometry of the base is dropped, a prior waits')
        return T

    def _read(self, name: str, pose: Any, T_camera: np.ndarray | None) -> CameraPose | None:
        """Return the camera's pose by what a message says; None: that cannot be used."""
        if T_camera is None:
            return None
        try:
            return CameraPose.nearest(read_pose(pose).T_world_cam @ T_camera)
        except GeometryError as error:
            self._tell(name, f'{name}: {error}: dropped')
            return None

    def _tell(self, kind: str, words: str) -> None:
        """Log complaints of a kind now and then: odometry comes many times a second."""
        now = time.monotonic()
        if now > self._told.get(kind, -math.inf) + REPORT_PERIOD_S:
            self._told[kind] = now
            self._node.get_logger().warning(words)
