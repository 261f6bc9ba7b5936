"""How sharp photos are beside their neighbours, and how often their pixels are drawn."""
from neo_ros.pictures.sharpness import sharpness_weights
from neo_ros.pictures.usable import draw_usable
import numpy as np


def test_a_blurred_photo_weighs_less_than_those_around_it() -> None:
    values = np.array([1.0] * 10 + [0.2, 1.1] + [5.0] * 10)
    weights = sharpness_weights(values, around=3)
    assert weights[10] == np.float64(0.2) and (np.delete(weights, 10) == 1).all()


def test_few_photos_are_compared_with_all() -> None:
    np.testing.assert_allclose(sharpness_weights(np.array([4.0, 4.0, 1.0])), [1, 1, 0.25])
    assert (sharpness_weights(np.zeros(4)) == 0.05).all()


def test_photos_are_drawn_as_often_as_their_shares_say() -> None:
    usable = np.ones((3, 4, 5), bool)
    usable[0, 0] = False
    photo, row, column = draw_usable(np.random.default_rng(0), 8000, (3, 4, 5), usable,
                                     np.array([0.7, 0.3, 0.0]))
    assert usable[photo, row, column].all()
    assert 0.6 < (photo == 0).mean() < 0.7 and not (photo == 2).any()
