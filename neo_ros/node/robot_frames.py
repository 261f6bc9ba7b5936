"""The robot's frames: its base's pose from the camera's, and the transform for tf."""
from time import monotonic
from typing import Any

from neo_ros.errors import GeometryError
from neo_ros.geometry import CameraPose
from neo_ros.geometry.camera_pose import quaternion_from_rotation
from neo_ros.node.message_types import make_message
from neo_ros.node.parameters import NodeParameters
import numpy as np
from rclpy.clock import JumpThreshold
from rclpy.duration import Duration
from rclpy.node import Node
from rclpy.time import Time

# Transforms of maps are dated ahead, or whoever asks for "now" would wait for the next image.
AHEAD = Duration(seconds=0.5)
NEWEST = Time()  # To tf2.
# Time that runs back by more has begun anew: a bag that is played again, a simulation's reset.
ANEW = Duration(seconds=1)
# Odometry may come a little later than the image: a transform that is missing for longer is told.
MISSED_S = 5.0
# One that nobody has asked for in so long may be there by now: nothing is told of it.
ASKED_S = 10.0


def moved_covariance(covariance: np.ndarray, offset: np.ndarray) -> np.ndarray:
    """
    Return the covariance of a point that is fixed to the camera, `offset` (3,) from it.

    Both (6, 6) as `memory.sight.Guide.covariance`; offset along the world's axes, metres.
    """
    x, y, z = offset
    J = np.eye(6)
    # A turn moves the point by turn x offset.
    J[:3, 3:] = [[0, z, -y], [-z, 0, x], [y, -x, 0]]
    return J @ covariance @ J.T


class RobotFrames:
    """Looks up where the camera is on the robot; needs tf2_ros, which read_parameters checks."""

    def __init__(self, node: Node, values: NodeParameters) -> None:
        import tf2_ros

        self._node, self._tf2, self._values = node, tf2_ros, values
        self._buffer = tf2_ros.Buffer()
        self._listener = tf2_ros.TransformListener(self._buffer, node)
        self._broadcaster = tf2_ros.TransformBroadcaster(node) if values.publish_tf else None
        self._stamp: Time | None = None
        # By target: since when, when last, and the words.
        self._missed: dict[str, tuple[float, float, str]] = {}
        # The buffer refuses what is 10 s older than its newest. Fixed transforms survive.
        self._jumps = node.get_clock().create_jump_callback(
            JumpThreshold(min_forward=None, min_backward=Duration(nanoseconds=-ANEW.nanoseconds)),
            post_callback=lambda _: self._buffer.clear())

    @property
    def sends(self) -> bool:
        """Whether transforms are sent, to whoever listens to tf."""
        return self._broadcaster is not None

    @property
    def missing(self) -> str:
        """Which transforms have been missing for long, in words; '' = none."""
        now = monotonic()
        return '; '.join(words for since, last, words in list(self._missed.values())
                         if now - since > MISSED_S and now - last <= ASKED_S)

    def camera_in_base(self, camera_frame: str, stamp: Time = NEWEST) -> np.ndarray | None:
        """Return T_base_camera (4, 4) at a time, else the newest one; None: nobody has sent it."""
        return self._lookup(self._values.base_frame, camera_frame, stamp, NEWEST)

    def base_pose(self, header: Any, pose: CameraPose, covariance: np.ndarray
                  ) -> tuple[CameraPose, np.ndarray] | None:
        """Return the pose of the base and its covariance, from the camera's; None: no tf."""
        stamp = Time.from_msg(header.stamp)
        self._watch(stamp)
        T_base_camera = self.camera_in_base(header.frame_id.lstrip('/'), stamp)
        if T_base_camera is None:
            return None
        T = pose.T_world_cam @ np.linalg.inv(T_base_camera)
        base = CameraPose.nearest(T)
        return base, moved_covariance(covariance, base.position - pose.position)

    def send_transform(self, header: Any, scene_frame: str, base: CameraPose) -> None:
        """Say where the odometry's frame is in the scene; nothing where odometry is silent."""
        stamp = Time.from_msg(header.stamp)
        T_odom_base = self._lookup(self._values.odom_frame, self._values.base_frame, stamp)
        if self._broadcaster is None or T_odom_base is None:
            return
        T = CameraPose.nearest(base.T_world_cam @ np.linalg.inv(T_odom_base))
        x, y, z = T.position.tolist()
        quaternion = quaternion_from_rotation(T.T_world_cam[:3, :3]).tolist()
        self._broadcaster.sendTransform(make_message(
            'geometry_msgs/msg/TransformStamped',
            header=make_message('std_msgs/msg/Header', stamp=(stamp + AHEAD).to_msg(),
                                frame_id=scene_frame),
            child_frame_id=self._values.odom_frame, transform=make_message(
                'geometry_msgs/msg/Transform',
                translation=make_message('geometry_msgs/msg/Vector3', x=x, y=y, z=z),
                rotation=make_message('geometry_msgs/msg/Quaternion',
                                      **dict(zip('xyzw', quaternion))))))

    def destroy(self) -> None:
        """Stop listening and sending."""
        self._jumps.unregister()
        self._listener.unregister()
        if self._broadcaster is not None:
            self._node.destroy_publisher(self._broadcaster.pub_tf)

    def _watch(self, stamp: Time) -> None:
        """Begin anew with the images: without simulated time only their stamps tell."""
        if self._stamp is not None and self._stamp - stamp > ANEW:
            self._buffer.clear()
        self._stamp = stamp

    def _lookup(self, target: str, source: str, *stamps: Time) -> np.ndarray | None:
        for stamp in stamps:
            try:
                found = self._buffer.lookup_transform(target, source, stamp).transform
                at, turn = found.translation, found.rotation
                T = CameraPose.from_quaternion(
                    np.array([at.x, at.y, at.z]),
                    np.array([turn.x, turn.y, turn.z, turn.w])).T_world_cam
            except (self._tf2.TransformException, GeometryError) as error:
                words = f'no transform from {target} to {source}: {error}'
                continue
            self._missed.pop(target, None)
            return T
        now = monotonic()
        since, last, _ = self._missed.get(target, (now, now, ''))
        self._missed[target] = since if now - last <= ASKED_S else now, now, words
        if self.missing and self._node.context.ok():
            self._node.get_logger().warning(self.missing, throttle_duration_sec=MISSED_S)
        return None
