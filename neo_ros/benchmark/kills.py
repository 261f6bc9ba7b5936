"""
Processes that learn, update or compact, killed at random moments: what is left of their files.

    python -m neo_ros.benchmark.kills [--kills 200] [--seed 0] [--out results/kills.json]
                                      [--work DIR] [--parts journal update compact]

Of the kills half are of a camera that learns (`kill_victims.py`), three tenths of `neo update`,
the rest of `neo memory compact` and `neo memory forget`, all in the small room of `small_room.py`.
They come at any moment of the process, or while it writes. After each a fresh process loads what
is left; of an update it does if there is a new run. DIR keeps the trained room; what is in the
file of rows is not measured again.
"""
import argparse
from collections.abc import Callable
from dataclasses import asdict, dataclass
import json
from pathlib import Path
import shutil
import tempfile
import time

from neo_ros.baking.keyframes import MemoryConfig
from neo_ros.benchmark.kill_victims import journal_of, marks
from neo_ros.benchmark.killing import ALWAYS, camera, digests, end, find, kill, Killed, neo
from neo_ros.benchmark.small_room import AFTER, BEFORE, write_drive, write_room
from neo_ros.experiment import Experiment, ViewConfig
from neo_ros.field.config import FieldConfig
from neo_ros.machine.result_rows import ResultRows
from neo_ros.memory.journal import delete_learnt, LEAST_BYTES, read_journal
from neo_ros.memory.learning import Learn
from neo_ros.outpaint.fitting import OutpaintConfig
from neo_ros.outpaint.network import NetworkConfig
from neo_ros.scenes.pose_sampling import SamplingConfig
import numpy as np
import yaml

ROOM = Experiment(
    seed=3, view=ViewConfig((64, 64), (128, 128)),
    field=FieldConfig(steps=800, voxels=200_000, rays_per_step=1024, device='cpu', near=0.1),
    sampling=SamplingConfig(positions=4), network=NetworkConfig(width=8, hidden=32),
    outpaint=OutpaintConfig(steps=4, batch=4, device='cpu'), memory=MemoryConfig(distance=0.9))
# Where the post stands on one day after the other; each is new to the memory.
POSTS = (AFTER, (2.9, 2.0), BEFORE, (3.9, 1.9), (3.1, 2.7))
ANY, WRITING = 'any', 'writing'
# Kills while something is written come at most so many seconds after it has begun.
APPENDING_S, REPLACING_S, FINISHING_S = 0.02, 0.004, 0.05
# So many seconds a camera lives, at most, that is killed at any moment.
LIFE_S = 10.0
# A camera of which nothing comes is killed after so many seconds.
PATIENCE_S = 90.0
# A journal that is so full is begun anew: a full one would not grow.
FULL = 0.6 * LEAST_BYTES
# What `neo update` writes behind its fit, in this order.
WRITTEN = ('room.memory.partial', 'field.npz.partial', 'field.npz', 'room.onnx.partial',
           'room/train/000000.png', 'room/transforms_train.json', 'run.json', 'report.html')
# So many kills of an update are followed by one that ends.
KILLS_BETWEEN = 8
# They tell when they were written.
DATED = ('report.html', 'room.onnx')


@dataclass
class Tally:
    """
    What became of some kills.

    loaded: a fresh process loaded what was left; lost_records: that were whole before the kill;
    cut_short: journals whose last record was not whole; damaged: files that are neither as before
    nor as after; resumed, of `tried`: the next process went on, or began anew, as if nobody had
    killed the one before; seconds_lost_max: of images that were not looked at yet.
    """

    kills: int = 0
    loaded: int = 0
    lost_records: int = 0
    cut_short: int = 0
    damaged: int = 0
    tried: int = 0
    resumed: int = 0
    seconds_lost_max: float | None = None


class Journal:
    """The journal that cameras learn into, one after the other, as the last look found it."""

    def __init__(self, model: Path) -> None:
        self.model = model
        self.path, self.sha256 = journal_of(model)
        self.anew()

    def anew(self) -> None:
        """Forget everything."""
        delete_learnt(self.path)
        self.records: list[int] = []

    @property
    def size(self) -> int:
        """Bytes of the file."""
        return self.path.stat().st_size if self.path.exists() else 0

    def goes_on(self, records: list[int]) -> bool:
        """Tell whether records are those of the last look, and further ones behind them."""
        return records[:len(self.records)] == self.records and len(records) > len(self.records)

    def kill_camera(self, number: int, moment: str, seconds: float,
                    random: np.random.Generator) -> tuple[Killed, list[int]]:
        """
        Kill a camera that learns; return also the records that were whole before the kill.

        At any moment as the node learns, and as a replay does; while it writes as a replay: on a
        busy machine the node's thread may not come to write for minutes.
        """
        copy = self.path.with_name('copy.journal')
        copy.unlink(missing_ok=True)
        size, began, wanted = self.size, time.monotonic(), int(random.integers(1, 3))

        def appends() -> bool:
            nonlocal size, wanted
            if self.size > size:
                size, wanted = self.size, wanted - 1
            return not wanted or time.monotonic() > began + PATIENCE_S

        def look() -> None:
            if self.path.exists():
                shutil.copyfile(self.path, copy)

        ready, delay = (ALWAYS, random.uniform(0, seconds)) if moment == ANY else (
            appends, APPENDING_S * random.uniform() ** 3)
        learn: Learn = 'beside' if moment == ANY and number % 2 else 'at once'
        killed = kill(camera(self.model, POSTS[number % len(POSTS)], 99, learn), ready, delay,
                      1e-4, look)
        return killed, marks(read_journal(copy, self.sha256))


def kill_cameras(model: Path, count: int, moment: str, random: np.random.Generator) -> Tally:
    """Kill cameras that learn, one after the other, into one journal."""
    tally, waiting, journal = Tally(seconds_lost_max=0.0), 0, Journal(model)
    seconds = min(end(camera(model, POSTS[-1], 1)), LIFE_S)
    journal.anew()
    for number in range(count + 1):
        if journal.size > FULL:
            journal.anew()
            waiting = 0  # Nobody can tell any more.
        if number == count:  # The last one ends, and goes on behind all kills.
            end(camera(model, POSTS[number % len(POSTS)], 1))
        else:
            killed, whole = journal.kill_camera(number, moment, seconds, random)
            tally.kills += 1
        found = find(model)
        if found is None:
            continue
        if found.records != journal.records:
            tally.tried += waiting
            tally.resumed += waiting if journal.goes_on(found.records) else 0
            waiting = 0
        if number < count:
            waiting += 1
            tally.loaded += 1
            tally.cut_short += found.cut_short
            tally.lost_records += sum(one != other for one, other in zip(
                whole, found.records + [-1] * len(whole)))
            tally.damaged += found.records[:len(journal.records)] != journal.records or (
                killed.said.get('records', journal.records) != journal.records)
            if 'looked' in killed.said:
                lost = (killed.at_ns - max(killed.said['looked'], found.last_ns)) / 1e9
                tally.seconds_lost_max = max(tally.seconds_lost_max or 0.0, round(lost, 2))
        journal.records = found.records
        print(f'{number + 1}: {len(found.records)} records; {tally}', flush=True)
    return tally


def result(run: Path) -> dict[str, str]:
    """Return the SHA-256 of all that an update writes, but of what tells the time."""
    return {name: digest for name, digest in digests(run).items() if name not in DATED}


def kill_updates(work: Path, count: int, moment: str, random: np.random.Generator) -> Tally:
    """Kill updates of one run; the run must stay, the new one be whole or not there."""
    tally, out = Tally(), work / 'new'
    command = neo('update', work / 'run', work / 'moved', '--out', out, '--config',
                  work / 'room.yaml')
    parts = [work / 'new.partial' / '0' / name for name in WRITTEN]
    kept = [digests(work / name) for name in ('run', 'room', 'moved')]
    shutil.rmtree(out, ignore_errors=True)
    seconds = end(command)
    unbroken = result(out)
    shutil.rmtree(out)
    stale = work / 'new.partial' / 'stale'
    while tally.kills < count:
        behind = parts[int(random.integers(len(parts))):]
        if stale.parent.exists():
            stale.touch()  # The next one has to take away what the one before left.

        def writes() -> bool:
            return not stale.exists() and (
                out.exists() or any(path.exists() for path in behind))

        # Early kills cost less: they are squares, a third of the time on average.
        ready, delay = (ALWAYS, seconds * random.uniform() ** 2) if moment == ANY else (
            writes, random.uniform(0, FINISHING_S))
        if not kill(command, ready, delay).alive:
            shutil.rmtree(out)
            continue
        tally.kills += 1
        same = [digests(work / name) for name in ('run', 'room', 'moved')] == kept
        whole = not out.exists() or result(out) == unbroken
        # What has the same bits loads as it did before.
        tally.loaded += same and (not out.exists() or find(out / 'room.onnx') is not None)
        tally.damaged += not (same and whole)
        shutil.rmtree(out, ignore_errors=True)
        if tally.kills % KILLS_BETWEEN == 0 or tally.kills == count:
            end(command)
            tally.tried += 1
            tally.resumed += result(out) == unbroken and not (work / 'new.partial').exists()
            shutil.rmtree(out)
        print(tally, flush=True)
    return tally


def kill_rewriting(model: Path, word: str, count: int, moment: str,
                   random: np.random.Generator) -> Tally:
    """Kill `neo memory WORD`; the journal must be as before or as after."""
    tally, journal = Tally(), Journal(model)
    path, command = journal.path, neo('memory', word, model)
    partial = path.with_name(f'{path.name}.partial')
    for post in POSTS[:3]:
        end(camera(model, post, 1))
    content = path.read_bytes()
    before = marks(read_journal(path, journal.sha256))
    seconds = end(command)
    after = marks(read_journal(path, journal.sha256))
    print(f'{word}: {len(before)} records become {len(after)}', flush=True)
    while tally.kills < count:
        path.write_bytes(content)
        ready, delay = (ALWAYS, random.uniform(0, seconds)) if moment == ANY else (
            partial.exists, random.uniform(0, REPLACING_S))
        if not kill(command, ready, delay, 0).alive:
            continue
        tally.kills += 1
        found = find(model)
        if found is not None:
            tally.loaded += 1
            tally.cut_short += found.cut_short
            tally.damaged += found.records not in (before, after)
            tally.lost_records += len(set(after) - set(found.records))
        end(command)
        tally.tried += 1
        tally.resumed += not partial.exists() and after == marks(
            read_journal(path, journal.sha256))
        print(tally, flush=True)
    journal.anew()
    return tally


def prepare(work: Path) -> Path:
    """Train the room, unless it is there; return a copy of the model that may learn."""
    copy = work / 'copy' / 'room.onnx'
    if not copy.exists():
        copy.parent.mkdir(parents=True)
        settings = asdict(ROOM)
        settings['view'] = {name: list(size) for name, size in settings['view'].items()}
        (work / 'room.yaml').write_text(yaml.safe_dump(settings))
        write_room(work / 'room')
        write_drive(work / 'moved', AFTER)
        end(neo('train', work / 'room', '--config', work / 'room.yaml', '--out', work / 'run'))
        for name in ('room.memory', 'room.onnx'):
            shutil.copyfile(work / 'run' / name, copy.with_name(name))
    return copy


def measure(work: Path, rows: ResultRows, kills: int, seed: int, parts: list[str]) -> None:
    """Kill in the small room, and add a row for each part and moment."""
    model = prepare(work)

    def rewriting(word: str) -> Callable[..., Tally]:
        return lambda *rest: kill_rewriting(model, word, *rest)

    def cameras(*rest: object) -> Tally:
        return kill_cameras(model, *rest)  # type: ignore[arg-type]

    def updates(*rest: object) -> Tally:
        return kill_updates(work, *rest)  # type: ignore[arg-type]

    plan = (('journal', 'journal', ANY, 25, cameras), ('journal', 'journal', WRITING, 25, cameras),
            ('compact', 'compact', ANY, 5, rewriting('compact')),
            ('compact', 'compact', WRITING, 10, rewriting('compact')),
            ('compact', 'forget', ANY, 5, rewriting('forget')),
            ('update', 'update', ANY, 20, updates), ('update', 'update', WRITING, 10, updates))
    for number, (part, what, moment, percent, run) in enumerate(plan):
        key, count = {'part': what, 'moment': moment, 'seed': seed}, kills * percent // 100
        if count and part in parts and rows.find(key) is None:
            tally = run(count, moment, np.random.default_rng([seed, number]))
            print(json.dumps(rows.add({**key, **asdict(tally)})), flush=True)


def main() -> None:
    """Measure, and write the rows."""
    parts = ['journal', 'update', 'compact']
    parser = argparse.ArgumentParser(description=__doc__)
    parser.add_argument('--kills', type=int, default=200, help='of all parts together')
    parser.add_argument('--seed', type=int, default=0)
    parser.add_argument('--out', type=Path, default=Path('results/kills.json'))
    parser.add_argument('--work', type=Path, help='default: a folder that is deleted again')
    parser.add_argument('--parts', nargs='+', choices=parts, default=parts)
    given = parser.parse_args()
    with tempfile.TemporaryDirectory() as folder:
        measure(given.work or Path(folder), ResultRows(given.out), given.kills, given.seed,
                given.parts)


if __name__ == '__main__':
    main()
