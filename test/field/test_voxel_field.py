from pathlib import Path
from typing import Any

from hypothesis import given, strategies as st
from neo_ros.errors import SceneError
from neo_ros.evaluation.metrics import psnr
from neo_ros.field.device import on_device
from neo_ros.field.rendering import render_view, to_uint8
from neo_ros.field.voxel_field import OCCUPIED_ALPHA, VoxelField
from neo_ros.geometry import Intrinsics
import numpy as np
from plain_field import CENTRE, room_field, standing, WALLS
import pytest
from scipy.ndimage import binary_dilation

VIEW = Intrinsics.from_hfov(48, 40, 1.6)
shells = st.floats(0.05, 2.0)


@given(shells, st.tuples(*[st.floats(0.3, 9.0)] * 3))
def test_contraction_undoes_its_inverse(shell: float, half: tuple[float, float, float]) -> None:
    field = VoxelField.empty(1000, CENTRE, np.array(half), shell, 0)
    axes = [np.linspace(-1, 1, size) for size in field.shape]
    expected = np.stack(np.meshgrid(*axes, indexing='ij'), axis=-1)
    found = field.grid_position(field.world_points())
    # The outermost points stand for infinity and come back a hundredth of the shell short.
    rim = np.abs(expected).max(-1) > 1 - 1e-9
    np.testing.assert_allclose(found[~rim], expected[~rim], atol=1e-9)
    np.testing.assert_allclose(found[rim], expected[rim], atol=0.011 * shell / (1 + shell))


@given(shells, st.integers(0, 99))
def test_the_whole_world_fits_into_the_grid(shell: float, seed: int) -> None:
    field = VoxelField.empty(1000, CENTRE, WALLS, shell, 0)
    random = np.random.default_rng(seed)
    points = CENTRE + random.normal(size=(50, 3)) * 10 ** random.uniform(-2, 5, (50, 1))
    position = field.grid_position(points)
    assert np.abs(position).max() <= 1
    inside = np.abs((points - CENTRE) / WALLS).max(1) <= 1
    np.testing.assert_allclose(position[inside], ((points - CENTRE) / WALLS)[inside] / (1 + shell))
    assert (np.abs(position[~inside]).max(1) >= 1 / (1 + shell) - 1e-9).all()


def test_without_a_shell_the_grid_is_the_box() -> None:
    field = VoxelField.empty(1000, CENTRE, WALLS, 0.0, 0)
    corners = field.world_points()[[0, -1], [0, -1], [0, -1]]
    np.testing.assert_allclose(corners, [CENTRE - WALLS, CENTRE + WALLS])


@pytest.mark.parametrize('sh_degree, terms', [(0, 1), (1, 4), (2, 9)], ids=str)
def test_an_empty_field_has_cubic_voxels_and_is_grey(sh_degree: int, terms: int) -> None:
    field = VoxelField.empty(50_000, CENTRE, WALLS, 0.2, sh_degree)
    assert len(field.grid) == pytest.approx(50_000, rel=0.15)
    assert field.terms == terms and field.grid.shape[1] == 1 + 3 * terms
    edges = 2 * WALLS * 1.2 / (np.array(field.shape) - 1)
    np.testing.assert_allclose(edges, field.voxel, rtol=0.05)
    rendering = render_view(field, VIEW, standing())
    np.testing.assert_allclose(rendering.image, 0.5, atol=1e-3)
    assert rendering.opacity.max() < 0.05


def test_a_finer_grid_keeps_the_picture() -> None:
    coarse = room_field(30_000)
    fine = coarse.resampled(120_000, CENTRE + 0.05, WALLS * 1.2)
    assert len(fine.grid) > 3 * len(coarse.grid) and fine.terms == coarse.terms
    assert (fine.near, fine.step, fine.shell) == (coarse.near, coarse.step, coarse.shell)
    for yaw in (0.0, 2.0):
        images = [to_uint8(render_view(field, VIEW, standing(0.2, 0.1, yaw)).image)
                  for field in (coarse, fine)]
        assert psnr(*images) > 33


def test_resampling_onto_the_same_grid_changes_nothing() -> None:
    field = room_field(20_000, sh_degree=1)
    again = field.resampled(20_000, field.centre, field.half_extent)
    assert again.shape == field.shape
    # But for the outermost points, which lie at infinity.
    inner = (np.abs(field.grid_position(field.world_points())).max(-1) < 0.99).ravel()
    np.testing.assert_allclose(again.grid[inner], field.grid[inner], atol=5e-3)


@pytest.mark.slow
def test_a_sparse_field_keeps_matter_and_the_air_around_it() -> None:
    field = room_field(30_000, sh_degree=1)
    dense, sparse = (field.resampled(60_000, CENTRE, WALLS * 1.2, sparse=sparse)
                     for sparse in (False, True))
    assert dense.update_occupancy() == sparse.update_occupancy()
    np.testing.assert_array_equal(sparse.skip, dense.skip)
    kept = sparse.row_of >= 0
    assert kept.sum() == len(sparse.grid) < 0.9 * len(dense.grid)
    np.testing.assert_array_equal(sparse.grid, dense.grid[kept])
    # Corners of the cells next to occupied ones.
    near = binary_dilation((dense.skip == 0).reshape(dense.shape), np.ones((3, 3, 3)))
    cells = np.argwhere(near)
    corners = np.unique(np.minimum(
        (cells[:, None] + np.indices((2, 2, 2)).reshape(3, -1).T).reshape(-1, 3),
        np.array(dense.shape) - 1), axis=0)
    np.testing.assert_array_equal(np.argwhere(kept.reshape(dense.shape)), corners)
    for first, second in zip(render_view(dense, VIEW, standing()),
                             render_view(sparse, VIEW, standing())):
        np.testing.assert_array_equal(first, second)


@pytest.mark.parametrize('device', ['cpu', 'torch'])
def test_a_sparse_field_that_becomes_empty_is_air(device: str) -> None:
    field = room_field(10_000).resampled(30_000, CENTRE, WALLS * 1.2, sparse=True)
    assert len(field.grid) < len(field.row_of)
    field.grid[:, 0] = -10
    placed = on_device(field, device)
    assert placed.update_occupancy() == 0 and field.skip.all()
    assert not render_view(placed, VIEW, standing()).opacity.any()


def test_a_field_that_is_empty_still_is_kept_whole() -> None:
    field = VoxelField.empty(1000, CENTRE, WALLS, 0.2, 0)
    finer = field.resampled(4000, CENTRE, WALLS, sparse=True)
    assert len(finer.grid) == len(finer.row_of) == np.prod(finer.shape)


def test_occupancy_counts_the_cells_to_the_nearest_matter() -> None:
    field = VoxelField.empty(8000, CENTRE, WALLS, 0.2, 0)
    field.grid[:, 0] = -10
    place = (7, 9, 6)
    field.grid[np.ravel_multi_index(place, field.shape), 0] = 30
    share = field.update_occupancy()
    skip = field.skip.reshape(field.shape)
    # A grid point is a corner of eight cells; a cell stands at its lowest corner.
    low, high = np.array(place) - 1, np.array(place)
    index = np.moveaxis(np.array(np.indices(field.shape)), 0, -1)
    away = np.maximum(np.maximum(low - index, index - high), 0).max(-1)
    np.testing.assert_array_equal(skip == 0, away == 0)
    # Never too far, and hardly too short.
    assert (skip <= away).all() and (skip[away > 0] >= np.maximum(away[away > 0] - 2, 1)).all()
    assert share == pytest.approx(8 / len(field.grid))


@pytest.mark.parametrize('factor, occupied', [(0.9, False), (1.1, True)], ids=['thin', 'thick'])
def test_occupied_means_opaque_enough_in_one_step(factor: float, occupied: bool) -> None:
    field = VoxelField.empty(1000, CENTRE, WALLS, 0.2, 0)
    sigma = -np.log(1 - factor * OCCUPIED_ALPHA) / field.step
    field.grid[:, 0] = np.log(np.expm1(sigma)) - field.shift
    assert (field.update_occupancy() > 0) == occupied
    # An empty field, early in a fit, is searched everywhere.
    assert (field.skip == 0).any() and (occupied or not field.skip.any())


def test_saved_fields_read_back(tmp_path: Path) -> None:
    field = room_field(10_000, sh_degree=1)
    field = field.resampled(30_000, field.centre, field.half_extent, sparse=True)
    field.near = 0.25
    field.update_occupancy()
    field.seen = np.random.default_rng(0).integers(0, 2, len(field.row_of)).astype(np.uint8)
    field.save(tmp_path / 'field.npz')
    again = VoxelField.load(tmp_path / 'field.npz')
    assert [path.name for path in tmp_path.iterdir()] == ['field.npz']
    assert (again.shape, again.near, again.shell) == (field.shape, 0.25, field.shell)
    for name in ('grid', 'row_of', 'skip', 'seen', 'centre', 'half_extent'):
        np.testing.assert_array_equal(getattr(again, name), getattr(field, name))
    for first, second in zip(render_view(field, VIEW, standing()),
                             render_view(again, VIEW, standing())):
        np.testing.assert_array_equal(first, second)


@pytest.mark.parametrize('content', [
    None, b'', b'no field', 'cut', 'array'], ids=['missing', 'empty', 'text', 'cut off', 'array'])
def test_what_is_no_field_is_refused(tmp_path: Path, content: bytes | str | None) -> None:
    path = tmp_path / 'field.npz'
    if content == 'cut':
        room_field(5000).save(path)
        path.write_bytes(path.read_bytes()[:2000])
    elif content == 'array':
        with path.open('wb') as file:
            np.save(file, np.zeros(3))
    elif isinstance(content, bytes):
        path.write_bytes(content)
    with pytest.raises(SceneError, match='field.npz: expected a radiance field') as refused:
        VoxelField.load(path)
    assert ('delete it to fit the field again' in str(refused.value)) == (content is not None)


@pytest.mark.parametrize('changes, message', [
    ({'shape': [200, 200, 200]}, r'kept: expected the shape .1000000,., got'),
    ({'shape': [20, 20]}, r'shape: expected three numbers, 2 or more, got .20, 20.'),
    ({'shape': [-8, -8, 8]}, 'shape: expected three numbers'),
    ({'kept': np.zeros(3, np.uint8)}, 'kept: expected the shape'),
    ({'seen': np.zeros(3, np.uint8)}, 'seen: expected the shape'),
    ({'grid': np.zeros((7, 4), np.float32)}, r'grid: expected the shape .*4. or .*got .7, 4.'),
    ({'grid': np.zeros(7, np.float32)}, 'grid: expected the shape'),
    ({'centre': np.zeros(2)}, 'centre: expected the shape'),
    ({'settings': 0.2}, r'settings: expected the shape .4,., got ..'),
    ({'settings': list('abcd')}, 'could not convert'),
    ({'kept': None}, 'kept'),
], ids=str)
def test_arrays_that_do_not_fit_are_refused(
        tmp_path: Path, changes: dict[str, Any], message: str) -> None:
    path = tmp_path / 'field.npz'
    room_field(5000).save(path)
    arrays = {**np.load(path), **changes}
    np.savez(path, **{name: value for name, value in arrays.items() if value is not None})
    with pytest.raises(SceneError, match=f'field.npz: expected .*{message}.*; delete it to fit'):
        VoxelField.load(path)


def test_an_unwritable_place_is_named(tmp_path: Path) -> None:
    with pytest.raises(SceneError, match='field.npz: cannot write the field'):
        room_field(5000).save(tmp_path / 'none' / 'field.npz')
