import math
from typing import Any

from hypothesis import given, strategies as st
from neo_ros.errors import GeometryError
from neo_ros.geometry import Intrinsics, ViewExpansion
import numpy as np
import pytest

CAMERA = Intrinsics(6, 4, 5.0, 5.0, 3.0, 2.0)
growth = st.integers(0, 5)
expansions = st.builds(
    ViewExpansion, st.just(CAMERA), st.integers(1, 5), growth, growth, growth)


def noise(camera: Intrinsics, seed: int) -> np.ndarray:
    return np.random.default_rng(seed).integers(
        0, 256, (camera.height, camera.width, 3), np.uint8)


def test_square_case_of_the_paper() -> None:
    source = Intrinsics.from_hfov(256, 256, math.radians(90))
    expansion = ViewExpansion.to_size(source, 512, 512)
    assert (expansion.target.width, expansion.target.height) == (512, 512)
    assert math.degrees(expansion.target.hfov) == pytest.approx(126.87, abs=0.005)
    assert math.degrees(expansion.target.vfov) == pytest.approx(126.87, abs=0.005)
    assert expansion.target.fx == source.fx == pytest.approx(128)
    assert expansion.observed == (slice(128, 384), slice(128, 384))
    assert expansion.extrapolated_mask.mean() == 0.75


def test_horizontal_case_of_the_paper() -> None:
    source = Intrinsics(160, 240, 290.0, 290.0, 80.0, 120.0)
    expansion = ViewExpansion.horizontal(source, 320)
    assert (expansion.target.height, expansion.target.width) == (240, 320)
    assert (expansion.left, expansion.right, expansion.top, expansion.bottom) == (80, 80, 0, 0)
    assert expansion.target.vfov == source.vfov
    assert expansion.extrapolated_mask[:, :80].all() and expansion.extrapolated_mask.mean() == 0.5


@given(expansions, st.integers(0, 99))
def test_what_is_pasted_is_what_is_cropped(expansion: ViewExpansion, seed: int) -> None:
    source_image, target_image = noise(expansion.source, seed), noise(expansion.target, seed + 1)
    before = target_image.copy()
    pasted = expansion.paste(source_image, target_image)
    np.testing.assert_array_equal(expansion.crop(pasted), source_image)
    ring = expansion.extrapolated_mask
    np.testing.assert_array_equal(pasted[ring], before[ring])
    np.testing.assert_array_equal(target_image, before)


@given(expansions)
def test_mask_is_the_complement_of_the_window(expansion: ViewExpansion) -> None:
    mask, target = expansion.extrapolated_mask, expansion.target
    assert mask.shape == (target.height, target.width) and mask.dtype == bool
    assert not mask[expansion.observed].any()
    assert (~mask).sum() == expansion.source.width * expansion.source.height


@given(expansions)
def test_the_window_sees_along_the_rays_of_the_source(expansion: ViewExpansion) -> None:
    np.testing.assert_allclose(expansion.crop(expansion.target.pixel_rays()),
                               expansion.source.pixel_rays(), atol=1e-6)


@given(expansions)
def test_the_source_is_a_window_of_the_target(expansion: ViewExpansion) -> None:
    source = expansion.source
    assert ViewExpansion.inside(expansion.target, expansion.left, expansion.top, source.width,
                                source.height) == expansion


@given(expansions, st.sampled_from([2, 5]))
def test_scaling_keeps_the_views(expansion: ViewExpansion, scale: int) -> None:
    scaled = expansion.scaled(scale)
    assert scaled.target.hfov == pytest.approx(expansion.target.hfov)
    assert scaled.source.vfov == pytest.approx(expansion.source.vfov)
    np.testing.assert_array_equal(
        scaled.extrapolated_mask, np.kron(expansion.extrapolated_mask, np.ones((scale, scale))))
    assert scaled.scaled(1 / scale) == expansion


@given(expansions, st.integers(1, 3))
def test_the_seam_is_the_ring_next_to_the_window(expansion: ViewExpansion, width: int) -> None:
    rows, columns = np.nonzero(expansion.extrapolated_mask)
    source = expansion.source
    away = np.maximum(
        np.maximum(expansion.top - rows, rows - (expansion.top + source.height - 1)),
        np.maximum(expansion.left - columns, columns - (expansion.left + source.width - 1)))
    np.testing.assert_array_equal(expansion.seam_mask(width)[rows, columns], away <= width)
    assert not expansion.seam_mask(width)[expansion.observed].any()


EXPANSION = ViewExpansion(CAMERA, 2, 2, 1, 1)


@pytest.mark.parametrize('call, message', [
    (lambda: ViewExpansion(CAMERA, -1, 0, 0, 0), 'left: expected pixels >= 0, got -1'),
    (lambda: ViewExpansion(CAMERA, 1, 0, 0, 0.5),  # type: ignore[arg-type]
     'bottom: expected pixels >= 0, got 0.5'),
    (lambda: ViewExpansion(CAMERA, 0, 0, 0, 0), 'expected growth at one side at least'),
    (lambda: ViewExpansion.to_size(CAMERA, 9, 4), 'even growth, got 9x4'),
    (lambda: ViewExpansion.to_size(CAMERA, 4, 8), 'expected at least 6x4'),
    (lambda: ViewExpansion.inside(CAMERA, 1, 1, 6, 3), 'is not inside 6x4'),
    (lambda: EXPANSION.scaled(0.5), 'scale: 0.5 does not give whole pixels'),
    (lambda: EXPANSION.crop(np.zeros((4, 6, 3))), 'target_image: expected height x width .6, 10'),
    (lambda: EXPANSION.paste(np.zeros((6, 4)), np.zeros((6, 10))), 'source_image: expected'),
], ids=['negative', 'part of a pixel', 'no growth', 'odd growth', 'shrinking',
        'window outside', 'scaled to half pixels', 'crop of another size',
        'paste of another size'])
def test_expansions_that_cannot_be(call: Any, message: str) -> None:
    with pytest.raises(GeometryError, match=message):
        call()
