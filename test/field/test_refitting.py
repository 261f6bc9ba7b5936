"""A fitted field changes where it may, and nowhere else."""
from neo_ros.field.config import FieldConfig
from neo_ros.field.fitting import FieldTrainer
from neo_ros.field.grid_points import cells_apart, dilated
from neo_ros.field.voxel_field import VoxelField
from neo_ros.geometry import Intrinsics
import numpy as np

CAMERA = Intrinsics.from_hfov(16, 16, 1.2)


def some_field() -> VoxelField:
    field = VoxelField.empty(4000, np.zeros(3), np.ones(3), 0.2, 0)
    field.grid[:, 0] = np.random.default_rng(0).normal(4, 3, len(field.grid))
    field.update_occupancy()
    return field


def test_only_the_points_of_open_cells_change() -> None:
    field = some_field()
    cells = np.zeros(field.shape, bool)
    cells[4:8, 4:8, 4:8] = True
    corners = dilated(cells, 0)
    T = np.tile(np.eye(4), (3, 1, 1))
    T[:, 2, 3] = -0.9, -0.8, -0.7
    images = np.random.default_rng(1).integers(0, 256, (3, 16, 16, 3), np.uint8)
    trainer = FieldTrainer(images, CAMERA, T, FieldConfig(rays_per_step=256, device='cpu'), 0)
    before = field.grid.copy()
    trainer.change_only(field, corners)
    for _ in range(5):
        trainer.train_step()
    changed = (trainer.field.grid != before).any(1)
    assert changed.any() and not changed[field.row_of[~corners.ravel()]].any()


def test_air_can_be_kept_and_searched() -> None:
    field = some_field()
    few = field.keeping(np.arange(len(field.row_of)) % 3 == 0)
    wanted = (few.row_of >= 0) | (np.arange(len(field.row_of)) % 5 == 0)
    more = few.keeping(wanted)
    had = few.row_of >= 0
    np.testing.assert_array_equal(more.grid[more.row_of[had]], field.grid[field.row_of[had]])
    assert (more.grid[more.row_of[wanted & ~had]] == 0).all()
    air = VoxelField.empty(4000, np.zeros(3), np.ones(3), 0.2, 0)
    air.grid[0, 0] = 20.0  # One corner is matter; elsewhere rays hop.
    air.update_occupancy()
    cells = np.zeros(air.shape, bool)
    cells[8, 8, 8] = True
    assert air.skip.reshape(air.shape)[8, 8, 8] > 0
    air.searched = cells
    air.update_occupancy()
    assert air.skip.reshape(air.shape)[8, 8, 8] == 0


def test_cells_are_no_nearer_to_marked_ones_than_they_are() -> None:
    cells = np.random.default_rng(2).random((9, 14, 11)) < 0.004
    there = np.argwhere(cells)
    away = np.argwhere(np.ones_like(cells))[:, None] - there
    truly = np.abs(away).max(-1).min(1).reshape(cells.shape)
    apart = cells_apart(cells)
    assert len(there) > 2 and truly.max() > 5
    assert ((apart == 0) == cells).all() and (apart <= truly).all() and (truly <= apart + 2).all()
    assert (cells_apart(np.zeros((3, 4, 5), bool)) == 255).all()


def test_few_usable_pixels_are_drawn_out_of_a_list_of_them() -> None:
    usable = np.zeros((3, 16, 16), bool)
    usable[1, 4:6, 7:9] = usable[2, 0, 3] = True
    images = np.zeros((3, 16, 16, 3), np.uint8)
    images[usable] = 255
    trainer = FieldTrainer(images, CAMERA, np.tile(np.eye(4), (3, 1, 1)), FieldConfig(
        rays_per_step=4096, voxels=4000, device='cpu'), 0, usable=usable)
    field = some_field()
    trainer.change_only(field, np.ones(field.shape, bool))
    assert trainer._few is not None and len(trainer._few) == 5
    trainer.random = np.random.default_rng(0)
    photo, target, *_ = trainer.sample_rays()
    assert (target == 1).all() and np.bincount(photo)[1] / len(photo) > 0.7
    # They are asked again when others are usable.
    usable[0] = True
    trainer.change_only(field, np.ones(field.shape, bool))
    assert trainer._few is None
