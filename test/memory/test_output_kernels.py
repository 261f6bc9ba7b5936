"""What kernels of pose, depth and colour tell, against the plain formulas they stand for."""
from concurrent.futures import ThreadPoolExecutor

import cv2
from neo_ros.geometry import CameraPose, Intrinsics
from neo_ros.geometry.camera_pose import rotation_from_vector
from neo_ros.memory.alignment_kernels import (
    equations_in_place, GuideLevel, normal_equations, PhotoLevel, Warp)
from neo_ros.memory.colour_kernels import bend_colours
from neo_ros.memory.descent_kernels import descend, Descent
from neo_ros.memory.kernels import Pinhole
from neo_ros.memory.pose_covariance import aligned_covariance, CovarianceThresholds
from neo_ros.memory.recent_images import SeenBefore
from neo_ros.memory.sight import Guide, TrustThresholds
import numpy as np
import pytest

OBSERVED = (slice(20, 60), slice(30, 91))


def patterned(pattern):
    """Return an image, what the memory shows of it, two metres away, and the camera."""
    camera = Intrinsics(48, 32, 30.0, 30.0, 24.0, 16.0)
    y, x = np.mgrid[:32, :48].astype(np.float32)
    noise = 1e-3 * np.random.default_rng(0).random((32, 48), np.float32)
    grey = {'vertical': 0.5 + 0.4 * np.sin(x), 'aslant': 0.5 + 0.4 * np.sin(0.7 * (x + y)),
            'plain': 0.5 + noise, 'black': 0 * x,
            'texture': 0.5 + 0.2 * np.sin(x) * np.sin(0.8 * y)}[pattern].astype(np.float32)
    photo = PhotoLevel(grey, *(np.gradient(grey, axis=axis).astype(np.float32) for axis in (1, 0)))
    shown = grey if pattern == 'black' else grey + noise
    return photo, GuideLevel(shown, np.full((32, 48), 2, np.float32), camera.pixel_rays()), camera


@pytest.mark.parametrize('pattern, unknown', [
    ('vertical', [0, 1, 0]), ('aslant', [0.7, -0.7, 0]), ('black', [0, 0, 1])])
def test_of_what_an_image_says_nothing_a_covariance_says_that_it_is_unknown(pattern, unknown):
    photo, guide, camera = patterned(pattern)
    covariance = aligned_covariance(photo, guide, camera, 0.08)
    assert unknown @ covariance[:3, :3] @ unknown > 1
    assert np.linalg.eigvalsh((covariance + covariance.T) / 2)[0] > 0
    if pattern != 'black':  # The ways across the stripes are known.
        assert covariance[2, 2] < 0.01 ** 2


def test_a_covariance_is_that_of_the_equations_where_they_tell_all():
    photo, guide, camera = patterned('texture')
    H, limits = np.empty((8, 8)), CovarianceThresholds()
    variance = equations_in_place(
        photo, guide, Pinhole(camera.fx, camera.fy, camera.cx, camera.cy), 0.08, H)
    factor = np.sqrt(np.repeat([limits.aligned_position, limits.aligned_rotation], 3))
    expected = variance * np.linalg.inv(H)[:6, :6] * np.outer(factor, factor)
    np.testing.assert_allclose(aligned_covariance(photo, guide, camera, 0.08), expected,
                               rtol=1e-3, atol=1e-6 * np.abs(expected).max())


@pytest.mark.parametrize('pattern', ['vertical', 'aslant', 'plain'])
def test_a_covariance_is_one_whatever_is_seen(pattern):
    photo, guide, camera = patterned(pattern)
    covariance = aligned_covariance(photo, guide, camera, 0.08)
    assert np.isfinite(covariance).all()
    least = np.linalg.eigvalsh((covariance + covariance.T) / 2)[0]
    assert least >= -1e-6 * np.abs(covariance).max()


def test_equations_in_place_are_those_of_a_warp_that_moves_nothing():
    random = np.random.default_rng(0)
    camera = Intrinsics(48, 32, 30.0, 31.0, 23.0, 17.0)
    grey, shown, depth = random.uniform(0, 1, (3, 32, 48)).astype(np.float32)
    depth[(depth < 0.3)] = 0
    # What `normal_equations` has of the outermost pixels depends on rounding.
    depth[[0, -1]], depth[:, [0, -1]] = 0, 0
    photo = PhotoLevel(grey, *(np.gradient(grey, axis=axis).astype(np.float32) for axis in (1, 0)))
    guide = GuideLevel(shown, depth, camera.pixel_rays())
    pinhole = Pinhole(camera.fx, camera.fy, camera.cx, camera.cy)
    H, expected, g = np.empty((8, 8)), np.empty((8, 8)), np.empty(8)
    cost = equations_in_place(photo, guide, pinhole, 0.08, H)
    expected_cost, _ = normal_equations(
        photo, guide, pinhole, Warp(np.eye(4), 1.0, 0.0), 0.08, True, expected, g)
    assert cost == pytest.approx(expected_cost, rel=1e-5)
    spread = np.sqrt(np.diag(expected))
    assert np.allclose(H / np.outer(spread, spread), expected / np.outer(spread, spread),
                       rtol=0, atol=1e-5)
    # Border pixels, whatever is known of them, change nothing.
    depth[[0, -1]] = 1
    again = np.empty((8, 8))
    assert equations_in_place(photo, guide, pinhole, 0.08, again) == cost
    assert np.array_equal(H, again)


def plain_descent(photo, guide, camera, warp, descent):
    """Return what `descend` returns, step by step."""
    H, g, kept, before = np.empty((8, 8)), np.empty(8), warp, np.inf
    away = max(np.median(guide.depth[guide.depth > 0]), 0.5)
    for iteration in range(descent.iterations + 1):
        error, overlap = normal_equations(photo, guide, camera, warp, descent.scale,
                                          descent.redescending, H, g)
        cost = error / overlap if overlap >= descent.lost else np.inf
        if cost > before:
            return kept
        if iteration == descent.iterations:
            return warp
        kept, before = warp, cost
        step = -np.linalg.solve(H + descent.damping * np.diag(np.diag(H) + 1e-6), g)
        move = np.eye(4)
        move[:3, :3], move[:3, 3] = rotation_from_vector(step[3:6]), step[:3]
        warp = Warp(move @ warp.T, np.clip(warp.gain + step[6], *descent.gains),
                    warp.bias + step[7])
        if camera.fx * (np.linalg.norm(step[:3]) / away
                        + np.linalg.norm(step[3:6])) < descent.still:
            return warp


@pytest.mark.parametrize('redescending', [False, True])
@pytest.mark.parametrize('iterations', [1, 3, 12])
def test_steps_are_those_of_plain_formulas(redescending, iterations):
    random, camera = np.random.default_rng(0), Intrinsics(48, 32, 30.0, 31.0, 23.0, 17.0)
    pinhole, ways = Pinhole(camera.fx, camera.fy, camera.cx, camera.cy), []
    for shift in (0.02, 0.1, 0.3, 0.6, 1.0, 1.6):  # The last ones lose much of the image.
        grey, shown = (cv2.GaussianBlur(random.uniform(0, 1, (32, 48)).astype(np.float32),
                                        (0, 0), 3) * 2 for _ in range(2))
        photo = PhotoLevel(grey, *(np.gradient(grey, axis=axis).astype(np.float32)
                                   for axis in (1, 0)))
        depth = random.uniform(1, 3, (32, 48)).astype(np.float32)
        guide = GuideLevel(0.8 * grey + 0.2 * shown, depth, camera.pixel_rays())
        T = CameraPose.from_planar(0, 0, 0, 0.1 * shift).T_world_cam
        start = Warp(np.linalg.inv(T) @ CameraPose.from_planar(
            shift, 0.5 * shift, 0, 0).T_world_cam, 1.0, 0.0)
        descent = Descent(0.08, redescending, iterations, 0.02, 1e-4, 0.05, (0.4, 2.5))
        found = descend(photo, guide, pinhole, start, descent)
        expected = plain_descent(photo, guide, pinhole, start, descent)
        np.testing.assert_allclose(found.T, expected.T, atol=1e-6)
        np.testing.assert_allclose(found[1:], expected[1:], atol=1e-6)
        ways.append(np.abs(found.T - start.T).max())
    assert np.count_nonzero(ways) > 2


def test_a_guide_of_which_nothing_is_known_stays_where_it_is():
    nothing = np.zeros((32, 48), np.float32)
    camera = Intrinsics(48, 32, 30.0, 31.0, 23.0, 17.0)
    start = Warp(np.eye(4), 1.0, 0.0)
    found = descend(PhotoLevel(nothing, nothing, nothing),
                    GuideLevel(nothing, nothing, camera.pixel_rays()),
                    Pinhole(camera.fx, camera.fy, camera.cx, camera.cy), start,
                    Descent(0.08, False, 12, 0.02, 1e-4, 0.05, (0.4, 2.5)))
    np.testing.assert_array_equal(found.T, start.T)


def plain_trusted_depth(guide, wide_image, confidence, limits):
    """Return what `Guide.trusted_depth` returns, formula by formula."""
    def large(off, weight):
        grey, share = (cv2.blur(values, (limits.around, limits.around))
                       for values in (off.mean(2), weight))
        return grey > limits.contradiction * np.maximum(share, 0.1)

    depth = guide.depth()
    window = depth[guide.observed]
    if window.size:
        off = np.abs(guide.image[guide.observed] - wide_image[guide.observed])
        window[large(off, np.ones(off.shape[:2]))] = np.nan
    depth[confidence < limits.least_confidence] = np.nan
    if guide.seen_before is not None:
        depth[large(np.abs(guide.seen_before.difference), guide.seen_before.weight)] = np.nan
    return depth


def some_guide(seed, seen=True, observed=OBSERVED):
    """Return a guide, a wide image and its confidence, of which all is drawn in patches."""
    random = np.random.default_rng(seed)

    def patches(low, high, channels):
        coarse = random.uniform(low, high, (12, 18, channels)).astype(np.float32)
        return cv2.resize(coarse, (125, 83), interpolation=cv2.INTER_LINEAR)

    depth = patches(-1, 5, 1)
    weight = np.clip(patches(-0.6, 1.2, 1), 0, 1)
    guide = Guide(
        patches(0, 255, 3), depth > 0, patches(-3, 1, 1) > 0, CameraPose(np.eye(4)), 1.0,
        SeenBefore(patches(-90, 90, 3) * weight[..., None], weight) if seen else None,
        remembered_depth=np.maximum(depth, 0), observed=observed)
    wide = np.clip(guide.image + patches(-90, 90, 3), 0, 255).astype(np.uint8)
    return guide, wide, random.integers(0, 256, depth.shape, np.uint8)


@pytest.mark.parametrize('case', [
    {}, {'seen': False}, {'observed': (slice(0, 0), slice(0, 0))},
    {'observed': (slice(0, 83), slice(0, 125))}, {'observed': (slice(80, 83), slice(124, 125))}])
@pytest.mark.parametrize('around', [1, 3, 9])
def test_trusted_depth_is_that_of_the_plain_formula(case, around):
    limits = TrustThresholds(around=around)
    guide, wide, confidence = some_guide(around, **case)
    found = guide.trusted_depth(wide, confidence, limits)
    expected = plain_trusted_depth(guide, wide, confidence, limits)
    assert found.dtype == np.float32
    assert np.array_equal(found, expected, equal_nan=True)
    # Every rule counts here.
    assert 0.05 < np.isnan(found).mean() < 0.95
    for weaker in (TrustThresholds(around=around, contradiction=1e9),
                   TrustThresholds(around=around, least_confidence=0)):
        assert np.isnan(guide.trusted_depth(wide, confidence, weaker)).sum() < (
            np.isnan(found).sum())


def test_threads_may_ask_at_once():
    asked = [some_guide(seed) for seed in range(8)]
    expected = [guide.trusted_depth(*given) for guide, *given in asked]
    with ThreadPoolExecutor(4) as pool:
        for _ in range(5):
            found = pool.map(lambda one: one[0].trusted_depth(*one[1:]), asked)
            assert all(np.array_equal(*pair, equal_nan=True) for pair in zip(found, expected))


@pytest.mark.parametrize('seen_rows', [99, 40, 1])
def test_colours_are_bent_by_what_lies_between_the_rows(seen_rows: int) -> None:
    random = np.random.default_rng(0)
    block, height, width = 8, 99, 123
    guide = random.uniform(0, 255, (height, width, 3)).astype(np.float32)
    carried = random.uniform(-9, 9, (13, width, 4)).astype(np.float32)
    seen = random.uniform(0, 1, (seen_rows, width, 4)).astype(np.float32)
    image = random.integers(0, 256, (40, 61, 3), np.uint8)
    wide, error = np.empty(guide.shape, np.uint8), np.empty(guide.shape[:2], np.float32)
    bend_colours(image, (30, 20), guide, carried, block, seen, np.float32(0.5), np.float32(1),
                 wide, error)
    bend = cv2.resize(carried, (width, 13 * block))[:height]
    fine = cv2.resize(seen, (width, height))
    off, weight = fine[..., :3], fine[..., 3]
    colours = np.clip(guide + bend[..., :3] * (1 - weight[..., None]) + off + 0.5, 0, 255)
    expected = bend[..., 3] * (1 - weight) + 0.5 * np.abs(off).mean(-1) + weight
    colours[30:70, 20:81], expected[30:70, 20:81] = image, 0
    # Of a colour that lies on a step rounding may take either side.
    off_by = np.abs(wide.astype(int) - colours.astype(np.uint8))
    assert off_by.max() <= 1 and (off_by > 0).mean() < 1e-3
    assert np.allclose(error, expected, rtol=0, atol=1e-4)
