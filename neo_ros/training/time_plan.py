"""
A training within so many minutes: what they are spent on, for any camera, scene and machine.

The field has its share, the memory at most its own, and the network what is left of them. How fine
the field and how large the network's images are follows from how fast this machine fits a field.
"""
from collections.abc import Callable
from dataclasses import asdict, dataclass, replace
import json
import math
from pathlib import Path
import time
from typing import Any

from neo_ros.errors import ConfigError
from neo_ros.experiment import Experiment, experiment_from
from neo_ros.field.config import FieldConfig
from neo_ros.field.device import field_trainer
from neo_ros.machine.evenly import evenly
from neo_ros.machine.files import write_bytes
from neo_ros.machine.progress import StageProgress
from neo_ros.scenes.posed_images import PosedImages
from neo_ros.scenes.scene import Scene
from neo_ros.training.tiles import tiles_of
import numpy as np

PLAN_FILE = 'plan.json'


@dataclass(frozen=True)
class PlanRules:
    """How minutes are shared; chosen by measuring on two cores."""

    field: float = 0.45            # share of the minutes
    memory: float = 0.3            # at most; what it leaves is the network's
    rest: float = 0.1              # export, scores and report, and reading the photos
    most_rest: float = 3.0         # minutes of it: it does not grow with the training
    least_network: float = 0.1
    least_memory: float = 0.1
    report: float = 0.6            # of the time that the scores take
    network_side: int = 160        # pixels that the network's image is at most wide and high
    passes: float = 1.0            # of the fit over the pixels that it is shown
    most_shrink: int = 8           # of the photos that a field is fitted to
    # Steps of a fit that voxels of these numbers need; with fewer the next coarser are taken.
    voxels: tuple[tuple[int, int], ...] = ((6000, 8_000_000), (2500, 4_000_000), (0, 1_500_000))
    measured_seconds: float = 4.0  # of a fit, to see how fast the machine is
    measured_photos: int = 24      # in it, so wide and of so many voxels: they are read at once
    measured_width: int = 128
    measured_voxels: int = 500_000
    # A fit is so many times slower than the middle step of its first seconds, of coarse voxels.
    slower: float = 2.5

    def rest_of(self, minutes: float) -> float:
        """Return the minutes that are kept for what comes last."""
        return min(self.rest * minutes, self.most_rest)


@dataclass(frozen=True)
class TimePlan:
    """
    What a training of `minutes` is made of; network_minutes are known when it comes to it.

    given: the hash of the settings that it was chosen from; None: of an older neo_ros.
    """

    minutes: float
    experiment: Experiment
    network_minutes: float | None = None
    given: str | None = None


def plan_training(out: Path, scene: Scene, base: Experiment, minutes: float,
                  say: Callable[[str], None], fits: bool = True, rules: PlanRules = PlanRules()
                  ) -> TimePlan:
    """
    Read the plan of the run in `out`, or make one for this machine and note it there.

    base: settings that stay, but for all minutes, and for shrink and voxels that are the default.
    say: told what was chosen, and why. fits: a field is fitted; else it is there, and its minutes
    are the network's. Raises ConfigError for minutes that are no number above 0, and for a run of
    others, or of other settings.
    """
    if not 0 < minutes < math.inf:
        raise ConfigError(f'--minutes: expected a number > 0, got {minutes}')
    if (out / PLAN_FILE).exists():
        plan = read_plan(out)
        if plan.minutes != minutes:
            raise ConfigError(f'--minutes: {out} holds a run of {plan.minutes:g} minutes, got '
                              f'{minutes:g}; choose another folder')
        if plan.given not in (None, base.config_hash):
            raise ConfigError(f'{out}: expected an empty folder or a run of these settings, got '
                              f'one of others ({plan.given}, not {base.config_hash}); give the '
                              'same --config again, or choose another folder')
        return plan
    if any(out.iterdir()):
        raise ConfigError(f'{out}: expected an empty folder or a run of --minutes {minutes:g}; it '
                          'holds other files, or a run without --minutes; choose another folder')
    plan = TimePlan(minutes, _chosen(scene, base, minutes, say, fits, rules),
                    given=base.config_hash)
    _write_plan(out, plan)
    return plan


def read_plan(out: Path) -> TimePlan:
    """Read the plan of the run in `out`; raises ConfigError for anything else."""
    path = out / PLAN_FILE
    try:
        found: dict[str, Any] = json.loads(path.read_text())
        return TimePlan(float(found['minutes']), experiment_from(found['experiment'], str(path)),
                        found['network_minutes'], found.get('given'))
    except (OSError, ValueError, KeyError, TypeError) as error:
        raise ConfigError(f'{path}: expected the plan of an earlier run: {error!r}; choose '
                          'another folder') from error


def settings_of(out: Path, given: Experiment | None) -> Experiment:
    """
    Return what the run in `out` was trained with: its plan's settings, those given, or none.

    Raises ConfigError where the plan is made of others than those given.
    """
    if not (out / PLAN_FILE).exists():
        return given or Experiment()
    plan = read_plan(out)
    if given is not None and plan.given not in (None, given.config_hash):
        raise ConfigError(f'--config: {out} holds a run of {plan.minutes:g} minutes, made of '
                          f'other settings ({plan.given}, not {given.config_hash}); leave it '
                          'out: the run knows its settings')
    return plan.experiment


def _write_plan(out: Path, plan: TimePlan) -> None:
    write_bytes(out / PLAN_FILE, json.dumps(asdict(plan), indent=1).encode())


def share_network_minutes(out: Path, spent_seconds: float, rank: int = 0,
                          rules: PlanRules = PlanRules()) -> float:
    """
    Return what is left for the network after what came before it took `spent_seconds`.

    It is noted in the plan: a training that was broken off goes on with it.
    """
    plan = read_plan(out)
    if plan.network_minutes is not None:
        return plan.network_minutes
    left = plan.minutes - rules.rest_of(plan.minutes) - spent_seconds / 60
    minutes = max(left, plan.minutes * rules.least_network)
    if rank == 0:
        _write_plan(out, replace(plan, network_minutes=minutes))
    return minutes


def most_memory_seconds(plan: TimePlan, spent_seconds: float, rules: PlanRules = PlanRules()
                        ) -> float:
    """Return what the memory may take where so much is spent: the network's least is kept."""
    minutes = plan.minutes
    return max(60 * (minutes * (1 - rules.least_network) - rules.rest_of(minutes)) - spent_seconds,
               60 * minutes * rules.least_memory)


class TimeLeft:
    """Adds to what a training shows how many minutes it has left in all."""

    # What comes between field and network; what comes after it is the rest.
    POINTS = ('features', 'matches', 'stereo', 'without landmarks')
    MEMORY = (*POINTS, 'depth of photos', 'planes of photos', 'keyframes', 'look-alikes',
              'panoramas')

    def __init__(self, plan: TimePlan, progress: StageProgress,
                 clock: Callable[[], float] = time.monotonic,
                 rules: PlanRules = PlanRules()) -> None:
        self._plan, self._progress, self._clock, self._rules = plan, progress, clock, rules
        self._fitted, self._points, self._scores = False, 0.0, 0.0
        self._field = rules.field  # Of the minutes: none where a geometry takes its place.
        self._began: dict[str, float] = {}
        self._first: dict[str, tuple[float, int]] = {}  # report of a stage: when, how much

    def __call__(self, stage: str, done: int, total: int, note: str = '') -> None:
        """Show the progress of a stage, see `StageProgress`."""
        minutes = self._minutes_left(stage, done, total)
        left = f'{minutes:.0f} of {self._plan.minutes:g} min left in all'
        self._progress(stage, done, total, f'{note}; {left}' if note else left)

    def _minutes_left(self, stage: str, done: int, total: int) -> float:
        minutes, rules = self._plan.minutes, self._rules
        self._fitted |= stage in ('field', 'tiles', 'geometry')
        if stage == 'geometry':
            self._field = 0.0
        # The field needs the points that the memory's landmarks are made of, too; what they take
        # is neither the field's nor the memory's, but the network's.
        if stage in self.POINTS and not self._fitted:
            self._points = self._since('points')
            return minutes - self._given()
        if stage in ('plan', 'photos'):
            return minutes - self._given()
        if stage in ('field', 'tiles'):
            return minutes * (1 - self._field * done / total) - self._given()
        if stage in ('geometry', 'joining tiles'):
            return minutes * (1 - self._field)
        if stage == 'outpainter':  # It counts in seconds.
            return (total - done) / 60 + rules.rest_of(minutes)
        if stage == 'scoring':
            self._scores = self._stage_minutes(stage, done, total)
            if self._scores > 0:
                return self._scores * (1 - done / total + rules.report)
        if stage == 'report':
            return self._stage_left(stage, done, total) or (
                self._scores * rules.report * (1 - done / total))
        part = 'memory' if stage in self.MEMORY else 'rest'
        spent = self._since(part)
        if part == 'memory':
            left = minutes * (1 - self._field) - self._given() - spent
            return max(left, self._stage_left(stage, done, total)
                       + minutes * rules.least_network + rules.rest_of(minutes))
        return max(rules.rest_of(minutes) - spent, 0.0)

    def _since(self, part: str) -> float:
        """Return the minutes since a part began, which is now where it is new."""
        now = self._clock()
        return (now - self._began.setdefault(part, now)) / 60

    def _given(self) -> float:
        """Return the minutes that the network has given for the points."""
        rules, minutes = self._rules, self._plan.minutes
        return min(self._points, minutes * (1 - self._field - rules.least_network)
                   - rules.rest_of(minutes))

    def _stage_left(self, stage: str, done: int, total: int) -> float:
        """Return the minutes that a stage still needs, as fast as it was so far."""
        return self._stage_minutes(stage, done, total) * (1 - done / total)

    def _stage_minutes(self, stage: str, done: int, total: int) -> float:
        """Return the minutes that all of a stage takes, as fast as it was so far; 0: not known."""
        began, first = self._first.setdefault(stage, (self._clock(), done))
        if done <= first:
            return 0.0
        return (self._clock() - began) / (done - first) * total / 60


def _chosen(scene: Scene, base: Experiment, minutes: float, say: Callable[[str], None],
            fits: bool, rules: PlanRules) -> Experiment:
    pixels_a_second = _fitting_rate(scene.train, base, rules)
    budget = 60 * minutes * rules.field
    camera = scene.train.intrinsics.scaled(base.scale)
    pixels = len(scene.train) * camera.width * camera.height
    fitted = pixels_a_second * budget / rules.slower
    shrink = base.field.shrink
    if shrink == 1:
        shrink = min(max(round(math.sqrt(rules.passes * pixels / fitted)), 1), rules.most_shrink)
    tiles = len(tiles_of(scene, base))
    steps = fitted / base.field.rays_per_step / tiles
    voxels = base.field.voxels
    if voxels == FieldConfig.voxels:
        voxels = next(voxels for least, voxels in rules.voxels if steps >= least)
    experiment = replace(
        base, field=replace(base.field, shrink=shrink, minutes=minutes * rules.field / tiles,
                            voxels=voxels),
        outpaint=replace(base.outpaint, minutes=minutes * rules.least_network),
        memory=None if base.memory is None else replace(
            base.memory, minutes=minutes * rules.memory))
    if base.network.shrink == 1:
        experiment = replace(experiment, network=replace(
            base.network, shrink=_network_shrink(experiment, scene, rules)))
    view = experiment.expansion(scene.train.intrinsics, scene.expansion)
    each = f'{tiles} tiles, each ' * (tiles > 1)
    field = (f'{each}a field of {voxels / 1e6:g} million voxels from photos of '
             f'{round(camera.width / shrink)}x{round(camera.height / shrink)} pixels '
             f'({minutes * rules.field:.1f} min), ' if fits else '')
    say(f'{minutes:g} minutes: {field}a memory of the photos in their full size '
        f'({camera.width}x{camera.height}, at most {minutes * rules.memory:.1f} min), a network '
        f'that sees {view.source.width // experiment.network.shrink}x'
        f'{view.source.height // experiment.network.shrink} (what is left). '
        + (_more_would_bring(shrink, voxels, minutes, rules) if fits else ''))
    return experiment


def _more_would_bring(shrink: int, voxels: int, minutes: float, rules: PlanRules) -> str:
    if shrink > 1:
        return (f'With {math.ceil(minutes * (shrink / (shrink - 0.5)) ** 2)} minutes the field '
                'would see finer photos.')
    finest = rules.voxels[0][1]
    return ('More minutes would bring finer voxels.' if voxels < finest
            else 'More minutes would bring little.')


def _network_shrink(experiment: Experiment, scene: Scene, rules: PlanRules) -> int:
    """Return the least whole number that brings the camera's view to the network's size."""
    whole = experiment.expansion(scene.train.intrinsics, scene.expansion)
    wanted = math.ceil(max(whole.source.width, whole.source.height) / rules.network_side)
    if experiment.view is None:
        if scene.expansion is None:
            return wanted  # The view is chosen to fit.
        whole, scale = scene.expansion, experiment.scale  # Not yet fitted to any cells.
    else:
        scale = 1.0
    sizes = (whole.source.width, whole.source.height, whole.left, whole.right, whole.top,
             whole.bottom)
    fitting = [shrink for shrink in range(1, 2 * wanted + 1)
               if all(size * scale % shrink == 0 for size in sizes)]
    return min(fitting, key=lambda shrink: (abs(shrink - wanted), -shrink), default=wanted)


def _fitting_rate(photos: PosedImages, base: Experiment, rules: PlanRules) -> float:
    """Fit some photos for some seconds; return pixels a second, of steps that do not compile."""
    chosen = photos.subset(evenly(len(photos), rules.measured_photos).tolist())
    scale = base.scale * min(
        1.0, rules.measured_width / (base.scale * photos.intrinsics.width))
    config = replace(base.field, minutes=rules.measured_seconds / 60,
                     voxels=rules.measured_voxels)
    trainer = field_trainer(chosen.read_images(scale), photos.intrinsics.scaled(scale),
                            chosen.T_world_cam, config, base.seed)
    trainer.train_step()
    ends = [trainer.seconds]
    while ends[-1] - ends[0] < rules.measured_seconds:
        trainer.train_step()
        ends.append(trainer.seconds)
    return config.rays_per_step / float(np.median(np.diff(ends)))
