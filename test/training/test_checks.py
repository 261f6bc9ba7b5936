"""What is refused before a training begins: settings, machines, folders of other runs."""
from dataclasses import replace
import json
from pathlib import Path
import sys
from typing import Any

from neo_ros.errors import ConfigError, ModelError, NeoError
from neo_ros.geometry import Intrinsics, ViewExpansion
from neo_ros.pipeline import train
from neo_ros.scenes.pose_sampling import SamplingConfig
from neo_ros.training import checks as training_checks
from neo_ros.training.folder import claim
from neo_ros.training.run import TrainingRun
import pytest
from tiny_training import TINY
import torch


def refuse_weights() -> None:
    raise ModelError('LPIPS weights: go online once')


@pytest.mark.parametrize('changes, message', [
    ({'field': replace(TINY.field, device='cuda')}, 'field.device: cuda needs a GPU'),
    ({'outpaint': replace(TINY.outpaint, device='cuda')},
     'outpaint.device: expected a CUDA device, there is none'),
    ({'outpaint': replace(TINY.outpaint, batch=5)}, 'outpaint.batch: expected a multiple of 2'),
    ({'outpaint': replace(TINY.outpaint, tensorboard=True)},
     'outpaint.tensorboard: the package tensorboard is not installed'),
    ({'outpaint': replace(TINY.outpaint, perceptual=0.1)}, 'LPIPS weights: go online once'),
], ids=['GPU for the field', 'GPU for the network', 'processes', 'tensorboard', 'LPIPS'])
def test_a_machine_that_cannot_train_says_so_at_once(
        tiny_run: TrainingRun, monkeypatch: pytest.MonkeyPatch, changes: dict[str, Any],
        message: str) -> None:
    monkeypatch.setattr(torch.cuda, 'is_available', lambda: False)
    monkeypatch.setattr(training_checks, 'processes', lambda: (0, 2))
    monkeypatch.setattr(training_checks, 'fetch_weights', refuse_weights)
    monkeypatch.setitem(sys.modules, 'torch.utils.tensorboard', None)
    run = TrainingRun(
        tiny_run.scene, replace(TINY, **changes), tiny_run.out, tiny_run.progress)
    with pytest.raises(NeoError, match=message):
        training_checks.check_training(run)


def test_workers_of_a_cluster_get_absolute_paths(
        flat_scene: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    seen = list[TrainingRun]()

    def stop(run: TrainingRun) -> None:
        seen.append(run)
        raise KeyboardInterrupt

    monkeypatch.chdir(flat_scene.parent)
    monkeypatch.setattr('neo_ros.pipeline.check_training', stop)
    with pytest.raises(KeyboardInterrupt):
        train(Path(flat_scene.name), TINY, Path('out'), cluster=True)
    run, = seen
    assert run.out == flat_scene.parent / 'out'
    assert all(path.is_absolute() for path in run.scene.train.image_paths)


def test_a_scene_that_cannot_be_trained_as_asked_says_so_at_once(tiny_run: TrainingRun) -> None:
    far = ViewExpansion.to_size(Intrinsics(32, 32, 20, 20, 16, 16), 64, 64)
    aside = ViewExpansion.to_size(Intrinsics(24, 24, 16, 16, 20, 20), 48, 48)
    cases: list[tuple[dict[str, Any], SamplingConfig, str]] = [
        ({'test': None, 'expansion': far}, TINY.sampling, 'view: expected the focal length'),
        ({'test': None, 'expansion': aside}, replace(TINY.sampling, area='photos'),
         'size of the photos, 32x32 pixels at this scale, got 24x24 from -4, -4 on'),
        ({'walkable': None}, SamplingConfig(area='walkable'), 'walkable needs walkable.json'),
        ({}, SamplingConfig(area='photos', interval=50.0, radius=0.1), 'a smaller interval')]
    for changes, sampling, message in cases:
        with pytest.raises(NeoError, match=message):
            training_checks.check_training(TrainingRun(
                replace(tiny_run.scene, **changes), replace(TINY, sampling=sampling),
                tiny_run.out, tiny_run.progress))


def test_a_scene_whose_name_no_card_can_hold_is_refused_before_the_work(
        tiny_run: TrainingRun) -> None:
    for name in ('my room', 'Küche'):
        training_checks.check_training(replace(
            tiny_run, scene=replace(tiny_run.scene, name=name)))
    with pytest.raises(ConfigError, match='scene: expected a folder whose name has no backslash'):
        training_checks.check_training(replace(
            tiny_run, scene=replace(tiny_run.scene, name='my\nroom')))


@pytest.mark.parametrize('changes, message', [
    ({'train': 'fewer'}, "photos': '[0-9a-f]{12}'.*got a run of"),
    ({'train': 'moved'}, "photos': '[0-9a-f]{12}'.*got a run of"),
    ({'walkable': 'lower'}, "floor': '[0-9a-f]{12}'.*got a run of"),
    ({'walkable': None}, "floor': None.*got a run of"),
], ids=['fewer photos', 'other poses', 'another floor', 'no floor'])
def test_a_folder_of_the_scene_as_it_was_is_refused(
        tiny_run: TrainingRun, changes: dict[str, Any], message: str) -> None:
    scene = tiny_run.scene
    assert scene.walkable is not None
    claim(tiny_run.out, scene, TINY)
    others: dict[Any, Any] = {
        'fewer': scene.train.subset(range(59)),
        'moved': replace(scene.train, poses=scene.train.poses[::-1]),
        'lower': replace(scene.walkable, camera_height=0.5), None: None}
    with pytest.raises(ConfigError, match=message):
        claim(tiny_run.out, replace(
            scene, **{name: others[value] for name, value in changes.items()}), TINY)


def test_a_folder_of_an_older_version_is_taken_when_the_user_says_so(
        tiny_run: TrainingRun, tmp_path: Path) -> None:
    note = tmp_path / 'run.json'
    found = json.loads((tiny_run.out / 'run.json').read_text())
    note.write_text(json.dumps({name: found[name] for name in ('scene', 'settings')}))
    with pytest.raises(ConfigError, match='of an older neo_ros, which did not note') as caught:
        train(tiny_run.out.parent / 'scene', TINY, tmp_path)
    note.write_text(str(caught.value).split('run.json: ')[1])
    claim(tmp_path, tiny_run.scene, TINY)


def test_photos_too_large_for_a_model_file_are_refused_before_the_work(
        tiny_run: TrainingRun, monkeypatch: pytest.MonkeyPatch) -> None:
    view = tiny_run.expansion.target
    monkeypatch.setattr(training_checks, 'MAX_PIXELS', view.width * view.height // 3)
    with pytest.raises(ConfigError, match=f'got {view.width}x{view.height}; write "scale: 0.55"'):
        training_checks.check_training(tiny_run)
    monkeypatch.setattr(training_checks, 'MAX_PIXELS', view.width * view.height)
    training_checks.check_training(tiny_run)
