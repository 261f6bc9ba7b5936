"""The score tells images of the scene from others, and old cards do without it."""
import json

import cv2
from neo_ros.errors import ModelError
from neo_ros.geometry import Intrinsics, ViewExpansion
from neo_ros.runtime import FovExtrapolator, ModelCard, read_model_card, write_model_card
from neo_ros.runtime.scene_check import (
    fit_scene_reference, measure_image, MEASURES, SceneCheck, SceneCheckThresholds)
import numpy as np
import pytest
from tiny_model import tiny_card, TINY_EXPANSION, write_tiny_model

VIEW = ViewExpansion.to_size(Intrinsics(64, 48, 32.0, 32.0, 32.0, 24.0), 128, 96)


def room(seed: int, hue=(200, 120, 60)) -> np.ndarray:
    """Paint a wall of one hue with boxes of others, uint8 (48, 64, 3)."""
    random = np.random.default_rng(seed)
    image = np.full((48, 64, 3), hue, np.uint8)
    for _ in range(12):
        corner = random.integers(0, (50, 36))
        colour = np.clip(np.array(hue) + random.integers(-60, 60, 3), 0, 255)
        cv2.rectangle(image, corner.tolist(), (corner + random.integers(6, 20, 2)).tolist(),
                      colour.tolist(), -1)
    return image


def confidence(image: np.ndarray, sure: int = 150) -> np.ndarray:
    """Stand in for a network that is a little less sure of darker images."""
    found = np.full((96, 128), sure + int(image.mean()) // 10, np.uint8)
    found[VIEW.observed] = 255
    return found


PHOTOS = np.stack([room(seed) for seed in range(200)])
REFERENCE = fit_scene_reference(PHOTOS, confidence, VIEW)
assert REFERENCE is not None
CHECK = SceneCheck(REFERENCE, VIEW)


def score(image: np.ndarray, sure: int = 150) -> float:
    return CHECK.score(image, confidence(image, sure))


def test_images_of_the_scene_score_low() -> None:
    scores = [score(room(seed)) for seed in range(1000, 1100)]
    assert np.median(scores) < 0.1 and np.mean(np.array(scores) > 0.5) < 0.25


@pytest.mark.parametrize('change', [
    lambda image: np.zeros_like(image),
    lambda image: np.full_like(image, (90, 60, 50)),
    lambda image: (image * 0.15).astype(np.uint8),
    lambda image: cv2.GaussianBlur(image, (0, 0), 3),
    lambda image: image[..., ::-1].copy(),
    lambda image: np.random.default_rng(0).integers(0, 256, image.shape, np.uint8),
], ids=['cap', 'finger', 'dark', 'blur', 'other colours', 'noise'])
def test_other_images_score_high(change) -> None:
    scores = [score(change(room(seed))) for seed in range(1000, 1020)]
    assert min(scores) > 0.5 and np.mean(scores) > 0.9


def test_an_unsure_network_raises_the_score_and_a_sure_one_does_not() -> None:
    image = room(1000)
    assert score(image, 40) > 0.9
    assert score(image, 200) <= score(image) + 1e-9


def test_too_few_photos_say_nothing() -> None:
    least = SceneCheckThresholds.least_photos
    assert fit_scene_reference(PHOTOS[:least - 1], confidence, VIEW) is None
    assert fit_scene_reference(PHOTOS[:least], confidence, VIEW) is not None
    assert fit_scene_reference(
        PHOTOS[:least], confidence, VIEW,
        thresholds=SceneCheckThresholds(least_photos=least + 1)) is None


def masked_photos(people: int) -> tuple[np.ndarray, np.ndarray]:
    """Return photos with a white figure in the first `people`, and what does not show it."""
    photos, usable = PHOTOS.copy(), np.ones(PHOTOS.shape[:3], bool)
    usable[:people, 10:44, 20:50] = False
    photos[~usable] = 255
    return photos, usable


def test_a_reference_is_of_what_masks_leave() -> None:
    photos, usable = masked_photos(people=90)
    masked, with_people = (fit_scene_reference(photos, lambda image: confidence(room(0)), VIEW,
                                               shown) for shown in (usable, None))
    assert masked is not None and with_people is not None
    image = masked_photos(people=1)[0][0]
    unlike = [SceneCheck(one, VIEW).score(image, confidence(room(0)))
              for one in (masked, with_people)]
    assert unlike[0] > 0.9 and unlike[1] < 0.5
    assert SceneCheck(masked, VIEW).score(room(1000), confidence(room(0))) < 0.3


def test_what_masks_leave_out_of_most_photos_is_the_robot_itself() -> None:
    photos, usable = masked_photos(people=200)
    assert fit_scene_reference(photos, confidence, VIEW, usable) == fit_scene_reference(
        photos, confidence, VIEW)


def test_photos_of_which_little_is_left_say_nothing() -> None:
    usable = np.ones(PHOTOS.shape[:3], bool)
    usable[:90, :30] = False
    assert fit_scene_reference(PHOTOS, confidence, VIEW, usable) == fit_scene_reference(
        PHOTOS[90:], confidence, VIEW)


def test_masked_measures_are_those_of_the_rest() -> None:
    image, usable = room(3), np.ones((48, 64), bool)
    usable[:, 40:] = False
    other = image.copy()
    other[:, 40:] = 7
    sure = confidence(image)
    assert (measure_image(image, sure, VIEW, usable) == measure_image(
        other, sure, VIEW, usable)).all()
    np.testing.assert_array_equal(
        measure_image(image, sure, VIEW), measure_image(image, sure, VIEW, usable | True))


def test_reference_survives_the_card_and_old_cards_do_without(tmp_path) -> None:
    path = write_tiny_model(tmp_path / 'm.onnx')
    assert FovExtrapolator.load(path).scene_check is None
    extrapolator = FovExtrapolator.load(path)
    random = np.random.default_rng(0)
    photos = random.integers(0, 256, (30, 24, 32, 3), np.uint8)
    reference = fit_scene_reference(
        photos, lambda image: extrapolator.expand(image).confidence, TINY_EXPANSION)
    write_model_card(path, tiny_card(scene_reference=reference))
    assert reference is not None and read_model_card(path).scene_reference == reference
    check = FovExtrapolator.load(path).scene_check
    assert check is not None
    wide = extrapolator.expand(photos[0])
    assert check.score(photos[0], wide.confidence) == SceneCheck(
        reference, TINY_EXPANSION).score(photos[0], wide.confidence)


@pytest.mark.parametrize('changes, words', [
    ({'mean': 'AAAAAA=='}, f'expected {MEASURES} finite'),
    ({'whitening': '!'}, 'scene_reference.whitening'),
    ({'threshold': 0}, 'scene_reference.threshold'),
], ids=['too short', 'no base64', 'zero'])
def test_damaged_references_are_refused_by_name(changes, words) -> None:
    fields = json.loads(tiny_card(
        scene_reference=fit_scene_reference(PHOTOS, confidence, VIEW)).to_json())
    fields['scene_reference'] |= changes
    with pytest.raises(ModelError, match=words):
        ModelCard.from_json(json.dumps(fields))
