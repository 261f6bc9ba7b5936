"""The field on a torch device shows, fits and marks what the compiled kernels do."""
import os
from pathlib import Path
import socket
import subprocess
import sys
from typing import Any

from neo_ros.errors import ConfigError
from neo_ros.evaluation.metrics import psnr
from neo_ros.field.config import FieldConfig
from neo_ros.field.device import chosen_device, field_trainer, on_device
from neo_ros.field.fitting import FieldTrainer, FitRules
from neo_ros.field.rendering import render_rays, render_view, to_uint8
from neo_ros.field.torch_field import TorchField
from neo_ros.field.torch_fitting import TorchFieldTrainer
from neo_ros.field.voxel_field import VoxelField
from neo_ros.geometry import Intrinsics
import numpy as np
from plain_field import CENTRE, random_rays, room_field, standing
import pytest
import torch

pytestmark = [pytest.mark.slow, pytest.mark.usefixtures('one_thread')]

CAMERA = Intrinsics.from_hfov(24, 20, 1.6)
POSES = np.stack([standing(0.4 * np.cos(3 * yaw), 0.3 * np.sin(2 * yaw), yaw).T_world_cam
                  for yaw in np.linspace(0, 2 * np.pi, 12, endpoint=False)])
# Every part of the loss.
ALL: dict[str, Any] = {
    'voxels': 8000, 'steps': 40, 'rays_per_step': 512, 'margin': 1.5,
    'sh_degree': 1, 'exposure': True, 'vignetting': True, 'robust': 0.3, 'sharpness': 1.0}
# What is quick to fit, to a picture of the room.
QUICK: dict[str, Any] = {'voxels': 4000, 'steps': 40, 'rays_per_step': 256, 'margin': 1.5,
                         'learning_rate': 0.6}


def room(sh_degree: int = 0) -> VoxelField:
    field = room_field(30_000, sh_degree=sh_degree)
    field = field.resampled(50_000, field.centre, field.half_extent, sparse=True)
    field.grid[:, 1:] += np.random.default_rng(0).normal(0, 0.3, field.grid[:, 1:].shape)
    field.update_occupancy()
    field.seen = (field.world_points()[..., 1] < CENTRE[1]).astype(np.uint8).ravel()
    return field


@pytest.fixture(scope='module')
def photos() -> np.ndarray:
    from neo_ros.geometry import CameraPose
    field = room_field(30_000)
    field.update_occupancy()
    return np.stack([to_uint8(render_view(field, CAMERA, CameraPose(T)).image) for T in POSES])


def decibels(a: np.ndarray, b: np.ndarray) -> float:
    return float(-10 * np.log10(np.mean((a - b) ** 2) + 1e-12))


DEVICES = ['torch', pytest.param('cuda', marks=pytest.mark.skipif(
    not torch.cuda.is_available(), reason='no GPU that torch can use'))]


@pytest.mark.parametrize('device', DEVICES)
@pytest.mark.parametrize('sh_degree', [0, 1, 2])
def test_both_paths_show_the_same(device: str, sh_degree: int) -> None:
    field = room(sh_degree)
    rays = random_rays(1500, 1)
    expected = render_rays(field, *rays)
    placed = on_device(field, device)
    found = render_rays(placed, *rays)
    assert isinstance(placed, TorchField)
    assert placed.grid.device.type == ('cuda' if device == 'cuda' else 'cpu')
    assert decibels(found.image, expected.image) > 90
    assert decibels(found.opacity, expected.opacity) > 90
    assert np.median(np.abs(found.depth - expected.depth)) < 1e-3
    assert np.abs(found.coverage - expected.coverage).mean() < 1e-3
    assert expected.coverage.std() > 0.3 and expected.image.std() > 0.1


def test_rays_through_nothing_show_the_background() -> None:
    field = room()
    field.grid[:, 0] = -8
    field.grid[0, 0] = 40
    field.update_occupancy()
    rendering = render_rays(on_device(field, 'torch'), *random_rays(10, 0))
    np.testing.assert_allclose(rendering.image, 0.5)
    assert not rendering.opacity.any()


def test_both_paths_find_the_same_free_space() -> None:
    field, other = room(), room()
    other.skip = np.zeros_like(other.skip)
    placed = on_device(other, 'torch')
    assert placed.update_occupancy() == pytest.approx(field.update_occupancy())
    np.testing.assert_array_equal(placed.home().skip, field.skip)


def trainers(photos: np.ndarray, rules: FitRules = FitRules(), **settings: Any
             ) -> tuple[FieldTrainer, TorchFieldTrainer]:
    config = FieldConfig(**settings)
    return (FieldTrainer(photos, CAMERA, POSES, config, 0, rules),
            TorchFieldTrainer(photos, CAMERA, POSES, config, 0, 'torch', rules))


def test_both_paths_draw_what_masks_leave() -> None:
    photos = np.random.default_rng(0).integers(0, 256, (len(POSES), CAMERA.height, CAMERA.width,
                                                        3), np.uint8)
    usable = photos[..., 0] > 100
    config = FieldConfig(voxels=2000, steps=10, rays_per_step=128)
    drawn = []
    for fit in (FieldTrainer(photos, CAMERA, POSES, config, 0, usable=usable),
                TorchFieldTrainer(photos, CAMERA, POSES, config, 0, 'torch', usable=usable)):
        fit.random = np.random.default_rng(1)
        drawn.append(fit.sample_rays())
    assert (drawn[0][1][:, 0] * 255 > 100).all()
    for ours, theirs in zip(*drawn):
        np.testing.assert_array_equal(ours, theirs)


def run_to(trainer: FieldTrainer, step: int) -> FieldTrainer:
    while trainer.step < step:
        trainer.train_step()
    return trainer


@pytest.mark.parametrize('fine', [8000, 8001], ids=['fine', 'coarse'])
def test_both_fits_take_the_same_steps(photos: np.ndarray, fine: int) -> None:
    """With every loss, through all refinements of the grid."""
    compiled, torches = trainers(photos, FitRules(fine_voxels=fine), **ALL)
    for step in (1, 5, 12, 18):
        run_to(compiled, step), run_to(torches, step)
        a, b = compiled.state(), torches.state()
        assert a['psnr'] == pytest.approx(b['psnr'], abs=1e-4)
        assert a['shape'] == b['shape']
        np.testing.assert_array_equal(a['updates'], b['updates'])
        # Adam magnifies rounding where a gradient is hardly more than that, step by step.
        close = np.isclose(a['grid'], b['grid'], atol=1e-4 if step == 1 else 2e-3)
        assert close.mean() > (0.9999 if step == 1 else 0.999)
        np.testing.assert_allclose(a['log_gain'], b['log_gain'], atol=1e-5)


def test_both_fits_reach_the_same_score(photos: np.ndarray) -> None:
    fields = [run_to(trainer, 40).finished() for trainer in trainers(photos, **QUICK)]
    truth = room_field(30_000)
    truth.update_occupancy()
    pose = standing(0.2, 0.1, 0.35)
    shown = to_uint8(render_view(truth, CAMERA, pose).image)
    scores = [psnr(shown, to_uint8(render_view(field, CAMERA, pose).image)) for field in fields]
    assert scores[0] > 22
    assert scores[1] == pytest.approx(scores[0], abs=0.3)
    assert (fields[0].seen != fields[1].seen).mean() < 0.01 < fields[0].seen.mean() < 1


def test_a_fit_goes_on_where_another_stopped(photos: np.ndarray) -> None:
    compiled, torches = trainers(photos, **QUICK)
    torches.restore({key: np.copy(value) if isinstance(value, np.ndarray) else value
                     for key, value in run_to(compiled, 8).state().items()})
    run_to(compiled, 10), run_to(torches, 10)
    a, b = compiled.state(), torches.state()
    np.testing.assert_array_equal(a['updates'], b['updates'])
    assert np.isclose(a['grid'], b['grid'], atol=2e-3).mean() > 0.999


@pytest.mark.skipif(not torch.cuda.is_available(), reason='no GPU that torch can use')
def test_a_gpu_reaches_the_score_too(photos: np.ndarray) -> None:
    compiled, _ = trainers(photos, **QUICK)
    gpu = field_trainer(photos, CAMERA, POSES, FieldConfig(**QUICK, device='cuda'), 0)
    run_to(compiled, 40), run_to(gpu, 40)
    assert gpu.psnr == pytest.approx(compiled.psnr, abs=0.3)


def test_the_device_is_chosen_by_the_experiment(
        photos: np.ndarray, monkeypatch: pytest.MonkeyPatch) -> None:
    monkeypatch.setattr(torch.cuda, 'is_available', lambda: False)
    assert [chosen_device(name) for name in ('auto', 'cpu', 'torch')] == ['cpu', 'cpu', 'torch']
    with pytest.raises(ConfigError, match='field.device: cuda needs a GPU'):
        chosen_device('cuda')
    with pytest.raises(ConfigError, match="field.device: expected auto, cpu, .* got 'tpu'"):
        FieldConfig(device='tpu')
    for device, kind in (('cpu', FieldTrainer), ('torch', TorchFieldTrainer)):
        made = field_trainer(photos, CAMERA, POSES, FieldConfig(device=device), 0)
        assert type(made) is kind
    monkeypatch.setattr(torch.cuda, 'is_available', lambda: True)
    assert chosen_device('auto') == 'cuda'


FIT = """
import sys
import numpy as np
import torch
from torch import distributed
torch.set_num_threads(1)
from neo_ros.outpaint.distributed import process_group
from neo_ros.field.device import field_trainer
from neo_ros.field.fitting import FieldConfig, FieldTrainer
from neo_ros.geometry import Intrinsics
data = np.load(sys.argv[1])
config = FieldConfig(voxels=8000, steps=40, rays_per_step=128, margin=1.5, exposure=True,
                     device='torch')
with process_group() as rank:
    # As on GPUs, whose sums have no fixed order: what each finds of the box differs.
    for name in ('content_box', 'empty_distance'):
        setattr(FieldTrainer, name, lambda self, find=getattr(FieldTrainer, name):
                np.add(find(self), 0.1 * rank))
    trainer = field_trainer(data['photos'], Intrinsics.from_hfov(24, 20, 1.6), data['poses'],
                            config, 0)
    for _ in range(10):
        trainer.train_step()
    state = trainer.state()
    np.savez(f'{sys.argv[1]}.{rank}.npz', grid=state['grid'], psnr=state['psnr'],
             updates=state['updates'], log_gain=state['log_gain'], centre=state['centre'],
             half_extent=state['half_extent'], view_near=state['view_near'])
"""


def fitted_by_processes(folder: Path, photos: np.ndarray, count: int
                        ) -> list[dict[str, np.ndarray]]:
    """Fit ten steps in so many processes; return what each of them has then."""
    np.savez(folder / 'data.npz', photos=photos, poses=POSES)
    with socket.socket() as free:
        free.bind(('127.0.0.1', 0))
        port = str(free.getsockname()[1])
    processes = [subprocess.Popen(
        [sys.executable, '-c', FIT, str(folder / 'data.npz')],
        env=os.environ | {'WORLD_SIZE': str(count), 'RANK': str(rank), 'MASTER_PORT': port,
                          'MASTER_ADDR': '127.0.0.1', 'CUDA_VISIBLE_DEVICES': ''},
        cwd=Path(__file__).parents[2], stderr=subprocess.PIPE, text=True)
        for rank in range(count)]
    try:
        errors = [process.communicate(timeout=100)[1] for process in processes]
    finally:
        for process in processes:
            process.kill()
    assert all(process.returncode == 0 for process in processes), errors
    return [dict(np.load(folder / f'data.npz.{rank}.npz')) for rank in range(count)]


def test_two_processes_fit_what_one_fits(photos: np.ndarray, tmp_path: Path) -> None:
    alone = fitted_by_processes(tmp_path, photos, 1)[0]
    first, second = fitted_by_processes(tmp_path, photos, 2)
    for name in ('grid', 'centre', 'half_extent', 'view_near'):
        np.testing.assert_array_equal(first[name], second[name])
    np.testing.assert_array_equal(first['updates'], alone['updates'])
    assert first['psnr'] == pytest.approx(alone['psnr'], abs=1e-4)
    assert np.isclose(first['grid'], alone['grid'], atol=2e-3).mean() > 0.999
    np.testing.assert_allclose(first['log_gain'], alone['log_gain'], atol=1e-5)
