"""The gradients of the compiled loops, against autograd and against differences."""
from typing import NamedTuple

from neo_ros.field.fitting_kernels import (
    adam_step, Batch, DEPTH_SHARE, differentiate_rays, LossWeights, SampleSlopes,
    scatter_gradients)
from neo_ros.field.voxel_field import VoxelField
import numpy as np
from plain_field import plain_samples, random_rays, room_field
import pytest
import torch

RAYS = 80


class Gradients(NamedTuple):
    """What the kernels make of a batch."""

    grid: np.ndarray
    touched: np.ndarray
    error: np.ndarray
    d_gain: np.ndarray


@pytest.fixture
def batch() -> Batch:
    random = np.random.default_rng(3)
    rays_o, rays_d = random_rays(RAYS, 2)
    jitter = random.random(RAYS, np.float32)
    target, gain, background = (random.random((RAYS, 3), np.float32) for _ in range(3))
    # Every other ray has measured depth.
    distance = np.where(np.arange(RAYS) % 2, random.uniform(0.3, 2, RAYS), 0).astype(np.float32)
    return Batch(rays_o, rays_d, jitter, target, gain, background, distance)


def foggy_field(sh_degree: int) -> VoxelField:
    """Return a small field in which rays have many samples of middling opacity."""
    field = room_field(3000, sh_degree=sh_degree)
    random = np.random.default_rng(1)
    field.grid[:, 0] = field.grid[:, 0] * 0.1 + 5.8 + random.normal(0, 1, len(field.grid))
    field.grid[:, 1:] += random.normal(0, 1, field.grid[:, 1:].shape)
    return field


def differentiate(field: VoxelField, batch: Batch, distortion: float = 0,
                  pointwise: float = 0, sparsity: float = 0, depth: float = 0,
                  robust: float = 0) -> tuple[Gradients, SampleSlopes]:
    rays, limit = len(batch.rays_o), field.sample_limit
    cell, count = np.empty((rays, limit), np.int64), np.empty(rays, np.int64)
    frac, d_rgb = (np.empty((rays, limit, 3), np.float32) for _ in range(2))
    d_density = np.empty((rays, limit), np.float32)
    error, d_gain = np.empty(RAYS, np.float32), np.empty((RAYS, 3), np.float32)
    slopes = SampleSlopes(cell, frac, d_density, d_rgb, count)
    weights = LossWeights(np.float32(distortion), np.float32(pointwise), np.float32(sparsity),
                          np.float32(depth), np.float32(robust))
    differentiate_rays(batch, field.arrays, weights, slopes, error, d_gain)
    gradient, touched = scatter(field, batch, slopes, 2)
    return Gradients(gradient, touched, error, d_gain), slopes


def scatter(field: VoxelField, batch: Batch, slopes: SampleSlopes, threads: int
            ) -> tuple[np.ndarray, np.ndarray]:
    gradient, touched = np.zeros_like(field.grid), np.zeros(len(field.grid), np.uint8)
    scatter_gradients(batch.rays_d, slopes, field.arrays, threads, gradient, touched)
    return gradient, touched


def plain_loss(field: VoxelField, grid: torch.Tensor, gain: torch.Tensor, batch: Batch,
               distortion: float = 0, pointwise: float = 0, sparsity: float = 0,
               depth: float = 0) -> torch.Tensor:
    """Sum over rays of the loss that the kernel's docstring states."""
    samples = plain_samples(field, grid, batch.rays_o, batch.rays_d, batch.jitter)
    target, background = (torch.from_numpy(values).double()
                          for values in (batch.target, batch.background))
    behind = background * samples.light[:, None]
    rays = (samples.weight[..., None] * samples.colour).sum(1) + behind
    error = (gain * rays - target).square().sum()
    place = samples.depth / (samples.depth + 1)
    away = (place[:, :, None] - place[:, None, :]).abs()
    spread = torch.einsum('ri,rij,rj->', samples.weight, away, samples.weight)
    own = (gain[:, None] * samples.colour - target[:, None]).square().sum(-1)
    measured = torch.from_numpy(batch.distance).double()[:, None]
    off = (samples.depth - measured) / (float(DEPTH_SHARE) * measured).clamp_min(1e-9)
    near = torch.where(measured > 0, 1 / (1 + off ** 2), 0.0)
    return (error + distortion * spread + pointwise * (samples.weight * own).sum()
            + sparsity * samples.alpha.sum() - depth * (samples.weight * near).sum())


@pytest.mark.parametrize('sh_degree', [0, 1], ids=['matt', 'shiny'])
@pytest.mark.parametrize('terms', [
    {}, {'distortion': 0.3}, {'pointwise': 0.2}, {'sparsity': 0.1},
    {'depth': 0.4}, {'distortion': 0.3, 'pointwise': 0.2, 'sparsity': 0.1, 'depth': 0.4},
], ids=['colour', 'distortion', 'pointwise', 'sparsity', 'depth', 'all'])
def test_gradients_agree_with_autograd(
        batch: Batch, terms: dict[str, float], sh_degree: int) -> None:
    field = foggy_field(sh_degree)
    found, _ = differentiate(field, batch, **terms)
    grid = torch.from_numpy(field.grid).double().requires_grad_()
    gain = torch.from_numpy(batch.gain).double()
    plain_loss(field, grid, gain, batch, **terms).backward()
    assert grid.grad is not None
    expected = grid.grad.numpy()
    for columns in (slice(0, 1), slice(1, None)):
        scale = np.abs(expected[:, columns]).max()
        np.testing.assert_allclose(
            found.grid[:, columns], expected[:, columns], atol=3e-3 * scale)
    untouched = found.touched == 0
    assert untouched.any() and np.abs(expected[untouched]).max() < 1e-6


def test_gain_gradient_agrees_with_autograd(batch: Batch) -> None:
    field = foggy_field(0)
    found, _ = differentiate(field, batch)
    grid = torch.from_numpy(field.grid).double()
    gain = torch.from_numpy(batch.gain).double().requires_grad_()
    loss = plain_loss(field, grid, gain, batch)
    loss.backward()
    assert gain.grad is not None
    expected = gain.grad.numpy()
    np.testing.assert_allclose(found.d_gain, expected, atol=3e-3 * np.abs(expected).max())
    assert found.error.sum() == pytest.approx(float(loss.detach()), rel=1e-3)


@pytest.mark.parametrize('column', [0, 1, 3], ids=['density', 'constant', 'linear'])
def test_gradients_agree_with_differences(batch: Batch, column: int) -> None:
    field, change = foggy_field(1), 1e-2
    found, _ = differentiate(field, batch)
    for row in np.argsort(-np.abs(found.grid[:, column]))[:6]:
        values = []
        for sign in (1, -1):
            changed = foggy_field(1)
            changed.grid[row, column] += sign * change
            values.append(differentiate(changed, batch)[0].error.sum(dtype=np.float64))
        assert (values[0] - values[1]) / (2 * change) == pytest.approx(
            found.grid[row, column], rel=0.03)


def test_air_that_is_not_kept_gets_no_gradient_and_changes_none(batch: Batch) -> None:
    field = room_field(20_000, sh_degree=1)
    dense, sparse = (field.resampled(30_000, field.centre, field.half_extent, sparse)
                     for sparse in (False, True))
    for one in (dense, sparse):
        one.update_occupancy()
    kept = sparse.row_of >= 0
    assert 0.1 < kept.mean() < 0.9
    expected, found = (differentiate(one, batch, 0.3, 0.2, 0.1)[0] for one in (dense, sparse))
    np.testing.assert_array_equal(found.grid, expected.grid[kept])
    np.testing.assert_array_equal(found.error, expected.error)
    assert np.abs(found.grid).max() > 0.01 and not expected.touched[~kept].any()


def test_the_number_of_threads_does_not_change_a_bit(batch: Batch) -> None:
    field = foggy_field(1)
    _, slopes = differentiate(field, batch, 0.3, 0.2, 0.1)
    gradient, touched = scatter(field, batch, slopes, 1)
    assert touched.sum() > 300
    for threads in (2, 3, 8):
        again, marks = scatter(field, batch, slopes, threads)
        np.testing.assert_array_equal(again, gradient)
        np.testing.assert_array_equal(marks, touched)


def test_adam_steps_touched_rows_as_torch_does() -> None:
    random = np.random.default_rng(0)
    grid = random.normal(size=(50, 4)).astype(np.float32)
    plain = torch.tensor(grid, requires_grad=True)
    optimizer = torch.optim.Adam([plain], lr=0.1, betas=(0.9, 0.99), eps=1e-8)
    first, second, gradient = (np.zeros_like(grid) for _ in range(3))
    updates, touched = np.zeros(50, np.int32), np.zeros(50, np.uint8)
    frozen = grid[:10].copy()
    for _ in range(5):
        gradient[:] = random.normal(size=grid.shape)
        touched[10:] = 1
        plain.grad = torch.from_numpy(gradient.copy())
        optimizer.step()
        gradient[:10] = 0
        adam_step(grid, gradient, first, second, touched, updates, np.float32(0.1))
        assert not gradient.any() and not touched.any()
    np.testing.assert_allclose(grid[10:], plain.detach()[10:], atol=1e-5)
    np.testing.assert_array_equal(grid[:10], frozen)
    assert (updates[10:] == 5).all() and not updates[:10].any()
