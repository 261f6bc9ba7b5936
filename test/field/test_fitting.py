from pathlib import Path
from typing import Any

from neo_ros.errors import ConfigError, SceneError
from neo_ros.evaluation.metrics import psnr
from neo_ros.field.camera_model import CameraModel
from neo_ros.field.config import FieldConfig, FIT_NEAR, fit_near
from neo_ros.field.fitting import FieldTrainer, FitRules, STAGES
from neo_ros.field.rendering import render_view, to_uint8
from neo_ros.field.voxel_field import VoxelField
from neo_ros.geometry import Intrinsics
from numba import get_num_threads, set_num_threads
import numpy as np
from plain_field import CENTRE, room_field, standing, WALLS
import pytest

pytestmark = pytest.mark.slow

CAMERA = Intrinsics.from_hfov(24, 20, 1.6)
YAWS = np.linspace(0, 2 * np.pi, 12, endpoint=False)
POSES = [standing(0.5 * np.cos(3 * yaw), 0.4 * np.sin(2 * yaw), yaw) for yaw in YAWS]
SETTINGS: dict[str, Any] = {
    'voxels': 8000, 'steps': 60, 'rays_per_step': 256, 'margin': 1.5,
    'sh_degree': 1, 'exposure': True}


NAN, INF = float('nan'), float('inf')
# Enough for a fit that can be looked at.
PLAIN: dict[str, Any] = {'voxels': 30_000, 'rays_per_step': 1024, 'sh_degree': 0}


@pytest.fixture(scope='module')
def images() -> np.ndarray:
    field = room_field(40_000)
    field.update_occupancy()
    return np.stack([to_uint8(render_view(field, CAMERA, pose).image) for pose in POSES])


def trainer(images: np.ndarray, rules: FitRules = FitRules(), seed: int = 0,
            **changes: Any) -> FieldTrainer:
    return FieldTrainer(images, CAMERA, np.stack([pose.T_world_cam for pose in POSES]),
                        FieldConfig(**{**SETTINGS, **changes}), seed, rules)


def trained(images: np.ndarray, until: int = 60, **changes: Any) -> FieldTrainer:
    result = trainer(images, **changes)
    while result.step < until:
        result.train_step()
    return result


def copied(state: dict[str, Any]) -> dict[str, Any]:
    """Copy a state as a checkpoint on disk would."""
    return {key: value.copy() if isinstance(value, np.ndarray) else value
            for key, value in state.items()}


def assert_same_state(first: FieldTrainer, second: FieldTrainer) -> None:
    a, b = first.state(), second.state()
    assert a.keys() == b.keys()
    for key in a.keys() - {'seconds'}:
        np.testing.assert_array_equal(a[key], b[key], err_msg=key)


@pytest.fixture(scope='module')
def unbroken(images: np.ndarray) -> FieldTrainer:
    return trained(images)


def test_a_seed_decides_every_bit(images: np.ndarray, unbroken: FieldTrainer) -> None:
    assert_same_state(trained(images), unbroken)
    assert (trained(images, 3, seed=1).field.grid != trained(images, 3).field.grid).any()


def test_rays_go_through_the_centres_of_the_pixels(
        images: np.ndarray, unbroken: FieldTrainer) -> None:
    photo, target, _, _, rays_o, rays_d = unbroken.sample_rays()
    pixel = []
    for T_world_cam, ray in zip(np.stack([POSES[i].T_world_cam for i in photo]), rays_d):
        x, y, z = ray @ T_world_cam[:3, :3]
        pixel.append((CAMERA.fx * x / z + CAMERA.cx, CAMERA.fy * y / z + CAMERA.cy))
    column, row = np.array(pixel).T
    np.testing.assert_allclose(column % 1, 0.5, atol=1e-4)
    np.testing.assert_allclose(row % 1, 0.5, atol=1e-4)
    np.testing.assert_array_equal(rays_o, unbroken.origins[photo])
    np.testing.assert_array_equal(
        np.rint(target * 255), images[photo, row.astype(int), column.astype(int)])


def test_what_a_mask_leaves_out_is_never_drawn(images: np.ndarray) -> None:
    usable = np.ones(images.shape[:3], bool)
    usable[:, 3:, :] = usable[2] = False
    fit = FieldTrainer(images, CAMERA, np.stack([pose.T_world_cam for pose in POSES]),
                       FieldConfig(**SETTINGS), 0, usable=usable)
    fit.random = np.random.default_rng(5)
    photo, target, _, _, _, rays_d = fit.sample_rays()
    down = np.array([POSES[i].T_world_cam[:3, 1] @ ray for i, ray in zip(photo, rays_d)])
    ahead = np.array([POSES[i].T_world_cam[:3, 2] @ ray for i, ray in zip(photo, rays_d)])
    assert len(target) == 256 and (photo != 2).all()
    row = CAMERA.fy * down / ahead + CAMERA.cy
    assert row.max() < 3 and len(set(photo)) == len(images) - 1
    # The field is not known by rays that a mask leaves out, either.
    assert [len(rays) for rays, _ in fit.photo_rays()] == [3 * CAMERA.width] * (len(images) - 1)
    with pytest.raises(SceneError, match='masks: expected pixels that are not left out'):
        FieldTrainer(images, CAMERA, np.stack([pose.T_world_cam for pose in POSES]),
                     FieldConfig(**SETTINGS), 0, usable=np.zeros_like(usable))


def test_a_mask_that_leaves_nothing_out_changes_nothing(
        images: np.ndarray, unbroken: FieldTrainer) -> None:
    fit = FieldTrainer(images, CAMERA, np.stack([pose.T_world_cam for pose in POSES]),
                       FieldConfig(**SETTINGS), 0, usable=np.ones(images.shape[:3], bool))
    while fit.step < 60:
        fit.train_step()
    assert_same_state(fit, unbroken)


# 3, 10 and 24 are steps at which the grid is refined next.
@pytest.mark.parametrize('stop', [3, 7, 10, 24, 59], ids=str)
def test_a_broken_fit_goes_on_to_the_same_bits(
        images: np.ndarray, unbroken: FieldTrainer, stop: int) -> None:
    state = copied(trained(images, stop).state())
    resumed = trainer(images)
    resumed.restore(state)
    assert resumed.step == stop
    while resumed.step < 60:
        resumed.train_step()
    assert_same_state(resumed, unbroken)


def test_a_fit_may_end_by_the_clock(images: np.ndarray, monkeypatch: pytest.MonkeyPatch) -> None:
    now = 0.0

    def tick() -> float:
        nonlocal now
        now += 0.125
        return now

    monkeypatch.setattr('neo_ros.field.fitting.time.monotonic', tick)
    fit = trainer(images, FitRules(least_steps=20), minutes=0.125)
    shares, stages = [], []
    while fit.done[0] < fit.done[1]:
        fit.train_step()
        shares.append(fit.share)
        stages.append(fit.stage)
    # Seven seconds and a half, an eighth of a second a step.
    assert fit.step == 60 and fit.seconds == 7.5
    assert shares == sorted(shares) and fit.done == (8, 8)
    assert stages[-1] == len(STAGES) - 1 and sorted(set(stages)) == [0, 1, 2, 3]
    hurried = trainer(images, FitRules(least_steps=90), minutes=0.125)
    while hurried.done[0] < hurried.done[1]:
        hurried.train_step()
    assert hurried.step == 90 and hurried.stage == 3


def test_the_last_stage_keeps_no_far_air(images: np.ndarray) -> None:
    fit = trainer(images, **PLAIN)
    fit.field, fit.stage, fit.step = room_field(10_000), len(STAGES) - 2, 40
    fit._allocate()
    fit.train_step()
    assert fit.stage == len(STAGES) - 1
    assert len(fit.field.grid) < 0.9 * len(fit.field.row_of)
    assert (fit.field.row_of[fit.field.skip == 0] >= 0).all()


def test_as_much_is_empty_as_the_nearest_photo_leaves(images: np.ndarray) -> None:
    fit = trainer(images)
    fit.field = room_field(40_000)
    fit.field.update_occupancy()
    nearest = [np.percentile(render_view(fit.field, CAMERA, pose, 1).depth, 5) for pose in POSES]
    assert np.ptp(nearest) > 0.2
    assert fit.empty_distance() == FitRules().most_near
    fit.rules = FitRules(most_near=9.0)
    assert fit.empty_distance() == pytest.approx(0.75 * min(nearest), abs=0.02)
    # What is nearer, but fills less of a photo, may be anything.
    before = fit.field.world_points() - POSES[0].position
    fit.field.grid[(np.abs(before - [0.25, 0, 0]).max(-1) < 0.04).ravel(), 0] = 40
    assert fit.empty_distance() == pytest.approx(0.75 * min(nearest), abs=0.05)
    fit.field.grid[:, 0] = -8
    fit.field.update_occupancy()
    fit.field.skip[:] = 0
    assert fit.empty_distance() == FIT_NEAR


@pytest.mark.parametrize('near', [None, 0.25])
def test_the_first_refinement_finds_what_is_empty_unless_it_is_told(
        images: np.ndarray, near: float | None) -> None:
    fit = trainer(images, near=near, **PLAIN)
    assert fit.view_near == (near or FIT_NEAR)
    while not fit.stage:
        expected = near or fit.empty_distance()
        fit.train_step()
    found = fit.view_near
    assert found == pytest.approx(expected, rel=0.3) and (found == 0.25) == (near is not None)
    while fit.step < 60:
        fit.train_step()
    # The fit itself leaves out less than views do.
    assert fit.field.near == FIT_NEAR and fit.view_near == found
    fit.field.grid[:, 0] += 9
    assert fit.finished().near == found


@pytest.mark.parametrize('view, fitted', [(None, FIT_NEAR), (0.3, FIT_NEAR), (0.02, 0.02)])
def test_a_fit_leaves_out_no_more_than_views(view: float | None, fitted: float) -> None:
    assert fit_near(view) == fitted


@pytest.mark.parametrize('minutes', [0.0, -1.0, NAN, INF])
def test_no_time_is_refused(minutes: float) -> None:
    with pytest.raises(ConfigError, match='field.minutes'):
        FieldConfig(minutes=minutes)


@pytest.mark.skipif(get_num_threads() < 2, reason='one processor')
def test_the_number_of_threads_does_not_change_a_bit(
        images: np.ndarray, unbroken: FieldTrainer) -> None:
    before = get_num_threads()
    try:
        set_num_threads(1)
        assert_same_state(trained(images), unbroken)
    finally:
        set_num_threads(before)


def test_room_for_rays_that_are_none_adds_nothing(
        images: np.ndarray, monkeypatch: pytest.MonkeyPatch) -> None:
    monkeypatch.setattr(FieldTrainer, 'rays_across', 2)  # Four rays a pixel.
    grids = []
    for rays in (256, 259):
        fit = trained(images, 0, **{**PLAIN, 'rays_per_step': rays})
        cell, frac, d_density, d_rgb, count = fit.slopes
        for part in (cell, frac):
            part[:] = 0
        for part in (d_density, d_rgb, count):
            part[:] = 1
        for _ in range(3):
            fit.train_step()
        grids.append(fit.field.grid.copy())
    np.testing.assert_array_equal(grids[0], grids[1])


# A field that loses the pull of faint samples leaves white walls empty for good.
@pytest.mark.parametrize('low, high', [(0.0, 1.0), (0.8, 1.0)], ids=['colourful', 'white'])
def test_a_fit_shows_the_room_from_new_places(
        images: np.ndarray, low: float, high: float) -> None:
    painted = to_uint8(low + (high - low) * images.astype(np.float32) / 255)
    result = trained(painted, 200, **PLAIN, steps=200, exposure=False)
    truth, field, pose = room_field(40_000), result.finished(), standing(0.2, 0.1, 0.35)
    shown = to_uint8(low + (high - low) * render_view(truth, CAMERA, pose).image)
    assert psnr(shown, to_uint8(render_view(field, CAMERA, pose).image)) > 20


def test_gains_find_the_exposure_of_the_photos(images: np.ndarray) -> None:
    dark = images.copy()
    dark[::2] = (dark[::2] * 0.7).astype(np.uint8)
    result = trained(dark, 300, **PLAIN, steps=300)
    gain = np.exp(result.camera.log_gain)
    assert gain[::2].mean() / gain[1::2].mean() == pytest.approx(0.7, abs=0.1)
    np.testing.assert_allclose(result.camera.log_gain.mean(0), 0, atol=1e-5)
    assert not trained(dark, 20, exposure=False).camera.log_gain.any()


def test_left_open_gains_are_learnt_where_photos_need_them(images: np.ndarray) -> None:
    dark = images.copy()
    dark[::2] = (dark[::2] * 0.7).astype(np.uint8)
    drifting, steady = (trained(photos, 400, **PLAIN, steps=400, exposure=None).camera
                        for photos in (dark, images))
    assert drifting.learns
    gain = np.exp(drifting.log_gain)
    assert gain[::2].mean() / gain[1::2].mean() == pytest.approx(0.7, abs=0.1)
    assert not steady.learns and not steady.log_gain.any()


def test_gains_that_fall_are_given_up_at_the_last_refinement_alone(images: np.ndarray) -> None:
    models = [CameraModel(2, CAMERA, FieldConfig(**{**SETTINGS, 'exposure': exposure}))
              for exposure in (None, None, True)]
    after = (0.08, 0.095, 0.08)
    for model, spread in zip(models, after):
        model.log_gain[:] = [[0.1], [-0.1]]
        model.refined(last=False)
        assert model.learns
        model.log_gain[:] = [[spread], [-spread]]
    again = CameraModel(2, CAMERA, models[0].config)
    again.restore(models[0].state())  # A fit that was broken off between them.
    for model in (*models, again):
        model.refined(last=True)
    assert [model.learns for model in (*models, again)] == [False, True, True, False]
    assert not models[0].log_gain.any() and models[1].log_gain.any()


def test_the_falloff_of_the_lens_is_found(images: np.ndarray) -> None:
    away = (CAMERA.pixel_rays()[..., :2] ** 2).sum(-1)
    dark = images * np.exp(-0.4 * away / away.max())[..., None]
    result = trained(dark.astype(np.uint8), 300, **PLAIN, steps=300, vignetting=True)
    assert np.exp(result.camera.falloff.sum()) == pytest.approx(np.exp(-0.4), abs=0.12)
    assert not trained(dark.astype(np.uint8), 20, exposure=False).camera.falloff.any()


def test_what_one_photo_alone_shows_loses_its_weight(images: np.ndarray) -> None:
    occluded = images.copy()
    occluded[3, :, 8:16] = (255, 0, 255)
    pink = [trained(occluded, 300, **PLAIN, steps=300, robust=robust) for robust in (0.0, 0.2)]
    shown = [render_view(fit.finished(), CAMERA, POSES[3]).image for fit in pink]
    errors = [np.abs(image[:, 8:16] - images[3, :, 8:16] / 255).mean() for image in shown]
    assert errors[1] < 0.7 * errors[0]


def looking_at(field: VoxelField, images: np.ndarray, **changes: Any) -> FieldTrainer:
    result = trainer(images, rays_per_step=4096, **changes)
    result.field, result.random = field, np.random.default_rng(0)
    return result


def test_the_content_box_is_the_room(images: np.ndarray) -> None:
    # The first guess: metres around the cameras, far larger than the room.
    field = room_field(120_000, half_extent=WALLS + 2.0)
    field.update_occupancy()
    centre, half = looking_at(field, images).content_box()
    np.testing.assert_allclose(centre, CENTRE, atol=0.12)
    assert (half > WALLS - 0.05).all() and (half < WALLS + 0.3).all()


def test_a_view_through_a_window_does_not_stretch_the_box(images: np.ndarray) -> None:
    field = room_field(120_000, half_extent=WALLS + 2.0)
    points = field.world_points().reshape(-1, 3) - CENTRE
    window = (points[:, 0] > 0) & (np.abs(points[:, 1:]) < 0.2).all(1)
    field.grid[window, 0] = np.where(points[window, 0] < WALLS[0] + 1.5, -8, 40)
    field.update_occupancy()
    centre, half = looking_at(field, images).content_box()
    assert centre[0] + half[0] < CENTRE[0] + WALLS[0] + 0.4


def test_a_field_that_shows_nothing_yet_keeps_its_box(images: np.ndarray) -> None:
    start = trainer(images)
    start.random = np.random.default_rng(0)
    centre, half = start.content_box()
    np.testing.assert_array_equal(centre, start.field.centre)
    np.testing.assert_array_equal(half, start.field.half_extent)


def test_what_no_photo_shows_is_neither_covered_nor_kept(images: np.ndarray) -> None:
    room = room_field(40_000)
    room.update_occupancy()
    result = looking_at(room, images)
    result.rays[1] = CAMERA.scaled(4).pixel_rays()
    ahead = np.stack([standing(-0.3, y, 0.0).T_world_cam for y in (-0.5, 0.0, 0.5)])
    result.rotations = ahead[:, :3, :3].astype(np.float32)
    result.origins = ahead[:, :3, 3].astype(np.float32)
    field = result.finished()
    seen, before = (render_view(one, CAMERA, standing(-0.3, 0.5, 0.0)) for one in (field, room))
    behind = render_view(field, CAMERA, standing(0.0, 0.0, np.pi))
    assert seen.coverage.mean() > 0.9
    # A twentieth of a ray's light may go on behind the wall.
    np.testing.assert_allclose(seen.image, before.image, atol=0.02)
    assert np.abs(seen.image - before.image).mean() < 1e-3
    assert render_view(room, CAMERA, standing(0.0, 0.0, np.pi)).opacity.mean() > 0.99
    assert behind.opacity.mean() < 0.02
    assert len(field.grid) < 0.7 * len(room.grid)


def test_a_blob_beside_the_photos_views_hides_nothing(images: np.ndarray, tmp_path: Path) -> None:
    room = room_field(40_000)
    result = looking_at(room, images)
    ahead = standing(0.0, 0.0, 0.0)
    result.rays[1] = CAMERA.scaled(4).pixel_rays()
    result.rotations = ahead.T_world_cam[None, :3, :3].astype(np.float32)
    result.origins = ahead.T_world_cam[None, :3, 3].astype(np.float32)
    # From further back one looks past the photo's camera, through what it did not see.
    pose = standing(-0.6, 0.0, 0.0)
    room.update_occupancy()
    clear = render_view(room, CAMERA, pose)
    points = room.world_points().reshape(-1, 3)
    blob = (np.abs(points - ahead.T_world_cam[:3, 3] - [-0.25, 0.0, 0.0]) < 0.12).all(1)
    room.grid[blob, 0] = 40
    room.update_occupancy()
    hidden = np.abs(render_view(room, CAMERA, pose).depth - clear.depth) > 0.2
    field = result.finished()
    field.save(tmp_path / 'field.npz')
    shown = render_view(VoxelField.load(tmp_path / 'field.npz'), CAMERA, pose)
    ring = (slice(8, 12), slice(10, 14))  # What the one photo shows, too.
    assert hidden[ring].all()
    np.testing.assert_allclose(shown.depth[ring], clear.depth[ring], atol=0.02)


def test_a_fit_that_left_nothing_says_so(images: np.ndarray) -> None:
    with pytest.raises(SceneError, match='the photos left nothing in it; are the poses right'):
        trainer(images).finished()


@pytest.mark.parametrize('changes, message', [
    ({'sh_degree': 3}, 'field.sh_degree: expected 0, 1 or 2, got 3'),
    ({'steps': 9}, 'field.steps: expected 10 ... 1_000_000_000, got 9'),
    ({'voxels': 10}, 'field.voxels: expected 1_000 ... '),
    ({'voxels': 10 ** 12}, 'field.voxels: expected .* got 1000000000000'),
    ({'rays_per_step': 0}, 'field.rays_per_step: expected 4 ... '),
    ({'margin': 0.0}, 'field.margin: expected 1e-06 ... 1_000, got 0.0'),
    ({'margin': INF}, 'field.margin'),
    ({'learning_rate': NAN}, 'field.learning_rate: expected .* got nan'),
    ({'learning_rate': 1e30}, 'field.learning_rate'),
    ({'shell': -0.1}, 'field.shell: expected 0 ... 10, got -0.1'),
    ({'shell': INF}, 'field.shell'),
    ({'near': -1.0}, 'field.near: expected 0 ... 100, got -1.0'),
    ({'near': 1e9}, 'field.near'),
    *[({name: value}, f'field.{name}: expected 0 ... 1_000, got {value}')
      for name in ('distortion', 'pointwise', 'sparsity') for value in (NAN, INF, -0.1)],
], ids=str)
def test_settings_out_of_range(changes: dict[str, Any], message: str) -> None:
    with pytest.raises(ConfigError, match=message):
        FieldConfig(**changes)
