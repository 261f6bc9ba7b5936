"""A field fitted tile by tile: here one after the other, or side by side on a Ray cluster."""
from collections.abc import Sequence
from dataclasses import dataclass, field, replace
import math
from pathlib import Path

from neo_ros.baking.worker_files import kept_file, read_part
from neo_ros.experiment import Experiment
from neo_ros.field.config import FieldConfig
from neo_ros.field.device import field_trainer
from neo_ros.field.extent import FineBox
from neo_ros.field.tiles import (
    brightness, cut_floor, EVERYWHERE, joined, photos_of, Tile, tile_edge, TileRules)
from neo_ros.field.voxel_field import VoxelField
from neo_ros.machine.evenly import evenly
from neo_ros.machine.files import make_output_folder
from neo_ros.machine.progress import no_stage_progress, StageProgress
from neo_ros.machine.ray_jobs import make_on_ray
from neo_ros.pictures.depth import MM_PER_M
from neo_ros.scenes.posed_images import PosedImages
from neo_ros.scenes.scene import Scene
from neo_ros.scenes.storeys import floor_height
from neo_ros.training.checkpoint import read_notes, train_with_checkpoints, write_notes
import numpy as np

# Where tiles lie in the output folder until the last one is fitted.
TILES = 'tiles'
FLOOR_PHOTOS = 256  # Of a storey, that tell where its floor is.


def tiles_of(scene: Scene, experiment: Experiment, held_out: Sequence[int] = ()) -> list[Tile]:
    """
    Return the tiles that a scene's field is fitted by: one where it is no large floor.

    held_out: photos that it is not fitted to.
    """
    if experiment.field.tile is None and scene.walkable is None:
        return [EVERYWHERE]  # A hand that holds the camera at two heights makes no storeys.
    return cut_floor(scene.train.T_world_cam[:, :3, 3], _most(experiment.field),
                     held_out=held_out)


def below_floors(tiles: Sequence[Tile], photos: PosedImages, scale: float,
                 rules: TileRules = TileRules()) -> list[Tile]:
    """
    Return the tiles, those of a storey from below its floor on, as far as photos' depth tells it.

    Half-way between the cameras of two storeys, where `cut_floor` cuts, may be the floor of one or
    the ceiling of the other: in the field of neither as it was fitted.
    """
    z = photos.T_world_cam[:, 2, 3]
    border_of = {math.inf: math.inf, -math.inf: -math.inf}
    for border in sorted({tile.low[2] for tile in tiles if math.isfinite(tile.low[2])}):
        high = min(tile.high[2] for tile in tiles if tile.low[2] == border)
        own = np.flatnonzero((z >= border) & (z < high))
        some = photos.subset(own[evenly(len(own), FLOOR_PHOTOS)].tolist())
        under = z[z < border].max()
        floor = floor_height(_heights(some, scale), under, z[own].min())
        border_of[border] = border if floor is None else max(floor - rules.below_floor, under)
    return [replace(tile, low=(*tile.low[:2], border_of[tile.low[2]]),
                    high=(*tile.high[:2], border_of[tile.high[2]])) for tile in tiles]


def _heights(photos: PosedImages, scale: float) -> np.ndarray:
    """Return the heights of all that the photos have depth of, (N,) metres."""
    depths = photos.read_depths(scale)
    if depths is None:
        return np.zeros(0)
    rays = photos.intrinsics.scaled(scale).pixel_rays()
    heights = [T[2, 3] + (depth / MM_PER_M * (rays @ T[2, :3]))[depth > 0]
               for depth, T in zip(depths, photos.T_world_cam)]
    return np.concatenate(heights)


def _most(config: FieldConfig) -> float:
    return TileRules.most if config.tile is None else config.tile


@dataclass(frozen=True)
class TileJob:
    """
    One tile to fit, as a worker on any machine can do it.

    out     where its field comes to lie, with its notes and checkpoint beside it
    edge    of its voxels, metres
    photos  all that the scene's field is fitted to, of which a tile chooses its own
    writes  whether this process writes it, of several that fit it together
    """

    out: Path
    tile: Tile
    edge: float
    photos: PosedImages
    scale: float
    config: FieldConfig
    seed: int
    writes: bool = True

    @property
    def gains(self) -> Path:
        """Where the gains of its photos come to lie."""
        return self.out.with_suffix('.gains.npz')


@dataclass
class _TileFit:
    """How far the fit of a tile is, and who watches it."""

    progress: StageProgress
    seconds: float = 0.0
    log: dict[str, list[list[float]]] = field(default_factory=dict)


def tile_jobs(out: Path, tiles: Sequence[Tile], photos: PosedImages, experiment: Experiment,
              config: FieldConfig, writes: bool = True) -> list[TileJob]:
    """Return what is to be done for the tiles of a run in the folder `out`."""
    edge = tile_edge(config, _most(config))
    folder = (out / TILES).absolute()
    return [TileJob(folder / f'{number:04d}.npz', tile, edge, photos, experiment.field_scale,
                    config, experiment.seed, writes) for number, tile in enumerate(tiles)]


def fit_tile(job: TileJob, progress: StageProgress = no_stage_progress,
             rules: TileRules = TileRules()) -> None:
    """Fit one tile, unless it is finished; a fit that was broken off goes on."""
    if job.out.exists():
        return
    camera = job.photos.intrinsics.scaled(job.scale)
    chosen, crossing = photos_of(job.tile, job.photos.T_world_cam, camera)
    photos = job.photos.subset(chosen)
    usable = photos.read_all_usable(job.scale)
    fine = FineBox(np.array(job.tile.low) - rules.overlap, np.array(job.tile.high) + rules.overlap,
                   job.edge)
    trainer = field_trainer(
        photos.read_images(job.scale), camera, photos.T_world_cam, job.config, job.seed,
        photos.read_depths(job.scale), crossing if usable is None else crossing & usable, fine)
    watched = _TileFit(progress)
    checkpoint = job.out.with_suffix('.ckpt')
    train_with_checkpoints(
        watched, trainer, checkpoint, 'field', lambda: trainer.done, trainer.train_step,
        lambda: f'{trainer.psnr:.2f} dB on its photos', writes=job.writes)
    found = trainer.finished()
    if job.writes:
        with kept_file(job.gains) as file:
            np.savez(file, photos=chosen, log_gain=trainer.camera.log_gain)
        write_notes(job.out.with_suffix('.json'), watched.seconds, watched.log['field'])
        found.save(job.out)
        checkpoint.unlink(missing_ok=True)


def fit_tiles(jobs: Sequence[TileJob], cluster: bool, progress: StageProgress
              ) -> tuple[VoxelField | None, float, list[list[float]]]:
    """
    Fit tiles and join them; return their field, how long that took in all, and their logs.

    cluster hands them to Ray, see `map_on_ray`: all its machines need the same paths. Only the
    process that writes has the field. Raises NeoError where a tile cannot be fitted.
    """
    make_output_folder(jobs[0].out.parent)
    left = [job for job in jobs if not job.out.exists()]
    if cluster and left:
        done = len(jobs) - len(left)
        progress('tiles', done, len(jobs))
        for _ in make_on_ray(fit_tile, left, 'the tile was not fitted'):
            done += 1
            progress('tiles', done, len(jobs))
    else:
        for number, job in enumerate(jobs):
            fit_tile(job, _of_all(progress, number, len(jobs)))
    if not jobs[0].writes:
        return None, 0.0, []
    seconds, log = 0.0, []
    for job in jobs:
        own, rows = read_notes(job.out.with_suffix('.json'), job.out.name)
        log += [[step, seconds + at, value] for step, at, value in rows]
        seconds += own
    progress('joining tiles', 0, 1)
    factors = brightness([_read_gains(job.gains) for job in jobs])
    return joined([job.tile for job in jobs], [job.out for job in jobs], factors), seconds, log


def _read_gains(path: Path) -> tuple[np.ndarray, np.ndarray]:
    if not path.exists():  # A tile of before they were kept.
        return np.zeros(0, int), np.zeros((0, 3))
    found = read_part(path)
    return found['photos'], found['log_gain']


def _of_all(progress: StageProgress, number: int, count: int) -> StageProgress:
    """Show the progress of one of several tiles as that of all."""
    def show(stage: str, done: int, total: int, note: str = '') -> None:
        progress(stage, number * total + done, count * total,
                 f'tile {number + 1} of {count}' + f', {note}' * bool(note))
    return show
