"""Keyframes for the scene memory: where they stand, and where their colours come from."""
from box_room import BAND, cast, HEIGHT, planar, SOURCE, view
from neo_ros.errors import ConfigError
from neo_ros.field.baking_kernels import colour_from_photos
from neo_ros.field.memory_baking import keyframe_positions, MemoryConfig, Photos
from neo_ros.scenes.pose_sampling import PoseSampler
import numpy as np
import pytest

POSITION = np.array([2.0, 2.0, HEIGHT])
SMALL = BAND.rays(44, 126)


def bake(poses: list, coarse: np.ndarray, gain: float = 1.0, shift: float = 0.0) -> np.ndarray:
    """Colour a panorama of the box room from photos at `poses`; `shift` falsifies its depth."""
    colour, depth = cast(POSITION, SMALL)
    views = [view(pose, SOURCE) for pose in poses]
    lengths = np.linalg.norm(SOURCE.pixel_rays(), axis=-1)
    out = np.empty((*depth.shape, 3), np.uint8)
    colour_from_photos(
        POSITION.astype(np.float32), SMALL, (depth + shift).astype(np.float32), coarse,
        np.stack([(image / gain).astype(np.uint8) for image, _ in views]),
        np.stack([z * lengths for _, z in views]).astype(np.float32),
        np.stack([pose.T_world_cam[:3, :3] for pose in poses]).astype(np.float32),
        np.stack([pose.position for pose in poses]).astype(np.float32),
        np.full((len(poses), 3), gain, np.float32),
        SOURCE.fx, SOURCE.fy, SOURCE.cx, SOURCE.cy, out)
    return out


@pytest.mark.parametrize('gain', [1.0, 1.25], ids=['same exposure', 'darker photos'])
def test_colours_come_from_the_photos(gain: float) -> None:
    truth, _ = cast(POSITION, SMALL)
    coarse = np.clip(truth + 15, 0, 255).astype(np.uint8)
    poses = [planar(2.2, 1.9, yaw) for yaw in range(0, 360, 45)]
    baked = bake(poses, coarse, gain)
    level = np.abs(np.arange(44) - 21.5) < 15
    assert np.abs(baked[level] - truth[level]).mean() < 3
    assert np.abs(coarse[level] - truth[level]).mean() > 10


def test_without_a_photo_the_field_keeps_its_colour() -> None:
    truth, _ = cast(POSITION, SMALL)
    coarse = np.clip(truth + 15, 0, 255).astype(np.uint8)
    baked = bake([planar(2.2, 1.9, 0)], coarse)
    behind = np.abs(np.arange(126) - 63) > 40  # the panorama's middle is azimuth 0
    assert np.array_equal(baked[:, behind], coarse[:, behind])


def test_photos_that_see_something_else_there_are_left_out() -> None:
    truth, _ = cast(POSITION, SMALL)
    coarse = np.rint(truth).astype(np.uint8)
    poses = [planar(2.2, 1.9, yaw) for yaw in range(0, 360, 45)]
    assert np.array_equal(bake(poses, coarse, shift=0.8), coarse)


def test_every_place_has_a_keyframe_near() -> None:
    grid = np.stack(np.meshgrid(np.arange(0, 3, 0.1), np.arange(0, 2, 0.1)), -1).reshape(-1, 2)
    sampler = PoseSampler(grid, (0.0, 1.0), ((0.0, 0.0), (0.0, 0.0)), (1.4, 0.0))
    photos = Photos(np.zeros((1, 4, 4, 3), np.uint8), SOURCE, np.eye(4)[None])
    chosen = keyframe_positions(sampler, photos, 0.4)
    away = np.linalg.norm(grid[:, None] - chosen[None, :, :2], axis=-1)
    assert away.min(1).max() <= 0.4
    assert len(chosen) < 30 and np.all(chosen[:, 2] == 1.4)


def test_a_hand_held_camera_gets_keyframes_where_photos_are() -> None:
    sampler = PoseSampler(np.zeros((1, 2)), (0.0, 1.0), ((0.0, 0.1), (0.0, 0.1)), (1.4, 0.2))
    T = np.tile(np.eye(4), (20, 1, 1))
    T[:, 0, 3] = np.linspace(0, 2, 20)
    chosen = keyframe_positions(sampler, Photos(np.zeros((20, 4, 4, 3), np.uint8), SOURCE, T), 0.3)
    assert {tuple(point) for point in chosen} <= {tuple(point) for point in T[:, :3, 3]}


def test_a_distance_must_be_positive() -> None:
    with pytest.raises(ConfigError, match='memory.distance'):
        MemoryConfig(distance=0)
