"""Depth is compared with points that photos triangulate to."""
from pathlib import Path

from corner_photos import CAMERA, write_corner
from neo_ros.benchmark import point_depth
from neo_ros.benchmark.point_depth import measure
from neo_ros.benchmark.true_depth import demo_depth
from neo_ros.errors import SceneError
from neo_ros.geometry import ViewExpansion
from neo_ros.machine.progress import no_stage_progress
from neo_ros.pipeline import fit_field_step
from neo_ros.scenes.scene import Scene
from neo_ros.training.memory import memory_step
from neo_ros.training.run import TrainingRun
import pytest
from tiny_training import TINY

pytestmark = pytest.mark.slow


def test_field_and_memory_are_compared_with_what_photos_triangulate_to(
        tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    pytest.importorskip('pycolmap')
    photos, _ = write_corner(tmp_path / 'scene')
    half = ViewExpansion.to_size(CAMERA.middle(48, 96), 96, 96)
    scene = Scene('corner', photos.subset([*range(7), *range(9, 15)]), photos.subset([7, 8]),
                  half, None)
    monkeypatch.setattr(point_depth, 'read_upright_scene', lambda path: scene)
    run = TrainingRun(scene, TINY, tmp_path, no_stage_progress)
    memory_step(run, fit_field_step(run))
    rows = measure(tmp_path / 'scene', tmp_path, TINY, tmp_path / 'rows.json')
    assert [row['what'] for row in rows] == ['field', 'memory']
    field, memory = rows
    for row in rows:
        assert row['points'] > 20 and 0.5 < row['known'] <= 1
    # A field of seconds is far off; the flat itself is where its points are.
    assert 0 < memory['depth_error_median'] < 0.5 and field['depth_error_median'] > 0.05
    monkeypatch.setattr(point_depth, 'field_depth',
                        lambda frames, field: demo_depth(frames))
    exact, _ = measure(tmp_path / 'scene', tmp_path, TINY, tmp_path / 'exact.json')
    # Photos were taken 0.2 m apart, of 96 pixels.
    assert exact['depth_error_median'] < 0.05 and exact['known'] > 0.99


def test_a_scene_without_test_frames_is_refused(
        tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    photos, wider = write_corner(tmp_path / 'scene')
    for test in (None, wider.images):
        scene = Scene('corner', photos, test, None, None)
        monkeypatch.setattr(point_depth, 'read_upright_scene', lambda path: scene)
        with pytest.raises(SceneError, match='expected runs of photos held out as test frames'):
            measure(tmp_path / 'scene', tmp_path, TINY, tmp_path / 'rows.json')
