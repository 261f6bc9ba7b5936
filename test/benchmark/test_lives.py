"""What the figures of a flat that changes are made of."""
from pathlib import Path

from neo_ros.benchmark import lives
from neo_ros.benchmark.lives import false_changes, RULES, Walks, walks_of
from neo_ros.flat.visits import CHAIRS, Visit
from neo_ros.geometry import Intrinsics
import numpy as np
import pytest

CAMERA = Intrinsics.from_hfov(8, 8, 1.6)


@pytest.mark.slow
def test_walks_are_cast_once_and_keep_off_what_was_moved(
        tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    before, after = (walks_of(Visit(changes), RULES.test_seed, 6, CAMERA, tmp_path, name)
                     for name, changes in (('day', ()), ('moved', CHAIRS)))
    assert np.array_equal(before.T, after.T) and len(before.images) == len(before.T) > 10
    assert set(before.walk) <= set(range(6))
    for chair in CHAIRS:
        away = np.linalg.norm(before.T[:, :2, 3] - chair.goal, axis=1)
        assert away.min() >= RULES.nearest
    apart = np.abs(before.images.astype(int) - after.images).mean(-1) > RULES.changed
    assert 0 < apart.mean() < 0.2
    monkeypatch.setattr(lives, '_cast', None)
    again = walks_of(Visit(), RULES.test_seed, 6, CAMERA, tmp_path, 'day')
    assert np.array_equal(again.images, before.images)


def test_a_false_change_was_right_before_and_is_in_the_ring() -> None:
    truth = np.full((1, 4, 4, 3), 100, np.uint8)
    old = truth.copy()
    old[0, 0] = 200  # Has changed: what is learnt there is no false change.
    shown, taught = truth.copy(), truth.copy()
    shown[0, 1, 0] = 200   # Was wrong before.
    taught[0, :2] = 10
    taught[0, 3, 3] = 160  # Outside the ring.
    ring = np.ones((4, 4), bool)
    ring[3, 3] = False
    walks = Walks(truth, np.eye(4)[None], np.zeros(1, int))
    before = Walks(old, walks.T, walks.walk)
    assert false_changes(walks, before, [shown[0]], [taught[0]], ring) == pytest.approx(3 / 11)
