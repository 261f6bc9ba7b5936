"""Depth that photos tell of one another: by stereo, and at the points they triangulate to."""
from dataclasses import replace
from pathlib import Path

from corner_photos import CAMERA, write_corner
from neo_ros import pipeline
from neo_ros.baking import landmarks
from neo_ros.baking.landmarks import find_landmarks, photos_for_landmarks
from neo_ros.baking.sparse_model import SparseModel
from neo_ros.field.voxel_field import VoxelField
from neo_ros.flat.demo_flat import build_demo_flat
from neo_ros.geometry import Intrinsics
from neo_ros.pipeline import fit_field_step
from neo_ros.scenes.posed_images import PosedImages
from neo_ros.scenes.scene import Scene
from neo_ros.training.memory import memory_step, WORK
from neo_ros.training.photo_depth import depth_of_points, photos_with_depth
from neo_ros.training.run import TrainingRun
import numpy as np
import pytest
from tiny_training import TINY

pytestmark = pytest.mark.slow


@pytest.fixture(scope='module')
def corner(tmp_path_factory: pytest.TempPathFactory) -> PosedImages:
    return write_corner(tmp_path_factory.mktemp('corner'))[0]


def run_of(photos: PosedImages, out: Path, said: list[str]) -> TrainingRun:
    return TrainingRun(Scene('corner', photos, None, None, None), TINY, out,
                       lambda stage, done, total, note='': said.append(stage))


def test_points_stand_for_what_is_around_them_and_the_nearest_counts() -> None:
    camera = Intrinsics.from_hfov(8, 6, np.pi / 2)  # f = 4: SPREAD is less than half a pixel.
    fine = Intrinsics.from_hfov(400, 300, np.pi / 2)
    T = np.eye(4)[None].repeat(2, 0)
    T[1, :3, 3] = 0, 0, 2.0
    points = np.array([[0.0, 0, 4], [0.04, 0, 3], [5, 0, 5], [0, 0, 70], [0, 0, 1], [9, 0, 1]])
    model = SparseModel(points, [np.array([0, 1, -1, 2, 3, 5]), np.array([0, 4])])
    depths = depth_of_points(model, T, camera)
    assert depths.shape == (2, 6, 8) and depths.dtype == np.uint16
    # The third lies at the right rim, the fourth too far for the numbers; what lies behind a
    # photo, or outside of it, is not seen.
    assert depths[0][depths[0] > 0].tolist() == [3000]
    assert depths[1][3, 4] == 2000 and (depths[1] > 0).sum() == 1
    around = depth_of_points(model, T, fine)[0]
    assert around[150, 202] == 3000 and around[150, 198] == 4000
    assert around[150, 205] == 0 and (around[148:153, 398:] == 5000).all()


def test_the_depth_of_photos_is_where_things_are(
        corner: PosedImages, tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    said: list[str] = []
    run = run_of(corner, tmp_path, said)
    with photos_with_depth(run) as photos:
        depths = photos.read_depths()
    assert depths is not None and run.seconds > 0
    assert said.index('stereo') > said.index('matches')
    flat = build_demo_flat()
    true = np.stack([flat.render(CAMERA, pose)[1] for pose in run.fitted.poses])
    known = depths > 0
    off = np.abs(depths[known] / 1000 - true[known]) / true[known]
    assert known.mean() > 0.3 and np.median(off) < 0.05  # They were taken 0.2 m apart.
    # The memory is made of the same points: nothing is found anew.
    bank = (tmp_path / WORK / 'features.npz').read_bytes()
    assert find_landmarks(run.fitted, 1.0, run.expansion.source, tmp_path / WORK, run.progress)
    assert (tmp_path / WORK / 'features.npz').read_bytes() == bank
    # One that was broken off goes on, with the same bits.
    said.clear()
    for gone in (3, 7):
        (tmp_path / WORK / f'stereo/{gone:06d}.png').unlink()
    with photos_with_depth(run) as photos:
        np.testing.assert_array_equal(photos.read_depths(), depths)
    assert said.count('stereo') == 2
    said.clear()
    with photos_with_depth(run):
        assert not said
    # Another process of the same training leaves nothing.
    beside = run_of(corner, tmp_path / 'beside', said)
    with photos_with_depth(beside, writes=False) as photos:
        np.testing.assert_array_equal(photos.read_depths(), depths)
    assert not (tmp_path / 'beside').exists()
    run.experiment = replace(TINY, memory=None)
    memory_step(run, VoxelField.empty(8, np.zeros(3), np.ones(3), 0.2, 0))
    assert not (tmp_path / WORK).exists()
    # Others than landmarks are made of have none.
    monkeypatch.setattr(landmarks, 'LEAST_PHOTOS', 10)
    monkeypatch.setattr(landmarks, 'PHOTOS_A_SQUARE_METRE', 1)
    with photos_with_depth(run_of(corner, tmp_path / 'some', said)) as photos:
        assert [index for index, path in enumerate(photos.depth_paths) if path is not None
                ] == photos_for_landmarks(run.fitted)


def test_where_nothing_is_to_be_found_nothing_is_looked_for(
        corner: PosedImages, tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    said: list[str] = []
    measured = tuple(tmp_path / f'{index}.png' for index in range(len(corner)))
    run = run_of(replace(corner, depth_paths=measured), tmp_path, said)
    with photos_with_depth(run) as photos:
        assert photos.depth_paths == run.fitted.depth_paths and len(photos.depth_paths) == 14
    run = run_of(corner, tmp_path, said)
    run.experiment = replace(TINY, field=replace(TINY.field, depth=0))
    with photos_with_depth(run) as photos:
        assert not photos.depth_paths
    assert not said
    monkeypatch.setattr(landmarks, 'find_spec', lambda name: None)
    with photos_with_depth(run_of(corner, tmp_path, said)) as photos:
        assert not photos.depth_paths
    assert said == ['without landmarks']


def test_a_field_is_fitted_with_it(
        corner: PosedImages, tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    given: list[np.ndarray | None] = []
    build = pipeline.field_trainer

    def look(*arguments):  # type: ignore[no-untyped-def]
        given.append(arguments[5])
        return build(*arguments)

    monkeypatch.setattr(pipeline, 'field_trainer', look)
    said: list[str] = []
    fit_field_step(run_of(corner, tmp_path, said))
    depths, = given
    assert depths is not None and (depths > 0).any()
    assert said.index('matches') < said.index('field')
