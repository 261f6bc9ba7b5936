"""A floor is cut into tiles that are fitted alone, and joined without a seam."""
import math
from pathlib import Path

from neo_ros.field.config import FieldConfig
from neo_ros.field.extent import FineBox
from neo_ros.field.fitting import FieldTrainer
from neo_ros.field.rendering import render_rays, render_view, to_uint8
from neo_ros.field.tiles import (
    brightness, cut_floor, joined, photos_of, Tile, tile_edge, TileRules)
from neo_ros.field.voxel_field import multiply_colours, VoxelField
from neo_ros.geometry import CameraPose, Intrinsics
import numpy as np
from plain_field import room_field, standing
import pytest

CAMERA = Intrinsics.from_hfov(24, 20, 1.6)
EDGE = 0.11


def positions(*boxes: tuple[float, float, float, float, float], apart: float = 0.5) -> np.ndarray:
    """Return places all over rooms x, y, width, depth, at the height z each: (N, 3)."""
    return np.concatenate([
        np.stack(np.meshgrid(np.arange(x, x + w, apart), np.arange(y, y + d, apart), z),
                 -1).reshape(-1, 3) for x, y, w, d, z in boxes])


def test_each_photo_is_in_one_tile_and_tiles_are_small_enough() -> None:
    places = positions((0, 0, 31, 9, 1.5))
    tiles = cut_floor(places, 6.0)
    held = np.stack([tile.holds(places) for tile in tiles])
    assert (held.sum(0) == 1).all() and len(tiles) >= 12
    for own in held:
        assert own.any() and np.ptp(places[own][:, :2], axis=0).max() <= 6.0
    # They are all of the world.
    anywhere = np.random.default_rng(0).uniform(-100, 100, (1000, 3))
    assert (np.stack([tile.holds(anywhere) for tile in tiles]).sum(0) == 1).all()


def test_a_tile_may_be_as_large_as_it_can_be_but_for_a_rounding() -> None:
    places = positions((1.6, -4.2, 28, 16, 1.5), apart=1.0)
    tiles = cut_floor(places, 6.0)
    held = np.stack([tile.holds(places) for tile in tiles])
    assert (held.sum(0) == 1).all()
    assert all(np.ptp(places[own][:, :2], axis=0).max() < 6.0 + 1e-9 for own in held)


def test_a_floor_is_cut_in_its_doors() -> None:
    doors = [4.0, 8.2, 12.1]
    rooms = positions(*((x + 0.5, 0, 3.2, 4, 1.5) for x in [0.0, *doors]))
    borders = sorted(tile.low[0] for tile in cut_floor(rooms, 4.5))[1:]
    assert len(borders) == 3
    np.testing.assert_allclose(borders, doors, atol=0.5)


def test_borders_lie_in_the_walls_between_rooms_on_both_sides_of_a_corridor() -> None:
    rooms = [(4.2 * number + 0.35, y, 3.6, 3.4, 1.5) for number in range(6) for y in (0.3, 6.2)]
    places = positions(*rooms, (0.35, 4.8, 24.6, 0.3, 1.5), apart=0.45)
    tiles = cut_floor(places, 6.0)
    assert len(tiles) == 12
    borders = np.array(sorted({tile.low[0] for tile in tiles if math.isfinite(tile.low[0])}))
    np.testing.assert_allclose(borders / 4.2, np.round(borders / 4.2), atol=0.08)
    for x, y, width, depth, z in rooms:  # Each room is in one tile.
        assert sum(tile.holds(positions((x, y, width, depth, z))).any() for tile in tiles) == 1


def test_a_tile_whose_photos_are_all_held_out_is_its_neighbours() -> None:
    rooms = positions((0, 0, 4, 4, 1.5), (9, 0, 4, 4, 1.5))
    places = np.concatenate([rooms, [[20.0, 2.0, 1.5]]])
    every = cut_floor(places, 5.0)
    alone = [tile for tile in every if tile.holds(places).sum() == 1]
    assert len(alone) == 1 and alone[0].holds(places[-1])
    # Others held out change nothing.
    assert cut_floor(places, 5.0, held_out=range(0, len(rooms), 3)) == every
    left = cut_floor(places, 5.0, held_out=[*range(0, len(rooms), 3), len(rooms)])
    assert len(left) == len(every) - 1
    assert all(tile.holds(rooms).any() for tile in left)
    anywhere = np.random.default_rng(0).uniform(-100, 100, (1000, 3))
    assert (np.stack([tile.holds(anywhere) for tile in left]).sum(0) == 1).all()


def test_a_storey_whose_photos_are_all_held_out_is_no_tile() -> None:
    storeys = positions(*((0, 0, 5, 5, z) for z in (1.5, 4.5, 7.5)))
    for z in (1.5, 4.5, 7.5):
        tiles = cut_floor(storeys, 6.0, held_out=np.flatnonzero(storeys[:, 2] == z).tolist())
        assert len(tiles) == 2
        assert (np.stack([tile.holds(storeys) for tile in tiles]).sum(0) == 1).all()
        assert all(tile.holds(storeys[storeys[:, 2] != z]).any() for tile in tiles)


@pytest.mark.parametrize('most', [6.0, math.inf])
def test_small_scenes_are_one_tile(most: float) -> None:
    tile, = cut_floor(positions((0, 0, 12, 9, 1.5)), most)
    assert tile == Tile((-math.inf,) * 3, (math.inf,) * 3)


def test_storeys_are_tiles_of_their_own() -> None:
    lower, upper = cut_floor(positions((0, 0, 5, 5, 1.5), (1, 1, 5, 5, 4.5)), 6.0)
    assert lower.high[2] == upper.low[2] == pytest.approx(3.0)
    # A camera that is held higher and lower is on one, and so is a photo whose pose is wrong.
    for other in ((0, 0, 5, 5, 2.0), (0, 0, 0.5, 0.5, -4.0)):
        assert len(cut_floor(positions((0, 0, 5, 5, 0.9), other), 6.0)) == 1


def test_rays_cross_a_tile_or_do_not() -> None:
    random = np.random.default_rng(1)
    tile = Tile((0.0, -1.0, -math.inf), (2.0, 1.0, math.inf))
    for origin in random.uniform(-4, 4, (20, 3)):
        rays = random.standard_normal((200, 3))
        rays[::7, 0] = 0
        found = tile.is_crossed(origin, rays, 0.25)
        along = origin + rays[:, None] * np.linspace(0, 40, 8000)[:, None]
        true = tile.holds(along, 0.25).any(1)
        assert (found == true).mean() > 0.97 and not (true & ~found).any()
    on_its_border = np.array([2.25, 0, 0])
    assert tile.is_crossed(on_its_border, np.array([[0.0, 1, 0], [1, 0, 0]]), 0.25).all()


def test_photos_around_a_tile_show_what_they_see_of_it() -> None:
    tile = Tile((0.0, -math.inf, -math.inf), (math.inf, math.inf, math.inf))
    inside, into, away, far = (CameraPose.from_planar(x, 0, 1, yaw).T_world_cam for x, yaw in (
        (0.5, math.pi), (-0.8, 0.0), (-0.8, math.pi), (-3.0, 0.0)))
    chosen, pixels = photos_of(tile, np.stack([inside, into, away, far]), CAMERA)
    assert chosen == [0, 1] and pixels.all()
    aside = CameraPose.from_planar(-0.8, 0, 1, math.pi / 2).T_world_cam
    _, (half,) = photos_of(tile, aside[None], CAMERA)
    assert half[:, -1].all() and not half[:, 0].any()


def walls(low: np.ndarray, high: np.ndarray) -> VoxelField:
    """Lay a lattice over a part of a world whose walls and colours are everywhere the same."""
    field = VoxelField.on_lattice(low, high, EDGE, 0.2, 0)
    points = field.world_points().reshape(-1, 3)
    outside = np.maximum([-2, -1, 0] - points, points - [6, 1, 2]).max(1)
    field.grid[:, 0] = np.where(np.abs(outside - 0.1) < 0.15, 12, -5)
    field.grid[:, 1:] = np.sin(2 * points)
    field.seen[:] = outside < 0.3
    field.update_occupancy()
    return field.of_seen_cells()


def test_joined_tiles_are_one_field(tmp_path: Path) -> None:
    border = 1.93
    tiles = [Tile((-math.inf,) * 3, (border, math.inf, math.inf)),
             Tile((border, -math.inf, -math.inf), (math.inf,) * 3)]
    boxes = [((-2.4, -1.4, -0.4), (border + 0.5, 1.4, 2.4)),
             ((border - 0.5, -1.4, -0.4), (6.4, 1.4, 2.4))]
    parts = [walls(np.array(low), np.array(high)) for low, high in boxes]
    parts[1].near = 0.3
    paths = [tmp_path / '0.npz', tmp_path / '1.npz']
    for part, path in zip(parts, paths):
        part.save(path)
    found, whole = joined(tiles, paths), walls(np.array(boxes[0][0]), np.array(boxes[1][1]))
    assert found.near == 0.1 and found.voxel == pytest.approx(EDGE)
    # Nothing is blurred: near walls, points have the values that their tile had there.
    points = found.world_points().reshape(-1, 3)
    outside = np.maximum([-2, -1, 0] - points, points - [6, 1, 2]).max(1)
    near = (np.abs(outside) < 0.1) & (found.row_of >= 0)
    assert near.sum() > 5000
    np.testing.assert_allclose(found.grid[found.row_of[near], 1:], np.sin(2 * points[near]),
                               atol=2e-3)
    # A view through the border, from either side and from right on it, is that of one field.
    for x in (-1.5, border - 0.01, border + 0.01, 5.5):
        rays = np.random.default_rng(2).standard_normal((800, 3)).astype(np.float32)
        rays /= np.linalg.norm(rays, axis=1, keepdims=True)
        shown, true = (render_rays(field, np.array([x, 0.1, 1], np.float32), rays)
                       for field in (found, whole))
        assert np.abs(shown.image - true.image).max() < 0.02
        assert np.abs(shown.depth - true.depth).max() < 0.02
        assert np.abs(shown.coverage - true.coverage).mean() < 0.02


def test_photos_that_tiles_share_tell_how_bright_each_is() -> None:
    random = np.random.default_rng(0)
    true = random.normal(0, 0.3, (30, 3))  # Logarithms of the gains of all photos.
    parts = [np.arange(0, 12), np.arange(8, 21), np.arange(19, 28), np.arange(28, 30)]
    gains = [(part, true[part] - true[part].mean(0)) for part in parts]
    gains[0][1][9] += 1  # One is wrong.
    factors = brightness(gains)
    assert factors is not None
    # As bright as each other: what a tile calls a photo's gain, less its factor, is one number.
    for one, other in ((0, 1), (1, 2)):
        np.testing.assert_allclose(
            np.log(factors[one]) + true[parts[one]].mean(0),
            np.log(factors[other]) + true[parts[other]].mean(0), atol=1e-9)
    np.testing.assert_allclose(factors[3], 1)  # It shares none.
    assert brightness([(part, np.zeros((len(part), 3))) for part in parts]) is None
    assert brightness(gains[:1]) is None


def test_a_tile_that_was_fitted_too_dark_is_joined_as_bright_as_the_others(
        tmp_path: Path) -> None:
    border = 1.93
    tiles = [Tile((-math.inf,) * 3, (border, math.inf, math.inf)),
             Tile((border, -math.inf, -math.inf), (math.inf,) * 3)]
    paths = [tmp_path / '0.npz', tmp_path / '1.npz']
    walls(np.array([-2.4, -1.4, -0.4]), np.array([border + 0.5, 1.4, 2.4])).save(paths[0])
    dark = walls(np.array([border - 0.5, -1.4, -0.4]), np.array([6.4, 1.4, 2.4]))
    multiply_colours(dark.grid, np.full(3, 0.6))
    dark.save(paths[1])
    found = joined(tiles, paths, np.array([[1.0] * 3, [1 / 0.6] * 3]))
    points = found.world_points().reshape(-1, 3)
    outside = np.maximum([-2, -1, 0] - points, points - [6, 1, 2]).max(1)
    near = (np.abs(outside) < 0.1) & (found.row_of >= 0)
    np.testing.assert_allclose(found.grid[found.row_of[near], 1:], np.sin(2 * points[near]),
                               atol=5e-3)


@pytest.mark.parametrize('terms', [1, 4])
def test_colours_are_multiplied_and_densities_are_not(terms: int) -> None:
    grid = np.random.default_rng(0).normal(size=(50, 1 + 3 * terms)).astype(np.float32)
    before = grid.copy()
    multiply_colours(grid, np.array([0.5, 1.0, 1.5]))
    means = slice(1, None, terms)
    colours, now = (1 / (1 + np.exp(-0.28209479 * one[:, means])) for one in (before, grid))
    np.testing.assert_allclose(now, np.minimum(colours * (0.5, 1, 1.5), 0.99), atol=1e-5)
    kept = np.ones(grid.shape[1], bool)
    kept[means] = False
    np.testing.assert_array_equal(grid[:, kept], before[:, kept])


def test_a_fit_ends_on_the_lattice_in_its_box() -> None:
    field = room_field(40_000)
    field.update_occupancy()
    poses = [standing(0.5 * np.cos(3 * yaw), 0.4 * np.sin(2 * yaw), yaw)
             for yaw in np.linspace(0, 2 * np.pi, 12, endpoint=False)]
    fine = FineBox(np.array([-0.6, -math.inf, -math.inf]), np.array([0.7, math.inf, math.inf]),
                   EDGE)
    fit = FieldTrainer(
        np.stack([to_uint8(render_view(field, CAMERA, pose).image) for pose in poses]), CAMERA,
        np.stack([pose.T_world_cam for pose in poses]),
        FieldConfig(voxels=30_000, steps=200, rays_per_step=1024, margin=1.5, device='cpu'), 0,
        fine=fine)
    while fit.step < 200:
        fit.train_step()
    found = fit.finished()
    low, high = found.centre - found.half_extent, found.centre + found.half_extent
    assert found.voxel == pytest.approx(EDGE)
    assert -0.6 - 2 * EDGE < low[0] <= -0.6 and 0.7 <= high[0] < 0.7 + 3 * EDGE
    # The room is wider than that, and all of it where nothing is said.
    assert high[1] - low[1] > 1.5
    inside = found.world_points()[tuple(np.array(found.shape) // 2)]
    np.testing.assert_allclose(inside / EDGE, np.rint(inside / EDGE), atol=1e-6)


def test_the_largest_tile_has_the_voxels_asked_for() -> None:
    rules, config = TileRules(), FieldConfig(voxels=500_000)
    edge = tile_edge(config, 6.0)
    across = 6.0 + 2 * rules.overlap
    field = VoxelField.on_lattice(np.zeros(3), np.array([across, across, rules.height]), edge,
                                  config.shell, 0)
    assert math.prod(field.shape) == pytest.approx(500_000, rel=0.2)
