"""`neo export`: the scene is read as the training read it."""
from dataclasses import replace
from pathlib import Path

from neo_ros.cli.main import app
from neo_ros.geometry import CameraPose, Intrinsics
from neo_ros.scenes.transforms_json import write_transforms
from neo_ros.training import variants
from neo_ros.training.run import TrainingRun
import numpy as np
import pytest
from scene_files import write_capture
from typer.testing import CliRunner


def test_a_world_with_another_axis_up_is_turned_as_for_the_training(
        tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    upright = write_capture(tmp_path / 'room', 30, Intrinsics.from_hfov(32, 32, 1.5))
    turn = np.eye(4)
    turn[:3, :3] = [[1, 0, 0], [0, 0, -1], [0, 1, 0]]  # z to y
    write_transforms(tmp_path / 'room' / 'transforms_train.json', replace(
        upright, poses=tuple(CameraPose(turn @ pose.T_world_cam) for pose in upright.poses)))
    runs = []

    def keep(run: TrainingRun, threads: int) -> list[variants.Variant]:
        runs.append(run)
        return [variants.Variant('fp32', tmp_path / 'room.fp32.onnx', 1.0, 2.0, 20.0)]

    monkeypatch.setattr(variants, 'export_variants', keep)
    result = CliRunner().invoke(
        app, ['export', str(tmp_path / 'room'), '--out', str(tmp_path / 'out')])
    assert result.exit_code == 0, result.output
    np.testing.assert_allclose(runs[0].scene.train.T_world_cam, upright.T_world_cam, atol=1e-9)
