"""What an output folder is a run of, and whose field it may take."""
from dataclasses import replace
import json
from pathlib import Path
import shutil

from box_room import write_box_model
from neo_ros.cli.main import app
from neo_ros.errors import ConfigError, NeoError, SceneError
from neo_ros.field.given_geometry import GivenGeometry
from neo_ros.geometry import ViewExpansion
from neo_ros.pipeline import fit_field_step, train
from neo_ros.scenes.upright import read_upright_scene
from neo_ros.training import time_plan
from neo_ros.training.folder import (
    begin_run, check_run, claim, free_where_refused, RUN_FILE, take_field)
from neo_ros.training.run import TrainingRun
from neo_ros.training.time_plan import plan_training, read_plan
from neo_ros.updating.update_run import UpdateRun
import pytest
from tiny_training import graph_of, TINY
from typer.testing import CliRunner


def test_a_folder_holds_one_run(tiny_run: TrainingRun) -> None:
    scene = tiny_run.out.parent / 'scene'
    before = {path: path.stat().st_mtime_ns for path in tiny_run.out.iterdir()}
    with pytest.raises(ConfigError, match='settings.* got a run of .*choose another'):
        train(scene, replace(TINY, seed=4), tiny_run.out)
    assert {path: path.stat().st_mtime_ns for path in tiny_run.out.iterdir()} == before


def test_a_plan_that_was_refused_is_forgotten(
        tiny_run: TrainingRun, tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    def refuse(run: TrainingRun) -> None:
        raise ConfigError('no GPU')

    monkeypatch.setattr('neo_ros.pipeline.check_training', refuse)
    scene, out = tiny_run.out.parent / 'scene', tmp_path / 'out'
    with pytest.raises(ConfigError, match='no GPU'):
        train(scene, TINY, out, minutes=0.01)
    assert (out / 'plan.json').exists()
    begin_run(out, None)
    assert not (out / 'plan.json').exists()


def test_what_was_refused_before_anything_was_made_leaves_the_folder_free(
        tiny_run: TrainingRun, tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    monkeypatch.setattr(time_plan, '_fitting_rate', lambda *of: 100_000.0)
    scene, out, file = tiny_run.out.parent / 'scene', tmp_path / 'out', tmp_path / 'room.splat'
    file.touch()
    with pytest.raises(ConfigError, match='got one of other field'):
        train(scene, replace(TINY, seed=4), out, field_of=tiny_run.out)
    assert not list(out.iterdir())
    for minutes in (None, 1.0):
        with pytest.raises(SceneError, match='save it as one of them'):
            train(scene, TINY, out, geometry=GivenGeometry(file), minutes=minutes)
        assert not list(out.iterdir())
    # What holds more than the claim stays.
    with pytest.raises(NeoError, match='no'), free_where_refused(tiny_run.out):
        raise NeoError('no')
    assert (tiny_run.out / RUN_FILE).exists()


@pytest.mark.parametrize('minutes', [None, 5.0])
def test_somebody_elses_file_of_the_name_of_a_plan_stays(
        tmp_path: Path, minutes: float | None) -> None:
    (tmp_path / 'plan.json').write_text('{"my": "house"}')
    with pytest.raises(ConfigError, match='plan.json: expected the plan of an earlier run: '):
        begin_run(tmp_path, minutes)
    assert (tmp_path / 'plan.json').read_text() == '{"my": "house"}'


def test_a_run_of_minutes_goes_on_with_them(tiny_run: TrainingRun, tmp_path: Path) -> None:
    scene = read_upright_scene(tiny_run.out.parent / 'scene')
    plan_training(tmp_path, scene, TINY, 2, lambda words: None)
    claim(tmp_path, scene, read_plan(tmp_path).experiment)
    with pytest.raises(ConfigError, match='run of 2 minutes; give --minutes 2 again, or'):
        train(tiny_run.out.parent / 'scene', TINY, tmp_path)
    begin_run(tmp_path, 2)
    assert read_plan(tmp_path).minutes == 2


@pytest.mark.parametrize('name, content, message', [
    ('holiday.jpg', b'', 'expected an empty folder or an earlier run; it holds other files'),
    ('run.json', b'', 'run.json: expected the note of an earlier run'),
    ('run.json', b'[1]', r'run.json: expected the note of an earlier run: got \[1\]'),
], ids=['other files', 'empty note', 'strange note'])
def test_folders_of_other_things_are_refused(
        tiny_run: TrainingRun, tmp_path: Path, name: str, content: bytes, message: str) -> None:
    (tmp_path / name).write_bytes(content)
    with pytest.raises(ConfigError, match=message):
        train(tiny_run.out.parent / 'scene', TINY, tmp_path)


def test_the_field_of_another_run_is_taken_if_it_is_of_the_same(
        tiny_run: TrainingRun, tmp_path: Path) -> None:
    scene, stages = tiny_run.out.parent / 'scene', set()
    slower = replace(TINY, memory=None, outpaint=replace(TINY.outpaint, learning_rate=1e-3))
    run = train(scene, slower, tmp_path / 'slower', lambda stage, *rest: stages.add(stage),
                field_of=tiny_run.out)
    assert 'outpainter' in stages and 'field' not in stages
    assert run.log['field'] == tiny_run.log['field'] and graph_of(run) != graph_of(tiny_run)
    # Without its field it would be another run's network.
    (run.out / 'field.npz').unlink()
    take_field(run.out, run.scene, slower, tiny_run.out)
    assert not (run.out / 'outpainter.ckpt').exists()
    for other, message in ((replace(slower, seed=9), 'got one of other field'),
                           (replace(slower, scale=0.5), 'got one of other field')):
        with pytest.raises(ConfigError, match=message):
            train(scene, other, tmp_path / f'{other.seed} {other.scale}', field_of=tiny_run.out)
    (run.out / 'field.npz').unlink()
    with pytest.raises(ConfigError, match='got one of no finished field'):
        train(scene, slower, tmp_path / 'again', field_of=run.out)
    with pytest.raises(ConfigError, match='run.json: expected the note of an earlier run'):
        train(scene, slower, tmp_path / 'again', field_of=tmp_path)


def test_a_scene_that_was_renamed_is_that_of_its_run(
        flat_scene: Path, tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    out, renamed = tmp_path / 'out', shutil.copytree(flat_scene, tmp_path / 'renamed')
    out.mkdir()
    claim(out, read_upright_scene(flat_scene), TINY)
    model = write_box_model(out).rename(out / 'flat.onnx')
    (out / 'field.npz').touch()
    found = UpdateRun.find(out, renamed, TINY)
    assert found.model == model and found.scene.name == 'flat'
    # The network's settings count where it is trained on, the memory's do not.
    other = replace(TINY, network=replace(TINY.network, width=16), memory=None)
    assert UpdateRun.find(out, renamed, other).model == model
    with pytest.raises(ConfigError, match='one of other settings .*--config'):
        UpdateRun.find(out, renamed, other, tuned=True)
    with pytest.raises(SceneError, match='expected outpainter.ckpt'):
        UpdateRun.find(out, renamed, replace(TINY, memory=None), tuned=True)
    exported = list[Path]()

    def note(run: TrainingRun, threads: int) -> None:
        exported.append(run.model_path)
        raise KeyboardInterrupt

    monkeypatch.setattr('neo_ros.training.time_plan.settings_of', lambda *_: TINY)
    monkeypatch.setattr('neo_ros.training.variants.export_variants', note)
    CliRunner().invoke(app, ['export', str(renamed), '--out', str(out)])
    assert exported == [model]


def test_another_view_of_the_test_frames_is_another_run(
        tiny_run: TrainingRun, tmp_path: Path) -> None:
    scene = shutil.copytree(tiny_run.out.parent / 'scene', tmp_path / 'scene')
    (scene / 'transforms_test.json').unlink()
    train_scene = read_upright_scene(scene)
    claim(tiny_run.out, train_scene, TINY)  # By default the view is the same without them.
    narrower = TINY.expansion(train_scene.train.intrinsics, None)
    with pytest.raises(ConfigError, match=r'32x32 at 8, 16 in 48x64.* got a run of .*in 64x64'):
        claim(tiny_run.out, replace(train_scene, expansion=ViewExpansion.to_size(
            narrower.source, 48, 64)), TINY)


def test_a_new_field_is_not_mixed_with_what_the_old_one_made(
        tiny_run: TrainingRun, tmp_path: Path) -> None:
    run = replace(tiny_run, out=shutil.copytree(tiny_run.out, tmp_path / 'out'))
    (run.out / 'panoramas_3').mkdir()
    for made in ('keyframes_0.3', 'stereo'):
        (run.out / 'memory_work' / made).mkdir(parents=True)
        (run.out / 'memory_work' / made / '000000').touch()
    for name in ('field.npz', 'field.json'):
        (run.out / name).unlink()
    fit_field_step(run)
    assert (run.out / 'field.npz').exists()
    for name in ('outpainter.ckpt', 'memory.json', 'panoramas_3',
                 'memory_work/keyframes_0.3', 'field.ckpt'):
        assert not (run.out / name).exists()
    # What the photos tell without a field: a training that is stopped before its field begins
    # does not look for it again.
    assert (run.out / 'memory_work/stereo/000000').exists()


def test_retouched_photos_are_others(tiny_run: TrainingRun, tmp_path: Path) -> None:
    folder = shutil.copytree(tiny_run.out.parent / 'scene', tmp_path / 'scene')
    out = tmp_path / 'out'
    out.mkdir()
    claim(out, read_upright_scene(folder), TINY)
    claim(out, read_upright_scene(folder), TINY)
    photo = read_upright_scene(folder).train.image_paths[3]
    shutil.copyfile(read_upright_scene(folder).train.image_paths[4], photo)
    with pytest.raises(ConfigError, match="files': '[0-9a-f]{12}'.*got a run of"):
        claim(out, read_upright_scene(folder), TINY)
    with pytest.raises(ConfigError, match='got one of other files'):
        take_field(out, read_upright_scene(folder), TINY, tiny_run.out)
    with pytest.raises(ConfigError, match='it is one of other files .*--scene'):
        check_run(out, read_upright_scene(folder), TINY)
    note = json.loads((out / RUN_FILE).read_text())
    del note['files']  # As an older neo_ros wrote it.
    (out / RUN_FILE).write_text(json.dumps(note))
    check_run(out, read_upright_scene(folder), TINY)
