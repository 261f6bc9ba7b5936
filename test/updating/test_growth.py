"""A room that no photo showed is taken into the field; what the field had keeps its bits."""
from types import SimpleNamespace
from typing import Any

from box_room import BAND
from neo_ros.baking.keyframes import Photos
from neo_ros.baking.plain_surfaces import hand_held
from neo_ros.field.config import FieldConfig
from neo_ros.field.rendering import render_rays, world_rays
from neo_ros.field.voxel_field import VoxelField
from neo_ros.geometry import CameraPose
from neo_ros.memory.keyframe import Keyframe
from neo_ros.memory.scene_memory import Glances, SceneMemory
from neo_ros.updating.compared_photos import compare
from neo_ros.updating.driven_photos import LostImage
from neo_ros.updating.growth import grow, GrowthRules, stand_outside
from neo_ros.updating.new_keyframes import new_positions
from neo_ros.updating.placing import Placed
from neo_ros.updating.refit import FitLength, trainer_of
import numpy as np
import pytest
from two_rooms import (
    cast, DOORWAY, drive_through_door, FIRST, HEIGHT, look, poses_in_first, SOURCE)

pytestmark = pytest.mark.slow
SMALL = SOURCE.scaled(0.5)


def first_room() -> VoxelField:
    """Return a field that shows the first room, its door closed; what is behind was not seen."""
    field = VoxelField.empty(60_000, FIRST.mean(0), (FIRST[1] - FIRST[0]) / 2 + 0.2, 0.2, 0)
    points = field.world_points().reshape(-1, 3)
    outside = np.maximum(FIRST[0] - points, points - FIRST[1]).max(1)
    field.grid[:, 0] = np.where((outside > -0.02) & (outside < 0.2), 12, -5)
    field.seen[:] = np.abs(outside) < 0.2
    field.update_occupancy()
    return field.of_seen_cells()


def remembered() -> SceneMemory:
    keyframes, size = [], (int((BAND.top - BAND.bottom) * 40), int(BAND.width * 40))
    for x in (0.8, 1.8, 2.8):
        position = np.array([x, 1.6, HEIGHT])
        _, depth = cast(position, BAND.rays(*size), closed=True)
        colour, _ = cast(position, BAND.rays(2 * size[0], 2 * size[1]), closed=True)
        keyframes.append(Keyframe(position, depth.astype(np.float32), colour))
    return SceneMemory.from_keyframes(
        keyframes, BAND, Glances(np.zeros((1, 16, 16), np.uint8), np.eye(4)[None]))


def test_a_new_room_is_added_and_the_old_one_keeps_its_bits() -> None:
    field, old, way = first_room(), poses_in_first(60), drive_through_door()[::2]
    located = [pose for pose in way if pose.position[0] < 3.2]
    placed = [pose for pose in way if pose.position[0] >= 3.2]
    poses = [*old, *located, *placed]
    images = np.stack([look(pose, SMALL, number < len(old)) for number, pose in enumerate(poses)])
    photos = Photos(images, SMALL, np.stack([pose.T_world_cam for pose in poses]),
                    np.ones(images.shape[:3], bool))
    compared = compare(photos, len(old), remembered(), elsewhere=len(placed))
    assert not compared.depth[-len(placed):].any()
    assert not len(stand_outside(compared.first(len(old) + len(located)), len(located)))
    outside = stand_outside(compared, len(placed))
    inside = [number for number, pose in enumerate(poses) if pose.position[0] > DOORWAY[0, 0]]
    assert set(inside) >= set(outside.tolist()) and len(outside) > 0.8 * len(inside)
    chosen = [*range(len(old) + len(located) - 8, len(poses))]
    tied = Placed([LostImage(image, 0) for image in images[-len(placed):]], placed, [], None, None)
    growth = grow(field, compared, outside, tied, chosen,
                  Photos(images[chosen], SMALL, photos.T_world_cam[chosen],
                         np.ones((len(chosen), *images.shape[1:3]), bool)),
                  FieldConfig(voxels=60_000, rays_per_step=1024, near=0.1), 0,
                  rules=GrowthRules(least_steps=500, most_steps=500))
    assert growth is not None
    grown = growth.field
    points = field.world_points().reshape(-1, 3)
    kept = (field.row_of >= 0) & (np.abs(points - field.centre) <= field.half_extent).all(1)
    index = np.rint((grown.grid_position(points[kept]) + 1) / 2 * (np.array(grown.shape) - 1))
    rows = grown.row_of.reshape(grown.shape)[tuple(index.astype(int).T)]
    np.testing.assert_array_equal(grown.grid[rows], field.grid[field.row_of[kept]])
    assert not growth.space.holds(grown, np.array([pose.position for pose in old])).any()
    assert growth.space.holds(grown, np.array([[5.5, 2.0, HEIGHT], [6.5, 1.0, 0.5]])).all()
    off, far = [], []
    for x, y, yaw in ((5.0, 1.4, 0.3), (5.6, 2.0, 2.0), (6.0, 1.5, -2.0)):
        pose = CameraPose.from_planar(x, y, HEIGHT, yaw)
        origin, rays = world_rays(SMALL, pose)
        shown = render_rays(grown, origin, rays)
        truth, depth = cast(pose.position, rays, closed=False)
        here = origin[0] + depth * rays[..., 0] > DOORWAY[1, 0]
        off.append(np.abs(255 * shown.image - truth).mean(-1)[here])
        far.append(np.abs(shown.depth - depth)[here])

    assert np.median(np.concatenate(far)) < 0.15 and np.concatenate(off).mean() < 20


def test_the_fit_of_a_part_takes_no_more_steps_than_that_of_the_whole() -> None:
    poses = poses_in_first(4)
    photos = Photos(np.zeros((4, 40, 40, 3), np.uint8), SMALL,
                    np.stack([pose.T_world_cam for pose in poses]), np.ones((4, 40, 40), bool))
    # Each pixel twelve times: 1200 steps. How many a fit by the minute took nobody knows.
    for steps, minutes, expected in ((6000, None, 1200), (500, None, 500), (500, 1.0, 1200)):
        config = FieldConfig(voxels=10_000, rays_per_step=64, steps=steps, minutes=minutes)
        trainer = trainer_of(photos, np.ones((4, 3)), config, 0, None, FitLength())
        assert trainer.done == (0, expected)


def test_new_keyframes_of_a_robot_stand_at_its_height_not_at_that_of_a_pose_that_is_off() -> None:
    memory = remembered()
    assert not hand_held(memory.positions)
    T = np.eye(4)[None].repeat(3, 0)
    T[:, :3, 3] = (5, 1, HEIGHT + 0.03), (7, 1, HEIGHT - 0.05), (9, 1, HEIGHT + 0.5)
    growth: Any = SimpleNamespace(T=T)
    positions = new_positions(growth, None, memory, 0.5)
    assert sorted(positions[:, 2]) == [HEIGHT, HEIGHT, HEIGHT + 0.5]  # The last stands on a ramp.
    memory.positions = memory.positions + np.array([[0, 0, 0], [0, 0, 0.1], [0, 0, 0.3]])
    assert set(new_positions(growth, None, memory, 0.5)[:, 2]) == set(T[:, 2, 3])
