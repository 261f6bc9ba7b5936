"""
One of many bags: what has to be done with it, what is finished, and doing it.

A new bag is written under another name and gets its own once it is whole, with what was asked
for beside it. So what has the name is finished: a run that was broken off goes on behind it, and
a job that was begun twice is done once.
"""
from collections.abc import Iterator
from contextlib import contextmanager
from dataclasses import asdict, dataclass
import functools
import hashlib
import json
from pathlib import Path
import shutil
import tempfile
from typing import Any

from neo_ros import __version__
from neo_ros.errors import BagError, NeoError
from neo_ros.machine.files import write_bytes
from neo_ros.machine.progress import no_progress, Progress
from neo_ros.machine.regular_file import read_model_bytes
from neo_ros.memory.journal import journal_path
from neo_ros.memory.light_file import lights_path
from neo_ros.replaying.bag_replayer import BagReplayer, ReplayOptions, ScoredReplay
from neo_ros.replaying.summary import ReplayedBag
from neo_ros.runtime import ModelCard
from neo_ros.runtime.fov_extrapolator import memory_path

# What is not whole yet lies in this folder beside the new bags; this file is in each of those.
PARTIAL, DONE_FILE = '.partial', 'replay.json'


@dataclass(frozen=True)
class BagJob:
    """
    One bag to replay, as a worker on any machine can do it.

    out    where the new bag comes to lie, with its own name
    asked  what its bytes depend on, as JSON has it: the same means the same bytes
    """

    bag: Path
    out: Path
    model: Path
    options: ReplayOptions
    threads: int
    asked: dict[str, Any]


def asked_of_all(model: Path, card: ModelCard, options: ReplayOptions) -> dict[str, Any]:
    """
    Return what the bytes of all new bags depend on, as JSON has it.

    Raises ModelError where the model cannot be read.
    """
    learnt = []
    if card.memory is not None:
        memory = memory_path(model, card.memory)
        learnt = [_digest(path) for path in (journal_path(memory), lights_path(memory))
                  if path.is_file() and path.stat().st_size]  # An empty one says nothing.
    return json.loads(json.dumps({
        'model': _digest(model), 'learnt': learnt, 'options': asdict(options),
        'neo_ros': __version__}))


def asked_of_bag(bag: Path) -> dict[str, Any]:
    """Return what the bytes of one new bag depend on: its size tells of one that was repaired."""
    files = bag.iterdir() if bag.is_dir() else [bag]
    return {'bag': str(bag), 'bytes': sum(file.stat().st_size for file in files if file.is_file())}


def finished(job: BagJob) -> ReplayedBag | None:
    """
    Return what became of a job that is finished; None where nothing has its name.

    Raises BagError where something else has it.
    """
    if not job.out.exists():
        return None
    try:
        content = json.loads((job.out / DONE_FILE).read_text())
        asked = content['asked']
        different = [key for key, value in job.asked.items() if asked.get(key) != value]
        row = ReplayedBag(**content['replayed'])
    except (OSError, ValueError, KeyError, TypeError, AttributeError):
        different = [f'no {DONE_FILE}']
    if different:
        raise BagError(f'{job.out}: exists already and was not made of this bag with this model '
                       f'and these options (differs: {", ".join(different)}); remove it or choose '
                       'another folder')
    return row


def do_job(job: BagJob, on_progress: Progress = no_progress) -> ReplayedBag:
    """Replay a bag, unless it is finished; what goes wrong is told in the ReplayedBag."""
    try:
        return finished(job) or _replay(job, on_progress)
    except Exception as error:  # What one bag brings to light must not cost the others.
        words = str(error) if isinstance(error, NeoError) else f'{type(error).__name__}: {error}'
        return failed_bag(job, words)


def failed_bag(job: BagJob, error: str) -> ReplayedBag:
    """Return what is told of a bag that failed."""
    return ReplayedBag(job.out.name, str(job.bag), error=error)


def _replay(job: BagJob, on_progress: Progress) -> ReplayedBag:
    """Replay a bag under another name, and give it its own."""
    replayer = _replayer(job.model, job.asked['model'], job.threads)
    with _attempt(job.out) as partial:
        found = replayer.replay(job.bag, partial, job.options, on_progress=on_progress)
        if found.scores is not None:
            found.scores.write(partial, found.about)
        row = _row(job, found)
        write_bytes(partial / DONE_FILE, (json.dumps(
            {'asked': job.asked, 'replayed': asdict(row)}, indent=1) + '\n').encode())
        try:
            partial.rename(job.out)
        except OSError as error:
            # Another attempt was first, which has the same bytes.
            if (other := finished(job)) is not None:
                return other
            raise BagError(f'{job.out}: cannot write: {error.strerror}') from error
    return row


def _row(job: BagJob, found: ScoredReplay) -> ReplayedBag:
    result, scores = found.result, found.scores
    lost: int | None = 0
    for damage in result.damages:
        lost = None if lost is None or damage.lost is None else lost + damage.lost
    return ReplayedBag(
        job.out.name, str(job.bag), frames=result.frames,
        guided=None if found.guided is None else result.guided,
        scored=0 if scores is None else len(scores.rows),
        ring_psnr=None if scores is None else scores.mean['ring_psnr'],
        truth_topic=None if scores is None else found.truth_topic,
        rejected=dict(sorted(result.rejected.items())), lost=lost,
        damages=[str(damage) for damage in result.damages], assumed=result.assumed)


@functools.lru_cache(1)
def _replayer(model: Path, digest: str, threads: int) -> BagReplayer:
    """Load a model once for all jobs of this process; BagError for one of another digest."""
    if _digest(model) != digest:
        raise BagError(f'{model}: expected the model of the machine where neo replay was called, '
                       'got another one; copy it, or use a folder that all machines share')
    return BagReplayer(model, threads)


@contextmanager
def _attempt(out: Path) -> Iterator[Path]:
    """Yield a name of this attempt alone, which ends like `out`; what still has it goes."""
    beside = out.parent / PARTIAL
    try:
        beside.mkdir(parents=True, exist_ok=True)
        folder = Path(tempfile.mkdtemp(prefix=f'{out.name}.', dir=beside))
    except OSError as error:
        raise BagError(f'{out}: cannot write: {error.strerror}') from error
    try:
        yield folder / out.name  # A bag's file has the name of its folder.
    finally:
        shutil.rmtree(folder, ignore_errors=True)


def _digest(path: Path) -> str:
    return hashlib.sha256(read_model_bytes(path)).hexdigest()
