"""Camera poses: `T_world_cam`, x_world = T_world_cam @ x_cam, metres, OpenCV camera axes."""
from collections.abc import Iterable
from dataclasses import dataclass
import math

from neo_ros.errors import GeometryError
import numpy as np

# OpenGL camera axes (+X right, +Y up, +Z back) expressed in OpenCV's (+X right, +Y down, +Z fwd).
OPENGL_FROM_OPENCV = np.diag([1.0, -1.0, -1.0, 1.0])
# REP-103: a body frame is x forward, y left, z up; its optical frame is x right, y down, z fwd.
T_BODY_OPTICAL = np.array([[0.0, 0, 1, 0], [-1, 0, 0, 0], [0, -1, 0, 0], [0, 0, 0, 1]])


def check_transform(matrix: np.ndarray, name: str = 'T_world_cam') -> np.ndarray:
    """
    Return `matrix` as a float64 (4, 4) rigid transform.

    Raises GeometryError for wrong shapes, values that are not finite, rotations that are not
    orthonormal to 1e-3 and left-handed (mirroring) matrices.
    """
    T = np.array(matrix, np.float64)
    if T.shape == (3, 4):
        T = np.vstack([T, [0, 0, 0, 1.0]])
    if T.shape != (4, 4):
        raise GeometryError(f'{name}: expected a 4x4 matrix, got shape {T.shape}')
    if not np.isfinite(T).all():
        raise GeometryError(f'{name}: expected finite numbers, got {T.tolist()}')
    R = T[:3, :3]
    error = np.abs(R.T @ R - np.eye(3)).max()
    if error > 1e-3:
        raise GeometryError(
            f'{name}: expected a rotation, but R^T R differs from identity by {error:.3g} '
            '(a scaled or sheared pose?)')
    if np.linalg.det(R) < 0:
        raise GeometryError(
            f'{name}: expected a right-handed rotation, got determinant -1 '
            '(one axis is mirrored)')
    if np.abs(T[3] - [0, 0, 0, 1]).max() > 1e-6:
        raise GeometryError(f'{name}: expected last row 0 0 0 1, got {T[3].tolist()}')
    return T


@dataclass(frozen=True, eq=False)
class CameraPose:
    """A rigid camera-to-world transform, float64 (4, 4), OpenCV camera axes, metres."""

    T_world_cam: np.ndarray

    def __post_init__(self) -> None:
        T = check_transform(self.T_world_cam)
        T.setflags(write=False)
        object.__setattr__(self, 'T_world_cam', T)

    @classmethod
    def from_opengl(cls, T_world_gl: np.ndarray) -> 'CameraPose':
        """Take camera-to-world with OpenGL camera axes, as in transforms.json files."""
        return cls(check_transform(T_world_gl, 'transform_matrix') @ OPENGL_FROM_OPENCV)

    @classmethod
    def from_planar(cls, x: float, y: float, z: float, yaw: float) -> 'CameraPose':
        """
        Place a camera that looks horizontally, in a world with z up (REP-103).

        x, y, z in metres; yaw in radians, counter-clockwise seen from above, 0 looks along +x.
        """
        c, s = math.cos(yaw), math.sin(yaw)
        T_world_body = np.array([[c, -s, 0, x], [s, c, 0, y], [0, 0, 1, z], [0, 0, 0, 1.0]])
        return cls(T_world_body @ T_BODY_OPTICAL)

    @classmethod
    def from_quaternion(cls, translation: np.ndarray, quaternion_xyzw: np.ndarray) -> 'CameraPose':
        """Take a ROS translation (metres) and quaternion (x, y, z, w), normalised here."""
        return cls(transform_from_quaternion(translation, quaternion_xyzw))

    def to_opengl(self) -> np.ndarray:
        """Return camera-to-world (4, 4) with OpenGL camera axes."""
        return self.T_world_cam @ OPENGL_FROM_OPENCV

    @property
    def position(self) -> np.ndarray:
        """Optical centre in the world, (3,) metres."""
        return self.T_world_cam[:3, 3]

    @property
    def forward(self) -> np.ndarray:
        """Viewing direction in the world, (3,) unit vector."""
        return self.T_world_cam[:3, 2]

    @property
    def yaw(self) -> float:
        """Heading about world +z in radians in (-pi, pi], 0 looks along +x."""
        return math.atan2(self.forward[1], self.forward[0])

    def inverse(self) -> np.ndarray:
        """Return T_cam_world (4, 4)."""
        R, t = self.T_world_cam[:3, :3], self.T_world_cam[:3, 3]
        T = np.eye(4)
        T[:3, :3] = R.T
        T[:3, 3] = -R.T @ t
        return T

    @classmethod
    def nearest(cls, matrix: np.ndarray) -> 'CameraPose':
        """
        Return the pose nearest to a (4, 4) matrix whose rotation is not quite one (Frobenius).

        For chains of products: rounding grows in them, because the inverse takes transposes.
        """
        return cls.nearest_each(matrix[None])[0]

    @classmethod
    def nearest_each(cls, matrices: np.ndarray) -> 'list[CameraPose]':
        """Return `nearest` of each of (N, 4, 4)."""
        U, _, Vt = np.linalg.svd(matrices[:, :3, :3])
        T = matrices.copy()
        U[..., 2] *= np.linalg.det(U @ Vt)[:, None]
        T[:, :3, :3] = U @ Vt
        return [cls(one) for one in T]

    def is_apart(self, other: 'CameraPose', metres: float, radians: float) -> bool:
        """Tell whether the other camera stands farther away, or is turned by more."""
        T = other.inverse() @ self.T_world_cam
        return bool(np.linalg.norm(T[:3, 3]) > metres or rotation_angle(T[:3, :3]) > radians)

    def interpolated(self, other: 'CameraPose', fraction: float) -> 'CameraPose':
        """
        Return the pose at `fraction` of the way to `other`: lerp and slerp.

        Above 1 it lies beyond `other`, as far as a steady motion would go on.
        """
        R0, R1 = self.T_world_cam[:3, :3], other.T_world_cam[:3, :3]
        T = np.eye(4)
        T[:3, :3] = R0 @ rotation_from_vector(fraction * rotation_vector(R0.T @ R1))
        T[:3, 3] = (1 - fraction) * self.position + fraction * other.position
        return CameraPose(T)


def is_quaternion(numbers: Iterable[float]) -> bool:
    """Whether four numbers can be normalised to a rotation."""
    # Without a warning for numbers that are too large; what is no number is never in between.
    return 1e-6 <= math.hypot(*numbers) < math.inf


def transform_from_quaternion(translation: np.ndarray, quaternion_xyzw: np.ndarray) -> np.ndarray:
    """
    Build a (4, 4) transform from (3,) metres and a quaternion (x, y, z, w).

    Raises GeometryError for quaternions that are not four finite numbers, or of length zero.
    """
    q = np.asarray(quaternion_xyzw, np.float64)
    if q.shape != (4,) or not is_quaternion(q):
        raise GeometryError(f'quaternion: expected a unit (x, y, z, w), got {q.tolist()}')
    x, y, z, w = q / math.hypot(*q)
    T = np.eye(4)
    T[:3, :3] = [[1 - 2 * (y * y + z * z), 2 * (x * y - z * w), 2 * (x * z + y * w)],
                 [2 * (x * y + z * w), 1 - 2 * (x * x + z * z), 2 * (y * z - x * w)],
                 [2 * (x * z - y * w), 2 * (y * z + x * w), 1 - 2 * (x * x + y * y)]]
    T[:3, 3] = translation
    return T


def quaternion_from_rotation(R: np.ndarray) -> np.ndarray:
    """Return the unit quaternion (x, y, z, w), w >= 0, of a (3, 3) rotation."""
    # The eigenvector of the largest eigenvalue is stable for every rotation (Bar-Itzhack, 2000).
    K = np.array([
        [R[0, 0] - R[1, 1] - R[2, 2], R[1, 0] + R[0, 1], R[2, 0] + R[0, 2], R[2, 1] - R[1, 2]],
        [R[1, 0] + R[0, 1], R[1, 1] - R[0, 0] - R[2, 2], R[2, 1] + R[1, 2], R[0, 2] - R[2, 0]],
        [R[2, 0] + R[0, 2], R[2, 1] + R[1, 2], R[2, 2] - R[0, 0] - R[1, 1], R[1, 0] - R[0, 1]],
        [R[2, 1] - R[1, 2], R[0, 2] - R[2, 0], R[1, 0] - R[0, 1], R[0, 0] + R[1, 1] + R[2, 2]],
    ])
    quaternion = np.linalg.eigh(K)[1][:, -1]
    return quaternion if quaternion[3] >= 0 else -quaternion


def rotation_vector(R: np.ndarray) -> np.ndarray:
    """Return axis * angle (3,), radians in [0, pi], of a (3, 3) rotation."""
    x, y, z, w = quaternion_from_rotation(R)
    sine = math.sqrt(x * x + y * y + z * z)
    scale = 2 * math.atan2(sine, w) / sine if sine > 1e-12 else 2.0
    return scale * np.array([x, y, z])


def rotation_angle(R: np.ndarray) -> float:
    """Return the angle of a (3, 3) rotation, radians in [0, pi]."""
    return float(np.linalg.norm(rotation_vector(R)))


def rotation_from_vector(vector: np.ndarray) -> np.ndarray:
    """Return the (3, 3) rotation of axis * angle (3,), radians (Rodrigues)."""
    angle = float(np.linalg.norm(vector))
    x, y, z = vector
    S = np.array([[0, -z, y], [z, 0, -x], [-y, x, 0.0]])
    if angle < 1e-8:
        return np.eye(3) + S
    return (np.eye(3) + math.sin(angle) / angle * S
            + (1 - math.cos(angle)) / angle ** 2 * S @ S)
