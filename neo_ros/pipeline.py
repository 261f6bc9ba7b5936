"""
The method from photos to model file, in the paper's three steps.

Yu et al., NeRF-Enhanced Outpainting for Faithful Field-of-View Extrapolation, section 3: fit a
radiance field, render wide views at poses where the robot can be, train the outpainter on them.
Every step leaves its result in the output folder; a run that was broken off goes on there.
"""
from dataclasses import dataclass
import json
from pathlib import Path
import time
from typing import Any, Callable, Optional

import neo_ros
from neo_ros.checkpoint import read_checkpoint, write_checkpoint
from neo_ros.errors import ConfigError, SceneError
from neo_ros.evaluation.baselines import EdgeReplication, MeanImage, Method, NeoModel
from neo_ros.evaluation.evaluate import evaluate, MethodScores, TruthFrames
from neo_ros.evaluation.output import make_output_folder, write_bytes
from neo_ros.experiment import Experiment
from neo_ros.field.fitting import FieldTrainer
from neo_ros.field.voxel_field import RadianceField
from neo_ros.geometry import ViewExpansion
from neo_ros.outpaint.export import check_parity, export_onnx
from neo_ros.outpaint.fitting import OutpaintTrainer
from neo_ros.outpaint.network import check_fits, Outpainter
from neo_ros.outpaint.pair_stream import PairStream
from neo_ros.runtime import FovExtrapolator, ModelCard
from neo_ros.runtime.model_card import Parity, write_model_card
from neo_ros.scenes.pose_sampling import PoseSampler
from neo_ros.scenes.posed_images import PosedImages
from neo_ros.scenes.scene import read_scene, Scene
from neo_ros.training_report import write_training_report
import numpy as np

CHECKPOINT_SECONDS = 60.0
# One photo in so many is kept from the field's fit, to see how well it shows new views.
HELD_OUT_EVERY = 25

Progress = Callable[[str, int, int, str], None]


@dataclass(frozen=True)
class Scoring:
    """The model and the floors on the test frames of a scene."""

    frames: TruthFrames
    methods: list[Method]
    results: list[MethodScores]

    def to_json(self, figures: dict[str, float]) -> str:
        """Return the figures of the training, the result rows and every frame's scores."""
        return json.dumps({'figures': figures, 'rows': [result.row for result in self.results],
                           'methods': [result.to_dict() for result in self.results]}, indent=1)


@dataclass
class TrainingRun:
    """One run of the pipeline: what is trained, where its files go, and who watches."""

    scene: Scene
    experiment: Experiment
    out: Path
    progress: Progress
    seconds: float = 0.0

    def __post_init__(self) -> None:
        camera = self.scene.train.intrinsics
        self.expansion: ViewExpansion = self.experiment.expansion(camera, self.scene.expansion)
        held_out = set(range(HELD_OUT_EVERY // 2, len(self.scene.train), HELD_OUT_EVERY))
        self.fitted = self.scene.train.subset(
            [i for i in range(len(self.scene.train)) if i not in held_out])
        self.held_out: Optional[PosedImages] = (
            self.scene.train.subset(sorted(held_out)) if held_out else None)
        self._check_settings()
        self.figures: dict[str, float] = {}
        self.log: dict[str, list[list[float]]] = {'field': [], 'outpainter': []}

    def _check_settings(self) -> None:
        """Raise now what the last steps would raise after all the work of the first."""
        photo = self.scene.train.intrinsics.scaled(self.experiment.scale)
        source = self.expansion.source
        if source.width > photo.width or source.height > photo.height:
            raise ConfigError(
                f'view.source: expected at most the size of the photos, {photo.width}x'
                f'{photo.height} pixels at this scale, got {source.width}x{source.height}')
        check_fits(self.expansion, self.experiment.network)
        if self.scene.test is not None:
            TruthFrames(self.scene.test, self.expansion)

    @property
    def model_path(self) -> Path:
        """Where the exported model goes."""
        return self.out / f'{self.scene.name}.onnx'


def train(scene_folder: Path, experiment: Experiment, out: Path,
          progress: Progress = lambda stage, done, total, note: None) -> TrainingRun:
    """
    Run the three steps on a scene folder and leave model, report and scores in `out`.

    progress(stage, done, total, note) is called as work goes on. Raises NeoError for scenes and
    settings that cannot be trained, and where `out` holds a run of other settings.
    """
    scene = read_scene(scene_folder)
    run = TrainingRun(scene, experiment, out, progress)
    make_output_folder(out)
    _claim(out, scene, experiment)
    field = fit_field_step(run)
    network = fit_outpainter_step(run, field)
    export_step(run, network)
    run.figures = write_training_report(run, field, score_step(run))
    return run


def fit_field_step(run: TrainingRun) -> RadianceField:
    """Step 1: fit the radiance field, or read it if it is there."""
    path, checkpoint = run.out / 'field.npz', run.out / 'field.ckpt'
    if path.exists():
        run.seconds, run.log['field'] = _read_notes(run.out / 'field.json')
        return RadianceField.load(path)
    scale, config = run.experiment.scale, run.experiment.field
    images = run.fitted.read_images(
        scale, lambda done: run.progress('photos', done, len(run.fitted), ''))
    trainer = FieldTrainer(images, run.fitted.intrinsics.scaled(scale), run.fitted.T_world_cam,
                           config, run.experiment.seed)
    _train_with_checkpoints(
        run, trainer, checkpoint, 'field', config.steps, trainer.train_step,
        lambda: f'{trainer.psnr:.2f} dB on its photos')
    field = trainer.finished()
    _write_notes(run.out / 'field.json', run.seconds, run.log['field'])
    field.save(path)
    checkpoint.unlink(missing_ok=True)
    return field


def fit_outpainter_step(run: TrainingRun, field: RadianceField) -> Outpainter:
    """Do steps 2 and 3: train the outpainter on views rendered where the robot can be."""
    experiment = run.experiment
    trainer = OutpaintTrainer(run.expansion, experiment.network, experiment.outpaint,
                              experiment.seed)
    stream = PairStream(field, make_sampler(run), run.expansion.target,
                        experiment.sampling.positions, experiment.seed)

    def learn() -> None:
        trainer.train_step(stream.batch(trainer.step, experiment.outpaint.batch))

    _train_with_checkpoints(
        run, trainer, run.out / 'outpainter.ckpt', 'outpainter', experiment.outpaint.steps,
        learn, lambda: f'loss {trainer.loss:.4f}')
    return trainer.averaged.eval()


def make_sampler(run: TrainingRun) -> PoseSampler:
    """Choose poses on the floor map if the scene has one, else around its photos."""
    if run.scene.walkable is not None:
        return PoseSampler.for_walkable(run.scene.walkable, run.experiment.sampling)
    return PoseSampler.around_photos(run.scene.train, run.experiment.sampling)


def export_step(run: TrainingRun, network: Outpainter) -> None:
    """Write the model file with its card; parity is checked on real photos."""
    path = run.model_path
    function = export_onnx(network, run.expansion, path)
    # Until it is measured, the card says the worst of the export.
    card = ModelCard(
        scene_id=run.scene.name, expansion=run.expansion, network='neo_fast',
        config_hash=run.experiment.config_hash, parity=Parity(max_abs_error=255, share_within_1=0),
        trained_seconds=run.seconds, neo_ros_version=neo_ros.__version__)
    write_model_card(path, card)
    extrapolator = FovExtrapolator.load(path)
    frames = real_frames(run, 8)
    worst, share = check_parity(
        function, lambda image: extrapolator.expand(image).wide_image, frames)
    write_model_card(path, card.model_copy(
        update={'parity': Parity(max_abs_error=worst, share_within_1=share)}))


def real_frames(run: TrainingRun, count: int) -> np.ndarray:
    """Read narrow views, uint8 (N, h, w, 3), out of the photos that the field was not shown."""
    photos = run.held_out or run.fitted
    source = run.expansion.source
    frames = []
    for index in range(min(count, len(photos))):
        photo = photos.read_image(index, run.experiment.scale)
        left, top = (photo.shape[1] - source.width) // 2, (photo.shape[0] - source.height) // 2
        frames.append(photo[top:top + source.height, left:left + source.width])
    return np.stack(frames)


def score_step(run: TrainingRun) -> Optional[Scoring]:
    """Score the model once on the scene's test frames, if it has any, and note it in the card."""
    if run.scene.test is None:
        return None
    truth = TruthFrames(run.scene.test, run.expansion)
    neo = NeoModel(run.model_path)
    photos = (run.fitted.read_image(i) for i in range(len(run.fitted)))
    methods: list[Method] = [neo, EdgeReplication(run.expansion), MeanImage(run.expansion, photos)]
    results = evaluate(run.scene.name, truth, methods, progress=lambda done: run.progress(
        'scoring', done, len(truth) * len(methods), ''))
    # The card tells how good the model is; how fast it is depends on the machine.
    scores = {name: round(estimate.mean, 4) for name, estimate in results[0].estimates.items()
              if name != 'milliseconds'}
    card = FovExtrapolator.load(run.model_path).card
    write_model_card(run.model_path, card.model_copy(update={'scores': scores}))
    return Scoring(truth, methods, results)


def _claim(out: Path, scene: Scene, experiment: Experiment) -> None:
    """Refuse a folder that holds another run, so that no two are ever mixed."""
    note = {'scene': scene.name, 'config_hash': experiment.config_hash}
    path = out / 'run.json'
    if path.exists():
        try:
            found = json.loads(path.read_text())
        except (OSError, ValueError) as error:
            raise ConfigError(f'{path}: expected the note of an earlier run: {error}; '
                              'choose another folder') from error
        if found != note:
            raise ConfigError(f'{out}: expected an empty folder or a run of {note}, got a run '
                              f'of {found}; choose another folder')
    elif any(out.iterdir()):
        raise ConfigError(f'{out}: expected an empty folder or an earlier run; it holds '
                          'other files')
    write_bytes(path, json.dumps(note).encode())


def _train_with_checkpoints(run: TrainingRun, trainer: Any, checkpoint: Path, stage: str,
                            steps: int, take_step: Callable[[], Any],
                            note: Callable[[], str]) -> None:
    """Call `take_step` until `steps`; the state is on disk once a minute and at the end."""
    if checkpoint.exists():
        state = read_checkpoint(checkpoint)
        run.seconds, run.log[stage] = state['seconds'], state['log']
        trainer.restore(state['trainer'])

    def save() -> None:
        write_checkpoint(checkpoint, {'seconds': run.seconds, 'log': run.log[stage],
                                      'trainer': trainer.state()})

    saved = last = time.monotonic()
    fresh = trainer.step < steps
    while trainer.step < steps:
        take_step()
        now = time.monotonic()
        run.seconds, last = run.seconds + now - last, now
        if trainer.step % max(steps // 200, 1) == 0:
            run.log[stage].append([trainer.step, run.seconds, trainer.figure])
        run.progress(stage, trainer.step, steps, note())
        if now - saved > CHECKPOINT_SECONDS:
            save()
            saved = time.monotonic()
    if fresh:
        save()


def _write_notes(path: Path, seconds: float, log: list[list[float]]) -> None:
    write_bytes(path, json.dumps({'seconds': seconds, 'log': log}).encode())


def _read_notes(path: Path) -> tuple[float, list[list[float]]]:
    try:
        notes = json.loads(path.read_text())
        return float(notes['seconds']), notes['log']
    except (OSError, ValueError, KeyError) as error:
        raise SceneError(f'{path}: expected the notes of a fitted field: {error}; '
                         'delete field.npz to fit it again') from error
