"""
What a memory learns of a flat that changes from visit to visit, and what an update makes of it.

    python -m neo_ros.benchmark.lives RUN --work DIR [--drive 130] [--visits 20] [--out FILE]
                                      [--retrain CONFIG] [--without learn|update]

RUN is the folder of `neo train` on the demo flat. On each visit (see `flat/visits.py`) a robot
drives through the flat. Other walks are widened by the memory as it was trained (none), by one
that learnt on all drives so far (learn), and by the run that `neo update` brought up to date with
the bags of all drives so far (update). With --retrain a fresh training with CONFIG
on photos of the last visit is the fourth (retrained). Scores are of the ring in the frames that
show something changed, with exact truth. Rows in FILE of what was not measured again stay. DIR
keeps frames, bags and models: visits of which it has all that is asked for are not gone through
anew.
"""
import argparse
from collections.abc import Sequence
from dataclasses import dataclass, replace
from functools import partial
from pathlib import Path
import shutil
import time

import cv2
from neo_ros.bags import write_demo_bag
from neo_ros.benchmark.killing import end, neo
from neo_ros.benchmark.lives_scores import read_rows, rows_of, Walks, widened, write_rows
from neo_ros.errors import NeoError
from neo_ros.flat.demo_flat import build_demo_flat, sample_training_poses, walking_paths
from neo_ros.flat.visits import (
    CHAIRS, DOOR_PLACE, PLANT, somebody, Visit, visited_flat, VISITS, with_more)
from neo_ros.geometry import CameraPose, Intrinsics
from neo_ros.machine.files import sha256_of, write_bytes
from neo_ros.machine.processes import map_in_processes
from neo_ros.memory.journal import journal_path, read_journal, write_journal
from neo_ros.messages.stamps import NS_PER_S
from neo_ros.runtime import FovExtrapolator
from neo_ros.scenes.posed_images import PosedImages
from neo_ros.scenes.transforms_json import write_transforms
from neo_ros.scenes.walkable import write_walkable
import numpy as np


@dataclass(frozen=True)
class LivesRules:
    """Where the camera drives."""

    nearest: float = 0.8       # metres that the camera keeps off what was moved
    test_seed: int = 1
    test_walks: int = 16
    drive_seed: int = 21       # of 20 walks on visit 0, the next number on the next visit
    rate: float = 6.0          # images a second, in the bags of the drives
    photos: int = 1000         # of a fresh training


RULES = LivesRules()
DAY_NS = 86400 * NS_PER_S
DONE = 'rows.json'  # In the folder of a visit: it was gone through.


def walks_of(visit: Visit, seed: int, count: int, camera: Intrinsics, folder: Path, name: str,
             most: int | None = None) -> Walks:
    """Cast the frames of some walks on a visit, at most so many, or read them where they lie."""
    path = folder / f'{name}_{seed}_{count}_{most}_{camera.width}.npz'
    if not path.exists():
        paths = []
        off = np.array([*(one.goal for one in (*CHAIRS, PLANT)), DOOR_PLACE])
        for number, walk in enumerate(walking_paths(build_demo_flat(), count, 25, seed)):
            paths += [(number, pose) for pose in walk if np.linalg.norm(
                off - pose.position[:2], axis=1).min() >= RULES.nearest]
        visited_flat(visit, folder)  # Its light is there for all processes.
        paths = paths[:most]
        T = np.stack([pose.T_world_cam for _, pose in paths])
        folder.mkdir(parents=True, exist_ok=True)
        np.savez(path, T=T, walk=np.array([number for number, _ in paths]), images=np.stack(list(
            map_in_processes(partial(_cast, visit, folder, camera), list(enumerate(T)), 2))))
    with np.load(path) as data:
        return Walks(data['images'], data['T'], data['walk'])


def _cast(visit: Visit, folder: Path, camera: Intrinsics, frame: tuple[int, np.ndarray]
          ) -> np.ndarray:
    step, T_world_cam = frame
    flat, pose = visited_flat(visit, folder), CameraPose(T_world_cam)
    return (with_more(flat, somebody(pose, step)) if visit.people else flat).render(
        camera, pose)[0]


def drive(model: Path, walks: Walks) -> None:
    """Learn from walks."""
    extrapolator = FovExtrapolator.load(model, learn='at once')
    for _ in widened(extrapolator, walks):
        pass
    extrapolator.finish_learning()


def become_a_day_older(model: Path) -> None:
    """
    Let a day pass for what a model has learnt.

    Visits lie days apart, but drives of a benchmark minutes: so near, what was learnt on one would
    be of one visit with what is learnt on the next.
    """
    memory = model.with_suffix('.memory')
    path, checksum = journal_path(memory), sha256_of(memory)
    write_journal(path, checksum, [replace(record, stamp_ns=record.stamp_ns - DAY_NS)
                                   for record in read_journal(path, checksum)])


def as_bag(path: Path, walks: Walks, model: Path) -> None:
    """Write a drive as the robot's bag."""
    write_demo_bag(path, (
        (NS_PER_S + round(index * NS_PER_S / RULES.rate), image, CameraPose(T))
        for index, (image, T) in enumerate(zip(walks.images, walks.T))),
        FovExtrapolator.load(model, guided=False).expansion)


def update_with(run: Path, bag: Path, out: Path) -> float:
    """Update a run with a bag; return the minutes that it took."""
    began = time.monotonic()
    try:
        end(neo('update', run, bag, '--out', out))
    except NeoError as error:
        # By lamps alone it is refused, and the run of before is what a robot has.
        if 'taken in another light' not in str(error):
            raise
    return (time.monotonic() - began) / 60


def train_anew(visit: Visit, camera: Intrinsics, config: Path, folder: Path) -> Path:
    """Train on photos of the flat as a visit finds it, taken as for the run; return the model."""
    poses, scene = sample_training_poses(build_demo_flat(), RULES.photos, 0), folder / 'demo_flat'
    names = [scene / 'train' / f'{index:04d}.png' for index in range(len(poses))]
    (scene / 'train').mkdir(parents=True)
    for name, image in zip(names, map_in_processes(
            partial(_cast, visit, folder, camera),
            list(enumerate(pose.T_world_cam for pose in poses)), 2)):
        write_bytes(name, cv2.imencode('.png', image[..., ::-1])[1].tobytes())
    write_transforms(scene / 'transforms_train.json', PosedImages(
        camera, tuple(names), tuple(poses), (0,) * len(poses)))
    write_walkable(scene / 'walkable.json', build_demo_flat().walkable())
    end(neo('train', scene, '--config', config, '--out', folder / 'run'))
    return folder / 'run' / 'demo_flat.onnx'


def measure(run: Path, work: Path, visits: int, driven: int, out: Path,
            retrain: Path | None, without: Sequence[str] = ()) -> None:
    """Go through the visits; write a row for each and each mode, all of them after each visit."""
    trained, = run.glob('*.onnx')
    expansion = FovExtrapolator.load(trained, guided=False).expansion
    cast = partial(walks_of, camera=expansion.target, folder=work / 'frames')
    learnt, newest = run, run
    for number, visit in enumerate(VISITS[:visits]):
        test_of = partial(cast, seed=RULES.test_seed, count=RULES.test_walks)
        folder, path = work / str(number), cast(
            visit, RULES.drive_seed + number, 20, name=f'drive_{number}', most=driven)
        done = folder / DONE
        wanted = {'learn', 'update'}.difference(without) | (
            {'retrained'} if retrain is not None and number == visits - 1 else set())
        if not wanted <= {row['mode'] for row in read_rows(done)}:
            shutil.rmtree(folder, ignore_errors=True)
            folder.mkdir(parents=True)
            models, minutes = {'none': trained}, 0.0
            if 'learn' in wanted:
                models['learn'] = learn(learnt / trained.name, folder / 'learn', path)
            if 'update' in wanted:
                as_bag(folder / 'drive', path, trained)
                minutes = update_with(newest, folder / 'drive', folder / 'update')
                # Where nothing has changed, or in a light that hides it, nothing is written.
                after = folder / 'update' if (folder / 'update').exists() else newest
                models['update'] = after / trained.name
            if 'retrained' in wanted and retrain is not None:
                models['retrained'] = train_anew(visit, expansion.source, retrain,
                                                 folder / 'retrained')
            # Nobody is in the way, and the light is the same, where what changed is told apart.
            found, shown = rows_of(
                'demo_flat', number, models, test_of(replace(visit, people=False),
                                                     name=f'test_{number}'),
                test_of(Visit(light=visit.light), name=visit.light), {
                    'light': visit.light, 'door': 'closed' if visit.closed else 'open',
                    'people': visit.people}, minutes)
            np.savez(folder / 'shown.npz', allow_pickle=False, **shown)
            write_rows(done, found)
        write_rows(out, read_rows(done))
        learnt, newest = (folder / mode if (folder / mode).exists() else before
                          for mode, before in (('learn', learnt), ('update', newest)))


def learn(model: Path, folder: Path, path: Walks) -> Path:
    """Let what a model knows learn from a drive in a folder of its own; return the model there."""
    shutil.copytree(model.parent, folder, ignore=lambda _, names: [
        name for name in names if not name.startswith((model.name, f'{model.stem}.memory'))])
    drive(folder / model.name, path)
    become_a_day_older(folder / model.name)
    return folder / model.name


def main() -> None:
    """Measure, and write the rows."""
    parser = argparse.ArgumentParser(
        description=__doc__, formatter_class=argparse.RawDescriptionHelpFormatter)
    parser.add_argument('run', type=Path)
    parser.add_argument('--work', type=Path, default=Path('out/lives'), metavar='DIR')
    parser.add_argument('--drive', type=int, default=130, help='frames of each drive')
    parser.add_argument('--visits', type=int, default=len(VISITS))
    parser.add_argument('--out', type=Path, default=Path('results/lives.json'))
    parser.add_argument('--retrain', type=Path, metavar='CONFIG',
                        help='experiment file: train anew on photos of the last visit')
    parser.add_argument('--without', action='append', choices=('learn', 'update'), default=[],
                        help='do not measure this one; may be given again')
    given = parser.parse_args()
    measure(given.run, given.work, given.visits, given.drive, given.out, given.retrain,
            given.without)


if __name__ == '__main__':
    main()
