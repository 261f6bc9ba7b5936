import math

from neo_ros.evaluation.metrics import psnr
from neo_ros.field import kernels
from neo_ros.field.rendering import (
    BACKGROUND, box_filtered, render_rays, render_view, to_uint8, world_rays)
from neo_ros.field.voxel_field import VoxelField
from neo_ros.geometry import Intrinsics
import numpy as np
from plain_field import CENTRE, plain_samples, random_rays, room_field, standing, WALLS
import pytest
import torch

VIEW = Intrinsics.from_hfov(48, 40, 1.6)


@pytest.mark.parametrize('sh_degree, half_extent', [
    (0, WALLS * 1.15), (1, WALLS * 1.15), (0, WALLS * 0.7),
], ids=['matt', 'shiny', 'walls in the contracted shell'])
def test_plain_torch_renders_the_same(sh_degree: int, half_extent: np.ndarray) -> None:
    field = room_field(30_000, half_extent, sh_degree)
    random = np.random.default_rng(0)
    field.grid[:, 1:] += random.normal(0, 0.5, field.grid[:, 1:].shape)
    rays_o, rays_d = random_rays(300, 1)
    samples = plain_samples(field, torch.from_numpy(field.grid).double(), rays_o, rays_d,
                            np.full(300, 0.5))
    image = ((samples.weight[..., None] * samples.colour).sum(1)
             + samples.light[:, None] * BACKGROUND).numpy()
    rendering = render_rays(field, rays_o, rays_d)
    assert psnr(to_uint8(image), to_uint8(rendering.image)) > 45
    np.testing.assert_allclose(rendering.opacity, samples.weight.sum(1), atol=2e-3)
    # The depth is where half of the light is lost that is lost in all.
    before = samples.light[:, None] + samples.weight.flip(1).cumsum(1).flip(1)
    half = (1 + samples.light[:, None]) / 2
    across = (before > half) & (before - samples.weight <= half)
    part = (before - half) / samples.weight - 0.5
    depth = (samples.depth + part * field.step * field.voxel)[across].numpy()
    np.testing.assert_allclose(rendering.depth, depth, rtol=5e-3)


def test_spherical_harmonics_are_orthonormal() -> None:
    count = 4000
    rise = 1 - (2 * np.arange(count) + 1) / count
    turn = np.arange(count) * math.pi * (3 - math.sqrt(5))
    flat = np.sqrt(1 - rise ** 2)
    values = np.empty((count, 9), np.float32)
    for row, (x, y, z) in zip(values, zip(flat * np.cos(turn), flat * np.sin(turn), rise)):
        kernels.sh_basis(x, y, z, row)
    np.testing.assert_allclose(values.T @ values * 4 * math.pi / count, np.eye(9), atol=0.01)


@pytest.mark.parametrize('half_extent, step', [(WALLS * 1.15, 0.02), (WALLS * 0.7, 0.4)],
                         ids=['walls in the box', 'walls in the contracted shell'])
def test_skipping_empty_space_changes_nothing_to_be_seen(
        half_extent: np.ndarray, step: float) -> None:
    field = room_field(half_extent=half_extent)
    brute = render_view(field, VIEW, standing(0.3, 0.2, 0.4))
    assert 0.3 < field.update_occupancy() < 0.7
    assert (field.skip > 4).mean() > 0.08
    quick = render_view(field, VIEW, standing(0.3, 0.2, 0.4))
    assert psnr(to_uint8(brute.image), to_uint8(quick.image)) > 40
    assert np.abs(quick.depth - brute.depth).max() < step


def test_rays_that_leave_the_box_aslant_meet_what_is_behind_it() -> None:
    field = VoxelField.empty(200_000, np.zeros(3), np.full(3, 2.0), 0.2, 0)
    x, y, _ = np.moveaxis(field.world_points(), -1, 0)
    fence = (x > 2) & (x < 3) & (y > 1) & (y < 1 + 3 * field.voxel)
    field.grid[:, 0] = np.where(fence.ravel(), 40, -8)
    random = np.random.default_rng(0)
    rays_o = random.uniform((1.6, -1.8, -1), (1.95, 0.3, 1), (1000, 3))
    rays_d = np.array([2.3, 1.1, 0]) - rays_o
    rays_d /= np.linalg.norm(rays_d, axis=1, keepdims=True)
    brute = render_rays(field, rays_o, rays_d).opacity
    field.update_occupancy()
    quick = render_rays(field, rays_o, rays_d).opacity
    assert (brute > 0.9).mean() > 0.95 and ((quick > 0.9) == (brute > 0.9)).mean() > 0.99


def test_rays_end_at_the_walls() -> None:
    rendering = render_rays(room_field(), CENTRE, np.array(
        [[1, 0, 0], [-1, 0, 0], [0, 1, 0], [0, -1, 0], [0, 0, 1], [0, 0, -1.0]]))
    np.testing.assert_allclose(rendering.depth, np.repeat(WALLS, 2), atol=0.06)
    np.testing.assert_allclose(rendering.opacity, 1, atol=1e-3)


def test_rays_into_nothing_show_the_background() -> None:
    field = room_field(5000)
    field.grid[:, 0] = -20
    rendering = render_view(field, VIEW, standing())
    np.testing.assert_allclose(rendering.image, BACKGROUND, atol=1e-3)
    np.testing.assert_allclose(rendering.opacity, 0, atol=1e-3)
    np.testing.assert_allclose(rendering.coverage, 0, atol=1e-3)


def test_near_walls_are_taken_for_empty() -> None:
    pose = standing(WALLS[0] - 0.3)
    near, far = (room_field() for _ in range(2))
    far.near = 0.8  # behind the surface: what is seen lies inside the wall
    assert render_view(near, VIEW, pose).depth[20, 24] == pytest.approx(0.3, abs=0.06)
    assert render_view(far, VIEW, pose).depth[20, 24] >= 0.8


def test_coverage_is_the_opacity_of_seen_cells() -> None:
    field = room_field()
    field.seen = (field.world_points()[..., 0] > CENTRE[0]).astype(np.uint8).ravel()
    ahead = render_view(field, VIEW, standing(yaw=0))
    behind = render_view(field, VIEW, standing(yaw=math.pi))
    np.testing.assert_allclose(ahead.coverage, ahead.opacity, atol=1e-5)
    assert behind.coverage.max() == 0 and behind.opacity.min() > 0.99


def test_world_rays_run_through_the_pixels() -> None:
    pose = standing(0.2, -0.1, 1.0)
    origin, directions = world_rays(VIEW, pose)
    assert directions.shape == (40, 48, 3) and directions.dtype == np.float32
    np.testing.assert_allclose(np.linalg.norm(directions, axis=-1), 1, atol=1e-6)
    in_camera = (origin + 3.0 * directions.astype(np.float64)) @ pose.inverse()[:3, :3].T
    in_camera += pose.inverse()[:3, 3]
    np.testing.assert_allclose(VIEW.project(in_camera)[7, 9], [9.5, 7.5], atol=1e-4)


def test_more_rays_a_pixel_average_to_it() -> None:
    field, pose = room_field(), standing(0.4, 0.1, 0.6)
    fine = render_view(field, VIEW.scaled(3), pose, supersample=1)
    np.testing.assert_allclose(render_view(field, VIEW, pose, supersample=3).image,
                               box_filtered(fine.image, 3), atol=1e-6)


def test_box_filter_averages_blocks() -> None:
    image = np.arange(24, dtype=np.float32).reshape(4, 6)
    np.testing.assert_allclose(box_filtered(image, 2), [[3.5, 5.5, 7.5], [15.5, 17.5, 19.5]])
    assert box_filtered(np.zeros((4, 6, 3)), 2).shape == (2, 3, 3)


def test_bytes_are_rounded_and_clipped() -> None:
    np.testing.assert_array_equal(
        to_uint8(np.array([-0.5, 0.0, 0.4999 / 255, 0.5001 / 255, 1.0, 7.0])),
        [0, 0, 0, 1, 255, 255])
