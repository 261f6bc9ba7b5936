"""Imports of many photos and of long bags are measured: on short ones."""
from pathlib import Path

from neo_ros.speed.long_imports import (
    KEYFRAMES, measure_import, write_bag, write_colmap, write_transforms)
import pytest


@pytest.mark.slow
@pytest.mark.parametrize('write, size, options, photos', [
    (write_transforms, 20, (), 20), (write_colmap, 20, (), 20), (write_bag, 4, KEYFRAMES, 12)],
    ids=['transforms', 'colmap', 'bag'])
def test_an_import_is_measured(tmp_path: Path, write, size, options, photos) -> None:
    write(tmp_path / 'source', size)
    row = measure_import(tmp_path / 'source', tmp_path / 'scene', options)
    assert abs(row['photos'] - photos) <= 1
    assert 50 < row['peak_mb'] < 1000 and 0 < row['cpu_minutes'] < 1


def test_an_import_that_fails_says_why(tmp_path: Path) -> None:
    with pytest.raises(RuntimeError, match='expected a folder|no such'):
        measure_import(tmp_path / 'source', tmp_path / 'scene')
