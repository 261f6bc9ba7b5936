"""Landmarks of a training run's photos."""
from dataclasses import replace
from pathlib import Path

from box_room import apart
from corner_photos import CAMERA, EXPANSION, write_corner
from neo_ros.baking import landmarks as landmarks_module, sparse_model
from neo_ros.baking.feature_database import write_database
from neo_ros.baking.landmarks import (
    _photos_for, find_landmarks, LEAST_PHOTOS, photos_for_landmarks)
from neo_ros.baking.photo_bank import read_photo_bank
from neo_ros.errors import NeoError
from neo_ros.evaluation.evaluate import TruthFrames
from neo_ros.geometry import Intrinsics
from neo_ros.machine.evenly import evenly
from neo_ros.memory.landmarks import Landmarks, Locator, magnification
from neo_ros.pictures.usable import write_usable
from neo_ros.scenes.posed_images import PosedImages
import numpy as np
import pytest
from scene_files import write_picture


@pytest.fixture(scope='module')
def corner(tmp_path_factory: pytest.TempPathFactory) -> tuple[PosedImages, TruthFrames]:
    return write_corner(tmp_path_factory.mktemp('corner'))


def landmarks_of(photos: PosedImages, work: Path) -> tuple[Landmarks | None, list[str]]:
    """Return the landmarks of photos, and the stages that were shown."""
    said: list[str] = []
    found = find_landmarks(photos, 1.0, EXPANSION.source, work,
                           lambda stage, done, total, note='': said.append(stage))
    return found, said


@pytest.mark.slow
def test_the_photos_landmarks_find_the_camera(
        corner: tuple[PosedImages, TruthFrames], tmp_path: Path,
        monkeypatch: pytest.MonkeyPatch) -> None:
    photos, frames = corner
    monkeypatch.setattr(landmarks_module, 'LEAST_PHOTOS', len(photos) - 1)
    monkeypatch.setattr(landmarks_module, 'PHOTOS_A_SQUARE_METRE', 1)
    assert photos_for_landmarks(photos) == evenly(len(photos), len(photos) - 1).tolist()
    landmarks, said = landmarks_of(photos, tmp_path)
    assert landmarks is not None and len(landmarks.points) > 30
    assert {'features', 'matches'} <= set(said)
    locator = Locator(landmarks, CAMERA)
    found = next(iter(locator.search(locator.features(frames.read(0)[0]))), None)
    assert found is not None and apart(found.pose, frames.images.poses[0])[0] < 0.05


@pytest.mark.slow
def test_what_a_mask_leaves_out_has_no_features(
        corner: tuple[PosedImages, TruthFrames], tmp_path: Path) -> None:
    photos, _ = corner
    usable = np.ones((96, 96), bool)
    usable[:, 30:] = False
    write_usable(tmp_path / 'mask.png', usable)
    masked = replace(photos, mask_paths=(tmp_path / 'mask.png', None) + (None,) * 13)
    whole, found = (read_photo_bank(one, 1.0, tmp_path / f'{index}.npz').features
                    for index, one in enumerate((photos, masked)))
    left = whole[0].points[:, 0] < 30
    assert 0 < left.sum() < len(left)
    np.testing.assert_array_equal(found[0].points, whole[0].points[left])
    np.testing.assert_array_equal(found[0].descriptors, whole[0].descriptors[left])
    np.testing.assert_array_equal(found[1].points, whole[1].points)


def test_pairs_are_the_same_however_many_photos_are_compared_at_once(
        corner: tuple[PosedImages, TruthFrames], tmp_path: Path,
        monkeypatch: pytest.MonkeyPatch) -> None:
    bank = read_photo_bank(corner[0], 1.0, tmp_path / 'features.npz')
    rules = sparse_model.MatchRules(partners=4)
    pairs = sparse_model.choose_pairs(bank, rules)
    monkeypatch.setattr(sparse_model, '_AT_ONCE', 4)
    assert sparse_model.choose_pairs(bank, rules) == pairs and len(pairs) > 15


@pytest.mark.parametrize('width, limit', [(96, 1.5), (320, 1.5), (640, 1.5), (1920, 4.5)])
def test_matches_are_known_as_exactly_as_the_shrunk_photo_shows_them(
        width: int, limit: float) -> None:
    rules = sparse_model.MatchRules()
    coarser = rules.coarser(magnification(Intrinsics.from_hfov(width, width, 1.5)))
    assert rules.epipolar_pixels * coarser == pytest.approx(limit, rel=1e-12)
    if width <= 640:
        assert coarser == 1


def test_limits_of_large_photos_are_larger_for_matches_and_for_points(
        corner: tuple[PosedImages, TruthFrames], tmp_path: Path) -> None:
    pytest.importorskip('pycolmap')
    usual, coarse = (sparse_model._options(times) for times in (1.0, 3.0))
    for name in ('merge_max_reproj_error', 'complete_max_reproj_error'):
        assert getattr(usual.triangulation, name) == 4.0
        assert getattr(coarse.triangulation, name) == 12.0
    assert (usual.mapper.filter_max_reproj_error, coarse.mapper.filter_max_reproj_error) == (4, 12)
    bank = read_photo_bank(corner[0], 1.0, tmp_path / 'features.npz', magnify=0.1)
    assert bank.magnify == 0.1


@pytest.mark.parametrize('patches', [True, False], ids=['patches', 'blank'])
def test_photos_without_texture_have_no_landmarks(
        corner: tuple[PosedImages, TruthFrames], tmp_path: Path, patches: bool) -> None:
    photos, _ = corner
    paths = tuple(tmp_path / f'{index}.png' for index in range(len(photos)))
    for index, path in enumerate(paths):
        image = np.full((96, 96, 3), 128, np.uint8)
        # A patch in each that is like no other photo's, or nothing at all.
        image[20:40, 20:40] = np.random.default_rng(index).integers(
            *((0, 256) if patches else (128, 129)), (20, 20, 3))
        write_picture(path, image)
    landmarks, said = landmarks_of(
        PosedImages(CAMERA, paths, photos.poses, photos.path_ids), tmp_path)
    assert landmarks is None
    assert said[-1] == 'without landmarks'


def test_of_one_photo_nothing_is_triangulated(
        corner: tuple[PosedImages, TruthFrames], tmp_path: Path) -> None:
    pytest.importorskip('pycolmap')
    landmarks, said = landmarks_of(corner[0].subset([0]), tmp_path)
    assert landmarks is None and said[-1] == 'without landmarks'


def test_no_room_for_the_database_is_one_line(tmp_path: Path) -> None:
    pytest.importorskip('pycolmap')
    path = tmp_path / 'none' / 'database.db'  # It cannot be written either.
    with pytest.raises(NeoError, match='database.db: cannot write .*; make room, and give the '):
        write_database(path, CAMERA, [], np.zeros((0, 4, 4)), [])


def test_without_pycolmap_there_are_no_landmarks(
        corner: tuple[PosedImages, TruthFrames], tmp_path: Path,
        monkeypatch: pytest.MonkeyPatch) -> None:
    monkeypatch.setattr(landmarks_module, 'find_spec', lambda name: None)
    landmarks, said = landmarks_of(corner[0], tmp_path)
    assert landmarks is None
    assert said == ['without landmarks'] and not list(tmp_path.iterdir())


def test_a_larger_floor_needs_more_photos() -> None:
    def needed(metres: int, floors: int = 1) -> int:
        return _photos_for(np.stack(np.meshgrid(
            np.arange(metres) + 0.5, np.arange(5) + 0.5, 3 * np.arange(floors) + 1.4),
            -1).reshape(-1, 3))
    assert needed(4) == LEAST_PHOTOS
    assert needed(40) == 40 * 5 * 12 and needed(40, floors=2) == 2 * needed(40)
