"""Parts of the camera's model are compared on runs held out of a capture: here of a tiny flat."""
from dataclasses import replace
from pathlib import Path
import shutil

from neo_ros.benchmark.real_ablations import ABLATIONS, measure
from neo_ros.errors import SceneError
import pytest
from tiny_training import TINY

pytestmark = pytest.mark.slow


def test_rows_are_measured_once(tiny_run, tmp_path: Path) -> None:
    scene, results = tiny_run.out.parent / 'scene', tmp_path / 'real.json'
    base = replace(TINY, field=replace(TINY.field, steps=300, exposure=True))
    two = {name: ABLATIONS[name] for name in ('exposure', 'robust 0.3')}
    rows = measure(scene, base, two, results)
    assert [row['name'] for row in rows] == ['exposure', 'robust 0.3']
    for row in rows:
        assert row['cpu_minutes'] > 0 and row['ring_psnr'] > 10
        assert row['aligned_ring_psnr'] > 10 and 'aligned_held_out_psnr' in row
    assert rows[0]['ring_psnr'] != rows[1]['ring_psnr']
    assert measure(scene, base, two, results) == rows


def test_a_capture_without_runs_held_out_is_refused(tiny_run, tmp_path: Path) -> None:
    scene = tiny_run.out.parent / 'scene'
    shutil.copytree(scene, tmp_path / 'scene')
    (tmp_path / 'scene' / 'transforms_test.json').unlink()
    with pytest.raises(SceneError, match='made by: neo import CAPTURE .* --test-runs 3'):
        measure(tmp_path / 'scene')
