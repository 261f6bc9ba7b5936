from io import BytesIO
import math
from typing import Any, Iterator

from hypothesis import given, settings, strategies as st
from neo_ros.errors import ConfigError
from neo_ros.geometry import Intrinsics, ViewExpansion
from neo_ros.outpaint.fitting import outpaint_loss, OutpaintConfig, OutpaintTrainer
from neo_ros.outpaint.network import NetworkConfig
import numpy as np
import pytest
import torch

EXPANSION = ViewExpansion.to_size(Intrinsics(16, 16, 8, 8, 8, 8), 32, 32)
NETWORK = NetworkConfig(patch=4, width=8, depth=2, memory=16)


@pytest.fixture(scope='module', autouse=True)
def one_thread() -> Iterator[None]:
    """Small tensors on a shared machine: threads would only wait for one another."""
    before = torch.get_num_threads()
    torch.set_num_threads(1)
    yield
    torch.set_num_threads(before)


def trainer(seed: int = 0, **changes: Any) -> OutpaintTrainer:
    settings: dict[str, Any] = {'steps': 40, 'batch': 4, 'precision': 'fp32', **changes}
    return OutpaintTrainer(EXPANSION, NETWORK, OutpaintConfig(**settings), seed)


def wide_views(step: int, size: int = 4) -> np.ndarray:
    """Return RGBA uint8 (size, 32, 32, 4): a few smooth pictures, all seen."""
    random = np.random.default_rng(step)
    phase = random.integers(0, 4, (size, 1, 1, 1))
    rows, columns = np.indices((32, 32))
    waves = np.stack([rows, columns, rows + columns, rows * 0], axis=-1) / 6
    views = (127 + 120 * np.sin(waves[None] + phase)).astype(np.uint8)
    views[..., 3] = 255
    return views


def weights(network: torch.nn.Module) -> dict[str, torch.Tensor]:
    return {name: value.clone() for name, value in network.state_dict().items()}


def same(first: dict[str, torch.Tensor], second: dict[str, torch.Tensor]) -> bool:
    return all(torch.equal(first[name], second[name]) for name in first)


def loss_gradients(seed: int, log_scale: float | None = None) -> tuple[torch.Tensor, ...]:
    """Return weight and the loss's gradients with respect to colour and log_scale."""
    torch.manual_seed(seed)
    colour, truth = torch.rand(2, 3, 6, 8, requires_grad=True), torch.rand(2, 3, 6, 8)
    weight = (torch.rand(2, 1, 6, 8) > 0.4).float()
    scale = torch.randn(2, 1, 6, 8) if log_scale is None else torch.full((2, 1, 6, 8), log_scale)
    scale.requires_grad_()
    outpaint_loss(colour, scale, truth, weight).backward()
    assert colour.grad is not None and scale.grad is not None
    return weight, colour.grad, scale.grad


@settings(max_examples=20)
@given(st.integers(0, 99))
def test_unweighted_pixels_teach_nothing(seed: int) -> None:
    weight, d_colour, d_scale = loss_gradients(seed)
    out = weight == 0
    assert not d_scale[out].any() and not d_colour[out.expand_as(d_colour)].any()
    assert d_colour[(~out).expand_as(d_colour)].all()


@settings(max_examples=20)
@given(st.integers(0, 99), st.floats(-6, 3))
def test_the_scale_does_not_touch_the_colour(seed: int, log_scale: float) -> None:
    _, d_colour, _ = loss_gradients(seed)
    torch.testing.assert_close(loss_gradients(seed, log_scale)[1], d_colour, atol=0, rtol=0)


def test_colour_is_judged_by_the_mean_absolute_error() -> None:
    truth, weight = torch.zeros(1, 3, 2, 2), torch.tensor([[[[1.0, 1], [0, 1]]]])
    colour = torch.tensor([0.1, 0.2, 0.9, 0.3]).reshape(1, 1, 2, 2).expand(1, 3, 2, 2)
    certain = torch.full((1, 1, 2, 2), 0.0)
    loss = outpaint_loss(colour, certain, truth, weight)
    assert float(loss) == pytest.approx(1.05 * (0.1 + 0.2 + 0.3) / 3)


@pytest.mark.parametrize('error', [0.01, 0.1, 0.5])
def test_the_best_scale_is_the_error(error: float) -> None:
    colour, truth = torch.full((1, 3, 1, 1), error), torch.zeros(1, 3, 1, 1)
    best = torch.full((1, 1, 1, 1), math.log(error), requires_grad=True)
    outpaint_loss(colour, best, truth, torch.ones(1, 1, 1, 1)).backward()
    assert best.grad is not None and float(best.grad) == pytest.approx(0, abs=1e-6)


def test_a_batch_that_nobody_saw_is_no_division_by_zero() -> None:
    start = trainer()
    batch = wide_views(0)
    batch[..., 3] = 0
    assert start.train_step(batch) == 0


def test_uncovered_truth_changes_no_weight() -> None:
    batch = wide_views(0)
    batch[:, :5, :, 3] = 0
    other = batch.copy()
    other[:, :5, :, :3] = 255 - other[:, :5, :, :3]
    first, second = trainer(), trainer()
    first.train_step(batch)
    second.train_step(other)
    assert same(weights(first.network), weights(second.network))
    other[:, 6, :, :3] = 255 - other[:, 6, :, :3]
    third = trainer()
    third.train_step(other)
    assert not same(weights(first.network), weights(third.network))


@pytest.mark.parametrize('precision', ['fp32', 'bf16'])
def test_a_few_pictures_are_learnt(precision: str) -> None:
    learning = trainer(precision=precision, steps=60, learning_rate=2e-2)
    losses = [learning.train_step(wide_views(step)) for step in range(60)]
    assert losses[-1] < 0.8 * losses[0]
    narrow = torch.from_numpy(wide_views(3)[:, 8:24, 8:24, :3]).permute(0, 3, 1, 2) / 255
    truth = torch.from_numpy(wide_views(3)[..., :3]).permute(0, 3, 1, 2) / 255
    ring = torch.from_numpy(EXPANSION.extrapolated_mask)
    with torch.no_grad():
        colour, _ = learning.averaged(narrow)
    assert (colour - truth).abs()[:, :, ring].mean() < 0.2


def test_the_average_follows_behind_the_weights() -> None:
    learning = trainer(average=0.9, learning_rate=0.01)
    before = weights(learning.network)
    for step in range(3):
        learning.train_step(wide_views(step))
    for name, start in before.items():
        way = weights(learning.network)[name] - start
        behind = weights(learning.averaged)[name] - start
        assert behind.norm() <= way.norm() * 1.01, name
    assert not same(weights(learning.averaged), before)


def test_the_rate_warms_up_and_falls_to_zero() -> None:
    learning = trainer(steps=1000, learning_rate=0.5)
    rates = []
    for learning.step in (0, 49, 99, 500, 1000):
        rates.append(learning.rate())
    assert rates == pytest.approx([0.005, 0.25, 0.5, 0.25, 0], abs=0.02)


@pytest.mark.parametrize('precision', ['fp32', 'bf16'])
def test_a_broken_training_goes_on_to_the_same_bits(precision: str) -> None:
    unbroken, broken = trainer(precision=precision), trainer(precision=precision)
    for step in range(12):
        unbroken.train_step(wide_views(step))
    for step in range(5):
        broken.train_step(wide_views(step))
    file = BytesIO()
    torch.save(broken.state(), file)
    file.seek(0)
    resumed = trainer(seed=9, precision=precision)
    resumed.restore(torch.load(file, weights_only=True))
    assert resumed.step == 5 and resumed.loss == broken.loss
    for step in range(5, 12):
        resumed.train_step(wide_views(step))
    assert resumed.loss == unbroken.loss
    assert same(weights(resumed.network), weights(unbroken.network))
    assert same(weights(resumed.averaged), weights(unbroken.averaged))


def test_a_seed_decides_the_weights() -> None:
    assert same(weights(trainer(3).network), weights(trainer(3).network))
    assert not same(weights(trainer(3).network), weights(trainer(4).network))


@pytest.mark.parametrize('changes, message', [
    ({'precision': 'fp16'}, "outpaint.precision: expected bf16 or fp32, got 'fp16'"),
    ({'steps': 0}, 'outpaint: expected steps >= 1'),
    ({'batch': 0}, 'batch >= 1'),
], ids=str)
def test_settings_out_of_range(changes: dict[str, Any], message: str) -> None:
    with pytest.raises(ConfigError, match=message):
        OutpaintConfig(**changes)
