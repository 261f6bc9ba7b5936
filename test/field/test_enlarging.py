"""A field in a larger grid keeps what it had, and takes another's surfaces into the rest."""
from neo_ros.errors import SceneError
from neo_ros.field import enlarging
from neo_ros.field.enlarging import enlarged, filled
from neo_ros.field.rendering import render_rays
from neo_ros.field.voxel_field import VoxelField
import numpy as np
import pytest

LOW, HIGH = np.array([0.0, 0.0, 0.0]), np.array([3.0, 2.0, 2.0])


def a_field(shift: float = 0.0, shell: float = 0.2) -> VoxelField:
    """Return a box with painted walls, sparse as a fitted field is."""
    field = VoxelField.empty(30_000, (LOW + HIGH) / 2 + [shift, 0, 0], (HIGH - LOW) / 2 + 0.3,
                             shell, 0)
    points = field.world_points().reshape(-1, 3) - [shift, 0, 0]
    outside = np.maximum(LOW - points, points - HIGH).max(1)
    field.grid[:, 0] = np.where(np.abs(outside - 0.1) < 0.15, 12, -5)
    field.grid[:, 1:] = np.sin(2 * points)
    field.seen[:] = outside < 0.2
    field.update_occupancy()
    return field.of_seen_cells()


def rays(shift: float = 0.0) -> tuple[np.ndarray, np.ndarray]:
    directions = np.random.default_rng(1).standard_normal((500, 3)).astype(np.float32)
    return (np.array([1.2 + shift, 1.0, 0.9], np.float32),
            directions / np.linalg.norm(directions, axis=1, keepdims=True))


@pytest.mark.parametrize('low, high', [
    (LOW - [4, 0, 0], HIGH), (LOW, HIGH + [0.31, 5, 0]), (LOW - 1, HIGH + 2)],
    ids=['before', 'behind', 'all around'])
def test_a_larger_field_keeps_points_and_looks(low: np.ndarray, high: np.ndarray) -> None:
    old = a_field()
    new = enlarged(old, low, high)
    assert (new.centre - new.half_extent <= low).all()
    assert (new.centre + new.half_extent >= high).all()
    points = old.world_points().reshape(-1, 3)
    inside = (np.abs(points - old.centre) <= old.half_extent).all(1) & (old.row_of >= 0)
    place = (new.grid_position(points[inside]) + 1) / 2 * (np.array(new.shape) - 1)
    index = np.rint(place).astype(int)
    assert np.abs(place - index).max() < 1e-6
    rows = new.row_of.reshape(new.shape)[tuple(index.T)]
    np.testing.assert_array_equal(new.grid[rows], old.grid[old.row_of[inside]])
    before, after = (render_rays(field, *rays()) for field in (old, new))
    assert np.abs(before.depth - after.depth).mean() < 0.01
    assert np.abs(before.coverage - after.coverage).mean() < 0.02


def test_a_box_that_is_inside_changes_nothing() -> None:
    field = a_field()
    assert enlarged(field, LOW + 0.5, HIGH - 0.5) is field


def test_a_place_that_is_too_large_is_refused(monkeypatch: pytest.MonkeyPatch) -> None:
    monkeypatch.setattr(enlarging, 'MOST_POINTS', 1000)
    with pytest.raises(SceneError, match='grid points'):
        enlarged(a_field(), LOW - 30, HIGH + 30)


def test_another_fields_surfaces_are_taken_into_chosen_cells_alone() -> None:
    first, second = a_field(), a_field(shift=3.4)
    larger = enlarged(first, second.centre - second.half_extent,
                      second.centre + second.half_extent)
    centres = larger.world_points(np.moveaxis(np.indices(larger.shape), 0, -1) + 0.5)
    cells = centres[..., 0] > 3.25
    grown, points = filled(larger, second, cells)
    both = larger.row_of >= 0
    np.testing.assert_array_equal(grown.grid[grown.row_of[both]], larger.grid[larger.row_of[both]])
    assert not points.ravel()[both].any() and points.any()
    shown, own = (render_rays(field, *rays(3.4)) for field in (grown, second))
    assert np.abs(shown.depth - own.depth).mean() < 0.05
    assert np.abs(shown.image - own.image).mean() < 0.03
