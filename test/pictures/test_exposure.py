from neo_ros.pictures.exposure import exposure_gain
import numpy as np


def test_the_gain_is_that_of_the_channels_whatever_a_few_pixels_say() -> None:
    shown = np.random.default_rng(0).uniform(40, 120, (20, 20, 3)).astype(np.float32)
    observed = shown * [1.2, 1.0, 0.8]
    observed[:4] = 200
    gain = exposure_gain(shown, observed)
    np.testing.assert_allclose(gain, [1.2, 1.0, 0.8], rtol=0.02)
    np.testing.assert_array_equal(gain, exposure_gain(shown.reshape(-1, 3),
                                                      observed.reshape(-1, 3)))


def test_where_nothing_tells_the_exposure_stays() -> None:
    grey = np.full((4, 4, 3), 100, np.uint8)
    assert (exposure_gain(np.zeros_like(grey), grey) == 1).all()
    assert (exposure_gain(grey, np.full_like(grey, 255)) == 1).all()
    assert (exposure_gain(grey[:0], grey[:0]) == 1).all()
