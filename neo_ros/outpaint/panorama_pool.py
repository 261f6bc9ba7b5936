"""Panoramas at places where the robot can be, and the views that are worth learning from."""
from collections import Counter
from dataclasses import dataclass
from typing import Any

from neo_ros.errors import SceneError
from neo_ros.field.panorama import Panorama, panorama_size, render_panorama, view_band
from neo_ros.field.radiance_field import RadianceField
from neo_ros.field.view_cutting import view_cutter
from neo_ros.geometry import Intrinsics
from neo_ros.machine.evenly import evenly
from neo_ros.machine.progress import no_progress, Progress
from neo_ros.outpaint.panorama_cache import DrawnPanorama, PanoramaCache
from neo_ros.pictures.sharpness import blur_threshold, relative_sharpness
from neo_ros.scenes.pose_sampling import PoseSampler
from neo_ros.scenes.posed_images import PosedImages
import numpy as np
import torch


@dataclass(frozen=True)
class PoolRules:
    """Which positions and views are worth learning from; chosen by measuring."""

    # A view of which no photo saw even half teaches little. A position with hardly any other view
    # lies inside matter or outside the scene.
    least_coverage: float = 0.5
    least_good_views: float = 0.2
    # Where half of all rays meet nothing, or end right in front of the lens, there is no room.
    least_opacity: float = 0.5
    most_blocked: float = 0.5
    tries: int = 200
    audited_views: int = 300
    measured_photos: int = 200     # for their sharpness; rendered at so many of them
    rendered_photos: int = 16


class PanoramaPool:
    """
    Up to `positions` panoramas, rendered one after the other at positions that the sampler draws.

    Positions inside matter, where there is nothing, and where photos saw too little are drawn
    again; so are views of which photos saw too little. After `measure_photos` blurred views
    are, too, and positions where most are. `refused` counts positions by reason. A cache keeps
    them in files. Views are cut where the field is: on a GPU, or by OpenCV.
    """

    def __init__(self, field: RadianceField, sampler: PoseSampler, view: Intrinsics,
                 positions: int, seed: int, cache: PanoramaCache | None = None,
                 rules: PoolRules = PoolRules()) -> None:
        self.field, self.sampler, self.view, self.rules = field, sampler, view, rules
        self.positions, self.seed, self.cache = positions, seed, cache
        self.device = field.device
        self.cut_view = view_cutter(field, view)
        self.least_sharpness, self.least_opacity = 0.0, rules.least_opacity
        # Told of work that keeps a training waiting: several panoramas at once.
        self.progress: Progress = no_progress
        self.panoramas: list[Panorama] = []
        self.refused: Counter[str] = Counter()
        self.refused_positions: list[np.ndarray] = []
        random = np.random.default_rng([seed, 0])
        self.band = view_band(
            view, np.stack([sampler.draw_rotation(random) for _ in range(500)]),
            sampler.yaw_range)
        self.glance_rotations = [sampler.draw_rotation(random) for _ in range(20)]

    def measure_photos(self, photos: PosedImages, scale: float, sharp_only: bool = True) -> None:
        """
        Refuse from now on places where there is little, and blurred views, by the photos' measure.

        Blurred views are refused if `sharp_only`. The threshold of sharpness is that at which a
        photo is an outlier among the photos, times how sharp a wide view at the place of a photo
        is, compared with the photo (median): a field is softer than photos everywhere, and only
        what is blurred beyond that says nothing. There is little where the opacity all around is
        below `least_opacity` of that at photos' places (median): where all photos look one way,
        nothing lies behind them.
        """
        chosen = evenly(len(photos), self.rules.measured_photos)
        sharp = np.array([relative_sharpness(photos.read_image(i, scale)) for i in chosen])
        kept, opacity = [], []
        for place in evenly(len(chosen), self.rules.rendered_photos):
            pose = photos.poses[chosen[place]]
            panorama = render_panorama(self.field, pose.position, self.view, self.band)
            view = self.cut_view(panorama, pose.T_world_cam[:3, :3])
            kept.append(_sharpness(view) / max(sharp[place], 1e-9))
            opacity.append(panorama.opacity)
        if sharp_only:
            self.least_sharpness = blur_threshold(sharp) * float(np.median(kept))
        self.least_opacity = self.rules.least_opacity * float(np.median(opacity))

    def fill(self, count: int) -> int:
        """Render until there are `count` panoramas or all; returns how many are to be used."""
        ready, before = min(count, self.positions), len(self.panoramas)
        while len(self.panoramas) < ready:
            self._add_position()
            if ready - before > 1:
                self.progress(len(self.panoramas) - before, ready - before)
        return ready

    def draw_view(self, index: int, random: np.random.Generator) -> torch.Tensor:
        """Cut a view in a new orientation out of panorama `index`: RGBA uint8 (H, W, 4)."""
        for _ in range(self.rules.tries):
            view = self._cut(index, random)
            if self._view_refusal(view) is None:
                break
        return view

    def summary(self) -> dict[str, Any]:
        """
        Tell what was drawn and refused, by reason; of views by drawing some hundred once more.

        The same after a training that ran through and one that was broken off.
        """
        random = np.random.default_rng([self.seed, 3])
        refused: Counter[str] = Counter()
        for index in random.integers(len(self.panoramas), size=self.rules.audited_views):
            reason = self._view_refusal(self._cut(int(index), random))
            refused.update([] if reason is None else [reason])
        return {
            'grid_positions': len(self.sampler.positions_xy), 'yaws': self.sampler.yaws,
            'drawn_positions': len(self.panoramas) + self.refused.total(),
            'positions': len(self.panoramas), 'refused_positions': dict(self.refused),
            'drawn_views': self.rules.audited_views, 'refused_views': dict(refused),
            'least_sharpness': self.least_sharpness}

    def _add_position(self) -> None:
        index = len(self.panoramas)
        size = panorama_size(self.view, self.band)
        drawn = self.cache.read(index, self.band, size) if self.cache else None
        if drawn is None:
            drawn = self._draw(index)
            if self.cache:
                drawn = self.cache.write(index, drawn)
        self.panoramas.append(drawn.panorama)
        self.refused.update(reason for reason, _ in drawn.refused)
        self.refused_positions += [position for _, position in drawn.refused]

    def _draw(self, index: int) -> DrawnPanorama:
        # A generator per panorama: those that come out of the cache need not be drawn again.
        random = np.random.default_rng([self.seed, 1, index])
        refused: list[tuple[str, np.ndarray]] = []
        for _ in range(self.rules.tries):
            position = self.sampler.draw_position(random)
            panorama = render_panorama(self.field, position, self.view, self.band)
            reason = self._refusal(panorama)
            if reason is None:
                return DrawnPanorama(panorama, refused)
            refused.append((reason, position))
        found = ', '.join(sorted({reason for reason, _ in refused}))
        raise SceneError(
            f'pair stream: {self.rules.tries} positions in a row show nothing to learn from '
            f'({found}); does the floor map belong to this scene?')

    def _refusal(self, panorama: Panorama) -> str | None:
        """Say why a position is of no use, None if it is of use."""
        if panorama.blocked > self.rules.most_blocked:
            return 'in matter'
        if panorama.opacity < self.least_opacity:
            return 'nothing there'
        glance = self.view.scaled(16 / self.view.width)
        good = [covered(torch.from_numpy(panorama.cut_view(glance, rotation)), self.rules)
                for rotation in self.glance_rotations]
        if np.mean(good) < self.rules.least_good_views:
            return 'not seen by photos'
        good = [self._view_refusal(self.cut_view(panorama, rotation)) is None
                for rotation in self.glance_rotations if self.least_sharpness]
        return 'blurred' if good and np.mean(good) < self.rules.least_good_views else None

    def _cut(self, index: int, random: np.random.Generator) -> torch.Tensor:
        return self.cut_view(self.panoramas[index], self.sampler.draw_rotation(random, index))

    def _view_refusal(self, view: torch.Tensor) -> str | None:
        if not covered(view, self.rules):
            return 'not seen by photos'
        if self.least_sharpness and _sharpness(view) < self.least_sharpness:
            return 'blurred'
        return None


def covered(view: torch.Tensor, rules: PoolRules = PoolRules()) -> bool:
    """Tell whether photos saw enough of an RGBA uint8 view (H, W, 4) to learn from it."""
    return bool(view[..., 3].float().mean() > 255 * rules.least_coverage)


def _sharpness(view: torch.Tensor) -> float:
    return relative_sharpness(view[..., :3].cpu().numpy())
