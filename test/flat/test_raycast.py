from neo_ros.flat.raycast import camera_directions, cast_camera, cast_rays
from neo_ros.flat.rooms import demo_solids
from neo_ros.flat.shapes import paint, SolidBuilder
from neo_ros.flat.surfaces import chart_places, face_sizes, locate
from neo_ros.geometry import CameraPose, Intrinsics
import numpy as np
import pytest

GREY = paint('808080')


def _box(builder):
    builder.box((3, -1, -1), (4, 1, 1), GREY)


def _turned_box(builder):
    builder.at(4, 0, 45).box((-0.5, -0.5, -1), (0.5, 0.5, 1), GREY)


def _sphere(builder):
    builder.ellipsoid((4, 0, 0), (0.5, 0.5, 0.5), GREY)


def _ellipsoid(builder):
    builder.ellipsoid((4, 0, 0), (0.5, 1.0, 0.2), GREY, yaw_deg=90)


def _leg(builder):
    builder.frustum(4, 0, (-1, 1), (0.02, 0.02), GREY)


def _cone(builder):
    builder.frustum(4, 0, (-1, 1), (0.1, 0.5), GREY)


@pytest.mark.parametrize('add, metres', [
    (_box, 3.0), (_turned_box, 4 - np.sqrt(0.5)), (_sphere, 3.5), (_ellipsoid, 3.0),
    (_leg, 3.98), (_cone, 3.7)],
    ids=['box', 'turned box', 'sphere', 'turned ellipsoid', 'thin leg', 'cone'])
def test_distance_along_x(add, metres):
    builder = SolidBuilder()
    add(builder)
    solids = builder.build()
    origin, direction = np.zeros((3, 1), np.float32), np.array([[1], [0], [0]], np.float32)
    hits = cast_rays(solids, np.arange(1), origin, direction)
    assert hits.solid.tolist() == [0]
    assert hits.distance[0] == pytest.approx(metres, abs=2e-5)
    away = cast_rays(solids, np.arange(1), origin, -direction)
    assert away.solid.tolist() == [-1]


def test_the_caps_of_a_frustum_close_it():
    builder = SolidBuilder()
    builder.frustum(0, 0, (-1, 1), (0.1, 0.5), GREY)
    solids = builder.build()
    origins = np.array([[0.4, 0, 3], [0.4, 0, -3], [0.05, 0, -3]], np.float32).T
    directions = np.array([[0, 0, -1], [0, 0, 1], [0, 0, 1]], np.float32).T
    hits = cast_rays(solids, np.arange(1), origins, directions)
    # The second ray passes beside the narrow foot and meets the flaring side from below.
    np.testing.assert_allclose(hits.distance, [2.0, 3.5, 2.0], atol=1e-4)


@pytest.mark.parametrize('x, y, yaw', [(3.4, 1.7, 2.6), (6.07, 2.55, 0.1), (9.4, 2.1, 3.0)],
                         ids=['living', 'doorway', 'bedroom'])
def test_culling_changes_nothing(x, y, yaw):
    solids = demo_solids()
    camera, pose = Intrinsics.from_hfov(24, 24, 2.2), CameraPose.from_planar(x, y, 1.5, yaw)
    directions = camera_directions(camera, pose, 1)
    fast = cast_camera(solids, camera, pose, directions)
    rays = directions.reshape(3, -1)
    origins = np.broadcast_to(pose.position.astype(np.float32)[:, None], rays.shape)
    slow = cast_rays(solids, np.arange(len(solids)), origins, rays)
    np.testing.assert_allclose(fast.distance.ravel(), slow.distance, rtol=1e-4)
    # Two solids that touch may swap where they meet.
    assert (fast.solid.ravel() == slow.solid).mean() > 0.99


def test_directions_of_a_crop_are_identical():
    camera, pose = Intrinsics.from_hfov(40, 30, 2.0), CameraPose.from_planar(1, 2, 1.5, 0.7)
    whole = camera_directions(camera, pose, 3)
    part = camera_directions(camera.cropped(7, 4, 20, 16), pose, 3)
    assert np.array_equal(whole[:, 12:60, 21:81], part)


@pytest.mark.parametrize('add, faces', [
    (_box, range(6)), (_turned_box, range(6)), (_sphere, [0]), (_ellipsoid, [0]), (_cone, [0])],
    ids=['box', 'turned box', 'sphere', 'turned ellipsoid', 'cone'])
def test_charts_undo_locate(add, faces):
    builder = SolidBuilder()
    add(builder)
    solids = builder.build()
    across, up = (grid.ravel() for grid in np.meshgrid([0.1, 0.35, 0.8], [0.2, 0.5, 0.9]))
    for face in faces:
        assert (face_sizes(solids)[face] > 0).all()
        points, normals = chart_places(solids, 0, face, across, up)
        np.testing.assert_allclose(np.linalg.norm(normals, axis=1), 1, atol=1e-9)
        places = locate(solids, np.zeros(len(points), int), points.astype(np.float32),
                        -normals.astype(np.float32))
        assert (places.face == face).all()
        np.testing.assert_allclose(places.across, across, atol=1e-4)
        np.testing.assert_allclose(places.up, up, atol=1e-4)
        np.testing.assert_allclose(places.slant, 1, atol=1e-3)
