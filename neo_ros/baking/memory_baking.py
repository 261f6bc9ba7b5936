"""
Make the scene memory out of a field and photos: its keyframes, one after the other or by Ray.

Finished keyframes lie in a folder, each a file, until all are there.
"""
from collections.abc import Iterator
from dataclasses import dataclass, replace
import math
from pathlib import Path
import time

import cv2
from neo_ros.baking.glances import glance_rotations, keyframe_glances, photo_glances
from neo_ros.baking.keyframes import (
    bake_keyframe, BakingRules, keyframe_positions, keyframe_size, MemoryConfig, Photos,
    seeing_camera)
from neo_ros.baking.plain_surfaces import hand_held
from neo_ros.baking.seen_depth import depth_here, depth_on_ray
from neo_ros.baking.worker_files import keep_array, kept_file, read_part, SharedScene
from neo_ros.errors import NeoError
from neo_ros.field.panorama import view_band
from neo_ros.field.radiance_field import RadianceField
from neo_ros.field.rendering import render_rays, to_uint8, world_rays
from neo_ros.geometry import Band, CameraPose, Intrinsics, ViewExpansion
from neo_ros.machine.progress import no_stage_progress, of_stage, Progress, StageProgress
from neo_ros.machine.ray_jobs import make_on_ray
from neo_ros.memory.keyframe import compress
from neo_ros.memory.scene_memory import Glances, SceneMemory
from neo_ros.scenes.pose_sampling import PoseSampler
import numpy as np

Finished = tuple[bytes, bytes, Glances]  # texture, depth and glances of a keyframe


@dataclass(frozen=True, eq=False)
class Recipe:
    """
    What all keyframes of a memory have in common.

    photos, seen, gains, directions: as `bake_keyframe` takes them; rotations: of the glances that
    a camera `source` takes from each.
    """

    photos: Photos
    seen: np.ndarray
    gains: np.ndarray
    band: Band
    size: tuple[int, int, int]
    rules: BakingRules
    directions: np.ndarray
    source: Intrinsics
    rotations: list[np.ndarray]

    def make(self, field: RadianceField, position: np.ndarray) -> Finished:
        """Make the keyframe at a position; one is 70 MB for a camera of 640 pixels, so packed."""
        keyframe = bake_keyframe(field, self.photos, self.seen, self.gains, position, self.band,
                                 self.size, self.rules, self.directions)
        return (*compress(keyframe),
                keyframe_glances([keyframe], self.band, self.source, self.rotations))


@dataclass(frozen=True, eq=False)
class KeyframeJob:
    """
    One keyframe to make, as a worker on any machine can do it.

    out: where it comes to lie; recipe: without photos and how far they see, of which a worker
    reads those near its keyframe alone
    """

    out: Path
    position: np.ndarray
    recipe: Recipe
    scene: SharedScene
    seen: Path


def bake_memory(field: RadianceField, photos: Photos, expansion: ViewExpansion,
                sampler: PoseSampler, config: MemoryConfig, seed: int, work: Path,
                progress: StageProgress = no_stage_progress, rules: BakingRules = BakingRules(),
                seconds: float = math.inf, scene: SharedScene | None = None) -> SceneMemory:
    """
    Render and colour the keyframes of `keyframe_positions`, and take glances from them.

    Finished keyframes lie in the folder `work`, and are not made again. In fewer `seconds` than
    all of them take, the first are made: each is as far from the ones before as can be. scene:
    field and photos where Ray's workers find them, who then make the keyframes, to the same bytes.
    """
    ends = time.monotonic() + seconds
    random = np.random.default_rng([seed, 3])
    band = view_band(expansion.target,
                     np.stack([sampler.draw_rotation(random) for _ in range(500)]),
                     sampler.yaw_range)
    positions = keyframe_positions(sampler, photos, config.distance)
    planes = not hand_held(positions)
    seen, gains, directions = (
        depth_here(field, photos, planes, rules, progress) if scene is None
        else depth_on_ray(scene, planes, rules, work, progress))
    recipe = Recipe(photos, seen, gains, band, keyframe_size(band, expansion.target.fx, rules),
                    rules, directions, expansion.source, glance_rotations(sampler))
    frames = make_keyframes(recipe, field, positions, work, progress, ends - time.monotonic(),
                            scene)
    textures, depths, glances = zip(*frames)
    glances = (*glances, photo_glances(
        _of_scene_alone(field, photos, gains, rules), photos.intrinsics, photos.T_world_cam,
        expansion.source))
    return SceneMemory(positions[:len(frames)], band, textures, depths, Glances(
        np.concatenate([part.pictures for part in glances]),
        np.concatenate([part.T_world_cam for part in glances])))


def make_keyframes(recipe: Recipe, field: RadianceField, positions: np.ndarray, work: Path,
                   progress: StageProgress, seconds: float = math.inf,
                   scene: SharedScene | None = None, stage: str = 'keyframes') -> list[Finished]:
    """
    Make keyframes at positions (K, 3): all, or as many of the first as the time is enough for.

    Finished ones lie in the folder `work`, and are not made again. scene: the recipe's photos
    where Ray's workers find them, who then make the keyframes; stage: the name of this work.
    """
    clock, show = _BakingClock(seconds), of_stage(progress, stage)
    if scene is None:
        return _make_here(recipe, field, positions, work, clock, show)
    return _make_on_ray(recipe, scene, positions, work, clock, show)


def _make_here(recipe: Recipe, field: RadianceField, positions: np.ndarray, work: Path,
               clock: '_BakingClock', progress: Progress) -> list[Finished]:
    frames: list[Finished] = []
    for index, position in enumerate(positions):
        if index >= max(recipe.rules.least_keyframes, clock.possible(index, len(positions))):
            break
        path = _path(work, index)
        frame = _read_finished(path)
        clock.finished += frame is not None
        if frame is None:
            frame = recipe.make(field, position)
            _write_finished(path, *frame)
        frames.append(frame)
        progress(index + 1, clock.possible(index + 1, len(positions)))
    return frames


def _make_on_ray(recipe: Recipe, scene: SharedScene, positions: np.ndarray, work: Path,
                 clock: '_BakingClock', progress: Progress) -> list[Finished]:
    """Make keyframes in rounds, as the first of them tell how many the time is enough for."""
    work = work.absolute()
    seen = keep_array(work / 'seen.npy', recipe.seen)
    small = replace(recipe, photos=scene.photos, seen=np.zeros((0, 1, 1), np.float32))
    jobs = [KeyframeJob(_path(work, index), position, small, scene, seen)
            for index, position in enumerate(positions)]
    there = [_read_finished(job.out) is not None for job in jobs]
    clock.finished = sum(there)
    made = clock.finished
    while True:
        least = recipe.rules.least_keyframes
        until = len(jobs) if math.isinf(clock.seconds) else made + least
        if made > clock.finished:
            until = max(clock.possible(made, len(jobs)), least)
        left = [index for index in range(min(until, len(jobs))) if not there[index]]
        if not left:
            break
        for place in make_on_ray(make_keyframe, [jobs[index] for index in left],
                                 'the keyframe was not made'):
            there[left[place]] = True
            made += 1
            progress(made, max(until, made))
    frames = []
    for job in jobs:
        frame = _read_finished(job.out)
        if frame is None:  # Those behind it are no use: each fills the gap that was left.
            break
        frames.append(frame)
    return frames


def make_keyframe(job: KeyframeJob) -> None:
    """Make one keyframe, unless it is finished."""
    if _read_finished(job.out) is not None:
        return
    recipe = replace(job.recipe, photos=job.scene.read_photos(),
                     seen=np.load(job.seen, mmap_mode='r'))
    _write_finished(job.out, *recipe.make(job.scene.read_field(), job.position))


def _of_scene_alone(field: RadianceField, photos: Photos, gains: np.ndarray, rules: BakingRules
                    ) -> Iterator[np.ndarray]:
    """Yield the photos; what their masks leave out is shown as the field has it."""
    camera = photos.intrinsics
    small = seeing_camera(camera, rules)
    for index, (image, T) in enumerate(zip(photos.images, photos.T_world_cam)):
        usable = None if photos.usable is None else photos.usable[index]
        if usable is not None and not usable.all():
            rendering = render_rays(field, *world_rays(small, CameraPose(T)))
            shown = cv2.resize(rendering.image / gains[index], (camera.width, camera.height))
            image = np.where(usable[..., None], image, to_uint8(shown))
        yield image


class _BakingClock:
    """Tells when the time for keyframes is over; those of before a break count as the others."""

    def __init__(self, seconds: float) -> None:
        self.seconds, self.finished = seconds, 0
        self.started = time.monotonic()

    def possible(self, made: int, wanted: int) -> int:
        """Return how many keyframes there will be, of those `wanted`, after `made`."""
        if math.isinf(self.seconds) or made == self.finished:
            return wanted
        each = (time.monotonic() - self.started) / (made - self.finished)
        return min(max(int(self.seconds / each), made), wanted)


def _path(work: Path, index: int) -> Path:
    return work / f'{index:06d}.npz'


def _write_finished(path: Path, texture: bytes, depth: bytes, glances: Glances) -> None:
    with kept_file(path) as file:
        np.savez(file, texture=np.frombuffer(texture, np.uint8),
                 depth=np.frombuffer(depth, np.uint8), pictures=glances.pictures,
                 T_world_cam=glances.T_world_cam)


def _read_finished(path: Path) -> Finished | None:
    """Read what `_write_finished` wrote; None where it is not there or damaged."""
    try:
        data = read_part(path)
        return (data['texture'].tobytes(), data['depth'].tobytes(),
                Glances(data['pictures'], data['T_world_cam']))
    except (NeoError, KeyError):
        return None
