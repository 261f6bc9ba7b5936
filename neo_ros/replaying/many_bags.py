"""Many bags, each a job of its own: one after the other here, or on a Ray cluster."""
from collections.abc import Iterator, Sequence
from contextlib import contextmanager, suppress
import fcntl
import os
from pathlib import Path
import shutil

from neo_ros.bags.bag_folder import bag_name
from neo_ros.errors import BagError, ConfigError, NeoError
from neo_ros.machine.files import make_output_folder
from neo_ros.machine.progress import no_stage_progress, StageProgress
from neo_ros.machine.ray_jobs import check_ray, map_on_ray
from neo_ros.replaying.bag_jobs import (
    asked_of_all, asked_of_bag, BagJob, do_job, failed_bag, finished, PARTIAL)
from neo_ros.replaying.bag_replayer import ReplayOptions
from neo_ros.replaying.summary import ReplayedBag, REPORT_FILE, SUMMARY_FILE, write_summary
from neo_ros.runtime import read_model_card


def replay_bags(bags: Sequence[Path], model: Path, out: Path, options: ReplayOptions,
                cluster: bool = False, progress: StageProgress = no_stage_progress
                ) -> list[ReplayedBag]:
    """
    Replay bags into a folder with one new bag each, bags.json and report.html.

    What is finished there, of the same bag with the same model and options, is not done again. A
    bag that fails, or in whose place something else is, says so in its ReplayedBag; the others go
    on. `cluster` hands them to Ray, see `map_on_ray`: all its machines need the same paths.
    Returns the bags in their order. Raises ConfigError for names that clash and a cluster that is
    not there, BagError where something else is in the way of all, ModelError as `read_model_card`
    does.
    """
    if cluster:
        check_ray()
    card = read_model_card(model)
    jobs = bag_jobs(bags, model, out, options, threads=1 if cluster else 0)
    if (out / 'metadata.yaml').exists():
        raise BagError(f'{out}: is a bag itself, as neo replay makes it of a single one; remove '
                       'it or choose another folder for several')
    with _alone_in(make_output_folder(out)):
        shutil.rmtree(out / PARTIAL, ignore_errors=True)
        found = _finished(jobs)
        left = [index for index in range(len(jobs)) if index not in found]
        progress('replaying, bags', len(found), len(jobs))
        for index, row in _done(jobs, left, cluster, progress):
            found[index] = row
            failed = sum(bool(row.error) for row in found.values())
            progress('replaying, bags', len(found), len(jobs), f'{failed} failed' * bool(failed))
        shutil.rmtree(out / PARTIAL, ignore_errors=True)
        rows = [found[index] for index in range(len(jobs))]
        write_summary(out, rows, {'model': model.name, 'scene_id': card.scene_id,
                                  'config_hash': card.config_hash})
    return rows


def bag_jobs(bags: Sequence[Path], model: Path, out: Path, options: ReplayOptions,
             threads: int) -> list[BagJob]:
    """Return the jobs of bags, each with a new bag of its name; raises ConfigError for a clash."""
    # A worker has another working directory. Links stay: they name bags, and memories of models.
    out, model = _absolute(out), _absolute(model)
    asked = asked_of_all(model, read_model_card(model), options)
    taken: dict[str, Path] = {}
    jobs = []
    for bag in map(_absolute, bags):
        name = bag_name(bag)
        if name in taken:
            raise ConfigError(f'{taken[name]}, {bag}: expected bags of different names, both would'
                              f' become {out / name}; rename one, or choose two folders')
        if name in (PARTIAL, SUMMARY_FILE, REPORT_FILE):
            raise ConfigError(f'{bag}: expected another name, {name} is kept; rename it')
        taken[name] = bag
        jobs.append(BagJob(bag, out / name, model, options, threads,
                           {**asked, **asked_of_bag(bag)}))
    return jobs


def _finished(jobs: Sequence[BagJob]) -> dict[int, ReplayedBag]:
    """Return by number the bags that are finished, and those in whose place something else is."""
    found, refused = dict[int, ReplayedBag](), list[BagError]()
    for index, job in enumerate(jobs):
        try:
            done = finished(job)
        except BagError as error:
            done = failed_bag(job, str(error))
            refused.append(error)
        if done is not None:
            found[index] = done
    if len(refused) == len(jobs):  # Nothing can be done, and the folder may be somebody else's.
        raise refused[0]
    return found


def _done(jobs: Sequence[BagJob], left: Sequence[int], cluster: bool, progress: StageProgress
          ) -> Iterator[tuple[int, ReplayedBag]]:
    """Do the jobs that are left, and yield them as they end."""
    if not cluster:
        for index in left:
            name = jobs[index].out.name
            yield index, do_job(jobs[index], lambda done, total: progress(
                'replaying, messages', done, total, name))
        return
    if not left:
        return
    for place, found in map_on_ray(do_job, [jobs[index] for index in left]):
        job = jobs[left[place]]
        if isinstance(found, NeoError):
            found = failed_bag(job, str(found))
        elif not found.error and not job.out.exists():
            found = failed_bag(job, f'its worker wrote {job.out}, but it is not there: --out must '
                                    'be a folder that all machines of the cluster share')
        yield left[place], found


@contextmanager
def _alone_in(folder: Path) -> Iterator[None]:
    """Keep a second run out of the folder: it would remove what this one has not finished."""
    handle = os.open(folder, os.O_RDONLY)
    try:
        with suppress(OSError):  # Not every network's file system locks folders.
            try:
                fcntl.flock(handle, fcntl.LOCK_EX | fcntl.LOCK_NB)
            except BlockingIOError:
                raise BagError(f'{folder}: another neo replay writes there; wait for its end, or '
                               'choose another folder') from None
        yield
    finally:
        os.close(handle)


def _absolute(path: Path) -> Path:
    return Path(os.path.abspath(path))
