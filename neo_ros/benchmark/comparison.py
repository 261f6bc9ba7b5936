"""Several experiments on one scene, side by side: networks at equal time, ablations."""
from collections.abc import Sequence
from dataclasses import asdict, dataclass, replace
import json
import math
from pathlib import Path
import statistics
import time
from typing import Any

from neo_ros.errors import ConfigError
from neo_ros.experiment import Experiment, read_experiment
from neo_ros.machine.files import make_output_folder, write_bytes
from neo_ros.machine.progress import no_stage_progress, StageProgress
from neo_ros.pipeline import train
from neo_ros.reports.report import Plot, Section, Series, Table, Text, write_report
from neo_ros.runtime import FovExtrapolator
from neo_ros.scenes.digests import list_digest
from neo_ros.scenes.upright import read_upright_scene
from neo_ros.training.folder import claim
import numpy as np

TIMED_RUNS = 30


@dataclass(frozen=True)
class Row:
    """
    What came of one experiment.

    samples         wide views that the outpainter saw; minutes: what it took to train it
    validation_psnr ring, photos held out of the training (dB); ring_psnr: test frames, if any
    on_front        no other is both better and cheaper in arithmetic
    """

    name: str
    network: str
    gflop: float
    megabytes: float
    milliseconds: float
    samples: int
    minutes: float
    validation_psnr: float | None
    ring_psnr: float | None
    on_front: bool = False


def compare(scene_folder: Path, configs: Sequence[Path], out: Path,
            minutes: Sequence[float] = (), steps: int | None = None,
            progress: StageProgress = no_stage_progress) -> list[Row]:
    """
    Train every experiment in its own folder of `out`, and write comparison.html and .json.

    minutes or steps, where given, replace those of all experiments; with several minutes each is
    trained once for each of them. None has a scene memory.
    Experiments whose fields agree share the first one's. What is finished is not done again: a
    run that was broken off goes on. Raises ConfigError for files of one name, and where `out`
    holds a run of other settings or of another scene.
    """
    if minutes and steps is not None:
        raise ConfigError('minutes, steps: expected one of both, got both')
    names = [path.stem for path in configs]
    if len(set(names)) != len(names):
        raise ConfigError(f'configs: expected files of different names, got {names}; a name '
                          'tells the rows apart: rename one')
    experiments = {
        path.stem + (f'_{length:g}min' if len(minutes) > 1 else ''): _prepared(
            read_experiment(path), length, steps)
        for path in configs for length in minutes or (None,)}
    make_output_folder(out)
    scene = read_upright_scene(scene_folder)
    # A finished row counts as long as its test frames are these.
    frames = '' if scene.test is None else list_digest(scene.test, scene.expansion)
    rows: list[Row] = []
    fields: dict[str, Path] = {}
    for name, experiment in experiments.items():
        folder = make_output_folder(out / name)
        claim(folder, scene, experiment)
        row = _finished_row(folder, frames)
        field = experiment.field_hash(scene.walkable is not None)
        if row is None:
            row = _trained_row(
                scene_folder, name, experiment, folder, fields.get(field), progress)
            write_bytes(folder / 'row.json', json.dumps(
                {'frames': frames, 'row': asdict(row)}).encode())
        rows.append(row)
        fields.setdefault(field, folder)
        written = marked_front(rows)
        write_bytes(out / 'comparison.json', json.dumps(
            [asdict(row) for row in written], indent=1).encode())
        write_report(out / 'comparison.html', f'Experiments on {scene.name}',
                     _sections(written, len(minutes) > 1))
    return marked_front(rows)


def marked_front(rows: Sequence[Row]) -> list[Row]:
    """
    Mark the rows that no other beats in quality and arithmetic at once.

    Quality is that of held-out photos, so that the test frames stay unseen: rows without any are
    not marked.
    """
    def beaten(row: Row) -> bool:
        return any(_quality(other) >= _quality(row) and other.gflop <= row.gflop
                   and (_quality(other), other.gflop) != (_quality(row), row.gflop)
                   for other in rows)

    return [replace(row, on_front=row.validation_psnr is not None and not beaten(row))
            for row in rows]


def _prepared(experiment: Experiment, minutes: float | None,
              steps: int | None) -> Experiment:
    changes: dict[str, Any] = {}
    if minutes is not None:
        changes['minutes'] = minutes
    if steps is not None:
        changes.update(steps=steps, minutes=None)
    # The networks by themselves: a scene memory would hide how good each of them is.
    return replace(experiment, memory=None, outpaint=replace(experiment.outpaint, **changes))


def _trained_row(scene_folder: Path, name: str, experiment: Experiment, folder: Path,
                 field_of: Path | None, progress: StageProgress) -> Row:
    run = train(scene_folder, experiment, folder,
                lambda stage, *rest: progress(f'{name}: {stage}', *rest), field_of=field_of)
    model = FovExtrapolator.load(run.model_path, guided=False)
    validation = run.log['validation']
    return Row(name, experiment.network.name, model.card.gflop or 0.0,
               run.model_path.stat().st_size / 1e6, _milliseconds(model), run.samples,
               run.outpaint_seconds / 60, validation[-1][2] if validation else None,
               run.figures.get('ring_psnr'))


def _finished_row(folder: Path, frames: str) -> Row | None:
    try:
        stored = json.loads((folder / 'row.json').read_text())
        return Row(**stored['row']) if stored['frames'] == frames else None
    except (OSError, ValueError, KeyError, TypeError):
        return None  # Not finished, damaged, or of another version.


def _milliseconds(model: FovExtrapolator) -> float:
    view, times = model.expansion.source, []
    image = np.random.default_rng(0).integers(0, 256, (view.height, view.width, 3), np.uint8)
    for _ in range(TIMED_RUNS):
        started = time.perf_counter()
        model.expand(image)
        times.append(1e3 * (time.perf_counter() - started))
    return statistics.median(times)


def _quality(row: Row) -> float:
    return -math.inf if row.validation_psnr is None else row.validation_psnr


def _sections(rows: Sequence[Row], timed: bool) -> list[Section]:
    def decibels(value: float | None) -> str:
        return '' if value is None else f'{value:.2f}'

    table = Table(
        ('experiment', 'network', 'GFLOP', 'MB', 'ms', 'samples', 'minutes', 'held out, ring dB',
         'test, ring dB', 'front'),
        [(row.name, row.network, f'{row.gflop:.2f}', f'{row.megabytes:.1f}',
          f'{row.milliseconds:.1f}', str(row.samples), f'{row.minutes:.1f}',
          decibels(row.validation_psnr), decibels(row.ring_psnr),
          'yes' if row.on_front else '') for row in rows])
    intro = Text('Front: no other experiment is better and cheaper at once. Around photos held '
                 'out the truth is what the field of the experiment shows: compare those that '
                 'share one. Time is the median of one image on all cores of this machine.')
    drawn = [row for row in rows if row.validation_psnr is not None]
    if not drawn:
        return [intro, table]
    plot = Plot('Arithmetic and quality', 'GFLOP per image', 'ring PSNR, held-out photos, dB',
                [Series(row.name, [row.gflop], [_quality(row)]) for row in drawn], 'points')
    return [intro, table, plot, *([_time_plot(drawn)] if timed else [])]


def _time_plot(rows: Sequence[Row]) -> Plot:
    """Draw a line for each experiment that was trained for several times."""
    lines: dict[str, list[Row]] = {}
    for row in sorted(rows, key=lambda row: row.minutes):
        lines.setdefault(row.name.rsplit('_', 1)[0], []).append(row)
    return Plot('Training time and quality', 'minutes', 'ring PSNR, held-out photos, dB', [
        Series(name, [row.minutes for row in line], [_quality(row) for row in line])
        for name, line in lines.items()])
