from collections.abc import Iterator
from io import BytesIO
import math
from typing import Any

from hypothesis import given, settings, strategies as st
from neo_ros.errors import ConfigError
from neo_ros.geometry import Intrinsics, ViewExpansion
from neo_ros.outpaint import fitting
from neo_ros.outpaint.fitting import OutpaintConfig, OutpaintTrainer
from neo_ros.outpaint.loss import outpaint_loss
from neo_ros.outpaint.network import NetworkConfig
import numpy as np
import pytest
import torch

EXPANSION = ViewExpansion.to_size(Intrinsics(16, 16, 8, 8, 8, 8), 32, 32)
NETWORK = NetworkConfig(patch=4, width=8, depth=2, hidden=16)


@pytest.fixture(scope='module', autouse=True)
def trainer_on_one_thread(one_thread: None) -> Iterator[None]:
    """Keep the trainer from setting the threads to all again."""
    with pytest.MonkeyPatch.context() as patch:
        patch.setattr(fitting, 'THREADS', 1)
        yield


def trainer(seed: int = 0, **changes: Any) -> OutpaintTrainer:
    settings: dict[str, Any] = {'steps': 40, 'batch': 4, 'precision': 'fp32', 'device': 'cpu',
                                **changes}
    return OutpaintTrainer(EXPANSION, NETWORK, OutpaintConfig(**settings), seed)


def wide_views(step: int, size: int = 4) -> torch.Tensor:
    """Return RGBA uint8 (size, 32, 32, 4): a few smooth pictures, all seen."""
    random = np.random.default_rng(step)
    phase = random.integers(0, 4, (size, 1, 1, 1))
    rows, columns = np.indices((32, 32))
    waves = np.stack([rows, columns, rows + columns, rows * 0], axis=-1) / 6
    views = (127 + 120 * np.sin(waves[None] + phase)).astype(np.uint8)
    views[..., 3] = 255
    return torch.from_numpy(views)


def state_of(learning: OutpaintTrainer) -> dict[str, Any]:
    """Return a trainer's state as it comes back from a file."""
    file = BytesIO()
    torch.save(learning.state(), file)
    file.seek(0)
    return torch.load(file, weights_only=True)


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
    other = batch.clone()
    other[:, :5, :, :3] = 255 - other[:, :5, :, :3]
    first, second = trainer(), trainer()
    first.train_step(batch)
    second.train_step(other)
    assert same(weights(first.network), weights(second.network))
    other[:, 6, :, :3] = 255 - other[:, 6, :, :3]
    third = trainer()
    third.train_step(other)
    assert not same(weights(first.network), weights(third.network))


@pytest.mark.slow
@pytest.mark.parametrize('precision', ['fp32', 'bf16'])
def test_a_few_pictures_are_learnt(precision: str) -> None:
    learning = trainer(precision=precision, steps=60, learning_rate=2e-2)
    losses = [learning.train_step(wide_views(step)) for step in range(60)]
    assert losses[-1] < 0.8 * losses[0]
    narrow = wide_views(3)[:, 8:24, 8:24, :3].permute(0, 3, 1, 2) / 255
    truth = wide_views(3)[..., :3].permute(0, 3, 1, 2) / 255
    ring = torch.from_numpy(EXPANSION.extrapolated_mask)
    with torch.no_grad():
        colour, _ = learning.averaged(narrow)
    assert (colour - truth).abs()[:, :, ring].mean() < 0.2


def test_the_average_follows_behind_the_weights() -> None:
    learning = trainer(average=0.2, learning_rate=0.01)
    expected = weights(learning.network)
    for step in range(3):
        learning.train_step(wide_views(step))
        keep = (0.1, 2 / 11, 0.2)[step]  # A young average follows more quickly.
        for name, now in weights(learning.network).items():
            expected[name] = keep * expected[name] + (1 - keep) * now
    for name, mean in weights(learning.averaged).items():
        torch.testing.assert_close(mean, expected[name], msg=name)
    assert not same(weights(learning.averaged), weights(learning.network))


def test_the_rate_warms_up_and_falls_to_zero() -> None:
    learning = trainer(steps=1000, learning_rate=0.5)
    rates = []
    for learning.step in (0, 24, 49, 500, 1000):
        rates.append(learning.rate())
    assert rates == pytest.approx([0.005, 0.24, 0.5, 0.25, 0], abs=0.02)
    # A long training warms up over 100 steps, a short one over 5 % of its time.
    longer = trainer(steps=100_000, learning_rate=0.5)
    longer.step = 99
    assert longer.rate() == pytest.approx(0.5, abs=0.01)


@pytest.mark.parametrize('precision', ['fp32', 'bf16'])
def test_a_broken_training_goes_on_to_the_same_bits(precision: str) -> None:
    unbroken, broken = trainer(precision=precision), trainer(precision=precision)
    for step in range(12):
        unbroken.train_step(wide_views(step))
    for step in range(5):
        broken.train_step(wide_views(step))
    resumed = trainer(seed=9, precision=precision)
    resumed.restore(state_of(broken))
    assert resumed.step == 5 and resumed.loss == broken.loss
    for step in range(5, 12):
        resumed.train_step(wide_views(step))
    assert resumed.loss == unbroken.loss
    assert same(weights(resumed.network), weights(unbroken.network))
    assert same(weights(resumed.averaged), weights(unbroken.averaged))


def test_a_seed_decides_the_weights() -> None:
    assert same(weights(trainer(3).network), weights(trainer(3).network))
    assert not same(weights(trainer(3).network), weights(trainer(4).network))


def test_a_training_by_time_ends_when_its_minutes_are_over(
        monkeypatch: pytest.MonkeyPatch) -> None:
    clock = [100.0]
    monkeypatch.setattr(fitting.time, 'monotonic', lambda: clock[0])
    learning, rates = trainer(minutes=0.5, learning_rate=1.0), []
    clock[0] += 100.0  # making the first batch, and its panoramas, does not count
    monkeypatch.setattr(learning, '_parallel', _seconds_pass(learning.network, clock, 2.0))
    while learning.done[0] < learning.done[1]:
        rates.append(learning.rate())
        learning.train_step(wide_views(learning.step))
        clock[0] += 1.0  # making the next batch
        if learning.step == 5:
            before, learning = learning, trainer(minutes=0.5, learning_rate=1.0)
            learning.restore(state_of(before))
            clock[0] += 1000.0  # what happens while the training is broken off does not count
            monkeypatch.setattr(
                learning, '_parallel', _seconds_pass(learning.network, clock, 2.0))
    # Neither the first step nor the first after the break has a batch before it on its clock.
    assert learning.seconds == pytest.approx(2 + 4 * 3 + 2 + 5 * 3)
    assert learning.done[1] == 30 and learning.share == 1 and learning.rate() == 0
    # The first twentieth, which is less than a step, warms up.
    assert rates[0] == pytest.approx(0.01) and rates[1] > 0.8
    assert all(np.diff(rates[1:]) < 0) and rates[-1] < 0.1


def _seconds_pass(network: torch.nn.Module, clock: list[float], seconds: float) -> Any:
    def run(narrow: torch.Tensor) -> Any:
        clock[0] += seconds
        return network(narrow)

    return run


def test_faults_are_put_into_the_input_alone_exposure_into_both() -> None:
    batch = wide_views(0)
    clean, same_truth, weight = trainer(photometric=0, occluders=0)._tensors(
        batch, np.random.default_rng(0))
    for changes, exposed in (({'photometric': 1, 'occluders': 0}, True),
                             ({'photometric': 0, 'occluders': 1}, False)):
        narrow, truth, _ = trainer(**changes)._tensors(batch, np.random.default_rng(0))
        assert (narrow - clean).abs().mean() > 0.02
        assert torch.equal(truth, same_truth) != exposed
        # The camera's window of the truth has the exposure of the input.
        window = truth[:, :, 8:24, 8:24]
        gain = float(truth.mean() / same_truth.mean())
        assert float(window.mean() / clean.mean()) == pytest.approx(gain, rel=0.05)
    truth = same_truth
    np.testing.assert_allclose(
        clean.permute(0, 2, 3, 1).numpy() * 255, batch[:, 8:24, 8:24, :3], atol=1e-3)
    np.testing.assert_allclose(truth.permute(0, 2, 3, 1).numpy() * 255, batch[..., :3], atol=1e-3)
    assert weight.sum() == 4 * (32 * 32 - 16 * 16)


def test_validation_is_the_ring_psnr_on_held_out_views() -> None:
    views = wide_views(77).numpy()
    views[0, :5, :, 3] = 0  # nobody saw it
    learning = OutpaintTrainer(EXPANSION, NETWORK, OutpaintConfig(
        steps=20, batch=4, precision='fp32', validations=4, device='cpu'), 0, views)
    for step in range(20):
        learning.train_step(wide_views(step))
    assert [row[0] for row in learning.validation] == [5, 10, 15, 20]
    rows, columns = EXPANSION.observed
    expected = []
    for view in views:
        ring = EXPANSION.extrapolated_mask & (view[..., 3] > 127)
        with torch.no_grad():
            colour = learning.averaged(torch.from_numpy(
                view[rows, columns, :3]).permute(2, 0, 1)[None] / 255)[0][0].permute(1, 2, 0)
        error = colour.clamp(0, 1).numpy()[ring] - view[..., :3][ring] / 255
        expected.append(-10 * np.log10((error ** 2).mean()))
    assert learning.validation[-1][2] == pytest.approx(np.mean(expected), abs=1e-3)
    assert learning.note().endswith('dB on held-out photos')
    resumed = trainer()
    resumed.restore(state_of(learning))
    assert resumed.validation == learning.validation


def test_a_training_that_explodes_says_so() -> None:
    learning = trainer(learning_rate=1e20)
    with pytest.raises(ConfigError, match='choose a lower outpaint.learning_rate than 1e'):
        for step in range(9):
            learning.train_step(wide_views(step))


@pytest.mark.parametrize('log_scale, error, pull', [
    (-30.0, 0.1, -0.05), (-30.0, 0.0, -0.05), (-6.1, 0.1, -0.05), (-5.0, 0.0, 0.05)])
def test_a_network_is_never_surer_than_half_a_grey_level(
        log_scale: float, error: float, pull: float) -> None:
    sure = torch.full((1, 1, 1, 1), log_scale, requires_grad=True)
    grey = torch.full((1, 3, 1, 1), 0.5)
    outpaint_loss(grey + error, sure, grey, torch.ones(1, 1, 1, 1)).backward()
    # Drawn back from beyond it, however wrong it was: no step is steeper than another.
    assert sure.grad is not None and float(sure.grad) == pytest.approx(pull, abs=1e-6)


def test_gradients_are_clipped() -> None:
    def norm(clip: float) -> float:
        learning = trainer(clip=clip)
        learning.train_step(wide_views(0))
        return math.sqrt(sum(float(weight.grad.square().sum())
                             for weight in learning.network.parameters()
                             if weight.grad is not None))

    assert norm(1e-3) == pytest.approx(1e-3, rel=1e-2) and norm(1e3) > 1e-2


@pytest.mark.slow
def test_mat_learns_in_the_default_precision() -> None:
    learning = OutpaintTrainer(
        EXPANSION, NetworkConfig(name='mat', patch=4, width=32, depth=2, window=4),
        OutpaintConfig(steps=30, batch=4, device='cpu'), 0)
    losses = [learning.train_step(wide_views(0)) for _ in range(30)]
    assert losses[-1] < 0.95 * losses[0]  # Smoothed: most of the first one is still in it.


def test_batch_statistics_are_averaged_too() -> None:
    learning = OutpaintTrainer(
        EXPANSION, NetworkConfig(name='lama', width=8, depth=1, blocks=1),
        OutpaintConfig(steps=5, batch=4, precision='fp32', device='cpu'), 0)
    learning.train_step(wide_views(0))
    means = [(name, buffer) for name, buffer in learning.averaged.named_buffers()
             if name.endswith('running_mean')]
    assert means and all(buffer.any() for _, buffer in means)


class PlainDistance(torch.nn.Module):
    """Stand in for LPIPS: the squared difference, in two layers; remembers what it saw."""

    def __init__(self, backbone: str) -> None:
        super().__init__()
        self.seen: list[tuple[torch.Tensor, torch.Tensor]] = []

    def distances_BCHW(self, x: torch.Tensor, y: torch.Tensor) -> list[torch.Tensor]:
        """Return two maps."""
        self.seen.append((x.detach(), y.detach()))
        return [(x - y).square().mean(1, keepdim=True)] * 2


def test_the_perceptual_term_sees_windows_whose_centre_is_the_truth(
        monkeypatch: pytest.MonkeyPatch) -> None:
    monkeypatch.setattr(fitting, 'PerceptualDistance', PlainDistance)
    learning = OutpaintTrainer(
        ViewExpansion.to_size(Intrinsics(32, 32, 16, 16, 16, 16), 64, 64), NETWORK,
        OutpaintConfig(steps=40, batch=2, precision='fp32', perceptual=2.0, device='cpu',
                       perceptual_window=48), 0)
    assert trainer(perceptual=0).perceptual is None
    batch = wide_views(0, 2).repeat_interleave(2, 1).repeat_interleave(2, 2)
    first = learning.train_step(batch)
    assert isinstance(learning.perceptual, PlainDistance)
    (painted, truth), = learning.perceptual.seen
    assert painted.shape == (2, 3, 48, 48) and painted.min() >= -1.5 and truth.min() >= -1
    equal = (painted == truth).all(1).all(0)
    # Any window of 48 of 64 pixels holds most of the 32 observed ones in its middle.
    assert 16 * 16 <= equal.sum() <= 32 * 32 + 20 and not equal.all()
    without = OutpaintTrainer(learning.expansion, NETWORK, OutpaintConfig(
        steps=40, batch=2, precision='fp32', device='cpu'), 0)
    difference = 2.0 * 2 * float((painted - truth).square().mean())
    assert first == pytest.approx(without.train_step(batch) + difference, rel=1e-4)
    assert not same(weights(learning.network), weights(without.network))


@pytest.mark.skipif(torch.cuda.is_available(), reason='there is a CUDA device')
def test_a_device_that_is_not_there_is_an_error() -> None:
    assert trainer(device='auto').device.type == 'cpu'
    with pytest.raises(ConfigError, match='outpaint.device: expected a CUDA device'):
        trainer(device='cuda')


@pytest.mark.parametrize('changes, message', [
    ({'precision': 'fp16'}, "outpaint.precision: expected bf16 or fp32, got 'fp16'"),
    ({'steps': 0}, 'outpaint: expected steps >= 1'),
    ({'batch': 0}, 'batch >= 1'),
    ({'minutes': 0.0}, 'outpaint.minutes: expected a number > 0, got 0.0'),
    ({'device': 'gpu'}, "outpaint.device: expected auto or cpu or cuda, got 'gpu'"),
    ({'training_view': 'narrow'}, 'outpaint.training_view: expected wide or source'),
    ({'training_view': 'source'}, 'set outpaint.real_centre to 0'),
    ({'real_centre': 1.5}, 'outpaint.real_centre: expected 0 ... 1, got 1.5'),
    ({'occluders': -0.1}, 'outpaint.occluders: expected 0 ... 1'),
    ({'photometric': -1}, 'outpaint.photometric: expected 0 ... 1_000_000'),
    ({'perceptual': -1}, 'outpaint.perceptual: expected 0'),
    *[({name: value}, f'outpaint.{name}: expected a number > 0, got {value}')
      for name, value in (('learning_rate', -0.002), ('learning_rate', math.nan), ('clip', 0.0))],
    ({'weight_decay': -1}, 'outpaint.weight_decay: expected 0 ... 1_000_000, got -1'),
    ({'average': 1.5}, 'outpaint.average: expected 0 ... 1, got 1.5'),
    ({'perceptual_window': 16}, 'outpaint.perceptual_window: expected at least 32'),
], ids=str)
def test_settings_out_of_range(changes: dict[str, Any], message: str) -> None:
    with pytest.raises(ConfigError, match=message):
        OutpaintConfig(**changes)
