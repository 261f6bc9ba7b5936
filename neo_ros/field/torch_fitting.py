"""
The same fit on a torch device, for CUDA: the losses and steps of `fitting`, with autograd.

Draws what `FieldTrainer` draws, so both follow the same path up to rounding. Several processes
(`torch.distributed`) share the pixels of a step and add their gradients. Nothing here is a
matrix product, so bf16 autocast would change nothing.
"""
from collections.abc import Sequence
import math
import time
from typing import Any

from neo_ros.field.config import FieldConfig
from neo_ros.field.extent import FineBox
from neo_ros.field.fitting import FieldTrainer, FitRules
from neo_ros.field.fitting_kernels import DEPTH_SHARE
from neo_ros.field.kernels import MIN_WEIGHT
from neo_ros.field.torch_field import (
    colours, corner_weights, Samples, sh_basis, torch_device, TorchField)
from neo_ros.geometry import Intrinsics
import numpy as np
import torch
from torch import distributed, Tensor
from torch.nn.functional import softplus


class TorchFieldTrainer(FieldTrainer):
    """`FieldTrainer` whose grid, gradients and moments live on a device, 'cuda' or 'torch'."""

    def __init__(self, images: np.ndarray, intrinsics: Intrinsics, T_world_cam: np.ndarray,
                 config: FieldConfig, seed: int, device: str,
                 rules: FitRules = FitRules(), depths: np.ndarray | None = None,
                 usable: np.ndarray | None = None, fine: FineBox | None = None) -> None:
        self.device = device
        super().__init__(images, intrinsics, T_world_cam, config, seed, rules, depths, usable,
                         fine)

    @property
    def placed(self) -> TorchField:
        """The field where it is fitted."""
        return self.arrays

    def _allocate(self) -> None:
        self.arrays = TorchField(self.field, torch_device(self.device))
        grid = self.arrays.grid
        self.slope = torch.zeros_like(grid)
        self.moments = torch.zeros_like(grid), torch.zeros_like(grid)
        self.hit = torch.zeros(len(grid), dtype=torch.uint8, device=grid.device)
        self.counts = torch.zeros(len(grid), dtype=torch.int32, device=grid.device)

    def train_step(self) -> None:
        """Take one optimiser step, as `FieldTrainer.train_step`."""
        started = time.monotonic()
        self.random = np.random.default_rng([self.seed, self.step])
        self._refine_when_due()
        config = self.config
        photo, target, distance, away, rays_o, rays_d = self.sample_rays()
        pixels = len(target)
        gain = self.camera.gains(photo, away)
        jitter = self.random.random(len(rays_o), np.float32)
        background = self.random.random((pixels, 3), np.float32)
        rank, processes = (distributed.get_rank(), distributed.get_world_size()) if (
            distributed.is_initialized()) else (0, 1)
        mine = slice(rank, None, processes)
        # The rays of a pixel follow one another: a row for each pixel.
        own = (torch.from_numpy(
            array.reshape(pixels, -1, *array.shape[1:])[mine].reshape(-1, *array.shape[1:])
        ).to(self.arrays.device)
            for array in (rays_o, rays_d, jitter, target, gain, background, distance))
        error, d_gain = self._differentiate(*own)
        totals = torch.zeros(pixels, 4, device=self.arrays.device)
        totals[mine, 0], totals[mine, 1:] = error, d_gain
        if processes > 1:
            distributed.all_reduce(self.slope)
            distributed.all_reduce(self.hit, distributed.ReduceOp.MAX)
            distributed.all_reduce(totals)
        self._adam(config.learning_rate * 0.1 ** self.share)
        found = totals.cpu().numpy()
        self.camera.learn(photo, away, found[:, 1:] * gain)
        smoothing = 0.98 if self.step else 0.0
        psnr = -10 * math.log10(max(float(found[:, 0].mean()) / 3, 1e-10))
        self.psnr = smoothing * self.psnr + (1 - smoothing) * psnr
        self.step += 1
        self.seconds += time.monotonic() - started
        if processes > 1 and config.minutes is not None:
            # All processes refine and stop at the same step.
            self.seconds = float(self._from_first([self.seconds])[0])

    def content_box(self) -> tuple[np.ndarray, np.ndarray]:
        """
        Find the inner box, as `FieldTrainer.content_box`: the first process's in all of them.

        A GPU adds in no fixed order: each would see a little else, and their grids would differ.
        """
        centre, half_extent = self._from_first(np.stack(super().content_box()))
        return centre, half_extent

    def empty_distance(self) -> float:
        """Find what is empty, as `FieldTrainer.empty_distance`: the first process's in all."""
        return float(self._from_first([super().empty_distance()])[0])

    def _from_first(self, values: Sequence[float] | np.ndarray) -> np.ndarray:
        """Return the first process's float64 values in all of them."""
        shared = torch.tensor(values, dtype=torch.float64, device=self.arrays.device)
        if distributed.is_initialized():
            distributed.broadcast(shared, 0)
        return shared.cpu().numpy()

    def _differentiate(self, rays_o: Tensor, rays_d: Tensor, jitter: Tensor, target: Tensor,
                       gain: Tensor, background: Tensor, distance: Tensor
                       ) -> tuple[Tensor, Tensor]:
        """
        Add the loss's gradient to `slope` and mark rows in `hit`.

        rays_o, rays_d (R, 3), jitter (R,), the others (P, 3) per pixel. The loss is that of
        `fitting_kernels.differentiate_rays`. Returns error (P,) and d_gain (P, 3).
        """
        config, arrays = self.config, self.arrays
        samples = arrays.march(rays_o, rays_d, jitter)
        ray = samples.ray
        values = arrays.interpolated(samples, torch.arange(len(ray), device=arrays.device))
        values.requires_grad_()
        weight, light, alpha, distortion = self._weights(samples, values, len(rays_d))
        shown = colours(values[:, 1:], sh_basis(rays_d[ray], arrays.terms))
        coloured = torch.where(weight.detach() >= MIN_WEIGHT, weight, 0.0)[:, None]
        each = self.rays_across ** 2
        behind = light[:, None] * background.repeat_interleave(each, 0)
        colour = (torch.zeros_like(rays_d).index_add(0, ray, coloured * shown) + behind).unflatten(
            0, (-1, each)).mean(1)
        difference = gain * colour - target
        error = (difference ** 2).sum(1)
        own = gain[ray // each] * shown - target[ray // each]
        trust = torch.ones_like(error)
        if config.robust:
            trust = 1 / (1 + error.detach() / config.robust ** 2) ** 2
        rest = (config.distortion * distortion + config.sparsity * alpha.sum()
                + self.pointwise * (trust[ray // each, None] * coloured * own ** 2).sum())
        measured = distance[ray // each]
        off = (samples.t - measured) / (float(DEPTH_SHARE) * measured).clamp_min(1e-6)
        near = torch.where(measured > 0, 1 / (1 + off ** 2), 0.0)
        rest = rest - config.depth * (weight * near).sum()
        slope = torch.autograd.grad(each * (trust * error).sum() + rest, values)[0]
        rows = arrays.rows(samples.base)
        spread = corner_weights(samples.frac)[..., None] * slope[:, None]
        self.slope.index_add_(0, rows.flatten(), spread.flatten(0, 1))
        self.hit[rows.flatten()] = 1
        return error.detach(), (2 * trust[:, None] * difference * colour).detach()

    def _weights(self, samples: Samples, values: Tensor, rays: int
                 ) -> tuple[Tensor, Tensor, Tensor, Tensor]:
        """Return weight (N,), light left behind rays (R,), alpha (N,), the distortion sum."""
        at = (samples.ray, samples.slot)
        longest = int(samples.slot.max()) + 1 if len(samples.slot) else 1
        thickness = softplus(values[:, 0] + self.arrays.shift) * self.arrays.step
        # (R, S): of one ray in a row; light falls by exp(-thickness) from sample to sample.
        table = torch.zeros(rays, longest, device=values.device).index_put(at, thickness)
        before = table.cumsum(1) - table
        alpha = 1 - torch.exp(-table)
        weight = torch.exp(-before) * alpha
        depth = torch.zeros_like(table).index_put(at, samples.t / (samples.t + 1))
        first, moment = weight.cumsum(1) - weight, (weight * depth).cumsum(1) - weight * depth
        distortion = 2 * (weight * (depth * first - moment)).sum()
        return weight[at], torch.exp(-table.sum(1)), alpha[at], distortion

    @torch.no_grad()
    def _adam(self, rate: float) -> None:
        """Step on the rows that were hit only, as `fitting_kernels.adam_step`."""
        rows = self.hit.nonzero()[:, 0]
        slope = self.slope[rows]
        self.counts[rows] += 1
        count = self.counts[rows][:, None].float()
        first, second = self.moments
        first[rows] = 0.9 * first[rows] + 0.1 * slope
        second[rows] = 0.99 * second[rows] + 0.01 * slope ** 2
        self.arrays.grid[rows] -= (
            rate * first[rows] / (1 - 0.9 ** count)
            / ((second[rows] / (1 - 0.99 ** count)).sqrt() + 1e-8))
        self.slope[rows] = 0
        self.hit[rows] = 0

    def state(self) -> dict[str, Any]:
        """Return everything a later `restore` needs, as `FieldTrainer.state`."""
        self.first, self.second = (moment.cpu().numpy() for moment in self.moments)
        self.updates = self.counts.cpu().numpy()
        return super().state()

    def restore(self, state: dict[str, Any]) -> None:
        """Go on from `state`, of this trainer or of the compiled one."""
        super().restore(state)
        for mine, saved in zip((*self.moments, self.counts),
                               (self.first, self.second, self.updates)):
            mine.copy_(torch.from_numpy(saved))
