import math

from hypothesis import given, settings, strategies as st
from neo_ros.errors import ImageRejected
from neo_ros.evaluation.metrics import (
    auroc, psnr, PSNR_CAP_DB, score_frame, seam_width, ssim_map, summarise)
from neo_ros.geometry import Intrinsics, ViewExpansion
import numpy as np
import pytest
from skimage.metrics import peak_signal_noise_ratio, structural_similarity

SQUARE = ViewExpansion.to_size(Intrinsics.from_hfov(32, 32, math.pi / 2), 64, 64)
HORIZONTAL = ViewExpansion.horizontal(Intrinsics.from_hfov(20, 30, 1.0), 40)


def random_image(expansion, seed=0):
    size = (expansion.target.height, expansion.target.width, 3)
    return np.random.default_rng(seed).integers(40, 200, size).astype(np.uint8)


@pytest.mark.parametrize('expansion, area_ratio', [
    (SQUARE, 4 / 3), (HORIZONTAL, 2.0)], ids=['square', 'horizontal'])
def test_a_pasted_centre_lifts_the_whole_by_the_area_ratio(expansion, area_ratio):
    truth = random_image(expansion)
    prediction = truth.copy()
    prediction[expansion.extrapolated_mask] += 10
    scores = score_frame(truth, prediction, expansion)
    assert scores['ring_psnr'] == pytest.approx(10 * math.log10(255 ** 2 / 100))
    assert scores['seam_psnr'] == pytest.approx(scores['ring_psnr'])
    assert scores['whole_psnr'] - scores['ring_psnr'] == pytest.approx(
        10 * math.log10(area_ratio))


def test_the_seam_is_the_band_at_the_window():
    truth = random_image(SQUARE)
    prediction = truth.copy()
    width = seam_width(SQUARE)
    assert width == 2
    prediction[SQUARE.seam_mask(width)] += 20
    scores = score_frame(truth, prediction, SQUARE)
    assert scores['seam_psnr'] == pytest.approx(10 * math.log10(255 ** 2 / 400))
    band, ring = 36 ** 2 - 32 ** 2, 64 ** 2 - 32 ** 2
    assert scores['ring_psnr'] - scores['seam_psnr'] == pytest.approx(
        10 * math.log10(ring / band))


def test_the_seams_ssim_is_that_of_the_band_alone():
    grey = np.full((64, 64, 3), 100, np.uint8)
    # As wide as the band and an SSIM window at both sides: nothing else is seen from the band.
    near, far = grey.copy(), grey.copy()
    near[16 - 7:48 + 7, 16 - 7:48 + 7] = 120
    near[16 + 5:48 - 5, 16 + 5:48 - 5] = 100
    far[:8] = 120
    luminance = (2 * 100 * 120 + 2.55 ** 2) / (100 ** 2 + 120 ** 2 + 2.55 ** 2)
    assert score_frame(grey, near, SQUARE)['seam_ssim'] == pytest.approx(luminance, abs=1e-9)
    scores = score_frame(grey, far, SQUARE)
    assert scores['seam_ssim'] == pytest.approx(1, abs=1e-9) and scores['ring_ssim'] < 0.999


def test_a_wrong_centre_leaves_the_ring_psnr_untouched():
    truth = random_image(SQUARE)
    prediction = truth.copy()
    prediction[SQUARE.observed] = 0
    scores = score_frame(truth, prediction, SQUARE)
    assert scores['ring_psnr'] == scores['seam_psnr'] == PSNR_CAP_DB
    assert scores['whole_psnr'] < 15


def test_a_perfect_prediction_scores_the_cap_and_one():
    scores = score_frame(random_image(SQUARE), random_image(SQUARE), SQUARE)
    assert scores == {
        'whole_psnr': PSNR_CAP_DB, 'ring_psnr': PSNR_CAP_DB, 'seam_psnr': PSNR_CAP_DB,
        'whole_ssim': pytest.approx(1), 'ring_ssim': pytest.approx(1),
        'seam_ssim': pytest.approx(1)}


def test_pixels_that_do_not_show_the_scene_count_nowhere():
    truth = random_image(SQUARE)
    prediction = truth.copy()
    usable = np.ones((64, 64), bool)
    usable[:20] = False
    prediction[~usable] = 0
    perfect = score_frame(truth, prediction, SQUARE, usable)
    assert perfect == score_frame(truth, truth, SQUARE)
    prediction[40:50, 2:9] += 30
    masked, plain = score_frame(truth, prediction, SQUARE, usable), score_frame(
        truth, np.where(usable[..., None], prediction, truth), SQUARE)
    # The same errors over fewer pixels.
    ring = SQUARE.extrapolated_mask
    assert plain['ring_psnr'] - masked['ring_psnr'] == pytest.approx(
        10 * math.log10(ring.sum() / (ring & usable).sum()))
    assert plain['whole_psnr'] - masked['whole_psnr'] == pytest.approx(
        10 * math.log10(64 / 44))
    assert masked['ring_ssim'] < plain['ring_ssim'] < 1


def test_a_part_without_a_usable_pixel_has_no_score():
    truth = random_image(SQUARE)
    assert set(score_frame(truth, truth, SQUARE, ~SQUARE.seam_mask(seam_width(SQUARE)))) == {
        'whole_psnr', 'whole_ssim', 'ring_psnr', 'ring_ssim'}


def test_the_smallest_difference_never_beats_the_cap():
    truth = np.zeros((1024, 1024, 3), np.uint8)
    prediction = truth.copy()
    prediction[0, 0, 0] = 1
    assert psnr(truth, prediction) == PSNR_CAP_DB


@pytest.mark.parametrize('expansion', [SQUARE, HORIZONTAL], ids=['square', 'horizontal'])
def test_scores_agree_with_scikit_image(expansion):
    truth = random_image(expansion)
    noise = np.random.default_rng(1).normal(0, 12, truth.shape)
    prediction = np.clip(truth + noise, 0, 255).astype(np.uint8)
    mean, full = structural_similarity(
        truth, prediction, gaussian_weights=True, sigma=1.5, use_sample_covariance=False,
        data_range=255, channel_axis=-1, full=True)
    scores = score_frame(truth, prediction, expansion)
    ring = expansion.extrapolated_mask
    assert scores['whole_ssim'] == pytest.approx(mean, abs=1e-9)
    assert scores['ring_ssim'] == pytest.approx(full[ring].mean(), abs=1e-9)
    np.testing.assert_allclose(ssim_map(truth, prediction), full.mean(axis=2), atol=1e-9)
    assert scores['whole_psnr'] == pytest.approx(
        peak_signal_noise_ratio(truth, prediction, data_range=255), abs=1e-5)
    assert scores['ring_psnr'] == pytest.approx(
        peak_signal_noise_ratio(truth[ring], prediction[ring], data_range=255), abs=1e-5)


@given(constant=st.integers(0, 235), offset=st.integers(1, 20))
@settings(max_examples=20, deadline=None)
def test_ssim_of_constants_is_the_luminance_term(constant, offset):
    x = np.full((16, 16, 3), constant, np.uint8)
    y = x + np.uint8(offset)
    a, b, c1 = float(constant), float(constant + offset), 2.55 ** 2
    np.testing.assert_allclose(
        ssim_map(x, y), (2 * a * b + c1) / (a * a + b * b + c1), atol=1e-9)


@pytest.mark.parametrize('shape, dtype, reason', [
    ((64, 64, 3), np.float32, 'dtype'),
    ((32, 32, 3), np.uint8, 'size'),
    ((64, 64), np.uint8, 'size'),
    ((64, 64, 4), np.uint8, 'size'),
], ids=['float', 'narrow', 'mono', 'rgba'])
@pytest.mark.parametrize('which', ['truth', 'prediction'])
def test_other_images_are_rejected_by_name(shape, dtype, reason, which):
    images = {'truth': random_image(SQUARE), 'prediction': random_image(SQUARE)}
    images[which] = np.zeros(shape, dtype)
    with pytest.raises(ImageRejected, match=which) as caught:
        score_frame(**images, expansion=SQUARE)
    assert caught.value.reason == reason


def test_a_view_smaller_than_the_ssim_window_is_rejected():
    tiny = ViewExpansion.to_size(Intrinsics.from_hfov(4, 4, 1.0), 8, 8)
    image = np.zeros((8, 8, 3), np.uint8)
    with pytest.raises(ImageRejected, match='10 pixels'):
        score_frame(image, image, tiny)


def frames_of(paths):
    return [{'path_id': path, 'frame': 'x.png', 'ring_psnr': float(value)}
            for path, values in enumerate(paths) for value in values]


def test_the_mean_counts_frames_and_the_interval_counts_paths():
    result = summarise(frames_of([[10, 10, 10], [20]]))
    assert set(result) == {'ring_psnr'}
    estimate = result['ring_psnr']
    assert estimate.mean == 12.5
    # Two paths give three resamples: (a, a), (a, b), (b, b); the extremes happen 25 % each.
    assert (estimate.low, estimate.high) == (10.0, 20.0)


def test_the_bootstrap_is_deterministic_and_covers_the_mean():
    paths = np.random.default_rng(3).normal(20, 2, (8, 25))
    first, second = summarise(frames_of(paths)), summarise(frames_of(paths))
    assert first == second
    assert first != summarise(frames_of(paths), seed=1)
    estimate = first['ring_psnr']
    assert estimate.low is not None and estimate.high is not None
    assert estimate.low < estimate.mean < estimate.high
    spread = paths.mean(axis=1).std() / math.sqrt(8)
    assert estimate.high - estimate.low == pytest.approx(2 * 1.96 * spread, rel=0.15)


def test_one_path_gives_no_interval():
    assert summarise(frames_of([[10, 14]]))['ring_psnr'] == (12.0, None, None)


def test_scores_missing_in_a_frame_are_left_out():
    frames = frames_of([[10], [20]])
    frames[0]['ring_lpips_vgg'] = 0.3
    frames[1]['ring_lpips_vgg'] = None
    assert set(summarise(frames)) == {'ring_psnr'}


def test_scores_that_a_walks_first_frame_lacks_are_averaged_over_the_others():
    frames = frames_of([[10, 10, 10], [20, 20]])
    for frame, error in zip(frames, (None, 0.1, 0.3, None, 0.8)):
        if error is not None:
            frame['warping_error'] = error
    estimate = summarise(frames)['warping_error']
    assert estimate.mean == pytest.approx(0.4)
    # Each of the two walks alone is the extreme of what is drawn.
    assert (estimate.low, estimate.high) == (pytest.approx(0.2), pytest.approx(0.8))


def test_a_walk_without_a_score_says_nothing_about_it():
    frames = frames_of([[10], [20], [30]])
    for frame, error in zip(frames, (0.4, 0.6, None)):
        if error is not None:
            frame['warping_error'] = error
    estimate = summarise(frames)['warping_error']
    assert (estimate.mean, estimate.low, estimate.high) == (pytest.approx(0.5), 0.4, 0.6)
    del frames[1]['warping_error']
    assert summarise(frames)['warping_error'] == (0.4, None, None)


def test_no_frames_is_an_error():
    with pytest.raises(ValueError, match='at least one'):
        summarise([])


def test_auroc_counts_the_pairs_that_are_in_order_and_ties_half():
    assert auroc(np.array([2.0, 3.0]), np.array([1.0, 2.0])) == 3.5 / 4
