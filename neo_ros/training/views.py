"""Step 2 of the paper: the wide views that a run trains its outpainter on, and validates it on."""
from collections.abc import Sequence
from dataclasses import dataclass, replace
from typing import Any, Self

from neo_ros.errors import ConfigError
from neo_ros.field.free_space import find_free_floor
from neo_ros.field.radiance_field import RadianceField
from neo_ros.geometry import CameraPose, ViewExpansion
from neo_ros.machine.evenly import evenly
from neo_ros.outpaint.pair_stream import PairStream, source_view_enlarged
from neo_ros.outpaint.panorama_cache import PanoramaCache
from neo_ros.outpaint.real_centres import RealCentres
from neo_ros.scenes.pose_sampling import PoseSampler
from neo_ros.scenes.posed_images import PosedImages
from neo_ros.training.pose_map import draw_poses, write_poses
from neo_ros.training.run import TrainingRun
import numpy as np


@dataclass(frozen=True)
class ValidationRules:
    """How many of the held-out photos a training looks at."""

    views: int = 32        # at the network's size: what the field renders in some seconds
    large_views: int = 8   # at the camera's, where that is larger and the field slow


def held_out_views(run: TrainingRun, field: RadianceField,
                   rules: ValidationRules = ValidationRules()) -> np.ndarray | None:
    """Return the views of `held_out_wide_views` at the network's size, and more of them."""
    return _held_out(run, field, run.network_expansion, run.experiment.network_scale,
                     rules.views)


def held_out_wide_views(run: TrainingRun, field: RadianceField) -> np.ndarray | None:
    """
    Return wide views RGBA uint8 (N, H, W, 4) of photos that nothing was trained on.

    The photo is in the middle, and all of it where it shows more than the source view; around
    it is what the field shows there, as no wider photo exists.
    """
    return _held_out(run, field, run.expansion, run.experiment.scale, _wide_views(run))


def calibration_views(run: TrainingRun, field: RadianceField, held_out: np.ndarray | None
                      ) -> np.ndarray | None:
    """Return wide views for the confidence; held_out: those of `held_out_views`."""
    # The network's size may be the camera's.
    return (held_out if run.experiment.network.shrink == 1
            else held_out_wide_views(run, field))


def held_out_poses(run: TrainingRun) -> list[CameraPose]:
    """Return the poses of `held_out_wide_views`."""
    assert run.held_out is not None
    return [run.held_out.poses[index] for index in _shown(run.held_out, _wide_views(run))]


def _wide_views(run: TrainingRun, rules: ValidationRules = ValidationRules()) -> int:
    return rules.views if run.experiment.network.shrink == 1 else rules.large_views


def _held_out(run: TrainingRun, field: RadianceField, expansion: ViewExpansion, scale: float,
              most: int) -> np.ndarray | None:
    if run.held_out is None:
        return None
    real = RealCentres(field, run.held_out, expansion, scale)
    return real.views(_shown(run.held_out, most))


def _shown(photos: PosedImages, most: int) -> list[int]:
    count = min(most, len(photos))
    return np.linspace(0, len(photos) - 1, count).astype(int).tolist()


def make_stream(run: TrainingRun, field: RadianceField, seed: int) -> PairStream:
    """Make the stream of training views that the experiment asks for."""
    experiment, expansion = run.experiment, run.network_expansion
    config = experiment.outpaint
    view = (expansion.target if config.training_view == 'wide'
            else source_view_enlarged(expansion))
    real = (RealCentres(field, run.fitted, expansion, experiment.network_scale)
            if config.real_centre > 0 else None)
    # Processes that train together differ in their seeds, and so in their panoramas.
    cache = (PanoramaCache(run.out / f'panoramas_{seed}', 1e9 * run.cache_gb)
             if run.cache_gb else None)
    stream = PairStream(field, make_sampler(run, field), view, experiment.sampling.positions,
                        seed, real, config.real_centre, cache)
    stream.pool.progress = lambda done, total: run.progress('panoramas', done, total, '')
    sharp_only, by_photos = experiment.sampling.sharp_only, run.sampling_area == 'photos'
    if sharp_only is None:
        sharp_only = by_photos
    if sharp_only or by_photos:
        stream.pool.measure_photos(run.fitted, experiment.network_scale, sharp_only)
    return stream


def make_sampler(run: TrainingRun, field: RadianceField | None) -> PoseSampler:
    """Choose poses where the experiment says; only `free_space` needs the field."""
    config, area = run.experiment.sampling, run.sampling_area
    if area == 'photos':
        return PoseSampler.around_photos(run.scene.train, config)
    floor = run.scene.walkable
    if area == 'free_space':
        assert field is not None
        floor = find_free_floor(field, run.scene.train, config)
    if floor is None:
        raise ConfigError(
            f'sampling.area: {area} needs walkable.json in the scene folder, there is none; '
            'make it with neo floor, or choose free_space or photos')
    return PoseSampler.for_walkable(
        floor, config, () if area == 'free_space' else run.scene.upper, run.scene.train)


def note_poses(run: TrainingRun, stream: PairStream, steps: int) -> None:
    """Leave the counts and the map of the poses of `steps` batches in the output folder."""
    pool = stream.pool
    stream.render_for(steps - 1)
    positions = np.stack([panorama.position for panorama in pool.panoramas])
    write_poses(run.out, pool.summary(), draw_poses(
        pool.sampler, positions, np.array(pool.refused_positions).reshape(-1, 3),
        run.scene.train))


@dataclass(frozen=True)
class RealFrames(Sequence[np.ndarray]):
    """Narrow views, uint8 (h, w, 3), of chosen photos; one is read when it is looked at."""

    photos: PosedImages
    chosen: Sequence[int]
    scale: float
    window: tuple[slice, slice]

    @classmethod
    def of(cls, run: TrainingRun, count: int, photos: PosedImages) -> Self:
        """Choose evenly; hundreds of large photos would fill the memory."""
        window = photos.intrinsics.scaled(run.experiment.scale).window(run.expansion.source)
        return cls(photos, evenly(len(photos), count).tolist(), run.experiment.scale, window)

    def __len__(self) -> int:
        return len(self.chosen)

    def __getitem__(self, place: Any) -> Any:
        if isinstance(place, slice):
            return replace(self, chosen=self.chosen[place])
        # A copy: a window would keep the whole photo.
        return self.photos.read_image(self.chosen[place], self.scale)[self.window].copy()


def real_frames(run: TrainingRun, count: int, photos: PosedImages | None = None) -> np.ndarray:
    """
    Read narrow views, uint8 (N, h, w, 3), evenly out of photos.

    Without `photos`, out of those that the field was not shown.
    """
    return np.stack(RealFrames.of(run, count, photos or run.held_out or run.fitted))


class RealUsable(RealFrames):
    """Which pixels of such views show the scene, bool (h, w) each."""

    def __getitem__(self, place: Any) -> Any:
        if isinstance(place, slice):
            return super().__getitem__(place)
        usable = self.photos.read_usable(self.chosen[place], self.scale)
        if usable is None:
            camera = self.photos.intrinsics.scaled(self.scale)
            usable = np.ones((camera.height, camera.width), bool)
        return usable[self.window]


def real_usable(run: TrainingRun, count: int, photos: PosedImages) -> RealUsable | None:
    """Return which pixels of `real_frames` show the scene; None without masks."""
    return RealUsable.of(run, count, photos) if any(photos.mask_paths) else None
