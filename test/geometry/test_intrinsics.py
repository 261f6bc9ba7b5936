import math
from typing import Any

from hypothesis import given, strategies as st
from neo_ros.errors import GeometryError
from neo_ros.geometry import Intrinsics
import numpy as np
import pytest

CAMERA: dict[str, Any] = {'width': 64, 'height': 48, 'fx': 40.0, 'fy': 42.0, 'cx': 31.0,
                          'cy': 25.0}
sizes = st.integers(1, 40)
focals = st.floats(5.0, 500.0)
centres = st.floats(-20.0, 60.0)
cameras = st.builds(Intrinsics, sizes, sizes, focals, focals, centres, centres)


@given(cameras, st.floats(0.01, 100.0))
def test_rays_project_to_the_centres_of_their_pixels(camera: Intrinsics, depth: float) -> None:
    rays = camera.pixel_rays()
    assert rays.shape == (camera.height, camera.width, 3) and rays.dtype == np.float32
    rows, columns = np.indices(rays.shape[:2])
    np.testing.assert_allclose(
        camera.project(rays.astype(np.float64) * depth),
        np.stack([columns + 0.5, rows + 0.5], axis=-1), atol=1e-3)


def test_points_behind_the_camera_have_no_pixel() -> None:
    pixels = Intrinsics(**CAMERA).project(np.array([[0, 0, 1.0], [0, 0, 0], [0.1, 0, -1]]))
    np.testing.assert_array_equal(np.isnan(pixels).any(1), [False, True, True])
    np.testing.assert_allclose(pixels[0], [31, 25])


@pytest.mark.parametrize('hfov_deg, focal', [(90.0, 128.0), (126.8698976, 64.0)],
                         ids=['90 deg', '126.87 deg'])
def test_focal_length_of_a_field_of_view(hfov_deg: float, focal: float) -> None:
    camera = Intrinsics.from_hfov(256, 256, math.radians(hfov_deg))
    assert camera.fx == camera.fy == pytest.approx(focal)
    assert (camera.cx, camera.cy) == (128, 128)
    assert math.degrees(camera.hfov) == pytest.approx(hfov_deg)


@given(st.integers(1, 500), st.integers(1, 500), st.floats(0.1, 3.0))
def test_field_of_view_round_trip(width: int, height: int, hfov: float) -> None:
    camera = Intrinsics.from_hfov(width, height, hfov)
    assert camera.hfov == pytest.approx(hfov)
    assert math.tan(camera.vfov / 2) == pytest.approx(math.tan(hfov / 2) * height / width)


@given(cameras, st.integers(0, 9), st.integers(0, 9), st.integers(0, 9), st.integers(0, 9))
def test_growing_and_cropping_undo_each_other(
        camera: Intrinsics, left: int, right: int, top: int, bottom: int) -> None:
    wide = camera.grown(left, right, top, bottom)
    assert (wide.width, wide.height) == (
        camera.width + left + right, camera.height + top + bottom)
    back = wide.cropped(left, top, camera.width, camera.height)
    assert (back.width, back.height, back.fx, back.fy) == (
        camera.width, camera.height, camera.fx, camera.fy)
    assert (back.cx, back.cy) == pytest.approx((camera.cx, camera.cy))


@given(cameras, st.sampled_from([2, 3, 7]))
def test_scaled_shows_the_same_view(camera: Intrinsics, scale: int) -> None:
    scaled = camera.scaled(scale)
    assert scaled.hfov == pytest.approx(camera.hfov)
    assert scaled.vfov == pytest.approx(camera.vfov)
    back = scaled.scaled(1 / scale)
    assert (back.width, back.height) == (camera.width, camera.height)
    np.testing.assert_allclose(back.matrix, camera.matrix)


def test_scales_to_no_whole_size_keep_the_field_of_view() -> None:
    scaled = Intrinsics(65, 49, 40, 42, 31, 25).scaled(0.5)
    assert (scaled.width, scaled.height) == (32, 24)
    assert scaled.hfov == pytest.approx(Intrinsics(65, 49, 40, 42, 31, 25).hfov)


@pytest.mark.parametrize('changes, message', [
    ({'width': 0}, 'width: expected a positive integer, got 0'),
    ({'height': 48.0}, 'height: expected a positive integer, got 48.0'),
    ({'fx': 0.0}, 'fx: expected a focal length > 0 pixels, got 0.0'),
    ({'fy': -3.0}, 'fy: expected a focal length > 0'),
    ({'fx': math.nan}, 'fx: expected a finite number'),
    ({'fy': math.inf}, 'fy: expected a finite number'),
    ({'cx': math.nan}, 'cx: expected a finite number'),
    ({'cy': -math.inf}, 'cy: expected a finite number'),
], ids=lambda value: str(value)[:24])
def test_what_is_no_camera(changes: dict[str, Any], message: str) -> None:
    with pytest.raises(GeometryError, match=message):
        Intrinsics(**{**CAMERA, **changes})


@pytest.mark.parametrize('call, message', [
    (lambda camera: camera.scaled(0.001), 'scale: 0.001 leaves no pixel'),
    (lambda camera: camera.cropped(40, 0, 40, 40), 'crop: 40x40 at .40, 0. is not inside 64x48'),
    (lambda camera: camera.cropped(-1, 0, 4, 4), 'is not inside'),
    (lambda camera: camera.cropped(0, 0, 0, 4), 'width: expected a positive integer'),
    (lambda camera: Intrinsics.from_hfov(8, 8, math.pi), 'hfov: expected radians'),
    (lambda camera: Intrinsics.from_hfov(8, 8, math.nan), 'hfov: expected radians'),
], ids=['scaled away', 'crop outside', 'crop before', 'crop empty', '180 deg', 'NaN fov'])
def test_views_that_cannot_be(call: Any, message: str) -> None:
    with pytest.raises(GeometryError, match=message):
        call(Intrinsics(**CAMERA))
