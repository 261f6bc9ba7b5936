"""How far all photos of a scene see: one after the other here, or part by part on Ray."""
from collections.abc import Callable, Sequence
from dataclasses import dataclass
from pathlib import Path
from typing import Any

from neo_ros.baking.keyframes import (
    BakingRules, directions_of_photos, Photos, put_on_planes, seen_by_photos)
from neo_ros.baking.plain_surfaces import NO_DIRECTIONS
from neo_ros.baking.worker_files import kept_file, read_part, SharedScene
from neo_ros.field.radiance_field import RadianceField
from neo_ros.machine.progress import of_stage, StageProgress
from neo_ros.machine.ray_jobs import make_on_ray
import numpy as np

# So many photos are a job.
PART = 16


@dataclass(frozen=True, eq=False)
class DepthJob:
    """
    Some photos whose depth is to be made, as a worker on any machine can do it.

    out: where it comes to lie; scene: all its photos, of which these are from first to last
    """

    out: Path
    scene: SharedScene
    first: int
    last: int
    rules: BakingRules


@dataclass(frozen=True, eq=False)
class PlanesJob:
    """Depth that a DepthJob made, to be put on planes that face these directions (D, 3)."""

    out: Path
    depth: DepthJob
    directions: np.ndarray


def depth_here(field: RadianceField, photos: Photos, planes: bool, rules: BakingRules,
               progress: StageProgress) -> tuple[np.ndarray, np.ndarray, np.ndarray]:
    """
    Return how far photos see (N, h, w), gains (N, 3) and directions of planes (D, 3).

    planes: what is plain is put on them.
    """
    seen, gains = seen_by_photos(field, photos, rules, of_stage(progress, 'depth of photos'))
    if not planes:
        return seen, gains, NO_DIRECTIONS
    directions = directions_of_photos(photos, seen, rules)
    put_on_planes(photos, seen, directions, rules, of_stage(progress, 'planes of photos'))
    return seen, gains, directions


def depth_on_ray(scene: SharedScene, planes: bool, rules: BakingRules, work: Path,
                 progress: StageProgress) -> tuple[np.ndarray, np.ndarray, np.ndarray]:
    """
    Return what `depth_here` does.

    Finished parts lie in the folder `work`, and are not made again. Raises NeoError where a part
    cannot be made.
    """
    count, work = len(scene.photos.T_world_cam), work.absolute()
    jobs = [DepthJob(work / f'depth_{first:06d}.npz', scene, first, min(first + PART, count),
                     rules) for first in range(0, count, PART)]
    seen, gains = _made(make_depth, jobs, 'depth of photos', progress)
    if not planes:
        return seen, gains, NO_DIRECTIONS
    directions = directions_of_photos(scene.photos, seen, rules)
    on_planes, = _made(make_planes, [
        PlanesJob(job.out.with_name(f'planes_{job.first:06d}.npz'), job, directions)
        for job in jobs], 'planes of photos', progress)
    return on_planes, gains, directions


def _made(function: Callable[[Any], None], jobs: Sequence[DepthJob | PlanesJob], what: str,
          progress: StageProgress) -> list[np.ndarray]:
    """Return the arrays that parts hold, joined, once all are made."""
    left = [job for job in jobs if not job.out.exists()]
    done = len(jobs) - len(left)
    for _ in make_on_ray(function, left, f'{what} was not made'):
        done += 1
        progress(what, done, len(jobs))
    return [np.concatenate(arrays) for arrays in zip(*(
        read_part(job.out).values() for job in jobs))]


def make_depth(job: DepthJob) -> None:
    """Make the depth of some photos."""
    photos = job.scene.read_photos().part(job.first, job.last)
    seen, gains = seen_by_photos(job.scene.read_field(), photos, job.rules)
    with kept_file(job.out) as file:
        np.savez(file, seen=seen, gains=gains)


def make_planes(job: PlanesJob) -> None:
    """Put the depth of some photos on planes."""
    one = job.depth
    seen = read_part(one.out)['seen']
    photos = one.scene.read_photos().part(one.first, one.last)
    put_on_planes(photos, seen, job.directions, one.rules)
    with kept_file(job.out) as file:
        np.savez(file, seen=seen)
