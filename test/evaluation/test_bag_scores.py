"""Scores of a bag: against truth, and of a camera against its own border."""
import csv
import json
import math
from pathlib import Path

import cv2
from neo_ros.errors import ImageRejected
from neo_ros.evaluation.bag_scores import BagScores, MAX_SAMPLES
from neo_ros.evaluation.metrics import score_frame
from neo_ros.evaluation.narrower_camera import NarrowerCamera
from neo_ros.geometry import Intrinsics, ViewExpansion
import numpy as np
import pytest

SOURCE = Intrinsics.from_hfov(128, 96, math.pi / 2)
SQUARE = ViewExpansion.to_size(SOURCE, 256, 192)
HORIZONTAL = ViewExpansion.horizontal(SOURCE, 256)
SKEWED = ViewExpansion(SOURCE, 64, 16, 8, 40)


def _picture(width: int = 128, height: int = 96) -> np.ndarray:
    """Return a smooth picture of so many pixels."""
    noise = np.random.default_rng(5).integers(0, 256, (6, 8, 3), np.uint8)
    return cv2.resize(noise, (width, height), interpolation=cv2.INTER_CUBIC)


@pytest.mark.parametrize('model', [
    SQUARE, HORIZONTAL, SKEWED,
    ViewExpansion(Intrinsics.from_hfov(640, 480, 1.2), 160, 0, 0, 0),
    ViewExpansion(Intrinsics.from_hfov(256, 256, 1.2), 0, 0, 64, 0),
], ids=['square', 'horizontal', 'skewed', 'left alone', 'up alone'])
def test_the_narrower_camera_is_the_models_view_at_another_scale(model: ViewExpansion) -> None:
    camera = NarrowerCamera(model)
    small, ratio = camera.expansion, camera.focal_ratio
    for name in ('width', 'height'):  # Whole pixels: half a pixel may be missing.
        assert abs(getattr(small.source, name) * ratio - getattr(model.source, name)) < ratio
        assert abs(getattr(small.target, name) * ratio - getattr(model.target, name)) < ratio
    for name in ('left', 'right', 'top', 'bottom'):
        assert abs(getattr(small, name) * ratio - getattr(model, name)) <= 2 * ratio
    assert small.target.fx == model.source.fx  # The truth is as it was recorded.
    # The optical axis lies where the model has it in its wide view.
    assert abs(small.target.cx * ratio - model.target.cx) <= ratio
    assert abs(small.target.cy * ratio - model.target.cy) <= ratio


def test_a_perfect_model_gets_a_high_score() -> None:
    """Widen by enlarging the recorded frame: what a model that knows the scene would do."""
    image = _picture()
    scores = BagScores(SQUARE, lambda narrow: cv2.resize(image, (256, 192)))
    scores.add_frame(0, image, np.zeros((192, 256, 3), np.uint8))
    assert scores.rows[0]['ring_psnr'] > 40 > 25 > scores.rows[0]['edge_ring_psnr']
    assert scores.rows[0]['whole_ssim'] > 0.98


def test_the_model_sees_only_the_window() -> None:
    camera = NarrowerCamera(SQUARE)
    image = np.zeros((96, 128, 3), np.uint8)
    image[24:72, 32:96] = 200
    seen = camera.model_input(image)
    assert seen.shape == (96, 128, 3) and (seen == 200).all()
    wide = np.full((192, 256, 3), 50, np.uint8)
    prediction = camera.prediction(wide, image)
    assert prediction.shape == (96, 128, 3)
    assert (prediction[camera.expansion.extrapolated_mask] == 50).all()
    assert (camera.expansion.crop(prediction) == 200).all()


def test_what_was_measured_is_said_with_its_angles() -> None:
    words = NarrowerCamera(SQUARE).describe()
    # 2 atan(1/2), 90 degrees, 2 atan(2).
    assert 'was trained to widen 90.0 to 126.9 degrees; here it widens 53.1 to 90.0' in words
    assert '2.00 times the focal length' in words and '64x48 pixels' in words


def test_a_camera_of_a_few_pixels_is_refused() -> None:
    small = ViewExpansion.to_size(Intrinsics.from_hfov(24, 24, 1.5), 48, 48)
    with pytest.raises(ImageRejected, match='too few'):
        NarrowerCamera(small)


def test_rows_are_the_same_in_every_file(tmp_path: Path) -> None:
    scores = BagScores(SQUARE)
    chance = np.random.default_rng(0)
    pairs = [(_picture(256, 192), chance.integers(0, 256, (192, 256, 3), np.uint8))
             for _ in range(3)]
    for index, (truth, wide_image) in enumerate(pairs):
        scores.add_pair(5_000_000_000 + index * 500_000_000, truth, wide_image)
    scores.write(tmp_path, {'bag': 'a_bag', 'truth_topic': '/truth'})
    with (tmp_path / 'scores.csv').open() as file:
        rows = list(csv.DictReader(file))
    content = json.loads((tmp_path / 'scores.json').read_text())
    assert [float(row['seconds']) for row in rows] == [0, 0.5, 1]
    assert [int(row['stamp_ns']) for row in rows] == [
        frame['stamp_ns'] for frame in content['frames']]
    expected = score_frame(*pairs[1], SQUARE)
    for name, value in expected.items():
        assert float(rows[1][name]) == content['frames'][1][name] == value
        assert content['mean'][name] == pytest.approx(np.mean([float(row[name]) for row in rows]))
    report = (tmp_path / 'report.html').read_text()
    assert 'How well a_bag is widened' in report and '/truth' in report
    assert f'{scores.mean["ring_psnr"]:.3f}' in report


def test_pictures_of_a_long_bag_do_not_pile_up(tmp_path: Path) -> None:
    scores = BagScores(ViewExpansion.to_size(Intrinsics.from_hfov(32, 24, 1.5), 64, 48))
    truth = _picture(64, 48)
    for index in range(100):
        worse = truth.copy()
        worse[:index % 37] = 0
        scores.add_pair(index, truth, worse)
    assert len(scores.rows) == 100
    assert 2 < len(scores._samples) <= MAX_SAMPLES
    assert scores._extremes['Best'][0] == 0 and scores._extremes['Worst'][0] == 36
