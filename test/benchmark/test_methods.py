"""The rivals on a small room: B2 and B3 find the place, the oracle needs the pose."""
from copy import copy
from dataclasses import replace
from typing import Any

from corner_photos import CAMERA, EXPANSION, write_corner
import cv2
from neo_ros.baking import sparse_model
from neo_ros.baking.photo_bank import read_photo_bank
from neo_ros.baking.sparse_model import epipolar_distance, read_sparse_model
from neo_ros.benchmark.field_view import FieldView, Oracle
from neo_ros.benchmark.relocalized import (
    Localization, pose_error, RelocalizationRules, Relocalized, RelocalizedNeo, Relocalizer)
from neo_ros.benchmark.warping import (
    covering, near_matches, on_plane, smooth_warp, WarpedPhoto, Warping)
from neo_ros.errors import SceneError
from neo_ros.evaluation.evaluate import score_frames
from neo_ros.flat.demo_flat import build_demo_flat
from neo_ros.geometry import CameraPose, Intrinsics, ViewExpansion
from neo_ros.geometry.camera_pose import rotation_from_vector
from neo_ros.memory.local_features import find_features, match_features
from neo_ros.pictures.filling import blend_bands, extend_edges
from neo_ros.pictures.usable import write_usable
from neo_ros.scenes.posed_images import PosedImages
import numpy as np
from plain_field import room_field, standing
import pytest


@pytest.fixture(scope='module')
def corner(tmp_path_factory):
    """Return a folder, photos around one place of the demo flat, and a wide view between them."""
    folder = tmp_path_factory.mktemp('corner')
    return folder, *write_corner(folder)


@pytest.fixture(scope='module')
def bank(corner):
    folder, photos, _ = corner
    return read_photo_bank(photos, 1.0, folder / 'features.npz')


@pytest.mark.slow
def test_b2_covers_the_ring_with_what_the_photos_show(corner, bank):
    method = Warping(bank, EXPANSION)
    frame = score_frames(corner[2], method)[0]
    assert frame['ring_psnr'] > 20
    assert 0 <= frame['uncovered'] < 0.6
    assert method.uncovered == frame['uncovered']


@pytest.mark.slow
def test_b2_shows_nothing_that_masks_leave_out(corner, bank, tmp_path):
    folder, photos, frames = corner
    usable = np.ones((96, 96), bool)
    usable[30:60, 30:60] = False
    write_usable(tmp_path / 'mask.png', usable)
    masked = copy(bank)
    masked.photos = replace(photos, mask_paths=(tmp_path / 'mask.png',) * len(photos))
    method, expected = Warping(masked, EXPANSION), Warping(masked, EXPANSION)
    method.images[:, ~usable] = 255  # Whoever stood there.
    expected.images[:, ~usable] = 0
    narrow = frames.read(0)[0]
    shown = [photo.weight > 0 for photo in method._warped_photos(narrow)]
    assert shown and np.mean(shown) < np.mean([
        photo.weight > 0 for photo in Warping(bank, EXPANSION)._warped_photos(narrow)]) - 0.01
    for one, other in zip(method._warped_photos(narrow), expected._warped_photos(narrow)):
        seen = one.weight > 0
        assert (one.image[seen] == other.image[seen]).all()


def test_b2_fuses_what_adds_to_the_ring():
    ring = np.ones((4, 6), bool)

    def photo(weight, columns):
        shown = np.zeros((4, 6), np.float32)
        shown[:, columns] = weight
        return WarpedPhoto(np.zeros((4, 6, 3), np.uint8), shown)

    left, same, right = photo(0.9, slice(3)), photo(0.8, slice(3)), photo(0.3, slice(3, 6))
    assert [one.weight[0, 0] for one in covering([same, right, left], ring)] == [
        left.weight[0, 0], right.weight[0, 0]]
    assert covering([], ring) == []


def test_a_warp_is_trusted_near_its_matches():
    trust = near_matches(np.array([[10.2, 5.1], [300.0, 5.0]]), 40, 30)
    assert trust[5, 10] == trust[5, 39] == 1 and trust.shape == (30, 40)
    assert 0.02 == trust[29, 25] < trust[5, 14] < 1


def test_b2_without_a_photo_that_fits_extends_the_edges(bank):
    method = Warping(bank, EXPANSION)
    grey = np.full((96, 96, 3), 90, np.uint8)
    np.testing.assert_array_equal(method.expand(grey), np.full((192, 192, 3), 90))
    assert method.uncovered == 1.0


@pytest.mark.slow
def test_b3_finds_the_pose_and_renders_there(corner, bank):
    model = read_sparse_model(bank, corner[0] / 'sparse')
    assert len(model.points) > 100
    true_pose = corner[2].images.poses[0]
    relocalizer = Relocalizer(bank, model, CAMERA)
    found = relocalizer.locate(corner[2].read(0)[0])
    error = pose_error(found.pose, true_pose)
    assert not found.failed
    assert error['pose_error_cm'] < 5
    assert error['pose_error_deg'] < 1
    method = Relocalized(relocalizer, FieldView(room_field(), EXPANSION, 1), None, None)
    frame = score_frames(corner[2], method)[0]
    assert frame['pose_failed'] == 0
    assert frame['pose_error_cm'] == pytest.approx(error['pose_error_cm'])


def test_b3_and_neo_fill_in_for_each_other():
    class Grey:
        train_minutes, model_mb = 4.0, 2.0

        def expand(self, narrow_image):
            return EXPANSION.paste(narrow_image, np.full((192, 192, 3), 90, np.uint8))

    class Finder:
        rules = RelocalizationRules()

        def locate(self, narrow_image):
            return Localization(standing(), 0, failed=not narrow_image.any())

    field = room_field()
    lower = np.arange(len(field.grid)) % field.shape[2] < field.shape[2] // 2
    field.seen = lower.astype(np.uint8)
    finder: Any = Finder()
    grey: Any = Grey()
    b3 = Relocalized(finder, FieldView(field, EXPANSION, 1), 1.0, 3.0)
    method = RelocalizedNeo(b3, grey, 4.5)
    assert (method.train_minutes, method.model_mb) == (4.5, 5.0)
    narrow_image = np.full((96, 96, 3), 128, np.uint8)
    wide, shown = method.expand(narrow_image), b3.expand(narrow_image)
    made_up = (wide == 90).all(2)
    assert made_up[:40].mean() > 0.9 and made_up[150:].mean() < 0.1
    np.testing.assert_array_equal(wide[~made_up], shown[~made_up])
    lost = method.expand(np.zeros((96, 96, 3), np.uint8))
    assert (lost[EXPANSION.extrapolated_mask] == 90).all()


def test_b3_falls_back_to_the_most_similar_photo(corner, bank):
    model = read_sparse_model(bank, corner[0] / 'sparse')
    found = Relocalizer(bank, model, CAMERA).locate(np.full((96, 96, 3), 90, np.uint8))
    assert found.failed
    assert any(found.pose is pose for pose in corner[1].poses)


def test_the_triangulated_points_lie_on_the_surfaces(corner, bank):
    model = read_sparse_model(bank, corner[0] / 'sparse')
    pose = corner[1].poses[6]
    depth = build_demo_flat().render(CAMERA, pose)[1]
    seen = model.point_of[6] >= 0
    points = model.points[model.point_of[6][seen]] @ pose.inverse()[:3, :3].T
    z = points[:, 2] + pose.inverse()[2, 3]
    x, y = bank.features[6].points[seen].astype(int).T
    assert np.median(np.abs(z - depth[y, x]) / depth[y, x]) < 0.1


def test_features_and_points_are_read_again_from_their_files(corner, bank):
    folder, photos, _ = corner
    again = read_photo_bank(photos, 1.0, folder / 'features.npz')
    np.testing.assert_array_equal(again.vectors, bank.vectors)
    first = read_sparse_model(bank, folder / 'sparse')
    np.testing.assert_array_equal(read_sparse_model(again, folder / 'sparse').points,
                                  first.points)


def test_photos_that_show_nothing_in_common_are_matched_once(tmp_path, monkeypatch):
    photos = PosedImages(CAMERA, tuple(tmp_path / f'{i}.png' for i in range(4)), tuple(
        CameraPose.from_planar(0.3 * i, 0, 1.5, 0) for i in range(4)), (0,) * 4)
    random = np.random.default_rng(0)
    for path in photos.image_paths:
        cv2.imwrite(str(path), random.integers(0, 256, (CAMERA.height, CAMERA.width, 3), np.uint8))
    bank, matched = read_photo_bank(photos, 1.0, tmp_path / 'features.npz'), []
    verified = sparse_model._verified

    def watched(*of):
        matched.append(1)
        return verified(*of)

    monkeypatch.setattr(sparse_model, '_verified', watched)
    for _ in range(2):
        with pytest.raises(SceneError, match='no point could be triangulated .*; landmarks need'):
            read_sparse_model(bank, tmp_path / 'sparse')
    assert matched == [1]


def test_the_oracle_renders_at_the_true_pose_and_refuses_without():
    camera = Intrinsics.from_hfov(16, 16, np.pi / 2)
    view = FieldView(room_field(), ViewExpansion.to_size(camera, 32, 32), 1)
    oracle = Oracle(view, 1.0, 2.0)
    narrow_image = np.full((16, 16, 3), 128, np.uint8)
    here = oracle.expand_at(narrow_image, standing())
    there = oracle.expand_at(narrow_image, standing(yaw=1.0))
    np.testing.assert_array_equal(view.expansion.crop(here), narrow_image)
    assert np.abs(here.astype(int) - there).mean() > 5
    with pytest.raises(SceneError, match='true pose'):
        oracle.expand(narrow_image)


def test_mutual_matches_by_ratio():
    random = np.random.default_rng(1)
    first = random.normal(size=(20, 128)).astype(np.float32)
    first /= np.linalg.norm(first, axis=1, keepdims=True)
    order = random.permutation(20)
    matches = match_features(first, first[order], 0.8)
    np.testing.assert_array_equal(order[matches[:, 1]], matches[:, 0])
    assert len(matches) == 20
    # Two alike candidates decide nothing.
    assert len(match_features(first, np.concatenate([first, first]), 0.8)) == 0


def test_an_image_of_nothing_has_no_features():
    features = find_features(np.full((32, 32, 3), 7, np.uint8))
    assert features.points.shape == (0, 2)
    assert features.descriptors.shape == (0, 128)


def test_points_lie_on_their_epipolar_lines():
    random = np.random.default_rng(2)
    points = random.uniform([-1, -1, 2], [1, 1, 4], (50, 3))
    T_b_a = np.eye(4)
    T_b_a[:3, :3], T_b_a[:3, 3] = rotation_from_vector(np.array([0.1, 0.2, 0])), [0.3, 0, 0.1]
    a = CAMERA.project(points)
    b = CAMERA.project(points @ T_b_a[:3, :3].T + T_b_a[:3, 3])
    assert epipolar_distance(CAMERA, T_b_a, a, b).max() < 1e-6
    assert np.median(epipolar_distance(CAMERA, T_b_a, a, b + [0, 5])) > 1


def test_matches_of_a_plane_are_kept_and_others_are_not():
    random = np.random.default_rng(3)
    wide = random.uniform(0, 100, (60, 2)).astype(np.float32)
    other = wide * 0.9 + [5, 3]
    other[40:] = random.uniform(0, 100, (20, 2))
    kept = on_plane(wide, other.astype(np.float32))
    assert kept[:40].all()
    assert kept[40:].sum() <= 3


def test_a_warp_of_one_homography_is_that_homography():
    random = np.random.default_rng(4)
    H = np.array([[0.9, 0.05, 4], [-0.03, 1.1, -6], [4e-4, -3e-4, 1]])

    def moved(points):
        result = np.c_[points, np.ones(len(points))] @ H.T
        return result[:, :2] / result[:, 2:]

    wide = random.uniform(50, 130, (80, 2))
    where = smooth_warp(wide, moved(wide), 192, 160)
    pixels = np.array([[10, 10], [96, 80], [180, 150]])
    np.testing.assert_allclose(where[pixels[:, 1], pixels[:, 0]], moved(pixels + 0.5), atol=0.5)


def test_bands_of_equal_pictures_give_the_picture():
    picture = np.random.default_rng(5).uniform(0, 255, (48, 64, 3)).astype(np.float32)
    weights = np.random.default_rng(6).uniform(0.1, 1, (2, 48, 64)).astype(np.float32)
    np.testing.assert_allclose(
        blend_bands([picture, picture], list(weights)), picture, atol=1e-2)


def test_extension_keeps_what_is_known_and_fills_the_rest_from_it():
    image = np.zeros((40, 40, 3), np.float32)
    image[:, :20] = [200, 100, 50]
    known = np.zeros((40, 40), bool)
    known[:, :20] = True
    filled = extend_edges(image, known)
    np.testing.assert_array_equal(filled[:, :20], image[:, :20])
    np.testing.assert_allclose(filled[:, 20:], np.broadcast_to([200, 100, 50], (40, 20, 3)),
                               atol=0.5)
