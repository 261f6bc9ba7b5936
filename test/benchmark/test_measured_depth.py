"""What measured depth brings is measured: on a tiny flat, in seconds."""
from pathlib import Path

from neo_ros.baking.keyframes import MemoryConfig
from neo_ros.benchmark import measured_depth
from neo_ros.benchmark.measured_depth import measure
from neo_ros.errors import SceneError
from neo_ros.flat.scene_writing import write_demo_scene
import pytest
from tiny_training import TINY

pytestmark = pytest.mark.slow


def test_fields_with_depth_and_without_are_scored_and_kept(
        tiny_run, tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    monkeypatch.setattr(measured_depth, 'MEMORY', MemoryConfig(distance=1.5))
    write_demo_scene(tmp_path / 'flat', image_size=32, n_train=60, n_paths=2, frames_per_path=3,
                     workers=1, depth=True)
    results = tmp_path / 'depth.json'

    def measured() -> list[dict]:
        return measure(tmp_path / 'flat', tiny_run.model_path, tmp_path / 'work', TINY, (200, 400),
                       results)

    rows = measured()
    assert [(row['steps'], row['depth']) for row in rows] == [
        (200, 'measured'), (200, 'none'), (400, 'measured'), (400, 'none')]
    depth, none = rows[2:]
    assert depth['field_depth_error_median'] < none['field_depth_error_median']
    assert depth['field_ring_psnr'] > 10 and 'guided_ring_psnr' not in rows[0]
    for row in (depth, none):
        assert row['guided_ring_psnr'] > 10 and row['cpu_minutes'] > 0
    assert measured() == rows
    with pytest.raises(SceneError, match='expected the demo flat with depth, made by: neo import'):
        measure(tiny_run.out.parent / 'scene', tiny_run.model_path, tmp_path / 'work', TINY)
