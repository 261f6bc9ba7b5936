"""Step 3 of the paper: train the outpainter on the stream of rendered views."""
import copy
from dataclasses import dataclass
import math
import os
import time
from typing import Any

from neo_ros.errors import ConfigError
from neo_ros.geometry import ViewExpansion
from neo_ros.outpaint.augmentation import augment_inputs, expose_views
from neo_ros.outpaint.distributed import from_first, processes, shared_gradients
from neo_ros.outpaint.loss import outpaint_loss
from neo_ros.outpaint.network import NetworkConfig
from neo_ros.outpaint.networks import build_network
from neo_ros.outpaint.perceptual import PerceptualDistance
import numpy as np
import torch


# Of the processes that torchrun started on this machine, each has its share of the cores.
THREADS = max(len(os.sched_getaffinity(0)) // int(os.environ.get('LOCAL_WORLD_SIZE', '1')), 1)


@dataclass(frozen=True)
class OutpaintConfig:
    """How the outpainter is trained."""

    __pydantic_config__ = {'extra': 'forbid'}
    steps: int = 4000              # optimiser steps; not read where `minutes` is given
    # Of training time, rendering included, instead of steps; depends on the speed of the machine.
    minutes: float | None = None
    batch: int = 16                # wide views in a step, over all processes
    learning_rate: float = 2e-3    # peak; warmed up over 100 steps or 5 %, then a cosine to zero
    weight_decay: float = 0.01     # of AdamW
    clip: float = 1.0              # largest gradient norm
    average: float = 0.998         # decay of the weights' moving average, which is exported
    precision: str = 'bf16'        # of the arithmetic in training: bf16 or fp32
    device: str = 'auto'           # cpu, cuda, or auto: cuda where there is one
    training_view: str = 'wide'    # what is rendered: wide views, or (ablation) the source view
    real_centre: float = 0.25      # share of the views with a real photo in the middle
    photometric: float = 0.25      # exposure, and faults in the input: 0 none ... 1 a poor camera
    occluders: float = 0.1         # share of the inputs with a person or a thing put into them
    perceptual: float = 0.0        # weight of LPIPS-VGG in the loss; its weights are a download
    perceptual_window: int = 64    # pixels a side of the window it looks at, another every step
    validations: int = 20          # scores on held-out photos during the training
    tensorboard: bool = False      # write curves for TensorBoard into the output folder

    def __post_init__(self) -> None:
        for name, choices in (('precision', ('bf16', 'fp32')), ('device', ('auto', 'cpu', 'cuda')),
                              ('training_view', ('wide', 'source'))):
            if getattr(self, name) not in choices:
                raise ConfigError(f'outpaint.{name}: expected {" or ".join(choices)}, '
                                  f'got {getattr(self, name)!r}')
        if self.steps < 1 or self.batch < 1:
            raise ConfigError('outpaint: expected steps >= 1 and batch >= 1, '
                              f'got {self.steps} and {self.batch}')
        if self.minutes is not None and not 0 < self.minutes < math.inf:
            raise ConfigError(f'outpaint.minutes: expected a number > 0, got {self.minutes}')
        for name in ('learning_rate', 'clip'):
            if not 0 < getattr(self, name) < math.inf:
                raise ConfigError(
                    f'outpaint.{name}: expected a number > 0, got {getattr(self, name)}')
        for name in ('real_centre', 'occluders', 'photometric', 'perceptual', 'validations',
                     'weight_decay', 'average'):
            most = 1 if name in ('real_centre', 'occluders', 'average') else 1_000_000
            if not 0 <= getattr(self, name) <= most:
                raise ConfigError(
                    f'outpaint.{name}: expected 0 ... {most:_}, got {getattr(self, name)}')
        if self.perceptual_window < 32:  # VGG halves it four times.
            raise ConfigError('outpaint.perceptual_window: expected at least 32 pixels, '
                              f'got {self.perceptual_window}')
        if self.training_view == 'source' and self.real_centre > 0:
            raise ConfigError('outpaint.training_view: source views have no room around a photo; '
                              'set outpaint.real_centre to 0')

    def progress(self, step: int, seconds: float) -> tuple[int, int]:
        """Tell how far a training is and where it ends: steps, or seconds with `minutes`."""
        if self.minutes is None:
            return step, self.steps
        total = math.ceil(60 * self.minutes)
        return min(int(seconds), total), total  # The last step may take long.


class OutpaintTrainer:
    """
    Network, its moving average and optimiser; `train_step` takes one batch.

    held_out: wide views RGBA uint8 (N, H, W, 4) to validate on, or None; `validation` collects
    [step, seconds, ring PSNR in dB] of the averaged network on them.
    """

    def __init__(self, expansion: ViewExpansion, network: NetworkConfig, config: OutpaintConfig,
                 seed: int, held_out: np.ndarray | None = None) -> None:
        torch.manual_seed(seed)
        self.config, self.expansion, self.seed = config, expansion, seed
        self.rank, self.world = processes()
        self.batch_size = share_of_batch(config.batch, self.world)
        self.device = outpaint_device(config.device, self.rank)
        self.network = build_network(expansion, network).to(self.device)
        self.network.to(memory_format=torch.channels_last)  # type: ignore[call-overload]
        self.averaged = copy.deepcopy(self.network)
        self._parallel = shared_gradients(self.network)
        self.optimizer = torch.optim.AdamW(
            self.network.parameters(), lr=config.learning_rate, betas=(0.9, 0.98),
            weight_decay=config.weight_decay, fused=True)
        self.perceptual = (
            PerceptualDistance('vgg').to(self.device) if config.perceptual > 0 else None)
        self.ring = torch.from_numpy(expansion.extrapolated_mask)[None, None].to(self.device)
        self.held_out = held_out
        self.validation: list[list[float]] = []
        self.step = 0
        self.loss = math.nan
        self.seconds = 0.0
        # Making the first batch does not count: it takes as long as its panoramas.
        self._clock: float | None = None

    @property
    def figure(self) -> float:
        """What a log of the training shows: the smoothed loss."""
        return self.loss

    def note(self) -> str:
        """Say in a few words how it goes."""
        score = f', {self.validation[-1][2]:.2f} dB on held-out photos' if self.validation else ''
        return f'loss {self.loss:.4f}{score}'

    @property
    def done(self) -> tuple[int, int]:
        """How far the training is and where it ends."""
        return self.config.progress(self.step, self.seconds)

    @property
    def share(self) -> float:
        """How much of the training is behind, 0 ... 1."""
        minutes = self.config.minutes
        whole = self.step / self.config.steps if minutes is None else self.seconds / 60 / minutes
        return min(whole, 1.0)

    def rate(self) -> float:
        """Learning rate of the present step."""
        warm = min(max((self.step + 1) / 100, 20 * self.share), 1.0)
        cosine = 0.5 * (1 + math.cos(math.pi * self.share))
        return self.config.learning_rate * warm * cosine

    def train_step(self, batch: torch.Tensor) -> float:
        """
        Learn from RGBA uint8 (B, H, W, 4), `batch_size` of them; returns the smoothed loss.

        `seconds` counts from the end of the step before, so making the batch is in it.
        """
        started = time.monotonic() if self._clock is None else self._clock
        random = np.random.default_rng([self.seed, 3, self.step, self.rank])
        narrow, truth, weight = self._tensors(batch, random)
        # The field's kernels set the number of OpenMP threads, too; sums depend on it.
        torch.set_num_threads(THREADS)
        for group in self.optimizer.param_groups:
            group['lr'] = self.rate()
        with self._mixed_precision():
            colour, log_scale = self._parallel(narrow)
        loss = outpaint_loss(colour.float(), log_scale.float(), truth, weight)
        if self.perceptual is not None:
            painted = torch.where(weight > 0, colour.float(), truth)
            loss = loss + self.config.perceptual * self._perceptual_term(painted, truth, random)
        self.optimizer.zero_grad(set_to_none=True)
        loss.backward()
        torch.nn.utils.clip_grad_norm_(self.network.parameters(), self.config.clip)
        self.optimizer.step()
        self._average()
        value = float(loss.detach())
        if not math.isfinite(value):
            raise ConfigError(f'outpaint: the loss of step {self.step} is {value}; choose a lower '
                              f'outpaint.learning_rate than {self.config.learning_rate}')
        self.loss = value if math.isnan(self.loss) else 0.98 * self.loss + 0.02 * value
        before = self.share
        self.step += 1
        self._count_seconds(started)
        times = self.config.validations
        if self.held_out is not None and int(before * times) < int(self.share * times):
            self.validation.append([self.step, self.seconds, self.validate()])
            self._clock = time.monotonic()  # Looking at it is not learning.
        return self.loss

    def _tensors(self, batch: torch.Tensor, random: np.random.Generator,
                 ) -> tuple[torch.Tensor, torch.Tensor, torch.Tensor]:
        """Make the network's input, altered as a camera would, the truth and its weight."""
        config = self.config
        batch = batch.to(self.device)
        if config.photometric > 0:
            batch = expose_views(batch, config.photometric, random)
        rows, columns = self.expansion.observed
        narrow = batch[:, rows, columns, :3]
        if config.photometric > 0 or config.occluders > 0:
            narrow = torch.from_numpy(augment_inputs(
                narrow.cpu().numpy(), config.photometric, config.occluders, random))
        wide = self._unit(batch)
        weight = (self.ring & (wide[:, 3:] > 0.5)).float()
        return (self._unit(narrow).contiguous(memory_format=torch.channels_last),
                wide[:, :3], weight)

    def _unit(self, images: torch.Tensor) -> torch.Tensor:
        """Bring uint8 (B, H, W, C) to the device as (B, C, H, W) in 0 ... 1."""
        return images.to(self.device).permute(0, 3, 1, 2).float() / 255

    def _perceptual_term(self, painted: torch.Tensor, truth: torch.Tensor,
                         random: np.random.Generator) -> torch.Tensor:
        """Compare one window, where there is any difference to see: mean LPIPS."""
        assert self.perceptual is not None
        height, width = (min(self.config.perceptual_window, side) for side in truth.shape[2:])
        top = int(random.integers(truth.shape[2] - height + 1))
        left = int(random.integers(truth.shape[3] - width + 1))
        window = (..., slice(top, top + height), slice(left, left + width))
        with self._mixed_precision():
            maps = self.perceptual.distances_BCHW(2 * painted[window] - 1, 2 * truth[window] - 1)
        return torch.stack([layer.float().mean() for layer in maps]).sum()

    def _mixed_precision(self) -> torch.autocast:
        return torch.autocast(self.device.type, torch.bfloat16,
                              enabled=self.config.precision == 'bf16')

    def _count_seconds(self, started: float) -> None:
        self._clock = time.monotonic()
        self.seconds += self._clock - started
        if self.config.minutes is not None:
            self.seconds = from_first(self.seconds)  # All processes stop at the same step.

    @torch.no_grad()
    def _average(self) -> None:
        # A young average follows quickly, so that the first weights are soon forgotten.
        keep = min(self.config.average, (1 + self.step) / (10 + self.step))
        for mean, now in zip(self.averaged.parameters(), self.network.parameters()):
            mean.lerp_(now, 1 - keep)
        for copied, counted in zip(self.averaged.buffers(), self.network.buffers()):
            copied.copy_(counted)

    @torch.no_grad()
    def validate(self) -> float:
        """Return the averaged network's mean ring PSNR on the held-out views, dB."""
        assert self.held_out is not None
        rows, columns = self.expansion.observed
        self.averaged.eval()
        scores = []
        for view in self.held_out:
            wide = self._unit(torch.from_numpy(view[None]))
            seen = (self.ring & (wide[:, 3:] > 0.5)).expand(-1, 3, -1, -1)
            if seen.any():
                colour = self.averaged(wide[:, :3, rows, columns])[0].clamp(0, 1)
                scores.append(-10 * math.log10(max(
                    float((colour - wide[:, :3])[seen].square().mean()), 1e-10)))
        return float(np.mean(scores)) if scores else math.nan

    def state(self) -> dict[str, Any]:
        """Return everything a later `restore` needs to go on."""
        return {'step': self.step, 'seed': self.seed, 'loss': self.loss, 'seconds': self.seconds,
                'validation': self.validation,
                'network': self.network.state_dict(), 'averaged': self.averaged.state_dict(),
                'optimizer': self.optimizer.state_dict()}

    def restore(self, state: dict[str, Any]) -> None:
        """Go on from `state`."""
        self.step, self.loss = state['step'], state['loss']
        self.seed, self.seconds = state['seed'], state['seconds']
        self.validation = state['validation']
        self.network.load_state_dict(state['network'])
        self.averaged.load_state_dict(state['averaged'])
        self.optimizer.load_state_dict(state['optimizer'])
        self._clock = None


def share_of_batch(batch: int, world: int) -> int:
    """Return how many views of a batch each process has; ConfigError if they do not divide."""
    if batch % world:
        raise ConfigError(f'outpaint.batch: expected a multiple of {world}, the number of '
                          f'processes, got {batch}')
    return batch // world


def outpaint_device(name: str, rank: int) -> torch.device:
    """Return the device of `outpaint.device`; raises ConfigError where it is not there."""
    if name == 'cuda' and not torch.cuda.is_available():
        raise ConfigError('outpaint.device: expected a CUDA device, there is none; '
                          'choose cpu or auto')
    if name == 'cpu' or not torch.cuda.is_available():
        return torch.device('cpu')
    return torch.device('cuda', rank % torch.cuda.device_count())
