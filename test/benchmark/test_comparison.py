"""Experiments side by side, on a scene that trains in seconds."""
from dataclasses import replace
from itertools import count
import json
from pathlib import Path
import shutil
from types import SimpleNamespace

from neo_ros.baking.keyframes import MemoryConfig
from neo_ros.benchmark.comparison import compare, marked_front, Row
from neo_ros.cli.main import app
from neo_ros.errors import ConfigError, ModelError, NeoError
from neo_ros.memory.scene_memory import SceneMemory
from neo_ros.outpaint import fitting
from neo_ros.outpaint.export import ExportedFunction
from neo_ros.runtime import read_model_card, write_model_card
from neo_ros.runtime.model_card import Update
from neo_ros.training import variants
from neo_ros.training.checkpoint import read_checkpoint, write_checkpoint
from neo_ros.training.run import TrainingRun
from neo_ros.training.variants import export_variants
import numpy as np
import pytest
from tiny_training import TINY, train_tiny
from typer.testing import CliRunner

pytestmark = pytest.mark.slow

SHORT = """
seed: 3
field: {voxels: 20_000, steps: 400, rays_per_step: 512}
sampling: {positions: 4}
network: %s
outpaint: {steps: 4, batch: 2, real_centre: 0, validations: 2}
"""


def row(name: str, gflop: float, psnr: float) -> Row:
    return Row(name, 'neo_fast', gflop, 1.0, 1.0, 1, 1.0, psnr, None)


def test_the_front_holds_what_nothing_beats() -> None:
    rows = [row('cheap', 1, 18), row('good', 10, 22), row('beaten', 10, 20), row('mid', 3, 20),
            row('dear', 11, 22), row('twin', 1, 18)]
    marked = {found.name for found in marked_front(rows) if found.on_front}
    assert marked == {'cheap', 'twin', 'good', 'mid'}


def test_test_frames_put_nothing_on_the_front() -> None:
    unseen = replace(row('unseen', 0.5, 0), validation_psnr=None, ring_psnr=40.0)
    assert [found.on_front for found in marked_front([unseen, row('seen', 1, 18)])] == [
        False, True]
    assert not any(found.on_front for found in marked_front([unseen]))


def test_experiments_share_a_field_and_are_not_trained_twice(
        tiny_run: TrainingRun, flat_scene: Path, tmp_path: Path) -> None:
    scene, configs = tiny_run.out.parent / 'scene', tmp_path / 'configs'
    configs.mkdir()
    (configs / 'fast.yaml').write_text(SHORT % '{width: 8, hidden: 32}')
    (configs / 'lama.yaml').write_text(SHORT % '{name: lama, width: 8, depth: 2, blocks: 1}')
    arguments = ['compare', str(scene), str(configs / 'fast.yaml'), str(configs / 'lama.yaml'),
                 '--out', str(tmp_path / 'out'), '--steps', '2']
    result = CliRunner().invoke(app, arguments)
    assert result.exit_code == 0, result.output
    assert 'fast' in result.output and 'lama' in result.output
    rows = json.loads((tmp_path / 'out' / 'comparison.json').read_text())
    assert [(found['name'], found['network'], found['samples']) for found in rows] == [
        ('fast', 'neo_fast', 4), ('lama', 'lama', 4)]
    for found in rows:
        assert found['gflop'] > 0 and found['milliseconds'] > 0 and found['megabytes'] > 0
        assert 3 < found['validation_psnr'] < 30 and 3 < found['ring_psnr'] < 30
    fields = [(tmp_path / 'out' / name / 'field.npz').stat().st_ino for name in ('fast', 'lama')]
    assert fields[0] == fields[1], 'one field, fitted once'
    assert 'Arithmetic and quality' in (tmp_path / 'out' / 'comparison.html').read_text()
    stages: list[str] = []
    again = compare(scene, [configs / 'fast.yaml', configs / 'lama.yaml'], tmp_path / 'out',
                    steps=2, progress=lambda stage, *rest: stages.append(stage))
    assert not stages and [found.name for found in again] == ['fast', 'lama']
    # Scores of other test frames are not taken for those of these.
    note = tmp_path / 'out' / 'fast' / 'row.json'
    note.write_text(json.dumps({**json.loads(note.read_text()), 'frames': 'of another list'}))
    once_more = compare(scene, [configs / 'fast.yaml', configs / 'lama.yaml'], tmp_path / 'out',
                        steps=2, progress=lambda stage, *rest: stages.append(stage))
    assert {'fast: scoring', 'fast: report'} <= set(stages)
    assert not {'fast: field', 'fast: outpainter', 'lama: scoring'} & set(stages)
    assert once_more[0].ring_psnr == again[0].ring_psnr
    for other_scene, steps in ((scene, 3), (flat_scene, 2)):
        with pytest.raises(ConfigError, match='choose another folder'):
            compare(other_scene, [configs / 'fast.yaml'], tmp_path / 'out', steps=steps)


def test_several_training_times_make_a_curve(
        tiny_run: TrainingRun, tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    # Each look at the clock takes a hundredth of a second: how busy the machine is does not count.
    looks = count()
    monkeypatch.setattr(fitting, 'time', SimpleNamespace(monotonic=lambda: 0.01 * next(looks)))
    config, out = tmp_path / 'fast.yaml', tmp_path / 'out'
    config.write_text(SHORT % '{width: 8, hidden: 32}')
    rows = compare(tiny_run.out.parent / 'scene', [config], out, minutes=(0.002, 0.05))
    assert [found.name for found in rows] == ['fast_0.002min', 'fast_0.05min']
    # Seconds are rounded up: one and three, of steps of two samples.
    assert [found.samples for found in rows] == [200, 600]
    page = (out / 'comparison.html').read_text()
    assert 'alt="Training time and quality"' in page


def test_minutes_and_steps_exclude_each_other(tmp_path: Path) -> None:
    with pytest.raises(ConfigError, match='minutes, steps: expected one of both'):
        compare(tmp_path, [tmp_path / 'a.yaml'], tmp_path / 'out', (5.0, 15.0), 100)


def test_files_of_one_name_are_refused(tmp_path: Path) -> None:
    with pytest.raises(ConfigError, match='expected files of different names'):
        compare(tmp_path, [tmp_path / 'a' / 'x.yaml', tmp_path / 'b' / 'x.yaml'], tmp_path / 'o')


def test_a_finished_run_is_exported_in_other_formats(
        tiny_run: TrainingRun, tmp_path: Path) -> None:
    shutil.copytree(tiny_run.out, tmp_path / 'out')
    run = TrainingRun(tiny_run.scene, TINY, tmp_path / 'out', tiny_run.progress)
    variants = {found.name: found for found in export_variants(run, ('fp32', 'int8'))}
    assert list(variants) == ['as trained', 'fp32', 'int8']
    assert variants['int8'].path == tmp_path / 'out' / 'scene.int8.onnx'
    assert variants['int8'].megabytes < 0.7 * variants['fp32'].megabytes
    scores = [found.ring_psnr for found in variants.values()]
    assert np.ptp(scores) < 1 and min(scores) > 5
    cards = {name: read_model_card(found.path) for name, found in variants.items()}
    assert cards['fp32'].parity.share_within_1 >= 0.999
    assert cards['int8'].parity.max_abs_error > cards['fp32'].parity.max_abs_error
    assert cards['int8'].scene_id == 'scene' and (cards['fp32'].gflop or 0) > 0
    # The scores of the model as trained, on the test frames, are not those of its variants.
    lost = {name: max(scores) - found.ring_psnr for name, found in variants.items()}
    for name in ('fp32', 'int8'):
        assert cards[name].scores == pytest.approx({
            'held_out_ring_psnr': variants[name].ring_psnr,
            'held_out_ring_psnr_lost': lost[name]}, abs=1e-4)
    assert 'ring_psnr' in cards['as trained'].scores
    # A memory that is made anew guides all of them.
    train_tiny(tiny_run.out.parent / 'scene', run.out,
               replace(TINY, memory=MemoryConfig(distance=1.5)))
    memory, *others = (read_model_card(found.path).memory for found in variants.values())
    assert memory is not None and memory != cards['int8'].memory and others == [memory] * 2
    assert SceneMemory.read(run.out / 'scene.memory', memory.sha256)


def test_an_fp32_variant_with_a_wrong_confidence_is_refused(
        tiny_run: TrainingRun, tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    shutil.copytree(tiny_run.out, tmp_path / 'out')
    run = TrainingRun(tiny_run.scene, TINY, tmp_path / 'out', tiny_run.progress)
    monkeypatch.setattr(
        variants, 'ExportedFunction',
        lambda network, view, factor: ExportedFunction(network, view, 3 * factor))
    with pytest.raises(ModelError, match='fp32.onnx: expected 99.9 % .* the file was deleted'):
        export_variants(run, ('fp32',))
    assert not (tmp_path / 'out' / 'scene.fp32.onnx').exists()


def test_other_settings_and_unfinished_runs_are_not_exported(
        tiny_run: TrainingRun, tmp_path: Path) -> None:
    other = TrainingRun(tiny_run.scene, replace(TINY, seed=9), tiny_run.out, tiny_run.progress)
    with pytest.raises(ConfigError, match='got a run of'):
        export_variants(other)
    unfinished = TrainingRun(tiny_run.scene, TINY, tmp_path / 'out', tiny_run.progress)
    with pytest.raises(ConfigError, match='got none with outpainter.ckpt and scene.onnx'):
        export_variants(unfinished)
    # Trained anew, and broken off: the model file is still the old one.
    shutil.copytree(tiny_run.out, unfinished.out)
    state = read_checkpoint(unfinished.out / 'outpainter.ckpt')
    state['trainer']['step'] -= 1
    write_checkpoint(unfinished.out / 'outpainter.ckpt', state)
    with pytest.raises(ConfigError, match='finished run, got one that is at .* of'):
        export_variants(unfinished)
    # An update trained it on: it counts anew.
    card = read_model_card(unfinished.model_path)
    write_model_card(unfinished.model_path, replace(card, updates=(
        Update(memory='0' * 64, bag='day', photos=3, at='2026-01-02 03:04:05'),)))
    assert len(export_variants(unfinished, ('fp32',))) == 2
    del state['trainer']['averaged']
    write_checkpoint(unfinished.out / 'outpainter.ckpt', state)
    with pytest.raises(NeoError, match="outpainter.ckpt: expected .*'averaged'.*; delete it"):
        export_variants(unfinished)
