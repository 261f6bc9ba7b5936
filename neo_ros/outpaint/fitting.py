"""Step 3 of the paper: train the outpainter on the stream of rendered views."""
from dataclasses import asdict, dataclass
import math
import os
from typing import Any

from neo_ros.errors import ConfigError
from neo_ros.geometry import ViewExpansion
from neo_ros.outpaint.network import NetworkConfig, Outpainter
import numpy as np
import torch


THREADS = len(os.sched_getaffinity(0))


@dataclass(frozen=True)
class OutpaintConfig:
    """How the outpainter is trained."""

    __pydantic_config__ = {'extra': 'forbid'}
    steps: int = 4000              # optimiser steps
    batch: int = 16                # wide views in a step
    learning_rate: float = 1e-3    # peak; warmed up over 100 steps, then a cosine to zero
    weight_decay: float = 0.01
    clip: float = 1.0              # largest gradient norm
    average: float = 0.998         # decay of the weights' moving average, which is exported
    precision: str = 'bf16'        # of the arithmetic in training: bf16 or fp32

    def __post_init__(self) -> None:
        if self.precision not in ('bf16', 'fp32'):
            raise ConfigError(
                f'outpaint.precision: expected bf16 or fp32, got {self.precision!r}')
        if self.steps < 1 or self.batch < 1:
            raise ConfigError('outpaint: expected steps >= 1 and batch >= 1, '
                              f'got {self.steps} and {self.batch}')


def outpaint_loss(colour: torch.Tensor, log_scale: torch.Tensor, truth: torch.Tensor,
                  weight: torch.Tensor) -> torch.Tensor:
    """
    Mean L1 over the ring plus the Laplace likelihood of its error.

    colour, truth (B, 3, H, W) and log_scale (B, 1, H, W) as in Outpainter; weight (B, 1, H, W)
    is 0 where the camera sees or nobody saw. The likelihood trains the scale alone: its
    gradient does not reach the colour.
    """
    error = (colour - truth).abs().mean(1, keepdim=True)
    likelihood = error.detach() * torch.exp(-log_scale) + log_scale
    return ((error + 0.05 * likelihood) * weight).sum() / weight.sum().clamp(min=1)


class OutpaintTrainer:
    """Network, its moving average and optimiser; `train_step` takes one batch."""

    def __init__(self, expansion: ViewExpansion, network: NetworkConfig, config: OutpaintConfig,
                 seed: int) -> None:
        torch.manual_seed(seed)
        self.config, self.expansion = config, expansion
        self.network = Outpainter(expansion, network).to(memory_format=torch.channels_last)
        self.averaged = Outpainter(expansion, network)
        self.averaged.load_state_dict(self.network.state_dict())
        self.optimizer = torch.optim.AdamW(
            self.network.parameters(), lr=config.learning_rate, betas=(0.9, 0.98),
            weight_decay=config.weight_decay)
        self.ring = torch.from_numpy(expansion.extrapolated_mask)[None, None]
        self.step = 0
        self.loss = math.nan

    @property
    def figure(self) -> float:
        """What a log of the training shows: the smoothed loss."""
        return self.loss

    def rate(self) -> float:
        """Learning rate of the present step."""
        warm = min((self.step + 1) / 100, 1.0)
        cosine = 0.5 * (1 + math.cos(math.pi * self.step / self.config.steps))
        return self.config.learning_rate * warm * cosine

    def train_step(self, batch: np.ndarray) -> float:
        """Learn from RGBA uint8 (B, H, W, 4); returns the smoothed loss."""
        wide = torch.from_numpy(batch).permute(0, 3, 1, 2).float() / 255
        truth, coverage = wide[:, :3], wide[:, 3:]
        rows, columns = self.expansion.observed
        narrow = truth[:, :, rows, columns].contiguous(memory_format=torch.channels_last)
        weight = (self.ring & (coverage > 0.5)).float()
        # The field's kernels set the number of OpenMP threads, too; sums depend on it.
        torch.set_num_threads(THREADS)
        for group in self.optimizer.param_groups:
            group['lr'] = self.rate()
        with torch.autocast('cpu', torch.bfloat16, enabled=self.config.precision == 'bf16'):
            colour, log_scale = self.network(narrow)
        loss = outpaint_loss(colour.float(), log_scale.float(), truth, weight)
        self.optimizer.zero_grad(set_to_none=True)
        loss.backward()
        torch.nn.utils.clip_grad_norm_(self.network.parameters(), self.config.clip)
        self.optimizer.step()
        self._average()
        value = float(loss.detach())
        self.loss = value if math.isnan(self.loss) else 0.98 * self.loss + 0.02 * value
        self.step += 1
        return self.loss

    @torch.no_grad()
    def _average(self) -> None:
        # A young average follows quickly, so that the first weights are soon forgotten.
        keep = min(self.config.average, (1 + self.step) / (10 + self.step))
        for mean, now in zip(self.averaged.parameters(), self.network.parameters()):
            mean.lerp_(now, 1 - keep)

    def state(self) -> dict[str, Any]:
        """Return everything a later `restore` needs to go on."""
        return {'step': self.step, 'loss': self.loss, 'config': asdict(self.config),
                'network': self.network.state_dict(), 'averaged': self.averaged.state_dict(),
                'optimizer': self.optimizer.state_dict()}

    def restore(self, state: dict[str, Any]) -> None:
        """Go on from `state`."""
        self.step, self.loss = state['step'], state['loss']
        self.network.load_state_dict(state['network'])
        self.averaged.load_state_dict(state['averaged'])
        self.optimizer.load_state_dict(state['optimizer'])
