"""Depth of photos from one another, against the truth of the demo flat."""
from collections.abc import Iterator

import cv2
from neo_ros.baking.photo_stereo import (
    agreed_depth, pair_depth, partners_of, photo_depths)
from neo_ros.baking.sparse_model import SparseModel
from neo_ros.flat.demo_flat import build_demo_flat
from neo_ros.geometry import CameraPose, Intrinsics
import numpy as np
import pytest

CAMERA = Intrinsics.from_hfov(160, 120, np.pi / 2)


@pytest.fixture(scope='module')
def photos() -> Iterator[tuple[np.ndarray, np.ndarray, np.ndarray, SparseModel]]:
    """Four photos around a place, beside one another and above, with true depth and points."""
    flat = build_demo_flat()
    places = flat.walkable().centres()
    x, y = places[np.argmin(((places - places.mean(0)) ** 2).sum(1))]
    poses = [CameraPose.from_planar(x + dx, y + dy, 1.5 + dz, yaw)
             for dx, dy, dz, yaw in [(0, 0, 0, 0), (0.05, 0.3, 0, 0.1), (0, -0.3, 0.05, -0.1),
                                     (0, 0.05, 0.3, 0)]]
    images, depths = map(np.stack, zip(*(flat.render(CAMERA, pose)[:2] for pose in poses)))
    T = np.stack([pose.T_world_cam for pose in poses])
    rows, columns = np.mgrid[10:120:12, 10:160:12].reshape(2, -1)
    points = (CAMERA.pixel_rays()[rows, columns] * depths[0, rows, columns, None]
              ) @ T[0, :3, :3].T + T[0, :3, 3]
    every = np.arange(len(points))
    yield images, depths, T, SparseModel(points, [every] * len(poses))


def test_depth_of_photos_is_that_of_the_scene(photos) -> None:  # type: ignore[no-untyped-def]
    images, true, T, model = photos
    found = np.stack(list(photo_depths(images, CAMERA, T, model, range(4))))
    assert found.shape == true.shape and found.dtype == np.float32
    told = found > 0
    off = np.abs(found / true - 1)[told]
    assert told.mean() > 0.5
    assert np.median(off) < 0.01 and (off > 0.1).mean() < 0.05
    # As many threads as there are, the same bits.
    threads = cv2.getNumThreads()
    try:
        cv2.setNumThreads(1)
        np.testing.assert_array_equal(
            np.stack(list(photo_depths(images, CAMERA, T, model, [2, 0]))), found[[2, 0]])
    finally:
        cv2.setNumThreads(threads)


def test_a_camera_ahead_is_not_beside(photos) -> None:  # type: ignore[no-untyped-def]
    images, true, T, _ = photos
    ahead = T[0].copy()
    ahead[:3, 3] += 0.3 * ahead[:3, 2]
    assert pair_depth(images[0], images[0], CAMERA, T[0], ahead, 0.5, 9.0) is None
    # One that stands above is: rows are columns then.
    found = pair_depth(images[0], images[3], CAMERA, T[0], T[3], 0.5, 9.0)
    assert found is not None
    assert np.median(np.abs(found / true[0] - 1)[found > 0]) < 0.02
    # Nothing is looked for that is nearer, nor farther.
    some = pair_depth(images[0], images[1], CAMERA, T[0], T[1], 2.0, 3.0)
    assert some is not None and (some > 0).any()
    assert some[some > 0].min() > 1.0


def test_photos_are_compared_that_show_the_same_from_elsewhere() -> None:
    points = np.random.default_rng(0).uniform([-1, -1, 3], [1, 1, 5], (40, 3))
    T = np.eye(4)[None].repeat(6, 0)
    T[1:, 0, 3] = 0.6, 0.01, 0.8, 0.6, 0.6
    every = np.arange(40)
    # The third stands too near, the fifth shows too little of it, the sixth half as much.
    shown = [every, every, every, every, every[:14], every[:20]]
    seen_in = [np.flatnonzero([point in of for of in shown]) for point in every]
    assert partners_of(0, points, shown, seen_in, T) == [1, 3, 5]


def test_a_photo_without_points_has_no_depth() -> None:
    images = np.zeros((2, 120, 160, 3), np.uint8)
    T = np.eye(4)[None].repeat(2, 0)
    behind = SparseModel(np.array([[0.0, 0, -3]]), [np.array([0]), np.array([-1])])
    for depth in photo_depths(images, CAMERA, T, behind, range(2)):
        assert depth.shape == (120, 160) and not depth.any()
    alone = SparseModel(np.array([[0.0, 0, 3]]), [np.array([0]), np.array([-1])])
    assert not any(depth.any() for depth in photo_depths(images, CAMERA, T, alone, [0, 1]))


def test_pairs_that_agree_are_believed() -> None:
    depths = np.array([[[2.0, 2, 0, 1]], [[2.02, 3, 0, 0]], [[9, 4, 5, 0]]], np.float32)
    told = agreed_depth(depths)
    assert told[0, 0] == pytest.approx(2 / (1 / 2 + 1 / 2.02) * 1, rel=1e-6)
    assert told[0, 1:].tolist() == [0, 0, 0]
    assert agreed_depth(depths[:1]).tolist() == depths[0].tolist()
