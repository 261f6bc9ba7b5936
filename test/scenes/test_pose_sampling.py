import math
from pathlib import Path
from typing import Any

from hypothesis import given, strategies as st
from neo_ros.errors import ConfigError
from neo_ros.flat.demo_flat import build_demo_flat
from neo_ros.flat.walks import CLEARANCE, obstacle_distance
from neo_ros.geometry import CameraPose, Intrinsics
from neo_ros.geometry.camera_pose import rotation_from_vector
from neo_ros.scenes.pose_sampling import (
    PoseSampler, rotation_from_angles, SamplingConfig, yaw_pitch_roll)
from neo_ros.scenes.posed_images import PosedImages
from neo_ros.scenes.walkable import WalkableMap
import numpy as np
import pytest

FLOOR = WalkableMap(0.05, (-1.0, 2.0), np.ones((40, 60), bool), 1.2)
# Below 85 degrees of pitch: at the pole yaw and roll are one.
angles = st.tuples(st.floats(-3.14, 3.14), st.floats(-1.48, 1.48), st.floats(-3.14, 3.14))


def photos_with(angles_xyz: list[tuple[float, float, float, float, float, float]]) -> PosedImages:
    """Return photos (no files) at x, y, z with yaw, pitch, roll."""
    poses = []
    for x, y, z, yaw, pitch, roll in angles_xyz:
        T = np.eye(4)
        T[:3, :3] = rotation_from_angles(yaw, pitch, roll)
        T[:3, 3] = x, y, z
        poses.append(CameraPose(T))
    return PosedImages(Intrinsics(4, 4, 4, 4, 2, 2), (Path('none.png'),) * len(poses),
                       tuple(poses), (0,) * len(poses))


def drawn_angles(sampler: PoseSampler, count: int = 4000) -> np.ndarray:
    random = np.random.default_rng(0)
    return np.array([yaw_pitch_roll(sampler.draw_rotation(random)) for _ in range(count)])


@given(angles)
def test_angles_round_trip(triple: tuple[float, float, float]) -> None:
    R = rotation_from_angles(*triple)
    np.testing.assert_allclose(R.T @ R, np.eye(3), atol=1e-12)
    assert yaw_pitch_roll(R) == pytest.approx(triple, abs=1e-6)


def test_angles_mean_what_they_say() -> None:
    level = rotation_from_angles(0.7, 0, 0)
    np.testing.assert_allclose(
        level, CameraPose.from_planar(0, 0, 0, 0.7).T_world_cam[:3, :3], atol=1e-12)
    assert rotation_from_angles(0.7, 0.3, 0)[2, 2] == pytest.approx(math.sin(0.3))  # looks up
    assert rotation_from_angles(0.7, 0, 0.2)[2, 0] == pytest.approx(-math.sin(0.2))  # right dips
    # Roll turns the camera about its optical axis.
    about_z = rotation_from_vector(np.array([0, 0, 0.2]))
    np.testing.assert_allclose(rotation_from_angles(0.7, 0.3, 0.2),
                               rotation_from_angles(0.7, 0.3, 0) @ about_z, atol=1e-12)


@pytest.mark.parametrize('interval', [0.05, 0.1, 0.5, 0.01, 0.12])
def test_the_floor_is_sampled_on_a_grid(interval: float) -> None:
    sampler = PoseSampler.for_walkable(FLOOR, SamplingConfig(interval=interval))
    for axis, length in ((0, 3.0), (1, 2.0)):
        values = np.unique(sampler.positions_xy[:, axis].round(6))
        np.testing.assert_allclose(np.diff(values), interval)
        assert len(values) == int((length - 0.05) / interval + 1e-6) + 1
    assert FLOOR.contains(sampler.positions_xy).all()


def ragged_floor(resolution: float) -> WalkableMap:
    cells = np.random.default_rng(3).random((40, 60)) < 0.7
    return WalkableMap(resolution, (-1.23, 2.17), cells, 1.2, clearance=0.25)


@pytest.mark.parametrize('every', [1, 2, 7])
def test_at_a_multiple_of_the_cells_positions_are_centres_of_cells(every: int) -> None:
    floor = ragged_floor(0.05)
    centres = floor.centres()
    index = np.round((centres - centres.min(0)) / 0.05).astype(int)
    sampler = PoseSampler.for_walkable(floor, SamplingConfig(interval=0.05 * every))
    np.testing.assert_allclose(sampler.positions_xy, centres[(index % every == 0).all(1)],
                               rtol=0, atol=1e-9)


def test_positions_may_lie_closer_than_the_cells() -> None:
    floor = ragged_floor(0.1)
    positions = PoseSampler.for_walkable(floor, SamplingConfig(interval=0.05)).positions_xy
    assert floor.contains(positions).all()
    centres = floor.centres()
    steps = (positions - centres.min(0)) / 0.05
    np.testing.assert_allclose(steps, steps.round(), atol=1e-6)
    # All centres of cells, and three more of every cell, less some at the edges.
    assert 3 * len(centres) < len(positions) <= 4 * len(centres)
    known = {tuple(place) for place in positions.round(6)}
    assert {tuple(place) for place in centres.round(6)} <= known


def test_positions_in_the_flat_keep_their_clearance() -> None:
    flat = build_demo_flat()
    sampler = PoseSampler.for_walkable(flat.walkable(), SamplingConfig(interval=0.2))
    assert len(sampler.positions_xy) > 200
    assert obstacle_distance(flat.solids, sampler.positions_xy).min() > CLEARANCE


def test_planar_cameras_stand_level_and_look_everywhere() -> None:
    sampler = PoseSampler.for_walkable(FLOOR, SamplingConfig())
    random = np.random.default_rng(1)
    positions = np.array([sampler.draw_position(random) for _ in range(500)])
    assert FLOOR.contains(positions[:, :2]).all() and (positions[:, 2] == 1.2).all()
    yaw, pitch, roll = drawn_angles(sampler).T
    np.testing.assert_allclose([pitch, roll], 0, atol=1e-12)
    counts, _ = np.histogram(yaw, bins=8, range=(-math.pi, math.pi))
    assert counts.min() > 0.8 * 500 and counts.max() < 1.2 * 500


def test_every_place_has_so_many_headings_and_all_places_all_headings() -> None:
    sampler = PoseSampler.for_walkable(FLOOR, SamplingConfig(yaws=6))
    random = np.random.default_rng(0)
    at_one = {round(yaw_pitch_roll(sampler.draw_rotation(random, 3))[0] % (2 * math.pi), 6)
              for _ in range(200)}
    assert len(at_one) == 6
    np.testing.assert_allclose(np.diff(sorted(at_one)), math.pi / 3, atol=1e-5)
    everywhere = np.sort([yaw_pitch_roll(sampler.draw_rotation(random, place))[0]
                          for place in range(400)])
    assert np.diff(everywhere).max() < 0.2
    assert SamplingConfig().yaws == 72


def test_without_a_word_the_grids_are_as_wide_as_the_papers() -> None:
    floor = PoseSampler.for_walkable(FLOOR, SamplingConfig())
    around = PoseSampler.around_photos(photos_with([(0, 0, 1.5, 0, 0, 0)]), SamplingConfig())
    for sampler, metres in ((floor, 0.05), (around, 0.2)):
        for values in sampler.positions_xy.T:
            np.testing.assert_allclose(np.diff(np.unique(values.round(6))), metres)


def test_the_camera_stands_as_high_as_the_experiment_says() -> None:
    sampler = PoseSampler.for_walkable(FLOOR, SamplingConfig(camera_height=0.4))
    assert sampler.draw_position(np.random.default_rng(0))[2] == 0.4


def test_storeys_are_sampled_together_each_at_its_height() -> None:
    above = WalkableMap(0.05, (0.0, 2.0), np.ones((40, 20), bool), 4.2)
    sampler = PoseSampler.for_walkable(FLOOR, SamplingConfig(camera_height=0.4), (above,))
    own = [PoseSampler.for_walkable(floor, SamplingConfig()).positions_xy
           for floor in (FLOOR, above)]
    places = sampler.places()
    # The camera is held lower than the map says, on both.
    for z, xy in ((0.4, own[0]), (3.4, own[1])):
        np.testing.assert_array_equal(places[np.isclose(places[:, 2], z), :2], xy)
    random = np.random.default_rng(0)
    drawn = np.stack([sampler.draw_position(random) for _ in range(400)])
    assert np.isclose(drawn[:, None], places).all(-1).any(1).all()
    share = len(own[1]) / len(places)
    assert abs((drawn[:, 2] > 2).mean() - share) < 0.1


def test_a_wide_robot_keeps_off_the_walls() -> None:
    sampler = PoseSampler.for_walkable(FLOOR, SamplingConfig(robot_radius=0.5))
    # The floor keeps 0.25 m off already.
    np.testing.assert_allclose(sampler.positions_xy.min(0), (-0.725, 2.275))


@pytest.mark.parametrize('yaws, low, width', [
    ([0.1, 0.5, 0.3], 0.1, 0.4),
    ([-3.0, 3.0, math.pi], 3.0, 2 * math.pi - 6.0),
    ([3.1, -2.5], 3.1, 2 * math.pi - 5.6),
    ([2.0], 2.0, 0.0),
    ([0.0, 1.5, 3.0, -1.5], -1.5, 4.5),
], ids=['plain', 'around +-pi', 'across +-pi', 'one', 'most of the circle'])
def test_yaws_stay_within_those_of_the_photos(
        yaws: list[float], low: float, width: float) -> None:
    photos = photos_with([(0, 0, 1, yaw, 0, 0) for yaw in yaws])
    sampler = PoseSampler.around_photos(photos, SamplingConfig())
    assert math.remainder(sampler.yaw_range[0] - low, 2 * math.pi) == pytest.approx(0, abs=1e-9)
    assert sampler.yaw_range[1] == pytest.approx(width)
    drawn = np.mod(drawn_angles(sampler, 500)[:, 0] - low + 1e-9, 2 * math.pi)
    assert drawn.max() <= width + 1e-6 and np.ptp(drawn) >= 0.95 * width


@pytest.mark.parametrize('mount', [0.0, math.pi], ids=['upright', 'upside down'])
def test_hand_held_cameras_tilt_as_the_photos_do(mount: float) -> None:
    random = np.random.default_rng(2)
    photos = photos_with([
        (random.uniform(0, 2), 0, random.normal(1.4, 0.1), random.uniform(-1, 1),
         random.normal(-0.3, 0.1), mount + random.normal(0.1, 0.05)) for _ in range(400)])
    sampler = PoseSampler.around_photos(photos, SamplingConfig())
    _, pitch, roll = drawn_angles(sampler).T
    roll = np.mod(roll - mount + math.pi, 2 * math.pi) - math.pi
    assert (pitch.mean(), pitch.std()) == pytest.approx((-0.3, 0.1), abs=0.015)
    assert (roll.mean(), roll.std()) == pytest.approx((0.1, 0.05), abs=0.01)
    heights = [sampler.draw_position(random)[2] for _ in range(2000)]
    assert (np.mean(heights), np.std(heights)) == pytest.approx((1.4, 0.1), abs=0.015)


@pytest.mark.parametrize('pitch, roll', [(-0.44, 0.0), (0.0, math.pi), (0.3, -3.1)],
                         ids=['tilted', 'upside down', 'both'])
def test_on_a_floor_a_camera_is_tilted_as_it_is_mounted(pitch: float, roll: float) -> None:
    random = np.random.default_rng(2)
    photos = photos_with([
        (0, 0, 1.2, random.uniform(-3, 3), pitch + random.normal(0, 0.01),
         roll + random.normal(0, 0.02)) for _ in range(400)])
    sampler = PoseSampler.for_walkable(FLOOR, SamplingConfig(), photos=photos)
    yaws, pitches, rolls = drawn_angles(sampler).T
    rolls = np.mod(rolls - roll + math.pi, 2 * math.pi) - math.pi
    assert (pitches.mean(), pitches.std()) == pytest.approx((pitch, 0.01), abs=0.003)
    assert (rolls.mean(), rolls.std()) == pytest.approx((0.0, 0.02), abs=0.003)
    assert np.ptp(yaws) > 6 and sampler.height == (1.2, 0.0)


def test_on_a_floor_the_views_of_level_photos_are_level_to_the_bit() -> None:
    random = np.random.default_rng(2)
    photos = photos_with([(0, 0, 1.2, random.uniform(-3, 3), *random.normal(0.006, 0.01, 2))
                          for _ in range(400)])
    with_photos, without = (PoseSampler.for_walkable(FLOOR, SamplingConfig(), photos=given)
                            for given in (photos, None))
    assert with_photos.pitch_roll == without.pitch_roll == ((0.0, 0.0), (0.0, 0.0))
    np.testing.assert_array_equal(drawn_angles(with_photos, 50), drawn_angles(without, 50))


def test_hand_held_cameras_stay_near_the_photos() -> None:
    photos = photos_with([(x, y, 1.5, 0, 0, 0) for x, y in ((0, 0), (2, 0), (2, 1.5))])
    sampler = PoseSampler.around_photos(photos, SamplingConfig(interval=0.05, radius=0.35))
    places = photos.T_world_cam[:, :2, 3]
    distance = np.linalg.norm(sampler.positions_xy[:, None] - places, axis=-1)
    assert distance.min(1).max() <= 0.35
    # Three discs of that radius, a point on every 0.05 x 0.05 m.
    assert len(sampler.positions_xy) == pytest.approx(3 * math.pi * 0.35 ** 2 / 0.0025, rel=0.1)
    assert (distance < 0.36).sum(0).min() > 120


def test_the_places_around_photos_are_the_grid_points_near_one() -> None:
    random = np.random.default_rng(0)
    photos = photos_with([(*random.uniform(-1, 3, 2), 1.5, 0, 0, 0) for _ in range(20)])
    config = SamplingConfig(interval=0.13, radius=0.3)
    sampler = PoseSampler.around_photos(photos, config)
    places = photos.T_world_cam[:, :2, 3]
    low, high = places.min(0) - 0.3, places.max(0) + 0.3
    grid = np.array([(x, y) for y in np.arange(low[1], high[1] + 0.13, 0.13)
                     for x in np.arange(low[0], high[0] + 0.13, 0.13)])
    near = np.linalg.norm(grid[:, None] - places, axis=-1).min(1) <= 0.3
    np.testing.assert_allclose(sampler.positions_xy, grid[near], atol=1e-12)


def test_hand_held_cameras_are_on_a_storey_and_not_between_two() -> None:
    random = np.random.default_rng(4)
    # The upper storey is beside the lower one, and in part above it.
    lower, upper = ([(random.uniform(x, x + 3), random.uniform(0, 1), random.normal(z, 0.05),
                      0.0, 0.0, 0.0) for _ in range(100)] for x, z in ((0, 1.5), (2, 4.5)))
    config = SamplingConfig()
    both = PoseSampler.around_photos(photos_with(lower + upper), config)
    drawn = np.stack([both.draw_position(random) for _ in range(2000)])
    off = np.abs(drawn[:, 2:] - [1.5, 4.5])
    assert off.min(1).max() < 0.3
    assert off[:, 0].min() < 0.01 and off[:, 1].min() < 0.01
    # Each is near photos of its own storey.
    for photos, own in ((lower, off[:, 0] < 1), (upper, off[:, 1] < 1)):
        places = np.array(photos)[:, :2]
        away = np.linalg.norm(drawn[own, None, :2] - places, axis=-1).min(1)
        assert own.mean() > 0.4 and away.max() <= config.radius
        # Above and below one another, too.
        assert ((drawn[own, 0] > 2.2) & (drawn[own, 0] < 2.8)).any()
    assert set(both.places()[:, 2].round(1)) == {1.5, 4.5}


def test_on_one_storey_heights_are_those_of_all_photos() -> None:
    random = np.random.default_rng(4)
    photos = photos_with([(*random.uniform(0, 3, 2), random.uniform(0.8, 2.2), 0, 0, 0)
                          for _ in range(50)])
    sampler = PoseSampler.around_photos(photos, SamplingConfig())
    assert sampler.rise is None and sampler.deviation is None
    z = photos.T_world_cam[:, 2, 3]
    assert sampler.height == (z.mean(), z.std())


def test_a_seed_fixes_the_poses() -> None:
    sampler = PoseSampler.for_walkable(FLOOR, SamplingConfig())
    first, second = (np.random.default_rng(5) for _ in range(2))
    np.testing.assert_array_equal(sampler.draw_position(first), sampler.draw_position(second))
    np.testing.assert_array_equal(sampler.draw_rotation(first), sampler.draw_rotation(second))


@pytest.mark.parametrize('changes', [{'interval': 0.0}, {'radius': -1.0}, {'positions': 0},
                                     {'interval': math.nan}, {'interval': math.inf},
                                     {'radius': math.inf}], ids=str)
def test_sampling_settings_out_of_range(changes: dict[str, float]) -> None:
    with pytest.raises(ConfigError, match='sampling: expected finite interval, radius and pos'):
        SamplingConfig(**changes)  # type: ignore[arg-type]


@pytest.mark.parametrize('changes, message', [
    ({'yaws': -1}, 'expected yaws and robot_radius >= 0, got -1'),
    ({'robot_radius': -0.1}, 'robot_radius >= 0'),
    ({'camera_height': math.inf}, 'sampling.camera_height: expected metres, got inf'),
], ids=str)
def test_places_out_of_range(changes: dict[str, Any], message: str) -> None:
    with pytest.raises(ConfigError, match=message):
        SamplingConfig(**changes)


def test_a_grid_that_misses_every_place_is_an_error() -> None:
    # A floor whose lowest row and lowest column meet in no free cell.
    corner = WalkableMap(0.5, (0, 0), np.array([[0, 1], [1, 0]], bool), 1.5)
    with pytest.raises(ConfigError, match='choose a smaller interval'):
        PoseSampler.for_walkable(corner, SamplingConfig(interval=5.0))
    with pytest.raises(ConfigError, match='choose a smaller interval'):
        PoseSampler.around_photos(photos_with([(0, 0, 1.5, 0, 0, 0)]),
                                  SamplingConfig(interval=1.0, radius=0.3))


@pytest.mark.parametrize('changes, got', [
    ({'interval': 1e-5}, '1e-05'), ({'interval': 1e-320}, '1e-320'),
    ({'radius': 1e5}, '0.2')], ids=str)
def test_a_grid_of_too_many_places_is_never_laid(changes: dict[str, float], got: str) -> None:
    config = SamplingConfig(**changes)  # type: ignore[arg-type]
    message = f'sampling.interval: expected a grid of at most 1e.08 places, got .* of {got} m over'
    with pytest.raises(ConfigError, match=message):
        PoseSampler.around_photos(photos_with([(0, 0, 1.5, 0, 0, 0)]), config)
    if config.interval is not None:
        with pytest.raises(ConfigError, match=message):
            PoseSampler.for_walkable(FLOOR, config)
