"""Distorted cameras become one pinhole camera, and what it shows is where it should be."""
from dataclasses import replace
from functools import lru_cache
import math

import cv2
from neo_ros.errors import GeometryError, SceneError
from neo_ros.flat.demo_flat import build_demo_flat
from neo_ros.geometry import CameraPose, Intrinsics
from neo_ros.geometry.lens import common_pinhole, Lens, Straightener
import numpy as np
import pytest

CAMERA = Intrinsics(96, 72, 60.0, 61.0, 47.0, 37.5)
LENSES = {
    'barrel': Lens(CAMERA, (-0.2, 0.05, 0.002, -0.003)),
    'pincushion': Lens(CAMERA, (0.15, 0.02, 0.0, 0.0, 0.01)),
    'rational': Lens(CAMERA, (0.1, 0.01, 0.001, 0.0, 0.0, 0.2, 0.01, 0.0)),
    'fisheye': Lens(CAMERA, (0.02, -0.01, 0.003, 0.0), fisheye=True),
    'thin prism': Lens(CAMERA, (0.1, 0.01, 0.001, 0.0, 0.0, 0.2, 0.01, 0.0, 0.01, 0.0, -0.02, 0)),
    'tilted': Lens(CAMERA, (-0.1, 0.01, 0.001, 0.0, 0.0, 0.0, 0.0, 0.0, 0.0, 0.0, 0.0, 0.0, 0.03,
                            -0.02)),
    'fisheye with a zero behind': Lens(CAMERA, (0.02, -0.01, 0.003, 0.0, 0.0), fisheye=True),
    'fisheye without coefficients': Lens(CAMERA, (), fisheye=True),
}
POSE = CameraPose.from_planar(3.0, 1.3, 1.5, 0.4)


WIDE = Intrinsics.from_hfov(400, 320, math.radians(120))


@lru_cache
def wide_view() -> np.ndarray:
    return cv2.GaussianBlur(build_demo_flat().render(WIDE, POSE)[0], (0, 0), 0.7)


def distorted_photo(lens: Lens) -> np.ndarray:
    """Photograph the demo flat through the lens: look up each pixel's true ray in a wide view."""
    camera = lens.intrinsics
    rows, columns = np.indices((camera.height, camera.width), np.float64)
    pixels = np.stack([columns, rows], -1).reshape(-1, 1, 2)  # OpenCV's: centres at 0
    undistort = cv2.fisheye.undistortPoints if lens.fisheye else cv2.undistortPoints
    rays = undistort(pixels, lens.cv_matrix, lens.coefficients).reshape(
        camera.height, camera.width, 2)
    x = (rays[..., 0] * WIDE.fx + WIDE.cx - 0.5).astype(np.float32)
    y = (rays[..., 1] * WIDE.fy + WIDE.cy - 0.5).astype(np.float32)
    return cv2.remap(wide_view(), x, y, cv2.INTER_LINEAR)


@pytest.mark.slow
@pytest.mark.parametrize('lens', LENSES.values(), ids=LENSES.keys())
def test_a_straightened_photo_is_the_pinhole_view_of_the_scene(lens: Lens) -> None:
    pinhole = common_pinhole({lens: 'a.png'})
    assert (pinhole.width, pinhole.height) == (CAMERA.width, CAMERA.height)
    straight = Straightener(pinhole).apply(distorted_photo(lens), lens)
    truth = build_demo_flat().render(pinhole, POSE)[0]

    def psnr(image: np.ndarray) -> float:
        error = (image[2:-2, 2:-2].astype(float) - truth[2:-2, 2:-2]) ** 2
        return 10 * math.log10(255 ** 2 / error.mean())

    # Both are sampled, so they never agree exactly; a shift by half a pixel costs decibels.
    assert psnr(straight) > 26
    assert psnr(straight) > psnr(np.roll(straight, 1, axis=1)) + 2
    assert psnr(straight) > psnr(np.roll(straight, 1, axis=0)) + 2


@pytest.mark.parametrize('lens', LENSES.values(), ids=LENSES.keys())
def test_the_pinhole_view_has_no_border_and_wastes_no_side(lens: Lens) -> None:
    pinhole = common_pinhole({lens: 'a.png'})
    x, y = lens.straighten_maps(pinhole)
    # Half a pixel beyond the last centre is still inside the picture.
    assert x.min() > -0.6 and x.max() < CAMERA.width - 0.4
    assert y.min() > -0.6 and y.max() < CAMERA.height - 0.4
    assert x[:, 0].min() < 1 and x[:, -1].max() > CAMERA.width - 2
    assert y[0].min() < 1 and y[-1].max() > CAMERA.height - 2


# A tracking camera of 173 degrees across, and lenses that see behind themselves.
T265 = Lens(Intrinsics(848, 800, 286, 286, 420, 402), (-0.0093, 0.0462, -0.0434, 0.008, 0), True)
ALL_AROUND = Lens(Intrinsics(1280, 960, 330, 330, 650, 470), (0.01, 0.0, 0.0, 0.0), True)


@pytest.mark.parametrize('lens', [T265, ALL_AROUND], ids=['T265', '220 degrees'])
@pytest.mark.parametrize('asked', [None, 90.0, 140.0])
def test_a_fisheye_gives_what_is_asked_of_it_at_most_120_degrees(
        lens: Lens, asked: float | None) -> None:
    lens = lens if asked is None else replace(lens, fisheye_view=asked)
    pinhole = common_pinhole({lens: 'a.png'})
    for angle in (pinhole.hfov, pinhole.vfov):
        assert math.degrees(angle) == pytest.approx(asked or 120, abs=0.01)
    # Every pixel's ray, also in the corners, is one that the lens brings to that place.
    x, y = lens.straighten_maps(pinhole)
    assert x.min() > -0.6 and x.max() < lens.intrinsics.width - 0.4
    rays = pinhole.pixel_rays()[::40, ::40].reshape(-1, 3)
    angle = np.arctan(np.hypot(rays[:, 0], rays[:, 1]))
    radius = angle * (1 + sum(
        k * angle ** (2 * i + 2) for i, k in enumerate(lens.coefficients)))
    camera = lens.intrinsics
    expected = camera.cx - 0.5 + camera.fx * radius * rays[:, 0] / np.tan(angle)
    np.testing.assert_allclose(x[::40, ::40].reshape(-1), expected, atol=0.01)


def test_a_fisheye_view_stays_inside_the_circle_that_its_polynomial_describes() -> None:
    # Beyond 52 degrees this calibration turns back: nothing of it is to be trusted there.
    lens = Lens(Intrinsics(640, 480, 200, 200, 320, 240), (-0.4, 0, 0, 0), True)
    left, right, top, bottom = lens.straight_rectangle()
    corner = math.degrees(math.atan(math.hypot(right, bottom)))
    assert 45 < corner < 52.4
    assert (left, top) == pytest.approx((-right, -bottom))


def test_a_calibration_whose_axis_is_not_in_the_image_is_refused() -> None:
    lens = Lens(Intrinsics(640, 480, 200, 200, -50, 240), (0, 0, 0, 0.1), True)
    with pytest.raises(SceneError, match='no pinhole view fits'):
        lens.straight_rectangle()


def test_a_single_pinhole_camera_stays_as_it_is() -> None:
    lens = Lens(CAMERA, (0.0, 0.0, 0.0, 0.0))
    assert lens.is_pinhole
    assert common_pinhole({lens: 'a.png'}) == CAMERA
    image = np.random.default_rng(0).integers(0, 256, (72, 96, 3), np.uint8)
    assert Straightener(CAMERA).apply(image, lens) is image


def test_several_cameras_are_brought_to_what_all_of_them_see() -> None:
    a = Intrinsics(96, 72, 60, 60, 48, 36)
    b = Intrinsics(96, 72, 66, 60, 40, 36)
    common = common_pinhole({Lens(a): 'a.png', Lens(b): 'b.png'})
    left, right = -common.cx / common.fx, (96 - common.cx) / common.fx
    assert left == pytest.approx(max(-48 / 60, -40 / 66))
    assert right == pytest.approx(min(48 / 60, 56 / 66))
    assert (common.fy, common.cy) == pytest.approx((60, 36))


@pytest.mark.parametrize('make, message', [
    (lambda: common_pinhole({Lens(CAMERA): 'a.png',
                             Lens(Intrinsics(48, 36, 30, 30, 24, 18)): 'b.png'}),
     r'one size, got 48x36 \(b.png\), 96x72 \(a.png\)'),
    (lambda: common_pinhole({Lens(Intrinsics(96, 72, 20, 20, 48, 36), (-0.9, 0, 0, 0)): 'a.png'}),
     'a.png: lens: no pinhole view fits'),
    (lambda: common_pinhole({Lens(Intrinsics(96, 72, 0.9, 0.9, 0.5, 0.5)): 'a.png'}),
     'a.png: expected a camera that sees 3 to 170 degrees, .*are they in pixels of .* 96x72?'),
    (lambda: common_pinhole({Lens(CAMERA): 'a.png', Lens(replace(CAMERA, fy=6000)): 'b.png'}),
     r'b.png: expected a camera that sees 3 to 170 degrees, got 77.* across and 0.7 down'),
    (lambda: common_pinhole({Lens(CAMERA): 'a.png', Lens(replace(CAMERA, fx=90)): 'b.png',
                             Lens(replace(CAMERA, fx=61)): 'c.png'}),
     'b.png: expected a camera like those .* shows 6.% of what they show'),
    (lambda: common_pinhole({Lens(CAMERA): 'a.png', Lens(replace(CAMERA, cy=-80)): 'b.png',
                             Lens(replace(CAMERA, cy=36)): 'c.png'}),
     'b.png: expected a camera like those .* shows 0% of what they show'),
    (lambda: Lens(CAMERA, (math.nan,)), 'distortion: expected finite'),
    (lambda: Lens(CAMERA, (0.1,) * 15), 'at most 14'),
    (lambda: Lens(CAMERA, (0.1,) * 5, True), 'at most 4'),
], ids=['two sizes', 'absurd distortion', 'a focal length in widths', 'a focal length too long',
        'one is zoomed', 'one looks elsewhere', 'nan',
        'too many', 'too many of a fisheye'])
def test_lenses_that_cannot_be_used_are_refused(make: object, message: str) -> None:
    assert callable(make)
    with pytest.raises((SceneError, GeometryError), match=message):
        make()
