from hypothesis import given, settings, strategies as st
from neo_ros.outpaint.augmentation import augment_inputs, expose_views
import numpy as np
import pytest
import torch


def pictures(count: int = 6, size: int = 40) -> np.ndarray:
    """Return uint8 (count, size, size, 3): smooth colours with a grey edge, darker to the end."""
    rows, columns = np.indices((size, size)) / size
    images = np.stack([np.stack([rows, columns, 1 - rows], -1) * (200 - 20 * i)
                       for i in range(count)]).astype(np.uint8)
    images[:, :, size // 2:] //= 2
    return images


@settings(max_examples=20)
@given(st.integers(0, 999), st.floats(0, 1), st.floats(0, 1))
def test_the_seed_decides_and_the_pictures_stay_pictures(
        seed: int, photometric: float, occluders: float) -> None:
    images, before = pictures(), pictures()
    first, second = (augment_inputs(images, photometric, occluders, np.random.default_rng(seed))
                     for _ in range(2))
    np.testing.assert_array_equal(first, second)
    np.testing.assert_array_equal(images, before)
    assert first.shape == images.shape and first.dtype == np.uint8


def test_nothing_changes_without_strength() -> None:
    images = pictures()
    np.testing.assert_array_equal(
        augment_inputs(images, 0, 0, np.random.default_rng(0)), images)


@pytest.mark.parametrize('weak, strong', [(0.1, 0.4), (0.4, 1.0)])
def test_the_strength_says_how_much(weak: float, strong: float) -> None:
    images = np.repeat(pictures(), 20, 0)
    changes = [np.abs(augment_inputs(images, strength, 0, np.random.default_rng(1)).astype(int)
                      - images).mean() for strength in (weak, strong)]
    assert 0.2 < changes[0] < changes[1] < 60


def test_faults_of_a_camera_are_all_there() -> None:
    images = np.repeat(pictures(1), 200, 0)
    altered = augment_inputs(images, 1, 0, np.random.default_rng(2)).astype(float)
    means = altered.mean((1, 2))
    # The edge in the middle is blurred in some, and left alone in others.
    edge = np.abs(altered[:, :, 20] - altered[:, :, 19]).mean((1, 2)) / means.mean(1)
    sharp = np.abs(images[0, :, 20].astype(float) - images[0, :, 19]).mean() / images[0].mean()
    assert edge.min() < 0.5 * sharp and edge.max() > 0.95 * sharp


def test_exposure_and_balance_are_those_of_the_whole_view() -> None:
    view = np.dstack([pictures(1)[0], np.full((40, 40), 9, np.uint8)])
    views = np.repeat(view[None], 200, 0)
    before = views.copy()
    exposed = expose_views(torch.from_numpy(views), 1, np.random.default_rng(2)).numpy()
    np.testing.assert_array_equal(views, before)
    np.testing.assert_array_equal(exposed[..., 3], 9)
    means = exposed[..., :3].mean((1, 2))
    brightness = means.mean(1) / views[0, ..., :3].mean()
    assert brightness.min() < 0.7 and brightness.max() > 1.3
    balance = means[:, 0] / means[:, 2] / (means[:, 0] / means[:, 2]).mean()
    assert 0.02 < balance.std() < 0.2
    # One gain a channel: what was alike stays alike.
    ratio = exposed[3, ..., :3] / np.maximum(views[3, ..., :3].astype(float), 1)
    bright = (views[3, ..., :3] > 60) & (exposed[3, ..., :3] < 250)
    assert all(ratio[..., channel][bright[..., channel]].std() < 0.02 for channel in range(3))


def test_occluders_cover_a_part_of_as_many_pictures_as_asked() -> None:
    images = np.repeat(pictures(), 100, 0)
    altered = augment_inputs(images, 0, 0.5, np.random.default_rng(3))
    covered = (altered != images).any(-1).mean((1, 2))
    assert 0.35 < (covered > 0).mean() < 0.55
    some = covered[covered > 0]
    assert some.max() < 0.75 and 0.05 < np.median(some) < 0.5
    untouched = covered == 0
    np.testing.assert_array_equal(altered[untouched], images[untouched])
