"""What an image says for one place and against another."""
from neo_ros.memory.evidence import misfit, speaks_against
from neo_ros.memory.thresholds import AmbiguityThresholds
import numpy as np
import pytest

LIMITS = AmbiguityThresholds()


def test_only_what_fits_one_place_and_not_the_other_speaks() -> None:
    image = np.random.default_rng(0).random((64, 64, 3)).astype(np.float32) * 0.4 + 0.3
    known = np.ones((64, 64), bool)
    changed = image.copy()
    changed[10:26, 20:36] += 0.3
    same, other = (misfit(image, shown, known, LIMITS) for shown in (0.5 * image + 0.1, changed))
    assert speaks_against(other, same, LIMITS) == pytest.approx(16 * 16 / 64 ** 2, rel=0.5)
    assert speaks_against(same, other, LIMITS) == -speaks_against(other, same, LIMITS)
    # What hides both, such as somebody who stands there, decides nothing.
    hidden = image.copy()
    hidden[:, 40:] = 0
    one, two = (misfit(hidden, shown, known, LIMITS) for shown in (image, 0.9 * image))
    assert abs(speaks_against(one, two, LIMITS)) < LIMITS.decisive
    # Nor does what one of them does not know.
    blind = misfit(image, changed, np.zeros_like(known), LIMITS)
    assert speaks_against(other, blind, LIMITS) == 0


def test_colours_speak_where_all_is_as_bright() -> None:
    image = np.full((64, 64, 3), 0.5, np.float32)
    image[:, ::8] = 0.2
    tinted = image.copy()
    tinted[20:40, 20:40] += [0.2, -0.1, -0.02]  # Grey of it is as before, within 0.002.
    known = np.ones((64, 64), bool)
    balanced = (image * [0.8, 0.9, 1.1]).astype(np.float32)  # Of another white balance.

    def against(one: np.ndarray, other: np.ndarray, seen: np.ndarray) -> float:
        bad, good = (misfit(seen, shown, known, LIMITS) for shown in (one, other))
        return speaks_against(bad, good, LIMITS)

    assert against(tinted, image, balanced) > 0.05
    assert against(image, balanced, image) == 0
    # A camera that sees no colours says nothing of them.
    grey = np.repeat(image.mean(-1, keepdims=True), 3, -1)
    red = (image + np.array([0.4, -0.2, -0.2]) * (np.arange(64) < 32)[:, None, None]).astype(
        np.float32)
    assert against(red, image, grey) == 0 < against(red, image, balanced)
