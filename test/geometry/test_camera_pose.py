import math

from hypothesis import given, strategies as st
from neo_ros.errors import GeometryError
from neo_ros.geometry import CameraPose
from neo_ros.geometry.camera_pose import (
    quaternion_from_rotation, rotation_angle, rotation_from_vector, rotation_vector,
    transform_from_quaternion)
import numpy as np
import pytest

metres = st.floats(-50.0, 50.0)
points = st.tuples(metres, metres, metres).map(np.array)
components = st.floats(-1.0, 1.0)
quaternions = st.tuples(components, components, components, components).filter(
    lambda q: np.linalg.norm(q) > 0.1).map(np.array)
poses = st.builds(CameraPose.from_quaternion, points, quaternions)


@given(poses)
def test_inverse_undoes_the_pose(pose: CameraPose) -> None:
    np.testing.assert_allclose(pose.inverse() @ pose.T_world_cam, np.eye(4), atol=1e-9)
    np.testing.assert_allclose(pose.T_world_cam @ pose.inverse(), np.eye(4), atol=1e-9)


@given(poses)
def test_opengl_axes_round_trip(pose: CameraPose) -> None:
    T_gl = pose.to_opengl()
    np.testing.assert_allclose(T_gl[:3, 0], pose.T_world_cam[:3, 0])
    np.testing.assert_allclose(T_gl[:3, 1:3], -pose.T_world_cam[:3, 1:3])
    np.testing.assert_array_equal(CameraPose.from_opengl(T_gl).T_world_cam, pose.T_world_cam)


@given(points, quaternions)
def test_quaternions_round_trip(translation: np.ndarray, quaternion: np.ndarray) -> None:
    T = transform_from_quaternion(translation, quaternion)
    back = quaternion_from_rotation(T[:3, :3])
    assert np.linalg.norm(back) == pytest.approx(1) and back[3] >= 0
    unit = quaternion / np.linalg.norm(quaternion)
    assert abs(back @ unit) == pytest.approx(1, abs=1e-9)
    np.testing.assert_allclose(transform_from_quaternion(translation, back), T, atol=1e-9)


@pytest.mark.parametrize('axis', [(1, 0, 0), (0, 1, 0), (0, 0, 1), (0.6, 0, -0.8)], ids=str)
@pytest.mark.parametrize('angle', [0.0, 1e-9, 0.3, math.pi / 2, 3.1, math.pi])
def test_rotation_vectors_round_trip(axis: tuple[float, ...], angle: float) -> None:
    R = rotation_from_vector(angle * np.array(axis))
    np.testing.assert_allclose(R @ R.T, np.eye(3), atol=1e-12)
    assert np.trace(R) == pytest.approx(1 + 2 * math.cos(angle))
    np.testing.assert_allclose(rotation_from_vector(rotation_vector(R)), R, atol=1e-7)


@given(metres, metres, st.floats(0.1, 3.0), st.floats(-math.pi + 1e-6, math.pi))
def test_planar_cameras_look_along_their_yaw(x: float, y: float, z: float, yaw: float) -> None:
    pose = CameraPose.from_planar(x, y, z, yaw)
    np.testing.assert_allclose(pose.position, [x, y, z])
    np.testing.assert_allclose(pose.forward, [math.cos(yaw), math.sin(yaw), 0], atol=1e-12)
    np.testing.assert_allclose(pose.T_world_cam[:3, 1], [0, 0, -1], atol=1e-12)  # down
    assert pose.yaw == pytest.approx(yaw)


def test_yaw_counts_counter_clockwise_and_right_is_right() -> None:
    pose = CameraPose.from_planar(0, 0, 1, math.pi / 2)
    np.testing.assert_allclose(pose.forward, [0, 1, 0], atol=1e-12)
    np.testing.assert_allclose(pose.T_world_cam[:3, 0], [1, 0, 0], atol=1e-12)


@given(poses, poses, st.floats(0, 1))
def test_interpolation_runs_from_end_to_end(
        first: CameraPose, second: CameraPose, fraction: float) -> None:
    np.testing.assert_allclose(
        first.interpolated(second, 0).T_world_cam, first.T_world_cam, atol=1e-9)
    np.testing.assert_allclose(
        first.interpolated(second, 1).T_world_cam, second.T_world_cam, atol=1e-6)
    middle = first.interpolated(second, fraction)
    way = np.linalg.norm(second.position - first.position)
    assert np.linalg.norm(middle.position - first.position) == pytest.approx(
        fraction * way, abs=1e-9)
    turn = [rotation_angle(first.T_world_cam[:3, :3].T @ R)
            for R in (middle.T_world_cam[:3, :3], second.T_world_cam[:3, :3])]
    assert turn[0] == pytest.approx(fraction * turn[1], abs=1e-6)


def test_poses_take_three_rows_and_cannot_be_written() -> None:
    pose = CameraPose(np.eye(4)[:3])
    np.testing.assert_array_equal(pose.T_world_cam, np.eye(4))
    with pytest.raises(ValueError, match='read-only'):
        pose.T_world_cam[0, 3] = 1


def changed(row: int, column: int, value: float) -> np.ndarray:
    matrix = np.eye(4)
    matrix[row, column] = value
    return matrix


@pytest.mark.parametrize('matrix, message', [
    (np.eye(3), r'T_world_cam: expected a 4x4 matrix, got shape \(3, 3\)'),
    (changed(0, 3, math.nan), 'expected finite numbers'),
    (changed(1, 1, math.inf), 'expected finite numbers'),
    (np.diag([1.0, 1, -1, 1]), 'one axis is mirrored'),
    (np.diag([2.0, 2, 2, 1]), 'a scaled or sheared pose'),
    (changed(0, 1, 0.01), 'differs from identity by 0.01'),
    (changed(3, 0, 1.0), 'expected last row 0 0 0 1'),
], ids=['3x3', 'NaN', 'infinite', 'mirrored', 'scaled', 'sheared', 'projective'])
def test_what_is_no_pose(matrix: np.ndarray, message: str) -> None:
    with pytest.raises(GeometryError, match=message):
        CameraPose(matrix)


@pytest.mark.parametrize('quaternion', [
    (0, 0, 0, 0), (0, 0, 0, math.nan), (0, math.inf, 0, 1), (0, 0, 1)], ids=str)
def test_what_is_no_quaternion(quaternion: tuple[float, ...]) -> None:
    with pytest.raises(GeometryError, match='quaternion: expected a unit'):
        CameraPose.from_quaternion(np.zeros(3), np.array(quaternion))


def test_the_nearest_pose_mends_a_rotation_that_has_drifted() -> None:
    pose = CameraPose.from_planar(1.0, 2.0, 1.5, 0.7)
    drifted = pose.T_world_cam + np.pad(np.full((3, 3), 0.004), ((0, 1), (0, 1)))
    with pytest.raises(GeometryError):
        CameraPose(drifted)
    mended = CameraPose.nearest(drifted)
    np.testing.assert_allclose(mended.T_world_cam, pose.T_world_cam, atol=0.01)
    R = mended.T_world_cam[:3, :3]
    np.testing.assert_allclose(R.T @ R, np.eye(3), atol=1e-12)
    np.testing.assert_allclose(CameraPose.nearest(pose.T_world_cam).T_world_cam,
                               pose.T_world_cam, atol=1e-12)
