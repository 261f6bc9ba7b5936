"""Whether a confidence is true, on errors that are known."""
from pathlib import Path

import cv2
from hypothesis import given, settings, strategies as st
from neo_ros.evaluation.calibration import calibrate, Calibration, DROPPED
from neo_ros.evaluation.evaluate import TruthFrames
from neo_ros.geometry import CameraPose, Intrinsics, ViewExpansion
from neo_ros.reports.report import Plot, Table
from neo_ros.runtime import WideView
from neo_ros.runtime.confidence import DECAY, expected_error
from neo_ros.scenes.posed_images import PosedImages
import numpy as np
import pytest

EXPANSION = ViewExpansion.to_size(Intrinsics(64, 64, 32.0, 32.0, 32.0, 32.0), 128, 128)
RING = EXPANSION.extrapolated_mask


def confidence_of(error: np.ndarray) -> np.ndarray:
    """Return the uint8 confidence that promises these errors, of full brightness."""
    return np.rint(255 * np.exp(-DECAY * error)).astype(np.uint8)


def frame(promised: float = 1.0, random_order: bool = False,
          ) -> tuple[np.ndarray, np.ndarray, np.ndarray]:
    """
    Return truth, prediction and confidence whose errors are Laplace of many scales.

    promised is the factor between the scale that the confidence promises and the true one.
    """
    random = np.random.default_rng(0)
    scale = np.exp(random.uniform(np.log(0.01), np.log(0.1), (128, 128)))
    error = random.laplace(0, 1, (128, 128)) * scale * 255
    truth = np.full((128, 128, 3), 128, np.uint8)
    prediction = np.clip(np.rint(128 + error), 0, 255).astype(np.uint8)[..., None].repeat(3, -1)
    told = random.permutation(scale.ravel()).reshape(scale.shape) if random_order else scale
    return truth, prediction, confidence_of(promised * told)


def calibration(**how: float) -> Calibration:
    result = Calibration()
    result.add(*frame(**how), EXPANSION)  # type: ignore[arg-type]
    return result


def test_a_true_confidence_has_hardly_any_calibration_error() -> None:
    found = calibration()
    predicted, actual, count = found.reliability()
    assert count.sum() == RING.sum() and len(count) == 10
    np.testing.assert_allclose(actual, predicted, rtol=0.15)
    assert found.calibration_error() < 0.05 * found.summary()['mean_error']


@pytest.mark.parametrize('factor', [0.5, 2.0])
def test_a_wrong_scale_is_the_calibration_error(factor: float) -> None:
    found = calibration(promised=factor).summary()
    expected = abs(factor - 1) * found['mean_error']
    assert found['expected_calibration_error'] == pytest.approx(expected, rel=0.15)


def test_sparsification_falls_with_a_true_confidence_and_not_with_a_random_one() -> None:
    true, oracle = calibration().sparsification()
    assert true[0] == pytest.approx(oracle[0]) and (np.diff(true) < 0.02).all()
    assert true[-1] < 0.4 * true[0] and (oracle <= true + 1e-9).all()
    blind, _ = calibration(random_order=True).sparsification()
    np.testing.assert_allclose(blind, blind[0], rtol=0.15)
    errors = [found.sparsification_error() for found in (
        calibration(), calibration(random_order=True))]
    assert 0 < errors[0] < 0.8 * errors[1]


def test_an_order_by_the_true_error_is_the_oracle() -> None:
    truth, prediction, _ = frame()
    error = np.abs(truth.astype(float) - prediction).mean(-1)
    result = Calibration()
    result.add(truth, prediction, np.clip(255 - error, 0, 255).astype(np.uint8), EXPANSION)
    assert result.sparsification_error() == pytest.approx(0, abs=1e-6)


def test_the_curve_is_the_mean_of_what_is_kept() -> None:
    truth, prediction, confidence = frame()
    error = np.abs(truth.astype(float) - prediction).mean(-1)[RING]
    order = np.argsort(-confidence[RING].astype(int), kind='stable')
    half = error[order][:len(order) // 2].mean()
    model, oracle = calibration().sparsification()
    at = int(np.argmin(np.abs(DROPPED - 0.5)))
    assert model[at] == pytest.approx(half, rel=0.02)
    assert oracle[at] == pytest.approx(np.sort(error)[:len(error) // 2].mean(), rel=0.02)


def test_observed_pixels_count_for_nothing() -> None:
    truth, prediction, confidence = frame()
    worse, one, two = prediction.copy(), Calibration(), Calibration()
    worse[EXPANSION.observed] = 0
    one.add(truth, prediction, confidence, EXPANSION)
    two.add(truth, worse, confidence, EXPANSION)
    np.testing.assert_array_equal(one.counts, two.counts)


def test_a_model_begins_anew_where_another_path_does(tmp_path: Path) -> None:
    truth, prediction, confidence = frame()
    calls: list[str] = []

    class Model:

        def reset(self) -> None:
            calls.append('reset')

        def expand(self, image: np.ndarray) -> WideView:
            np.testing.assert_array_equal(image, truth[EXPANSION.observed])
            calls.append('image')
            return WideView(prediction, confidence)

    path = tmp_path / 'wide.png'
    cv2.imwrite(str(path), truth[..., ::-1])
    pose = CameraPose(np.eye(4))
    frames = TruthFrames(PosedImages(EXPANSION.target, (path,) * 3, (pose,) * 3, (0, 0, 1)),
                         EXPANSION)
    found = calibrate(Model(), frames)  # type: ignore[arg-type]
    assert calls == ['reset', 'image', 'image', 'reset', 'image']
    one = Calibration()
    one.add(truth, prediction, confidence, EXPANSION)
    np.testing.assert_array_equal(found.counts, 3 * one.counts)
    assert found.summary() == pytest.approx(one.summary())


def test_a_report_shows_figures_and_both_curves() -> None:
    found = calibration()
    table, reliability, sparsification = found.sections('Of a test.')
    assert isinstance(table, Table)
    assert isinstance(reliability, Plot) and isinstance(sparsification, Plot)
    mean, expected, area = found.summary().values()
    assert [row[1] for row in table.rows] == [
        f'{mean:.2f} / 255', f'{expected:.2f} / 255', f'{area:.3f}']
    predicted, actual, _ = found.reliability()
    by_confidence, by_truth = found.sparsification()
    for plot, curves in ((reliability, [(predicted, actual), (predicted, predicted)]),
                         (sparsification, [(100 * DROPPED, by_confidence),
                                           (100 * DROPPED, by_truth)])):
        assert [(series.x, series.y) for series in plot.series] == [
            (list(x), list(y)) for x, y in curves]


@settings(max_examples=30)
@given(st.integers(1, 255))
def test_the_expected_error_undoes_the_confidence(value: int) -> None:
    error = expected_error(np.array([value], np.uint8))
    assert confidence_of(error)[0] == value


@pytest.mark.parametrize('value, error', [(255, 0), (128, 0.0249), (64, 0.0499), (0, 0.25)])
def test_the_documented_values_of_the_confidence(value: int, error: float) -> None:
    assert expected_error(np.array([[value]], np.uint8))[0, 0] == pytest.approx(error, abs=1e-3)
