"""The three steps end to end, small: what a training leaves behind, and how it goes on."""
from dataclasses import replace
import hashlib
import json
import os
from pathlib import Path
import re
import shutil
import signal
import subprocess
import sys
from typing import Any

import cv2
import neo_ros
from neo_ros import pipeline
from neo_ros.baking.keyframes import MemoryConfig
from neo_ros.errors import ConfigError, ModelError, NeoError, SceneError
from neo_ros.evaluation.evaluate import TruthFrames
from neo_ros.experiment import Experiment, ViewConfig
from neo_ros.field.config import FIT_NEAR
from neo_ros.field.device import read_field
from neo_ros.field.voxel_field import VoxelField
from neo_ros.memory import scene_memory
from neo_ros.outpaint.network import NetworkConfig
from neo_ros.pictures.usable import write_usable
from neo_ros.pipeline import train
from neo_ros.runtime import FovExtrapolator
from neo_ros.scenes.pose_sampling import SamplingConfig
from neo_ros.scenes.scene import read_scene
from neo_ros.training import checkpoint, views as training_views
from neo_ros.training.checkpoint import read_checkpoint
from neo_ros.training.report import _exposed, _oracle, Scoring
from neo_ros.training.run import TrainingRun
import numpy as np
import pytest
from tiny_training import graph_of, TINY, train_tiny


def test_the_model_loads_with_a_complete_card(tiny_run: TrainingRun) -> None:
    extrapolator = FovExtrapolator.load(tiny_run.model_path)
    card = extrapolator.card
    assert (card.scene_id, card.config_hash) == ('scene', TINY.config_hash)
    assert card.neo_ros_version == neo_ros.__version__ and card.network == 'neo_fast'
    assert card.gflop is not None and 0.001 < card.gflop < 1
    assert np.degrees(card.expansion.source.hfov) == pytest.approx(90)
    assert np.degrees(card.expansion.target.hfov) == pytest.approx(126.87, abs=0.01)
    assert card.parity.share_within_1 >= 0.999 and card.parity.max_abs_error <= 2
    assert 1 < card.trained_seconds < 600
    assert {'ring_psnr', 'ring_ssim', 'whole_psnr', 'whole_ssim'} <= card.scores.keys()
    assert card.scores['ring_psnr'] == pytest.approx(tiny_run.figures['ring_psnr'], abs=1e-3)


def test_the_scene_memory_belongs_to_the_card(tiny_run: TrainingRun) -> None:
    memory = FovExtrapolator.load(tiny_run.model_path).card.memory
    assert memory is not None and memory.file == 'scene.memory'
    content = (tiny_run.out / memory.file).read_bytes()
    assert hashlib.sha256(content).hexdigest() == memory.sha256


def test_the_model_widens_test_frames(tiny_run: TrainingRun) -> None:
    extrapolator = FovExtrapolator.load(tiny_run.model_path)
    test = tiny_run.scene.test
    assert test is not None
    narrow = tiny_run.expansion.crop(test.read_image(0))
    view = extrapolator.expand(narrow)
    assert view.wide_image.shape == (64, 64, 3)
    np.testing.assert_array_equal(tiny_run.expansion.crop(view.wide_image), narrow)


def test_the_figures_are_those_of_a_training_that_works(tiny_run: TrainingRun) -> None:
    figures = tiny_run.figures
    assert set(figures) == {'field_psnr', 'from_photo_psnr', 'from_rendering_psnr',
                            'oracle_whole_psnr', 'oracle_ring_psnr', 'ring_psnr'}
    # What it learnt of renderings holds for photos.
    assert figures['from_photo_psnr'] > figures['from_rendering_psnr'] - 1.5 > 8
    assert figures['field_psnr'] > 17 and figures['oracle_ring_psnr'] > 15
    assert figures['ring_psnr'] > 11
    steps, seconds, psnr = np.array(tiny_run.log['field']).T
    assert steps[-1] == 400 and (np.diff(seconds) >= 0).all() and psnr[-1] > psnr[0] + 5
    assert tiny_run.log['outpainter'][-1][0] == 20
    validation = np.array(tiny_run.log['validation'])
    assert validation[-1, 0] == 20 and 5 < validation[-1, 2] < 30


def test_report_and_scores_hold_pictures_and_rows(tiny_run: TrainingRun) -> None:
    html = (tiny_run.out / 'report.html').read_text()
    pictures = re.findall(r'data:image/(?:png|jpeg);base64,[A-Za-z0-9+/=]{200,}', html)
    assert len(pictures) >= 6
    for figure in tiny_run.figures.values():
        assert f'{figure:.2f} dB' in html
    scores = json.loads((tiny_run.out / 'scores.json').read_text())
    assert scores['figures'] == pytest.approx(tiny_run.figures)
    assert [row['method'] for row in scores['rows']] == [
        'guided', 'neo_fast', 'edge_replication', 'mean_image']
    assert all(row['n_frames'] == 6 and row['ring_psnr'] > 5 for row in scores['rows'])
    assert len(scores['methods'][0]['frames']) == 6
    assert 0 < scores['confidence']['expected_calibration_error'] < 60
    assert 0 < scores['confidence']['sparsification_error'] < 1
    assert scores['guided_confidence'].keys() == scores['confidence'].keys()
    assert 'Of the model with its scene memory; in the ring of 6 test frames.' in html
    assert 'Is the confidence true?' in html and 'photos held out' in html


def test_the_folder_holds_no_leftovers(tiny_run: TrainingRun) -> None:
    assert {path.name for path in tiny_run.out.iterdir()} == {
        'run.json', 'field.npz', 'field.json', 'outpainter.ckpt', 'scene.onnx', 'report.html',
        'scores.json', 'poses.json', 'poses.png', 'scene.memory',
        'memory.json'}
    assert (VoxelField.load(tiny_run.out / 'field.npz').seen == 0).any()


def test_held_out_photos_are_not_fitted(tiny_run: TrainingRun) -> None:
    assert tiny_run.held_out is not None
    assert len(tiny_run.held_out) == 2 and len(tiny_run.fitted) == 58
    assert not set(tiny_run.held_out.image_paths) & set(tiny_run.fitted.image_paths)


class Killed(Exception):
    """What ends a training in the middle."""


KILL_HARD = """
import os, signal, sys
from pathlib import Path
from neo_ros.training import checkpoint, views as training_views
from tiny_training import train_tiny

def kill(stage, done, total, note=''):
    if stage == 'outpainter':
        checkpoint.CHECKPOINT_SECONDS = 0.0
        if done == 12:
            os.kill(os.getpid(), signal.SIGKILL)

train_tiny(Path(sys.argv[1]), Path(sys.argv[2]), progress=kill)
"""


def test_a_killed_training_goes_on_to_the_same_model(
        tiny_run: TrainingRun, tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    scene, out = tiny_run.out.parent / 'scene', tmp_path / 'out'

    def kill(stage: str, done: int, total: int, note: str = '') -> None:
        if stage == 'field' and done >= 120:
            monkeypatch.setattr(checkpoint, 'CHECKPOINT_SECONDS', 0.0)
            if done == 130:
                raise Killed

    with pytest.raises(Killed):
        train_tiny(scene, out, progress=kill)
    monkeypatch.undo()
    # The checkpoint of a step is written after its progress was shown.
    assert read_checkpoint(out / 'field.ckpt')['trainer']['step'] == 129
    paths = [str(Path(__file__).parent / 'helpers'), str(Path(neo_ros.__file__).parent.parent)]
    killed = subprocess.run(
        [sys.executable, '-c', KILL_HARD, str(scene), str(out)], capture_output=True, text=True,
        env={**os.environ, 'PYTHONPATH': os.pathsep.join(paths)}, timeout=100)
    assert killed.returncode == -signal.SIGKILL, killed.stderr
    assert not (out / 'field.ckpt').exists()
    assert read_checkpoint(out / 'outpainter.ckpt')['trainer']['step'] == 11
    stages: list[str] = []
    resumed = train_tiny(scene, out, progress=lambda stage, *rest: stages.append(stage))
    assert stages.count('outpainter') == 20 - 11 and 'field' not in stages
    fields = [VoxelField.load(run.out / 'field.npz') for run in (tiny_run, resumed)]
    np.testing.assert_array_equal(fields[0].grid, fields[1].grid)
    np.testing.assert_array_equal(fields[0].seen, fields[1].seen)
    assert graph_of(resumed) == graph_of(tiny_run)
    assert resumed.figures == tiny_run.figures
    assert [step for step, *_ in resumed.log['field']] == [
        step for step, *_ in tiny_run.log['field']]
    assert resumed.seconds > 0


def test_panoramas_in_files_make_the_same_model(tiny_run: TrainingRun, tmp_path: Path) -> None:
    scene, out = tiny_run.out.parent / 'scene', tmp_path / 'out'
    # The network is what is compared: the field is there, and no memory is made.
    run = train(scene, replace(TINY, memory=None), out, cache_gb=1.0, field_of=tiny_run.out)
    kept = list(out.glob('panoramas_*/*.npy'))
    assert len(kept) == 8
    assert graph_of(run) == graph_of(tiny_run)


@pytest.mark.parametrize('cache_gb', [-1.0, float('nan')])
def test_no_room_for_panoramas_is_refused(
        flat_scene: Path, tmp_path: Path, cache_gb: float) -> None:
    with pytest.raises(ConfigError, match='--cache-gb: expected GB, 0 or more, got'):
        train_tiny(flat_scene, tmp_path / 'out', cache_gb=cache_gb)


def test_a_finished_training_is_not_trained_again(
        tiny_run: TrainingRun, tmp_path: Path) -> None:
    shutil.copytree(tiny_run.out, tmp_path / 'out')
    (tmp_path / 'out' / 'field.ckpt').touch()  # Killed after the field was written.
    stages: set[str] = set()
    again = train_tiny(tiny_run.out.parent / 'scene', tmp_path / 'out',
                       progress=lambda stage, *rest: stages.add(stage))
    assert stages == {'export', 'scoring', 'report', 'field on held-out photos',
                      'network on held-out photos', 'field at the true poses'}
    assert again.figures == tiny_run.figures and again.seconds == tiny_run.seconds
    assert not (tmp_path / 'out' / 'field.ckpt').exists()


def test_photos_alone_are_enough(tiny_run: TrainingRun, tmp_path: Path) -> None:
    scene = tmp_path / 'photos'
    shutil.copytree(tiny_run.out.parent / 'scene', scene)
    for name in ('transforms_test.json', 'walkable.json'):
        (scene / name).unlink()
    experiment = replace(
        TINY, field=replace(TINY.field, steps=200), view=ViewConfig((16, 32), (32, 32)),
        network=NetworkConfig(patch=4, width=4, depth=2, hidden=8),
        outpaint=replace(TINY.outpaint, steps=2),
        sampling=replace(TINY.sampling, interval=0.2))
    run = train_tiny(scene, tmp_path / 'out', experiment)
    assert set(run.figures) == {'field_psnr', 'from_photo_psnr', 'from_rendering_psnr'}
    assert not (run.out / 'scores.json').exists()
    assert 'Photos that the field was not shown' in (run.out / 'report.html').read_text()
    card = FovExtrapolator.load(run.model_path).card
    assert card.scores == {} and card.parity.share_within_1 >= 0.999
    assert (card.expansion.left, card.expansion.top) == (8, 0)


@pytest.mark.parametrize('changes, error, message', [
    ({'view': ViewConfig((64, 64), (128, 128))}, ConfigError,
     'view.source: expected at most the size of the photos, 32x32 pixels .* got 64x64'),
    ({'scale': 0.0625}, ConfigError, 'network: expected multiples of 16 pixels'),
    ({'network': NetworkConfig(patch=5)}, ConfigError, 'network: expected multiples of 10'),
    ({'view': ViewConfig((32, 32), (96, 96))}, SceneError,
     'test frames: expected the wide view of the model, 96x96'),
    ({'network': NetworkConfig(name='mat', width=48)}, ConfigError,
     'network.width: mat expects a multiple of 32, got 48'),
    ({'sampling': SamplingConfig(robot_radius=50)}, SceneError, 'sampling.robot_radius: expected'),
], ids=['photos smaller than the view', 'scale', 'patch', 'test frames of another view',
        'mat', 'no room for the robot'])
def test_settings_that_cannot_end_well_are_refused_at_once(
        tiny_run: TrainingRun, tmp_path: Path, changes: dict[str, Any],
        error: type[NeoError], message: str) -> None:
    with pytest.raises(error, match=message):
        train(tiny_run.out.parent / 'scene', replace(TINY, **changes), tmp_path / 'out')
    # The folder stays free for the mended settings.
    assert not (tmp_path / 'out').exists()


def test_a_folder_of_another_scene_is_refused(tiny_run: TrainingRun, tmp_path: Path) -> None:
    shutil.copytree(tiny_run.out.parent / 'scene', tmp_path / 'kitchen')
    with pytest.raises(ConfigError, match="a run of .*'kitchen'.* got a run of .*'scene'"):
        train(tmp_path / 'kitchen', TINY, tiny_run.out)


def test_missing_notes_of_a_field_say_what_to_do(tiny_run: TrainingRun, tmp_path: Path) -> None:
    shutil.copytree(tiny_run.out, tmp_path / 'out')
    (tmp_path / 'out' / 'field.json').unlink()
    with pytest.raises(SceneError, match='field.json: .*delete field.npz to do this step again'):
        train(tiny_run.out.parent / 'scene', TINY, tmp_path / 'out')


def test_without_a_floor_map_cameras_stay_near_the_photos(tiny_run: TrainingRun) -> None:
    scene, field = tiny_run.scene, VoxelField.load(tiny_run.out / 'field.npz')
    on_floor = training_views.make_sampler(tiny_run, field)
    assert scene.walkable is not None and scene.walkable.contains(on_floor.positions_xy).all()
    run = TrainingRun(replace(scene, walkable=None), Experiment(), tiny_run.out,
                      tiny_run.progress)
    places = training_views.make_sampler(run, field).positions_xy
    near = places[:, None] - scene.train.T_world_cam[:, :2, 3]
    assert np.linalg.norm(near, axis=-1).min(1).max() <= Experiment().sampling.radius


def test_the_field_is_fitted_as_the_floor_map_asks(tiny_run: TrainingRun) -> None:
    assert tiny_run.field_config.near == FIT_NEAR
    run = TrainingRun(replace(tiny_run.scene, walkable=None), Experiment(), tiny_run.out,
                      tiny_run.progress)
    assert run.field_config.near is None and run.sampling_area == 'photos'


@pytest.mark.parametrize('area', ['walkable', 'free_space'])
def test_the_area_is_the_one_asked_for(tiny_run: TrainingRun, area: Any) -> None:
    field = VoxelField.load(tiny_run.out / 'field.npz')
    run = TrainingRun(replace(tiny_run.scene, walkable=None),
                      replace(TINY, sampling=SamplingConfig(area=area)), tiny_run.out,
                      tiny_run.progress)
    if area == 'walkable':
        with pytest.raises(ConfigError, match='walkable needs walkable.json .* neo floor'):
            training_views.make_sampler(run, field)
    else:
        sampler, walkable = training_views.make_sampler(run, field), tiny_run.scene.walkable
        assert sampler.yaws == 72 and len(sampler.positions_xy) > 100
        assert walkable is not None and walkable.contains(sampler.positions_xy).mean() > 0.5


def test_parity_is_measured_on_held_out_photos(tiny_run: TrainingRun) -> None:
    frames = pipeline.real_frames(tiny_run, 8)
    assert frames.shape == (2, 32, 32, 3) and tiny_run.held_out is not None
    np.testing.assert_array_equal(frames[1], tiny_run.held_out.read_image(1))
    photos = read_scene(tiny_run.out.parent / 'scene').train
    assert not any((frames[1] == photos.read_image(i)).all() for i in range(3))


def test_another_memory_needs_no_other_training(
        tiny_run: TrainingRun, tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    scene, out = tiny_run.out.parent / 'scene', tmp_path / 'out'
    shutil.copytree(tiny_run.out, out)
    before = FovExtrapolator.load(tiny_run.model_path).card
    wider = replace(TINY, memory=MemoryConfig(distance=1.5))
    monkeypatch.setattr(scene_memory, 'MOST_BYTES', 1000)
    with pytest.raises(ModelError, match='at most 0 MB, got .* set memory.distance to more'):
        train_tiny(scene, out, wider)
    monkeypatch.undo()
    # The model is there and works alone.
    assert FovExtrapolator.load(out / 'scene.onnx').card.memory is None
    assert before.memory is not None
    stages: set[str] = set()
    run = train_tiny(scene, out, wider, lambda stage, *rest: stages.add(stage))
    assert {'keyframes'} <= stages and not {'field', 'outpainter'} & stages
    card = FovExtrapolator.load(run.model_path).card
    assert card.memory is not None and card.memory.sha256 != before.memory.sha256
    assert card.config_hash == wider.config_hash
    smaller, larger = (folder / 'scene.memory' for folder in (out, tiny_run.out))
    assert smaller.stat().st_size < larger.stat().st_size
    assert not (out / 'memory_work').exists()


def test_renderings_are_compared_at_the_exposure_of_the_photo() -> None:
    rendered = np.full((4, 6, 3), 0.25)
    rendered[:, 3:] = 0.5
    dark = np.full((4, 3, 3), 32, np.uint8)  # of the left half
    usable = np.ones((4, 3), bool)
    np.testing.assert_array_equal(_exposed(rendered, rendered[:, :3], dark, usable)[0, :, 0],
                                  [32] * 3 + [64] * 3)
    dark[:3], usable[:3] = 255, False  # The robot itself is in most of it.
    np.testing.assert_array_equal(_exposed(rendered, rendered[:, :3], dark, usable)[0, :, 0],
                                  [32] * 3 + [64] * 3)


def test_upper_bounds_leave_out_what_masks_do(tiny_run: TrainingRun, tmp_path: Path) -> None:
    field, test = read_field(tiny_run.out / 'field.npz', 'cpu'), tiny_run.scene.test
    assert test is not None
    size = (test.intrinsics.height, test.intrinsics.width)
    usable = np.ones(size, bool)
    usable[:, :size[1] // 3] = False  # The robot's own arm, bright.
    write_usable(tmp_path / 'mask.png', usable)
    paths = []
    for index in range(len(test)):
        image = test.read_image(index)
        image[~usable] = 255
        paths.append(tmp_path / f'{index}.png')
        cv2.imwrite(str(paths[-1]), image[..., ::-1])
    arm = replace(test, image_paths=tuple(paths))
    masked = replace(arm, mask_paths=(tmp_path / 'mask.png',) * len(test))
    plain, wrong, right = (_oracle(field, Scoring(TruthFrames(images, tiny_run.expansion), []))
                           for images in (test, arm, masked))
    for one, other, bound in zip(plain, wrong, right):
        assert other < bound - 2 and abs(bound - one) < 2
