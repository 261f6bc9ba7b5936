"""
Everything that a benchmark's methods need of one scene, made once and kept in one folder.

Fields, networks and feature banks are trained or built when a method first asks for them; a
run that was broken off goes on where it stopped.
"""
from collections.abc import Callable
from dataclasses import asdict, dataclass, replace
import json
from pathlib import Path
import time
from typing import Any, TypeVar

from neo_ros.baking.photo_bank import PhotoBank, read_photo_bank
from neo_ros.baking.sparse_model import read_sparse_model, SparseModel
from neo_ros.benchmark.naive import train_naive
from neo_ros.benchmark.protocols import (
    choose_view, fitting_network, SCALES, split_checksums, split_walks)
from neo_ros.errors import ConfigError
from neo_ros.evaluation.evaluate import TruthFrames
from neo_ros.experiment import Experiment, experiment_from, in_new_words, read_experiment
from neo_ros.field.radiance_field import RadianceField
from neo_ros.machine.files import make_output_folder, share_dir, write_bytes
from neo_ros.machine.names import listed
from neo_ros.machine.progress import StageProgress
from neo_ros.outpaint.network import NETWORKS
from neo_ros.pipeline import fit_field_step, train
from neo_ros.scenes.scene import read_scene, Scene
from neo_ros.scenes.upright import stood_up
from neo_ros.training.checkpoint import read_notes, write_notes
from neo_ros.training.folder import claim
from neo_ros.training.memory import memory_seconds, NOTES
from neo_ros.training.run import TrainingRun

# Of the training time that goes to the field, which is also B3's: half of six minutes is enough,
# as 2.2 gave held-out photos within 0.36 dB of what 3.7 gave.
FIELD_SHARE = 0.5
_Made = TypeVar('_Made')


@dataclass(frozen=True)
class Job:
    """
    One scene under one protocol.

    test_scene  folder whose training frames are the wide truth, where `scene` has none
    minutes     training time of field and network together
    settings    of the experiment, beside what protocol, scale and minutes decide
    """

    scene: str
    protocol: str
    scale: str
    minutes: float
    test_scene: str | None = None
    most_frames: int | None = None
    settings: dict[str, Any] | None = None

    def __post_init__(self) -> None:
        if self.scale not in SCALES:
            raise ConfigError(f'scale: expected {", ".join(SCALES)}, got {self.scale!r}')
        if not self.minutes > 0:
            raise ConfigError(f'budget-minutes: expected a number > 0, got {self.minutes}')


class Workbench:
    """A scene, its test frames, and what has been made for its methods so far."""

    def __init__(self, job: Job, folder: Path, progress: StageProgress) -> None:
        self.job, self.folder, self.progress = job, folder, progress
        scene = read_scene(Path(job.scene))
        if job.test_scene is not None:
            scene = _with_truth(scene, Path(job.test_scene))
        if scene.test is None:
            raise ConfigError(
                f'{job.scene}: expected test frames (transforms_test.json) with the wide truth, '
                'there are none; name a folder of them with --test-scene')
        self.checksums = split_checksums(scene.train, scene.test, scene.expansion)
        self.scene = stood_up(scene)  # As the training does it.
        test = self.scene.test
        assert test is not None
        base = experiment_from({**(job.settings or {}), 'scale': SCALES[job.scale]},
                               'benchmark settings')
        view = choose_view(self.scene, job.protocol, SCALES[job.scale])
        base = replace(base, view=view)
        self.expansion = base.expansion(self.scene.train.intrinsics, self.scene.expansion)
        # Methods name their networks.
        base = replace(base, network=replace(base.network, name='neo_fast'))
        self.base = replace(base, network=fitting_network(base, self.expansion))
        self.frames = TruthFrames(split_walks(test), self.expansion, job.most_frames)
        make_output_folder(folder)
        self._claim()

    @property
    def experiment(self) -> Experiment:
        """The settings, with the times that field and network have; B1 has the network's."""
        minutes = self.job.minutes
        return replace(
            self.base, field=replace(self.base.field, minutes=FIELD_SHARE * minutes),
            outpaint=replace(self.base.outpaint, minutes=(1 - FIELD_SHARE) * minutes))

    def field(self) -> tuple[RadianceField, float, float]:
        """Return the field, its training minutes and its size in MB."""
        run = self._run(self.experiment, self.folder / 'field')
        field = fit_field_step(run)
        return field, run.seconds / 60, (run.out / 'field.npz').stat().st_size / 1e6

    def model(self, network: str) -> Path:
        """Return the model file of NEO with a network (neo_fast, mat, lama)."""
        run = self._run(self._experiment_of(network), self.folder / network)
        if not (run.out / 'done').exists():
            self.field()
            train(Path(self.job.scene), run.experiment, run.out, self.progress,
                  field_of=self.folder / 'field')
            (run.out / 'done').touch()
        return run.model_path

    def memory_minutes(self, network: str) -> float:
        """Return what of the minutes on a model's card went into its scene memory."""
        config = self._experiment_of(network).memory
        if config is None:
            return 0.0
        return (memory_seconds(self.folder / network / NOTES, config) or 0.0) / 60

    def naive(self) -> Path:
        """Return the model file of B1; it may take the time that NEO's network takes."""
        run = self._run(self.experiment, self.folder / 'naive')
        if not (run.out / 'done').exists():
            train_naive(run)
            (run.out / 'done').touch()
        return run.model_path

    def bank(self) -> tuple[PhotoBank, float]:
        """Return the features of the training photos, and the minutes that they took."""
        path = self.folder / 'features.npz'
        return _timed(path, lambda: read_photo_bank(
            self.scene.train, SCALES[self.job.scale], path,
            lambda done, total: self.progress('features', done, total, '')))

    def sparse_model(self, bank: PhotoBank) -> tuple[SparseModel, float]:
        """Return the triangulated points of the features, and the minutes that they took."""
        folder = self.folder / 'sparse'
        return _timed(folder / 'points.npz', lambda: read_sparse_model(
            bank, folder, lambda done, total: self.progress('matches', done, total, '')))

    def _experiment_of(self, network: str) -> Experiment:
        if network == 'neo_fast':
            return self.experiment
        # Sizes mean something else in each network; and one scene has one memory.
        path = share_dir() / 'config' / 'experiments' / 'networks' / f'{network}.yaml'
        return replace(self.experiment, memory=None, network=read_experiment(path).network)

    def _run(self, experiment: Experiment, out: Path) -> TrainingRun:
        run = TrainingRun(self.scene, experiment, out, self.progress)
        make_output_folder(out)
        claim(out, self.scene, experiment)
        return run

    def _claim(self) -> None:
        """Note what the folder is for, so that no two jobs are mixed."""
        note = self.folder / 'job.json'
        # A different number of test frames or folder changes no artefact.
        kept = {'protocol': self.job.protocol, 'scale': self.job.scale,
                'minutes': self.job.minutes, 'checksums': self.checksums,
                'settings': in_new_words(self.job.settings or {}, self.job.scene),
                'experiments': {network: self._experiment_of(network).config_hash
                                for network in NETWORKS}}
        text = json.dumps({'job': asdict(self.job), **kept}, indent=1)
        if note.exists():
            found = json.loads(note.read_text())
            found['settings'] = in_new_words(found.get('settings'), str(note))
            differ = [name for name, value in kept.items() if found.get(name) != value]
            if differ:
                raise ConfigError(
                    f'{self.folder}: holds a benchmark with other {", ".join(differ)}, or of an '
                    'older neo_ros, which did not note them; choose another --work folder or '
                    'delete this one')
        write_bytes(note, text.encode())


def _with_truth(scene: Scene, folder: Path) -> Scene:
    """Take the photos of another scene folder for the truth."""
    if scene.test is not None:
        raise ConfigError('--test-scene: expected only where the scene has no test frames of its '
                          f'own, {scene.name} has transforms_test.json; leave it out')
    test = read_scene(folder).train
    trained = {path.resolve() for path in scene.train.image_paths}
    shared = [path.name for path in test.image_paths if path.resolve() in trained]
    if shared:
        raise ConfigError(f'--test-scene: expected photos that are not trained on, got '
                          f'{len(shared)} that {scene.name} has, too ({listed(shared)})')
    return replace(scene, test=test, expansion=None)


def _timed(path: Path, make: Callable[[], _Made]) -> tuple[_Made, float]:
    """
    Return what `make` makes, or reads from the file `path`, and the minutes that making it took.

    They are noted beside the file; a file without its note is made again.
    """
    notes, started = path.with_suffix('.json'), time.monotonic()
    if not notes.exists():
        path.unlink(missing_ok=True)
    made = make()
    if not notes.exists():
        write_notes(notes, time.monotonic() - started, [])
    return made, read_notes(notes, path.name)[0] / 60
