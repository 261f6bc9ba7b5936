"""
The voxel field on a torch device: what `kernels` does ray by ray, done for many rays at once.

The same layout, the same steps and the same thresholds, so both show the same pictures. Made for
CUDA; on a CPU the compiled kernels are several times as fast.
"""
from collections.abc import Iterable, Iterator
import math
from typing import NamedTuple

from neo_ros.field.kernels import MIN_SHOWN, MIN_TRANSMITTANCE
from neo_ros.field.voxel_field import OCCUPIED_ALPHA, VoxelField
import numpy as np
import torch
from torch.nn.functional import max_pool3d, softplus

# Rays that are marched together: as many as fit a GPU well, or the caches of a CPU.
WAVE = {'cuda': 1 << 18, 'cpu': 1 << 14}
# Steps after which the rays that have ended are left out.
COMPACT_EVERY = 6


class Samples(NamedTuple):
    """
    Samples in occupied cells, N of them, in no order across rays; of one ray, slots count up.

    ray, slot, base int64 (N,): ray, number on the ray, grid point at the cell's low corner;
    frac (N, 3) place in the cell; t (N,) metres; before (N,) light that arrives; alpha (N,);
    light (R,) that is left behind each ray's last sample.
    """

    ray: torch.Tensor
    slot: torch.Tensor
    base: torch.Tensor
    frac: torch.Tensor
    t: torch.Tensor
    before: torch.Tensor
    alpha: torch.Tensor
    light: torch.Tensor


class TorchField:
    """
    A `RadianceField` whose arrays are on a torch device.

    grid (V, 1 + 3K) float32; row_of int32, skip and seen uint8 (X * Y * Z,) as in `VoxelField`.
    They are copied once; on a CPU they are those of the voxel field itself.
    """

    def __init__(self, field: VoxelField, device: torch.device) -> None:
        self._home = field
        self.device, self.shape, self.limit = device, field.shape, field.sample_limit
        self.grid = torch.from_numpy(field.grid).to(device)
        self.row_of = torch.from_numpy(field.row_of).to(device)
        self.skip = torch.from_numpy(field.skip).to(device)
        self.seen = torch.from_numpy(field.seen).to(device)
        self.centre = torch.tensor(field.centre, dtype=torch.float32, device=device)
        self.half_extent = torch.tensor(field.half_extent, dtype=torch.float32, device=device)
        self.size = torch.tensor(field.shape, device=device)
        self.shell, self.voxel = field.shell, field.voxel
        self.step, self.near, self.shift = field.step, field.near, field.shift
        sy, sz = field.shape[1], field.shape[2]
        self.corners = torch.tensor(
            [(a * sy + b) * sz + c for a in (0, 1) for b in (0, 1) for c in (0, 1)],
            device=device)

    @property
    def terms(self) -> int:
        """Spherical-harmonic coefficients per colour channel: 1, 4 or 9."""
        return (self.grid.shape[1] - 1) // 3

    def rows(self, base: torch.Tensor) -> torch.Tensor:
        """Rows of the eight corners of cells (N,): int64 (N, 8)."""
        return self.row_of[base[:, None] + self.corners].long()

    def _locate(self, points: torch.Tensor, rays_d: torch.Tensor) -> tuple[torch.Tensor, ...]:
        """Return cell (N,), place in it (N, 3), stretch of a step (N,) and whether it exists."""
        q = (points - self.centre) / self.half_extent
        norm, axis = q.abs().max(1)
        outside = norm > 1
        exists = ~outside | ((norm <= 1000) & (self.shell > 0))
        safe = norm.clamp(min=1)
        shell, extent = self.shell, 1 + self.shell
        squeeze = torch.where(outside, (extent - shell / safe) / safe, 1.0)[:, None]
        # As in `kernels.march`: how fast a ray moves through the grid out there.
        growth = (q.sign() * rays_d / self.half_extent).gather(1, axis[:, None]) * (
            (2 * shell / safe - extent) / (safe * safe))[:, None]
        speed = torch.linalg.norm(squeeze * rays_d + growth * q * self.half_extent, dim=1)
        stretch = torch.where(outside, 1 / speed.clamp(min=1e-9), 1.0)
        q = squeeze * q
        g = (q / extent + 1) * 0.5 * (self.size - 1)
        cell = torch.minimum(g.long().clamp(min=0), self.size - 2)
        base = (cell[:, 0] * self.shape[1] + cell[:, 1]) * self.shape[2] + cell[:, 2]
        return base, g - cell, stretch, exists

    @torch.no_grad()
    def march(self, rays_o: torch.Tensor, rays_d: torch.Tensor,
              jitter: torch.Tensor) -> Samples:
        """Walk unit rays (R, 3) through the field; jitter (R,) is in [0, 1)."""
        length = self.step * self.voxel
        count = len(rays_o)
        light = torch.ones(count, device=self.device)
        ray = torch.arange(count, device=self.device)
        slot = torch.zeros_like(ray)
        t, o, d = self.near + jitter * length, rays_o, rays_d
        alive = torch.ones(count, dtype=torch.bool, device=self.device)
        found: list[tuple[torch.Tensor, ...]] = []
        turn = 0
        while True:
            if turn % COMPACT_EVERY == 0:
                left = alive.nonzero()[:, 0]
                if not len(left):
                    break
                ray, slot, t, o, d, alive = (
                    x[left] for x in (ray, slot, t, o, d, alive))
            turn += 1
            base, frac, stretch, exists = self._locate(o + t[:, None] * d, d)
            alive = alive & exists & (slot < self.limit)
            free = self.skip[base].float()
            here = (alive & (free == 0)).nonzero()[:, 0]
            if len(here):
                density = self._density(base[here], frac[here])
                alpha = 1 - torch.exp(-density * self.step)
                before = light[ray[here]]
                found.append((ray[here], slot[here], base[here], frac[here], t[here], before,
                              alpha))
                after = before * (1 - alpha)
                light[ray[here]] = after
                slot[here] += 1
                alive[here] = after >= MIN_TRANSMITTANCE
            hops = ((free - 1) / self.step).floor().clamp(min=1)
            t = t + torch.where(free > 0, hops, 1.0) * length * stretch
        if not found:
            none = torch.empty(0, device=self.device)
            found = [(none.long(), none.long(), none.long(), none.reshape(0, 3), none, none, none)]
        return Samples._make([*(torch.cat(parts) for parts in zip(*found)), light])

    def _density(self, base: torch.Tensor, frac: torch.Tensor) -> torch.Tensor:
        raw = (corner_weights(frac) * self.grid[self.rows(base), 0]).sum(1) + self.shift
        return softplus(raw)

    def interpolated(self, samples: Samples, chosen: torch.Tensor) -> torch.Tensor:
        """Interpolate all columns of the grid at some of the samples: float32 (M, 1 + 3K)."""
        weights = corner_weights(samples.frac[chosen])
        return torch.einsum('nc,nck->nk', weights, self.grid[self.rows(
            samples.base[chosen])])

    @torch.no_grad()
    def render(self, rays_o: np.ndarray, rays_d: np.ndarray, background: float) -> np.ndarray:
        """Render unit rays (N, 3), as `VoxelField.render`."""
        return torch.cat([self._render(o, d, background)
                          for o, d in self._waves(rays_o, rays_d)]).cpu().numpy()

    def _waves(self, *rays: np.ndarray) -> Iterator[tuple[torch.Tensor, ...]]:
        """Bring rays_o and rays_d to the device, and cut them into what is marched together."""
        return zip(*(torch.tensor(part, device=self.device).split(WAVE[self.device.type])
                     for part in rays))

    def _render(self, rays_o: torch.Tensor, rays_d: torch.Tensor,
                background: float) -> torch.Tensor:
        samples = self.march(rays_o, rays_d, torch.full((len(rays_o),), 0.5, device=self.device))
        out = torch.zeros(len(rays_o), 6, device=self.device)
        weight = samples.before * samples.alpha
        half = 0.5 * (1 + samples.light[samples.ray])
        across = (samples.before > half) & (samples.before - weight <= half)
        depth = samples.t + ((samples.before - half) / weight - 0.5) * self.step * self.voxel
        out[samples.ray[across], 3] = depth[across]
        seen = (self.seen[samples.base] > 0).float()
        out[:, 4:].index_add_(0, samples.ray, torch.stack([weight, weight * seen], 1))
        chosen = (weight >= MIN_SHOWN).nonzero()[:, 0]
        ray = samples.ray[chosen]
        values = self.interpolated(samples, chosen)
        shown = colours(values[:, 1:], sh_basis(rays_d[ray], self.terms))
        out[:, :3] = background
        out[:, :3].index_add_(0, ray, (shown - background) * weight[chosen, None])
        return out

    @torch.no_grad()
    def mark_seen(self, rays: Iterable[tuple[np.ndarray, np.ndarray]]) -> None:
        """Take for seen what photos' rays reach with light left, as `VoxelField.mark_seen`."""
        self.seen.zero_()
        for pair in rays:
            for o, d in self._waves(*pair):
                samples = self.march(o, d, torch.full((len(o),), 0.5, device=self.device))
                self.seen[samples.base[samples.before >= 0.05]] = 1
        self._home.seen = self.seen.cpu().numpy()

    def is_matter(self, points: np.ndarray) -> np.ndarray:
        """Tell which world points (..., 3) lie in cells that are not empty air: bool (...)."""
        return self._home.is_matter(points)

    def home(self) -> VoxelField:
        """Return the field with its arrays in main memory, as they are now."""
        np.copyto(self._home.grid, self.grid.cpu().numpy())
        return self._home

    @torch.no_grad()
    def update_occupancy(self) -> float:
        """Recompute `skip`, as `VoxelField.update_occupancy`; returns the occupied share."""
        share = self._find_free_space()
        self._home.skip = self.skip.cpu().numpy()
        return share

    def _find_free_space(self) -> float:
        # A cell with a corner that is not kept is air.
        raw = torch.where(self.row_of >= 0, self.grid[self.row_of, 0], torch.inf)
        raw = raw.reshape(1, 1, *self.shape)
        best = max_pool3d(raw, 2, stride=1) + self.shift
        best[best == torch.inf] = -torch.inf
        occupied = torch.zeros_like(raw)
        occupied[..., :-1, :-1, :-1] = 1 - torch.exp(-softplus(best) * self.step) > OCCUPIED_ALPHA
        if not occupied.any():
            self.skip.fill_(len(self.grid) < len(self.row_of))
            return 0.0
        share = float(occupied.mean())
        blocks = max_pool3d(occupied, 2, ceil_mode=True)
        distance = torch.zeros_like(blocks)
        for _ in range(128):
            missing = blocks == 0
            if not missing.any():
                break
            distance += missing
            blocks = max_pool3d(blocks, 3, stride=1, padding=1)
        x, y, z = self.shape
        skip = (2 * distance - 1).clamp(1, 255).repeat_interleave(2, 2).repeat_interleave(
            2, 3).repeat_interleave(2, 4)[..., :x, :y, :z]
        self.skip.copy_(torch.where(occupied > 0, 0, skip).flatten())
        return share


def torch_device(name: str) -> torch.device:
    """Return the device that `cuda` or `torch` stands for."""
    return torch.device('cuda' if name == 'cuda' else 'cpu')


def corner_weights(frac: torch.Tensor) -> torch.Tensor:
    """Trilinear weights of the eight corners, in the order of `TorchField.corners`: (N, 8)."""
    low_high = torch.stack([1 - frac, frac], -1)
    x, y, z = low_high.unbind(1)
    return (x[:, :, None, None] * y[:, None, :, None] * z[:, None, None, :]).flatten(1)


def colours(coefficients: torch.Tensor, basis: torch.Tensor) -> torch.Tensor:
    """Evaluate coefficients (N, 3K) in the basis (N, K); returns N colours in (0, 1), (N, 3)."""
    return torch.sigmoid(torch.einsum(
        'nck,nk->nc', coefficients.unflatten(1, (3, basis.shape[1])), basis))


def sh_basis(directions: torch.Tensor, terms: int) -> torch.Tensor:
    """Real spherical harmonics of unit directions (N, 3) up to 1, 4 or 9 terms: (N, terms)."""
    x, y, z = directions.unbind(1)
    linear = math.sqrt(3 / (4 * math.pi))
    basis = [torch.full_like(x, 0.28209479), -linear * y, linear * z, -linear * x]
    if terms > 4:
        basis += [1.09254843 * x * y, -1.09254843 * y * z,
                  0.31539157 * (2 * z * z - x * x - y * y), -1.09254843 * x * z,
                  0.54627421 * (x * x - y * y)]
    return torch.stack(basis[:terms], 1)
