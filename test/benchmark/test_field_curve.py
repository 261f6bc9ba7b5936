"""Quality of the field over training time, and the public field beside it."""
from dataclasses import replace
from functools import partial
from importlib.util import find_spec
import json
import shutil
from typing import Any

from neo_ros.benchmark import field_curve
from neo_ros.benchmark.field_curve import measure_field_curve
from neo_ros.cli.main import app
from neo_ros.errors import ConfigError
from neo_ros.evaluation.metrics import score_frame
from neo_ros.experiment import experiment_from
from neo_ros.field import device
from neo_ros.field.fitting import FitRules
from neo_ros.flat.demo_flat import build_demo_flat
from neo_ros.machine.progress import no_stage_progress
from neo_ros.pictures.usable import write_usable
from neo_ros.scenes.scene import read_scene
from neo_ros.training.run import TrainingRun
import numpy as np
import pytest
from typer.testing import CliRunner

pytestmark = pytest.mark.slow

EXPERIMENT = experiment_from({'field': {'voxels': 20_000, 'rays_per_step': 512}}, 'test')


@pytest.fixture(autouse=True)
def short(monkeypatch):
    """Leave out LPIPS, whose weights are a download, and most steps."""
    monkeypatch.setattr(device, 'FitRules', partial(FitRules, least_steps=200))
    monkeypatch.setattr(field_curve, 'load_scorers', lambda progress: {'psnr': score_frame})


def measure(scene, minutes, out, monkeypatch, rival=False, experiment=EXPERIMENT):
    monkeypatch.setattr(field_curve, 'find_spec', lambda name: True if rival else None)
    seen = []
    table = measure_field_curve(scene, experiment, 'full', minutes, 3, out,
                                lambda stage, done, total, note='': seen.append(stage))
    return table, set(seen)


def fit_grey(run, seconds, stage):
    """Stand in for a training: a field that is grey everywhere."""
    run.progress(stage, 1, 1, '')
    return (lambda view, pose: np.full((view.height, view.width, 3), 0.5),
            {'steps': 1, 'minutes': seconds / 60})


def test_longer_trainings_are_better_and_none_is_measured_twice(flat_scene, tmp_path, monkeypatch):
    out = tmp_path / 'results/curve.json'
    _, seen = measure(flat_scene, (0.002,), out, monkeypatch)
    assert {'flat, neo_ros, 0.002 min', 'flat, neo_ros, 0.002 min: views'} <= seen
    table, seen = measure(flat_scene, (0.002, 0.3), out, monkeypatch)
    assert 'flat, neo_ros, 0.002 min' not in seen
    short, long = json.loads(out.read_text())
    assert (short['scene'], short['scale'], short['implementation']) == (
        'flat', 'full', 'neo_ros')
    assert short['steps'] == 200 < long['steps']
    # The first fit of all compiles its kernels, and may take longer for that.
    assert short['minutes'] > 0 and long['minutes'] >= 0.3
    # What it was fitted to looks the other way than the test frames: only those must gain.
    assert long['whole_psnr'] > short['whole_psnr'] + 0.5
    assert 0.3 < long['held_out_ssim'] < 1
    assert long['held_out_psnr'] > 15 and long['ring_psnr'] > 10
    assert table.count('| flat | neo_ros |') == 2
    assert f'{long["whole_psnr"]:.2f}' in table


def test_other_settings_or_photos_are_measured_anew(flat_scene, tmp_path, monkeypatch):
    monkeypatch.setattr(field_curve, 'fit_own', fit_grey)
    shutil.copytree(flat_scene, tmp_path / 'flat')
    scene, out = tmp_path / 'flat', tmp_path / 'curve.json'
    stage = 'flat, neo_ros, 1 min'

    def is_fitted(experiment=EXPERIMENT):
        return stage in measure(scene, (1.0,), out, monkeypatch, experiment=experiment)[1]

    assert is_fitted() and not is_fitted()
    assert is_fitted(replace(EXPERIMENT, seed=7)) and not is_fitted()
    with monkeypatch.context() as elsewhere:
        elsewhere.setattr(field_curve, 'host', lambda: 'another machine')
        assert is_fitted() and not is_fitted()
    assert not is_fitted()
    photos = sorted((scene / 'train').glob('*'))
    photos[0].write_bytes(photos[1].read_bytes())
    assert is_fitted() and not is_fitted()
    assert len(json.loads(out.read_text())) == 4


def test_on_a_gpu_the_rival_on_the_cpu_is_left_out(flat_scene, tmp_path, monkeypatch):
    monkeypatch.setattr(field_curve, 'fit_own', fit_grey)
    monkeypatch.setattr(field_curve, 'chosen_device', lambda name: 'cuda')
    _, seen = measure(flat_scene, (1.0,), tmp_path / 'curve.json', monkeypatch, rival=True)
    assert 'without nerfacto' in seen and 'flat, neo_ros, 1 min' in seen
    assert len(json.loads((tmp_path / 'curve.json').read_text())) == 1


@pytest.mark.skipif(find_spec('nerfstudio') is None, reason='nerfstudio is not installed')
def test_nerfacto_learns_the_same_photos(flat_scene, tmp_path, monkeypatch):
    out = tmp_path / 'curve.json'
    measure(flat_scene, (0.3,), out, monkeypatch, rival=True)
    rows = {row['implementation']: row for row in json.loads(out.read_text())}
    assert rows['nerfacto']['steps'] > 3
    assert rows['neo_ros']['minutes'] <= rows['nerfacto']['minutes']
    assert rows['nerfacto']['minutes'] < rows['neo_ros']['minutes'] + 0.2
    assert rows['nerfacto']['held_out_psnr'] > 12


def test_the_exposure_of_the_observed_window_is_taken_out():
    shown = np.full((8, 8, 3), 100.0)
    observed = np.full((4, 4, 3), 120.0)
    assert (field_curve._gained(shown, shown[2:6, 2:6], observed, None) == 120).all()
    usable = np.ones((4, 4), bool)
    usable[:3] = False
    observed[:3] = 200
    assert (field_curve._gained(shown, shown[2:6, 2:6], observed, usable) == 120).all()


def test_masks_leave_pixels_out_of_the_scores_of_held_out_photos_and_test_frames(
        flat_scene, tmp_path):
    scene = read_scene(flat_scene)
    assert scene.test is not None
    plain = TrainingRun(scene, EXPERIMENT, tmp_path, no_stage_progress)
    masked: dict[str, Any] = {}
    for name, images in (('train', scene.train), ('test', scene.test)):
        size = images.intrinsics
        usable = np.ones((size.height, size.width), bool)
        usable[size.height // 2:] = False
        write_usable(tmp_path / f'{name}.png', usable)
        masked[name] = replace(images, mask_paths=(tmp_path / f'{name}.png',) * len(images))
    run = TrainingRun(replace(scene, **masked), EXPERIMENT, tmp_path, no_stage_progress)

    def render(view, pose):
        """Show the truth above, a stranger below: what masks take out."""
        image = build_demo_flat().render(view, pose)[0] / 255
        image[view.height // 2:] = 0.9
        return image

    scores = [field_curve.score(one, render, 2, [score_frame], 'x') for one in (plain, run)]
    assert scores[1]['ring_psnr'] > 35 and scores[1]['held_out_psnr'] > 35
    assert scores[0]['ring_psnr'] < 20 and scores[0]['held_out_psnr'] < 20


def test_the_command_names_a_wrong_scale(flat_scene):
    result = CliRunner().invoke(app, ['field-curve', str(flat_scene), '--scale', 'tenth'])
    assert isinstance(result.exception, ConfigError)
    assert 'expected full, half, quarter' in str(result.exception)
