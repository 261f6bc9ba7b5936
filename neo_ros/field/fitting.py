"""Step 1 of the paper: fit a radiance field to posed photos of one scene."""
from collections.abc import Iterator
from dataclasses import dataclass
import math
import time
from typing import Any

from neo_ros.errors import SceneError
from neo_ros.field.camera_model import CameraModel, photo_shares
from neo_ros.field.config import FieldConfig, fit_near
from neo_ros.field.extent import content_box, FineBox, nearest_content
from neo_ros.field.fitting_kernels import (
    adam_step, Batch, differentiate_rays, LossWeights, SampleSlopes, scatter_gradients)
from neo_ros.field.grid_points import packed, unpacked
from neo_ros.field.radiance_field import FittedField
from neo_ros.field.rendering import render_rays
from neo_ros.field.voxel_field import VoxelField
from neo_ros.geometry import Intrinsics
from neo_ros.pictures.depth import MM_PER_M
from neo_ros.pictures.usable import draw_usable
from numba import get_num_threads
import numpy as np

# Share of the fit at which the grid is refined, and the share of voxels it then has.
STAGES = ((0.0, 1 / 64), (0.06, 1 / 64), (0.18, 1 / 8), (0.4, 1.0))
# Of an update: pixels that are a smaller share of all are drawn out of a list of them.
FEW_USABLE = 0.05


@dataclass(frozen=True)
class FitRules:
    """What was chosen by measuring, and holds for all scenes."""

    fine_voxels: int = 9_000_000    # from so many on voxels are finer than pixels, mostly
    occupancy_every: int = 100      # steps
    least_steps: int = 300          # however short the time, with fewer steps a field is fog
    # Views leave out a share of how near the nearest photo came to anything, with so many percent
    # of its pixels. But a camera may come nearer than any photo: no more than so many metres.
    near_share: float = 0.75
    nearest_percent: float = 5
    most_near: float = 0.5
    near_pixels: int = 400          # pixels of each photo that are asked for it


class FieldTrainer:
    """The optimiser's state; one call of `train_step` is one batch."""

    def __init__(self, images: np.ndarray, intrinsics: Intrinsics, T_world_cam: np.ndarray,
                 config: FieldConfig, seed: int, rules: FitRules = FitRules(),
                 depths: np.ndarray | None = None, usable: np.ndarray | None = None,
                 fine: FineBox | None = None) -> None:
        """
        Take photos uint8 (N, H, W, 3), their camera and T_world_cam (N, 4, 4).

        depths: uint16 (N, H, W), millimetres along the optical axis, 0 = unknown.
        usable: bool (N, H, W), False where a photo does not show the scene; None: it does.
        fine: where the fine voxels may lie; None: around all that the photos see.
        """
        self.images, self.config, self.rules, self.depths = images, config, rules, depths
        self.fine = fine
        self.usable = usable
        if usable is not None and not usable.any():
            raise SceneError('masks: expected pixels that are not left out, there are none')
        self.rotations = T_world_cam[:, :3, :3].astype(np.float32)
        self.origins = T_world_cam[:, :3, 3].astype(np.float32)
        self.camera = CameraModel(len(images), intrinsics, config)
        self.shares = photo_shares(images, config.sharpness)
        # Through the pixels' centres, and those of their quarters: (H, W, 3), (2 H, 2 W, 3).
        self.rays = {across: intrinsics.scaled(across).pixel_rays() for across in (1, 2)}
        self.seed = seed
        self.step = self.stage = self.boxed_at = 0
        self.seconds = self.psnr = 0.0
        low, high = self.origins.min(0) - config.margin, self.origins.max(0) + config.margin
        self.field = VoxelField.empty(
            int(config.voxels * STAGES[0][1]), (low + high) / 2, (high - low) / 2,
            config.shell, config.sh_degree, near=fit_near(config.near))
        self.view_near = self.field.near if config.near is None else config.near
        self._fixed: np.ndarray | None = None
        self._few: np.ndarray | None = None  # The usable pixels, where they are too few to meet.
        self._allocate()

    def change_only(self, field: VoxelField, points: np.ndarray) -> None:
        """Go on from a field that is fitted; of its grid points these, bool (X, Y, Z), change."""
        self.field, self.stage = field, len(STAGES) - 1
        self._allocate()
        self._fixed = np.ones(len(field.grid), bool)
        self._fixed[field.row_of[points.ravel() & (field.row_of >= 0)]] = False
        self._few = None
        if self.usable is not None and self.shares is None and self.usable.mean() < FEW_USABLE:
            self._few = np.flatnonzero(self.usable)

    @property
    def placed(self) -> FittedField:
        """The field where it is fitted."""
        return self.field

    def _allocate(self) -> None:
        """Make the optimiser's buffers for the present grid."""
        grid = self.field.grid
        self.gradient = np.zeros_like(grid)
        self.first = np.zeros_like(grid)
        self.second = np.zeros_like(grid)
        self.touched = np.zeros(len(grid), np.uint8)
        self.updates = np.zeros(len(grid), np.int32)
        rays = self.config.rays_per_step
        limit = self.field.sample_limit
        self.slopes = SampleSlopes(
            np.empty((rays, limit), np.int64), np.empty((rays, limit, 3), np.float32),
            np.empty((rays, limit), np.float32), np.empty((rays, limit, 3), np.float32),
            np.empty(rays, np.int64))

    def sample_rays(self) -> tuple[np.ndarray, ...]:
        """
        Draw pixels; returns photo index (P,), target (P, 3), distance, away, rays_o, rays_d.

        distance and away (P,), see `CameraModel`; rays (R, 3).

        A ray goes through its pixel's centre: rays through all of a pixel, each fitted to the
        pixel's colour, would blur the field by a pixel once more. Where voxels are finer than
        pixels, the mean of four is fitted to it; they follow one another.
        """
        across = self.rays_across
        photo, row, column = draw_usable(
            self.random, self.config.rays_per_step // across ** 2, self.images.shape[:3],
            self.usable, self.shares, self._few)
        target = self.images[photo, row, column].astype(np.float32) / 255
        part = np.arange(across)
        rows = (across * row[:, None] + part.repeat(across)).ravel()
        columns = (across * column[:, None] + np.tile(part, across)).ravel()
        each = photo.repeat(across ** 2)
        directions = np.einsum('pij,pj->pi', self.rotations[each],
                               self.rays[across][rows, columns])
        directions /= np.linalg.norm(directions, axis=-1, keepdims=True)
        return (photo, target, self._distances(photo, row, column), self.camera.away[row, column],
                self.origins[each], directions)

    def _distances(self, photo: np.ndarray, row: np.ndarray, column: np.ndarray) -> np.ndarray:
        """Return float32 (P,), metres along the rays of pixels to measured depth, 0 = unknown."""
        if self.depths is None:
            return np.zeros(len(photo), np.float32)
        # Pixel rays have length 1 along the optical axis.
        stretch = np.linalg.norm(self.rays[1][row, column], axis=-1)
        return (self.depths[photo, row, column] / MM_PER_M * stretch).astype(np.float32)

    @property
    def rays_across(self) -> int:
        """Rays through a pixel, across it and down."""
        fine = self.config.voxels >= self.rules.fine_voxels and self.stage + 1 == len(STAGES)
        return 2 if fine else 1

    @property
    def pointwise(self) -> float:
        """Weight of the samples' own colour error; none has to show a pixel's mean colour."""
        return self.config.pointwise if self.rays_across == 1 else 0.0

    @property
    def share(self) -> float:
        """How far the fit is: 0 at the beginning, 1 and more at the end."""
        if self.config.minutes is None:
            return self.step / self.config.steps
        return min(self.seconds / 60 / self.config.minutes, self.step / self.rules.least_steps)

    @property
    def done(self) -> tuple[int, int]:
        """How far the fit is and where it ends: steps, or seconds with `minutes`."""
        if self.config.minutes is None:
            return self.step, self.config.steps
        total = math.ceil(60 * self.config.minutes)
        return int(total * min(self.share, 1)), total

    def train_step(self) -> None:
        """Take one optimiser step, refining the grid and its occupancy when they are due."""
        started = time.monotonic()
        # A generator per step: a resumed training draws what an unbroken one would.
        self.random = np.random.default_rng([self.seed, self.step])
        self._refine_when_due()
        config, field = self.config, self.field
        photo, target, distance, away, rays_o, rays_d = self.sample_rays()
        pixels = len(target)
        error = np.empty(pixels, np.float32)
        d_gain = np.empty((pixels, 3), np.float32)
        gain = self.camera.gains(photo, away)
        arrays = field.arrays
        jitter = self.random.random(len(rays_o), np.float32)
        background = self.random.random((pixels, 3), np.float32)
        weights = LossWeights(np.float32(config.distortion), np.float32(self.pointwise),
                              np.float32(config.sparsity), np.float32(config.depth),
                              np.float32(config.robust))
        differentiate_rays(Batch(rays_o, rays_d, jitter, target, gain, background, distance),
                           arrays, weights, self.slopes, error, d_gain)
        scatter_gradients(
            rays_d, self.slopes, arrays, get_num_threads(), self.gradient, self.touched)
        if self._fixed is not None:
            self.touched[self._fixed] = 0
        rate = np.float32(config.learning_rate * 0.1 ** self.share)
        adam_step(
            field.grid, self.gradient, self.first, self.second, self.touched, self.updates, rate)
        self.camera.learn(photo, away, d_gain * gain)
        smoothing = 0.98 if self.step else 0.0
        psnr = -10 * math.log10(max(float(error.mean()) / 3, 1e-10))
        self.psnr = smoothing * self.psnr + (1 - smoothing) * psnr
        self.step += 1
        self.seconds += time.monotonic() - started

    def _refine_when_due(self) -> None:
        if self.stage + 1 < len(STAGES) and self.share >= STAGES[self.stage + 1][0]:
            self.stage += 1
            self.camera.refined(self.stage + 1 == len(STAGES))
            if self.stage == 1 and self.config.near is None:
                self.view_near = self.empty_distance()
            self.field = self._refined(self.placed.home(), self.stage + 1 == len(STAGES))
            self._allocate()
            if self.stage == 1:
                self.boxed_at = self.step
            else:
                self.placed.update_occupancy()
        elif (self.stage and self.step > self.boxed_at + self.rules.occupancy_every
              and self.step % self.rules.occupancy_every == 0):
            self.placed.update_occupancy()

    def _refined(self, field: VoxelField, last: bool) -> VoxelField:
        centre, half_extent = self.content_box()
        if not last or self.fine is None:
            return field.resampled(int(self.config.voxels * STAGES[self.stage][1]), centre,
                                   half_extent, sparse=last)
        return field.onto(VoxelField.on_lattice(
            centre - half_extent, centre + half_extent, self.fine.edge, field.shell,
            self.config.sh_degree, step=field.step, near=field.near,
            initial_alpha=field.initial_alpha), sparse=True)

    @property
    def figure(self) -> float:
        """What a log of the training shows: the smoothed PSNR on its own photos, dB."""
        return self.psnr

    def state(self) -> dict[str, Any]:
        """Return everything a later `restore` needs to go on."""
        field = self.placed.home()
        return {'step': self.step, 'stage': self.stage, 'boxed_at': self.boxed_at,
                'seconds': self.seconds, 'psnr': self.psnr, **self.camera.state(),
                'view_near': self.view_near,
                'grid': field.grid, 'shape': list(field.shape), 'kept': packed(field.row_of),
                'skip': field.skip, 'centre': field.centre, 'half_extent': field.half_extent,
                'first': self.first, 'second': self.second, 'updates': self.updates}

    def restore(self, state: dict[str, Any]) -> None:
        """Go on from `state`; arrays may be tensors."""
        for name in ('step', 'stage', 'boxed_at', 'seconds', 'psnr', 'view_near'):
            setattr(self, name, state[name])
        arrays = {key: np.asarray(value) for key, value in state.items()}
        self.camera.restore(arrays)
        self.field = VoxelField(
            arrays['grid'], tuple(state['shape']), arrays['centre'], arrays['half_extent'],
            self.config.shell, near=fit_near(self.config.near),
            row_of=unpacked(arrays['kept'], state['shape']))
        self.field.skip = arrays['skip']
        self._allocate()
        self.first, self.second, self.updates = (
            arrays['first'], arrays['second'], arrays['updates'])

    def content_box(self) -> tuple[np.ndarray, np.ndarray]:
        """Find the inner box from what a coarse field shows: centre and half extent (3,)."""
        *_, rays_o, rays_d = self.sample_rays()
        return content_box(self.field, render_rays(self.placed, rays_o, rays_d), rays_o, rays_d,
                           self.origins, self.fine)

    def empty_distance(self) -> float:
        """Find how many metres before the lens are empty, from what a coarse field shows."""
        stride = max(int(math.sqrt(self.images[0, ..., 0].size / self.rules.near_pixels)), 1)
        nearest = nearest_content(self.placed, self.photo_rays(stride), self.rules.nearest_percent)
        return (min(self.rules.near_share * nearest, self.rules.most_near)
                if nearest < math.inf else self.view_near)

    def finished(self) -> VoxelField:
        """
        Return the fitted field with its coverage marked, without what no photo reached.

        Nothing says what is there, and poses that no photo was near would look into it.
        """
        if self.placed.update_occupancy() == 0:
            raise SceneError(
                'field: the photos left nothing in it; are the poses right (OpenGL camera axes, '
                'metres), and field.steps enough?')
        self.placed.mark_seen(self.photo_rays())
        found = self.placed.home().of_seen_cells()
        found.near = self.view_near
        return found

    def photo_rays(self, stride: int = 1) -> Iterator[tuple[np.ndarray, np.ndarray]]:
        """Yield each photo's rays_o and rays_d (R, 3), through every `stride`th row and column."""
        directions = self.rays[1][::stride, ::stride].reshape(-1, 3)
        for photo, (rotation, origin) in enumerate(zip(self.rotations, self.origins)):
            rays_d = directions @ rotation.T
            if self.usable is not None:
                rays_d = rays_d[self.usable[photo, ::stride, ::stride].ravel()]
                if not len(rays_d):
                    continue
            rays_d /= np.linalg.norm(rays_d, axis=-1, keepdims=True)
            yield np.broadcast_to(origin, rays_d.shape).copy(), rays_d
