"""What the report of an update says in words."""
from neo_ros.updating.update_report import what_happened
import numpy as np
import pytest


@pytest.mark.parametrize('came, left, stayed, words', [
    (40, 0, 5, 'something came'), (0, 40, 5, 'something left'), (3, 40, 5, 'something left'),
    (30, 40, 9, 'something came, something left'), (2, 1, 40, 'painted anew')])
def test_what_happened_is_told_by_what_is_matter(
        came: int, left: int, stayed: int, words: str) -> None:
    before = np.repeat([False, True, True, False], [came, left, stayed, 7])
    after = np.repeat([True, False, True, False], [came, left, stayed, 7])
    assert what_happened(before, after) == words
