"""Cameras other than the trained one: cropped, resampled, rectified, or refused."""
import math
from types import SimpleNamespace

from camera_messages import camera_info_message
import cv2
from hypothesis import given, strategies as st
from neo_ros.errors import ImageRejected
from neo_ros.geometry import Intrinsics, ViewExpansion
from neo_ros.messages import camera_info_fields, camera_info_of, CameraFit
from neo_ros.messages.camera_fit import camera_key
import numpy as np
import pytest

MODEL = Intrinsics.from_hfov(64, 64, math.radians(90))
EXPANSION = ViewExpansion.to_size(MODEL, 128, 128)
BARREL = ('plumb_bob', [-0.2, 0.03, 0.001, -0.002, 0.0])
RATIONAL = ('rational_polynomial', [-0.1, 0.02, 0.001, 0.0, 0.0, 0.1, 0.01, 0.0])
THIN_PRISM = ('rational_polynomial', [*RATIONAL[1], 0.01, 0.0, -0.01, 0.0])
TILTED = ('rational_polynomial', [*THIN_PRISM[1], 0.02, -0.01])
FISHEYE = ('equidistant', [0.02, -0.01, 0.0, 0.0])


def pattern(rays: np.ndarray) -> np.ndarray:
    """Colour directions (..., 3) with z = 1 smoothly, so that every camera sees the same world."""
    x, y = rays[..., 0], rays[..., 1]
    colour = np.stack([np.sin(3 * x), np.cos(2 * y + x), np.sin(2 * x * y)], -1)
    return np.rint(127.5 + 100 * colour).astype(np.uint8)


def rays_of(camera: Intrinsics, distortion=None, rotation=np.eye(3)) -> np.ndarray:
    """Directions through all pixels of a camera with this lens, in the rectified frame."""
    columns, rows = np.meshgrid(np.arange(camera.width), np.arange(camera.height))
    points = np.stack([columns, rows], -1).reshape(-1, 1, 2).astype(np.float64)
    k = camera.matrix
    k[:2, 2] -= 0.5
    name, coefficients = distortion or ('plumb_bob', [0.0] * 5)
    if name == 'equidistant':
        found = cv2.fisheye.undistortPoints(
            points, k, np.array(coefficients[:4]), R=rotation)[:, 0]
    else:
        found = cv2.undistortPoints(
            points, k, np.array(coefficients), R=rotation,
            criteria=(cv2.TERM_CRITERIA_COUNT | cv2.TERM_CRITERIA_EPS, 100, 1e-9))[:, 0]
    return np.concatenate([found, np.ones((len(found), 1))], 1).reshape(*columns.shape, 3)


EXPECTED = pattern(MODEL.pixel_rays())


@pytest.mark.parametrize('camera, distortion', [
    (MODEL.grown(10, 20, 5, 8), None),
    (Intrinsics.from_hfov(160, 140, math.radians(100)), None),
    (Intrinsics.from_hfov(500, 500, math.radians(95)), None),
    (MODEL.scaled(0.75), None),
    (Intrinsics(100, 90, 40.0, 38.0, 51.3, 44.1), None),
    (Intrinsics.from_hfov(200, 200, math.radians(115)), BARREL),
    (Intrinsics.from_hfov(200, 200, math.radians(115)), RATIONAL),
    (Intrinsics.from_hfov(200, 200, math.radians(115)), THIN_PRISM),
    (Intrinsics.from_hfov(200, 200, math.radians(115)), TILTED),
    (Intrinsics.from_hfov(200, 200, math.radians(115)), ('rational_polynomial', [
        *RATIONAL[1], *[0.0] * 6])),
    (Intrinsics(200, 200, 70.0, 70.0, 100.0, 100.0), FISHEYE),
    (Intrinsics(200, 200, 70.0, 70.0, 100.0, 100.0), (FISHEYE[0], [*FISHEYE[1], 0.0])),
], ids=['crop', 'wider', 'finer', 'coarser', 'odd pixels', 'barrel', 'rational', 'thin prism',
        'tilted', 'rational and zeros', 'fisheye', 'fisheye and a zero'])
def test_a_camera_that_sees_the_trained_view_is_brought_to_it(camera, distortion) -> None:
    changes = {} if distortion is None else {
        'distortion_model': distortion[0], 'd': distortion[1]}
    message = camera_info_message(camera, **changes)
    fit = CameraFit(message, EXPANSION, rectify=distortion is not None)
    assert fit.size == (camera.width, camera.height)
    image = fit.apply(pattern(rays_of(camera, distortion)))
    error = np.abs(image.astype(int) - EXPECTED)
    assert image.shape == EXPECTED.shape and error.mean() < 1.5 and np.median(error) <= 1
    assert 'resampled' in fit.note and ('rectified' in fit.note) == (distortion is not None)
    wanted = camera_info_fields(EXPANSION.target)
    for name in ('width', 'height', 'd', 'k', 'r', 'p'):
        np.testing.assert_array_equal(fit.camera_info[name], wanted[name])


def test_whole_pixels_of_a_crop_stay_bit_identical() -> None:
    fit = CameraFit(camera_info_message(MODEL.grown(3, 4, 5, 6)), EXPANSION, rectify=False)
    image = np.random.default_rng(0).integers(0, 256, (75, 71, 3), np.uint8)
    np.testing.assert_array_equal(fit.apply(image), image[5:69, 3:67])


def test_the_trained_camera_passes_untouched() -> None:
    image = EXPECTED.copy()
    for rectify in (False, True):
        fit = CameraFit(camera_info_message(MODEL), EXPANSION, rectify)
        assert fit.apply(image) is image and fit.note == 'as the model takes it'


def test_rotation_of_a_stereo_camera_is_applied_with_its_distortion_and_named_no_more() -> None:
    angle = math.radians(3)
    rotation = np.array([[math.cos(angle), 0, math.sin(angle)], [0, 1, 0],
                         [-math.sin(angle), 0, math.cos(angle)]])
    camera = Intrinsics.from_hfov(200, 200, math.radians(120))
    p = camera_info_fields(camera)['p']
    p[3] = -0.1 * camera.fx
    message = camera_info_message(camera, distortion_model=BARREL[0], d=BARREL[1],
                                  r=rotation.reshape(-1), p=p)
    fit = CameraFit(message, EXPANSION, rectify=True)
    seen = pattern(rays_of(camera, BARREL, rotation))
    assert np.abs(fit.apply(seen).astype(int) - EXPECTED).mean() < 1.5
    np.testing.assert_array_equal(fit.camera_info['r'], np.eye(3).reshape(-1))
    assert fit.camera_info['p'][3] == pytest.approx(-0.1 * MODEL.fx)


@pytest.mark.parametrize('rectify', [False, True])
@pytest.mark.parametrize('lens', [BARREL, FISHEYE], ids=['barrel', 'fisheye'])
def test_images_that_image_proc_rectified_are_those_of_p(lens, rectify) -> None:
    raw, straight = Intrinsics(200, 180, 90, 90, 99, 91), Intrinsics(200, 180, 60, 62, 104, 88)
    rotation = cv2.Rodrigues(np.array([0.02, -0.05, 0.01]))[0]
    p = camera_info_fields(straight)['p']
    p[3] = -0.1 * straight.fx
    raw_info = camera_info_message(
        raw, distortion_model=lens[0], d=lens[1], r=rotation.reshape(-1), p=p)
    fit = CameraFit(camera_info_of(raw_info, '/camera/image_rect'), EXPANSION, rectify)
    seen = fit.apply(pattern(straight.pixel_rays()))
    assert np.abs(seen.astype(int) - EXPECTED).mean() < 1.5
    assert fit.note.startswith('resampled from 200x180')
    wanted = camera_info_fields(EXPANSION.target)
    for name in ('d', 'k', 'r'):
        np.testing.assert_array_equal(fit.camera_info[name], wanted[name])
    assert fit.camera_info['p'][3] == pytest.approx(-0.1 * MODEL.fx)


def test_a_rectified_camera_like_the_trained_one_passes_untouched() -> None:
    raw_info = camera_info_message(
        MODEL.scaled(0.9).grown(3, 3, 3, 4), width=64, height=64, d=BARREL[1],
        r=np.diag([1.0, -1, -1]).reshape(-1), p=camera_info_fields(MODEL)['p'])
    fit = CameraFit(camera_info_of(raw_info, '/camera/image_rect_color'), EXPANSION, True)
    image = EXPECTED.copy()
    assert fit.apply(image) is image and fit.note == 'as the model takes it'
    for name, value in camera_info_fields(EXPANSION.target).items():
        np.testing.assert_array_equal(fit.camera_info[name], value)


@pytest.mark.parametrize('topic, rectified', [
    ('/camera/image_rect', True), ('/left/image_rect_color/compressed', True), ('/rect', True),
    ('/camera/rectified/image', True), ('/camera/image_raw', False), ('/direct/image', False),
    ('/camera/image_unrectified', False), ('/rectangle/image', False),
])
def test_the_name_of_a_topic_says_whether_its_images_are_rectified(topic, rectified) -> None:
    message = camera_info_message(MODEL, d=BARREL[1], p=np.zeros(12))
    found = camera_info_of(message, topic)
    assert found is message or (found.d.any(), list(found.k)) == (False, list(message.k))
    assert (found is not message) == rectified


def test_roi_and_binning_are_folded_in_before() -> None:
    sensor = Intrinsics.from_hfov(400, 300, math.radians(110))
    roi = SimpleNamespace(x_offset=40, y_offset=10, width=320, height=280, do_rectify=False)
    message = camera_info_message(sensor, roi=roi, binning_x=2, binning_y=2)
    sent = sensor.cropped(40, 10, 320, 280).scaled(0.5)
    fit = CameraFit(message, EXPANSION, rectify=False)
    assert fit.size == (160, 140)
    assert np.abs(fit.apply(pattern(sent.pixel_rays())).astype(int) - EXPECTED).mean() < 1.5


@pytest.mark.parametrize('camera, changes, rectify, reason, words', [
    (Intrinsics.from_hfov(64, 64, math.radians(60)), {}, False, 'camera', '90.00 deg.*60.00 deg'),
    (Intrinsics.from_hfov(200, 60, math.radians(100)), {}, False, 'camera', '90.00 deg.*100.00'),
    (Intrinsics(200, 200, 64, 64, 60, 100), {}, False, 'camera', 'does not see all'),
    (Intrinsics.from_hfov(200, 200, math.radians(95)),
     {'distortion_model': BARREL[0], 'd': [-0.9, 0, 0, 0, 0]}, True, 'camera', 'does not see'),
    (MODEL, {'d': [0.1, 0, 0, 0, 0]}, False, 'camera_info', 'parameter rectify'),
    (MODEL, {'d': [0.1, 0, 0, 0, 0], 'distortion_model': 'tilted'}, True, 'camera_info', 'tilted'),
    (MODEL, {'d': [math.nan, 0, 0, 0, 0]}, True, 'camera_info', 'finite'),
    (MODEL, {'d': [0.1] * 3}, True, 'camera_info', '4 or 5 or 8 or 12 or 14 of plumb_bob'),
    (MODEL, {'d': [0.1] * 5, 'distortion_model': FISHEYE[0]}, True, 'camera_info',
     '4 of equidistant'),
    (MODEL, {'k': np.zeros(9)}, True, 'camera_info', 'uncalibrated'),
], ids=['narrow', 'low', 'off centre', 'lens folds back', 'not asked to rectify', 'unknown lens',
        'nan', 'too few', 'too many of a fisheye', 'uncalibrated'])
def test_what_cannot_be_brought_to_it_is_refused(camera, changes, rectify, reason, words) -> None:
    with pytest.raises(ImageRejected, match=words) as refusal:
        CameraFit(camera_info_message(camera, **changes), EXPANSION, rectify)
    assert refusal.value.reason == reason


numbers = st.one_of(st.floats(), st.floats(-500, 500), st.just(0.0))
counts = st.one_of(st.integers(0, 600), st.integers(0, 2**32 - 1))


@given(st.lists(numbers, min_size=9, max_size=9), st.lists(numbers, min_size=12, max_size=12),
       st.lists(numbers, max_size=9), st.lists(numbers, min_size=9, max_size=9),
       st.sampled_from(['plumb_bob', 'equidistant', 'rational_polynomial', '']),
       st.tuples(counts, counts), st.tuples(*[counts] * 6))
def test_any_fields_give_a_fit_or_a_refusal(k, p, d, r, model, size, rest) -> None:
    roi = SimpleNamespace(x_offset=rest[0], y_offset=rest[1], width=rest[2], height=rest[3])
    message = SimpleNamespace(width=size[0], height=size[1], k=k, p=p, d=d, r=r, roi=roi,
                              distortion_model=model, binning_x=rest[4], binning_y=rest[5])
    camera_key(message)
    try:
        fit = CameraFit(message, EXPANSION, rectify=True)
    except ImageRejected as refusal:
        assert refusal.reason in ('camera', 'camera_info')
    else:
        assert all(np.isfinite(fit.camera_info[name]).all() for name in 'dkrp')
