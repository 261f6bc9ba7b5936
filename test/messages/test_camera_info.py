"""CameraInfo: the half pixel, ROI and binning, growth of the view, and refusals."""
import math
from types import SimpleNamespace

from hypothesis import given, strategies as st
from neo_ros.errors import ImageRejected
from neo_ros.geometry import Intrinsics, ViewExpansion
from neo_ros.messages import (
    camera_info_fields,
    expand_camera_info,
    is_same_camera,
    read_camera_info,
)
import numpy as np
import pytest

PAPER = Intrinsics.from_hfov(256, 256, math.radians(90))


def message(camera=PAPER, *, roi=(0, 0, 0, 0), binning=(0, 0), **changes):
    """Describe a camera, with an ROI given as x, y, width, height."""
    fields = camera_info_fields(camera) | {
        'roi': SimpleNamespace(x_offset=roi[0], y_offset=roi[1], width=roi[2], height=roi[3],
                               do_rectify=False),
        'binning_x': binning[0], 'binning_y': binning[1]}
    return SimpleNamespace(**(fields | changes))


pixels = st.integers(1, 2000)
focal = st.floats(1, 5000)


@given(pixels, pixels, focal, focal, st.floats(-100, 2000), st.floats(-100, 2000))
def test_camera_comes_back(width, height, fx, fy, cx, cy):
    camera = Intrinsics(width, height, fx, fy, cx, cy)
    found = read_camera_info(message(camera))
    np.testing.assert_allclose(found.matrix, camera.matrix, rtol=1e-12, atol=1e-9)
    assert (found.width, found.height) == (width, height)


def test_pixel_centres_are_counted_from_zero():
    fields = camera_info_fields(PAPER)
    assert fields['k'][2] == fields['k'][5] == fields['p'][2] == 127.5
    assert fields['k'][0] == fields['p'][0] == pytest.approx(128)


def test_roi_is_a_crop():
    found = read_camera_info(message(roi=(16, 32, 100, 50)))
    expected = PAPER.cropped(16, 32, 100, 50)
    np.testing.assert_allclose(found.matrix, expected.matrix)
    assert (found.width, found.height) == (100, 50)


def test_binning_keeps_the_field_of_view():
    found = read_camera_info(message(binning=(2, 4)))
    assert (found.width, found.height) == (128, 64)
    assert found.hfov == pytest.approx(PAPER.hfov) and found.vfov == pytest.approx(PAPER.vfov)


def test_roi_counts_full_pixels_and_binning_comes_after():
    found = read_camera_info(message(roi=(16, 32, 200, 100), binning=(2, 2)))
    np.testing.assert_allclose(
        found.matrix, PAPER.cropped(16, 32, 200, 100).scaled(0.5).matrix)


NAN, INF = float('nan'), float('inf')


def changed(values, index, value):
    """Return a copy with one element changed."""
    values = np.array(values, np.float64)
    values[index] = value
    return values


K = camera_info_fields(PAPER)['k']


@pytest.mark.parametrize('changes, words', [
    ({'k': np.zeros(9)}, 'uncalibrated'),
    ({'k': changed(K, 0, NAN)}, 'finite'),
    ({'k': changed(K, 2, INF)}, 'finite'),
    ({'k': changed(K, 4, 0)}, 'fy'),
    ({'k': changed(K, 0, -128)}, 'fx'),
    ({'k': K[:8]}, '9 finite'),
    ({'width': 0}, 'width'),
    ({'d': [0.1, 0, 0, 0, 0]}, 'rectified input required'),
    ({'d': [0, 0, NAN]}, 'rectified input required'),
    ({'roi': (200, 0, 100, 100)}, 'roi'),
    ({'binning': (1000, 1)}, 'width'),
], ids=lambda value: str(value).replace(' ', '')[:40])
@pytest.mark.parametrize('use', [
    read_camera_info,
    lambda sent: expand_camera_info(sent, ViewExpansion.to_size(PAPER, 512, 512)),
], ids=['read', 'expand'])
def test_bad_cameras_are_refused(use, changes, words):
    with pytest.raises(ImageRejected, match=words) as refusal:
        use(message(**changes))
    assert refusal.value.reason == 'camera_info'


def test_wide_camera_info_of_the_paper():
    expansion = ViewExpansion(PAPER, left=100, right=156, top=10, bottom=20)
    stereo = changed(camera_info_fields(PAPER)['p'], 3, -42.0)
    stereo[7] = 7.0
    rotation = np.array([0, -1, 0, 1, 0, 0, 0, 0, 1.0])
    wide = expand_camera_info(message(p=stereo, r=rotation), expansion)
    assert (wide['width'], wide['height']) == (512, 286)
    assert wide['k'] == pytest.approx([128, 0, 227.5, 0, 128, 137.5, 0, 0, 1])
    assert wide['p'] == pytest.approx([128, 0, 227.5, -42, 0, 128, 137.5, 7, 0, 0, 1, 0])
    np.testing.assert_array_equal(wide['r'], rotation)
    assert not wide['d'].any() and wide['distortion_model'] == 'plumb_bob'


@given(*[st.integers(0, 300)] * 4)
def test_reading_the_wide_camera_info_gives_the_target(left, right, top, bottom):
    if left + right + top + bottom == 0:
        return
    expansion = ViewExpansion(PAPER, left, right, top, bottom)
    wide = expand_camera_info(message(), expansion)
    found = read_camera_info(message(**wide))
    np.testing.assert_allclose(found.matrix, expansion.target.matrix)
    assert (found.width, found.height) == (expansion.target.width, expansion.target.height)


def test_binned_stereo_camera_folds_into_k_and_p():
    big = PAPER.scaled(2)
    p = changed(camera_info_fields(big)['p'], 3, -42.0)
    wide = expand_camera_info(
        message(big, binning=(2, 2), p=p), ViewExpansion.to_size(PAPER, 512, 512))
    expected = camera_info_fields(ViewExpansion.to_size(PAPER, 512, 512).target)
    assert wide['k'] == pytest.approx(expected['k'])
    assert wide['p'] == pytest.approx(changed(expected['p'], 3, -21.0))


def test_empty_p_is_filled_from_k():
    wide = expand_camera_info(message(p=np.zeros(12)), ViewExpansion.to_size(PAPER, 512, 512))
    assert wide['p'].reshape(3, 4)[:, :3].ravel() == pytest.approx(wide['k'])


def test_expansion_of_another_size_is_refused():
    with pytest.raises(ImageRejected, match='expected 256x256, got 128x128'):
        expand_camera_info(message(PAPER.scaled(0.5)), ViewExpansion.to_size(PAPER, 512, 512))


@pytest.mark.parametrize('found, same', [
    (PAPER, True),
    (Intrinsics(256, 256, 129.2, 126.8, 130.5, 125.5), True),
    (Intrinsics(256, 256, 129.4, 128, 128, 128), False),
    (Intrinsics(256, 256, 128, 126.6, 128, 128), False),
    (Intrinsics(256, 256, 128, 128, 131, 128), False),
    (Intrinsics(256, 256, 128, 128, 128, 125), False),
    (Intrinsics(255, 256, 128, 128, 127.5, 128), False),
    (Intrinsics.from_hfov(256, 256, math.radians(60)), False),
], ids=['same', 'within', 'fx', 'fy', 'cx', 'cy', 'size', 'hfov 60'])
def test_same_camera(found, same):
    assert is_same_camera(found, PAPER) is same


numbers = st.floats(allow_nan=True, allow_infinity=True)
counts = st.one_of(st.integers(0, 600), st.integers(0, 2**32 - 1))


@given(st.lists(numbers, min_size=9, max_size=9), st.lists(numbers, min_size=12, max_size=12),
       st.lists(st.one_of(st.just(0.0), numbers), max_size=6), st.tuples(*[counts] * 4),
       st.tuples(counts, counts), counts, counts)
def test_any_fields_give_a_camera_or_a_refusal(k, p, d, roi, binning, width, height):
    sent = message(k=k, p=p, d=d, roi=roi, binning=binning, width=width, height=height)
    for use in (read_camera_info, lambda sent: expand_camera_info(
            sent, ViewExpansion.to_size(PAPER, 512, 512))):
        try:
            use(sent)
        except ImageRejected as refusal:
            assert refusal.reason == 'camera_info'
