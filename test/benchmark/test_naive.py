"""B1 is as strong as its idea allows: the best weights, no longer than they get better."""
from types import SimpleNamespace
from typing import Any

from neo_ros.benchmark import naive
from neo_ros.benchmark.naive import as_wide, NaiveRules, ResizedPhotos, train_naive
from neo_ros.errors import ConfigError, NeoError
from neo_ros.geometry import Intrinsics, ViewExpansion
from neo_ros.outpaint.fitting import OutpaintConfig
from neo_ros.outpaint.network import NetworkConfig
from neo_ros.training import checkpoint
from neo_ros.training.checkpoint import read_checkpoint, write_checkpoint
from neo_ros.training.run import HoldOutRules
import numpy as np
import pytest
import torch

pytestmark = pytest.mark.slow

RAMP = np.dstack([np.broadcast_to(np.arange(40), (20, 40))] * 3).astype(np.uint8)
EXPANSION = ViewExpansion.to_size(Intrinsics.from_hfov(16, 16, 1.5), 32, 32)


class Photos:
    """Photos of 20x40 pixels, each of the grey of its number."""

    def __init__(self, count):
        self.count = count

    def __len__(self):
        return self.count

    def read_shown(self, index):
        return np.full((20, 40, 3), index, np.uint8), np.ones((20, 40), bool)


class Trainer:
    """Stand in for a training: step k leaves the weight k and scores `SCORES[k - 1]`."""

    scores: list[float] = []
    batch_size = 2

    def __init__(self, expansion, network, config, seed, held_out):
        self.step, self.seconds, self.validation = 0, 0.0, []
        self.averaged = torch.nn.Linear(1, 1, bias=False)

    @property
    def done(self):
        return self.step, len(self.scores)

    def train_step(self, batch):
        assert batch.shape == (2, 32, 32, 4)
        self.step += 1
        self.seconds += 100.0
        torch.nn.init.constant_(self.averaged.weight, self.step)
        self.validation.append([self.step, self.seconds, self.scores[self.step - 1]])

    @property
    def figure(self):
        return self.scores[self.step - 1]

    def note(self):
        return ''

    def state(self):
        return {'step': self.step, 'validation': self.validation}

    def restore(self, state):
        self.step, self.validation = state['step'], state['validation']


@pytest.fixture
def run(tmp_path, monkeypatch):
    monkeypatch.setattr(naive, 'OutpaintTrainer', Trainer)
    result = SimpleNamespace(
        held_out=Photos(2), fitted=Photos(5), scene=SimpleNamespace(name='room', train=Photos(7)),
        network_expansion=EXPANSION, out=tmp_path, hold_out=HoldOutRules(), seconds=0.0, log={},
        exported=[],
        progress=lambda *told: None,
        experiment=SimpleNamespace(network=NetworkConfig(), outpaint=OutpaintConfig(), seed=0))
    monkeypatch.setattr(naive, 'export_step', lambda run, network: result.exported.append(
        float(network.weight.detach())))
    return result


RULES = NaiveRules()
RISES, FALLS = [10.0, 12, 14], [13.0] * (RULES.patience + 5)


def test_the_best_weights_are_exported_soon_after_them(run, monkeypatch):
    monkeypatch.setattr(Trainer, 'scores', RISES + FALLS)
    steps = []
    run.progress = lambda stage, done, total, note: steps.append(done)
    train_naive(run)
    assert run.exported == [3.0] and steps[-1] == 3 + RULES.patience


def test_a_training_that_still_gets_better_goes_on_to_its_end(run, monkeypatch):
    monkeypatch.setattr(Trainer, 'scores', list(np.arange(30.0)))
    train_naive(run)
    assert run.exported == [30.0]


@pytest.mark.parametrize('log', [True, False], ids=['as today', 'of before, without a log'])
def test_a_broken_training_remembers_its_best(run, monkeypatch, log):
    monkeypatch.setattr(Trainer, 'scores', RISES + FALLS)
    monkeypatch.setattr(checkpoint, 'CHECKPOINT_SECONDS', -1.0)

    def stop(stage, done, total, note):
        if done == 5:
            raise KeyboardInterrupt

    run.progress = stop
    with pytest.raises(KeyboardInterrupt):
        train_naive(run)
    state = read_checkpoint(run.out / 'naive.ckpt')
    if not log:
        del state['log']
        write_checkpoint(run.out / 'naive.ckpt', state)
    assert state['best']['at'] == 3
    steps = []
    run.progress = lambda stage, done, total, note: steps.append(done)
    train_naive(run)
    assert run.exported == [3.0] and steps == list(range(5, 3 + RULES.patience + 1))


def test_a_checkpoint_of_something_else_is_named(run):
    torch.save({'trainer': {'step': 1}}, run.out / 'naive.ckpt')
    with pytest.raises(NeoError, match='naive.ckpt: expected a checkpoint .*delete it'):
        train_naive(run)


def test_without_photos_to_validate_on_there_is_no_b1(run):
    run.held_out = None
    with pytest.raises(ConfigError, match='expected at least 13 photos.*leave naive out'):
        train_naive(run)


def test_photos_become_wide_views_of_their_middle():
    photos: Any = SimpleNamespace(read_shown=lambda index: (RAMP, np.ones((20, 40), bool)))
    square = as_wide(photos, 0, 20, 20)
    assert square.shape == (20, 20, 4) and (square[:, 0, 0] == 10).all()
    assert (square[:, -1, 0] == 29).all()
    whole = as_wide(photos, 0, 80, 40)
    assert whole.shape == (40, 80, 4) and whole[0, 0, 0] == 0 and whole[0, -1, 0] == 39
    assert (square[..., 3] == 255).all() and (whole[..., 3] == 255).all()


def test_what_a_mask_leaves_out_neither_counts_nor_is_shown():
    usable = np.ones((20, 40), bool)
    usable[5:12, 15:25] = False
    photo = RAMP.copy()
    photo[~usable] = 255
    photos: Any = SimpleNamespace(read_shown=lambda index: (photo, usable))
    wide = as_wide(photos, 0, 40, 20)
    np.testing.assert_array_equal(wide[..., 3] == 255, usable)
    assert (wide[usable][:, :3] == RAMP[usable]).all() and wide[..., 0].max() < 40


def test_the_stream_is_the_same_again_and_cuts_a_little():
    ramp = np.dstack([np.broadcast_to(np.linspace(0, 255, 64), (64, 64))] * 3).astype(np.uint8)
    photos: Any = Photos(1)
    photos.read_shown = lambda index: (ramp, np.ones((64, 64), bool))
    stream = ResizedPhotos(photos, 64, 64, seed=3)
    batch = stream.batch(5, 8).numpy()
    assert np.array_equal(batch, stream.batch(5, 8)) and (batch[..., 3] == 255).all()
    assert not np.array_equal(batch, stream.batch(6, 8))
    shown = np.ptp(batch[:, 0, :, 0].astype(int), axis=1) / 255
    assert RULES.zoom - 0.03 < shown.min() < shown.max() <= 1
