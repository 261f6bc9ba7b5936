"""
The method from photos to model file, in the paper's three steps.

Yu et al., NeRF-Enhanced Outpainting for Faithful Field-of-View Extrapolation, section 3: fit a
radiance field, render wide views at poses where the robot can be, train the outpainter on them.
Every step leaves its result in the output folder; a run that was broken off goes on there.
"""
from dataclasses import replace
from pathlib import Path
import shutil
import time

import neo_ros
from neo_ros.evaluation.baselines import EdgeReplication, MeanImage, Method, NeoModel
from neo_ros.evaluation.evaluate import evaluate, TruthFrames
from neo_ros.experiment import Experiment
from neo_ros.field.device import chosen_device, field_trainer, read_field
from neo_ros.field.given_geometry import field_of_geometry, GivenGeometry
from neo_ros.field.radiance_field import RadianceField
from neo_ros.field.tiles import Tile
from neo_ros.machine.files import make_output_folder
from neo_ros.machine.progress import no_stage_progress, StageProgress
from neo_ros.outpaint.distributed import from_first, process_group, wait_for_all
from neo_ros.outpaint.export import calibration_factor, check_parity, export_onnx, require_parity
from neo_ros.outpaint.fitting import OutpaintTrainer
from neo_ros.outpaint.networks import at_full_size
from neo_ros.outpaint.training_log import TrainingLog
from neo_ros.runtime import FovExtrapolator, ModelCard
from neo_ros.runtime.model_card import Parity, write_model_card
from neo_ros.runtime.scene_check import fit_scene_reference
from neo_ros.scenes.upright import read_upright_scene
from neo_ros.speed.model import count_flops
from neo_ros.training.checkpoint import (
    begin_as, read_notes, train_with_checkpoints, write_notes)
from neo_ros.training.checks import check_training
from neo_ros.training.folder import (
    begin_run, claim, drop_made_of_a_field, free_where_refused, take_field)
from neo_ros.training.memory import memory_step, name_memory
from neo_ros.training.photo_depth import photos_with_depth
from neo_ros.training.pose_map import COUNTS_FILE
from neo_ros.training.report import Scoring, write_training_report
from neo_ros.training.run import TrainingRun
from neo_ros.training.tiles import below_floors, fit_tiles, tile_jobs, TILES, tiles_of
from neo_ros.training.time_plan import (
    plan_training, read_plan, share_network_minutes, TimeLeft)
from neo_ros.training.views import (
    calibration_views, held_out_views, make_stream, note_poses, real_frames, real_usable,
    RealFrames)
import numpy as np
from torch import nn

# Photos that tell the node later what images of the scene look like.
REFERENCE_PHOTOS = 300
# Steps of an export that are shown.
EXPORTS = 4


def train(scene_folder: Path, experiment: Experiment, out: Path,
          progress: StageProgress = no_stage_progress,
          cache_gb: float = 0.0, field_of: Path | None = None,
          minutes: float | None = None, geometry: GivenGeometry | None = None,
          cluster: bool = False) -> TrainingRun:
    """
    Run the three steps on a scene folder and leave model, report and scores in `out`.

    progress(stage, done, total, note) is called as work goes on; up to cache_gb GB of panoramas
    are kept in files instead of in memory. `field_of` is the folder of another run, whose field is
    taken; `geometry` is a mesh or splats that take its place. With `minutes` all of it takes so
    long: settings are chosen for camera and machine, see `training/time_plan.py`. `cluster` hands
    the tiles of a large floor and the keyframes to Ray, see `machine/ray_jobs.py`. Raises NeoError
    for scenes and settings that cannot be trained, where `out` holds a run of other settings,
    where the other field is of other photos or settings, and where the geometry does not show what
    the photos do.
    """
    if cluster:  # Its workers have another working directory.
        scene_folder, out = scene_folder.absolute(), out.absolute()
    scene = read_upright_scene(scene_folder)
    with process_group() as rank:
        if rank == 0:
            begin_run(out, minutes)
        if rank == 0 and minutes is not None:
            make_output_folder(out)
            plan_training(out, scene, experiment, minutes,
                          lambda chosen: progress('plan', 1, 1, chosen), geometry is None)
        wait_for_all()
        plan = None if minutes is None else read_plan(out)
        if plan is not None:
            experiment, progress = plan.experiment, TimeLeft(plan, progress)
        run = TrainingRun(scene, experiment, out, progress, cache_gb, plan=plan,
                          geometry=geometry, cluster=cluster)
        check_training(run)
        if rank == 0:
            make_output_folder(out)
            claim(out, scene, experiment, geometry, scene_folder)
            if field_of is not None:
                with free_where_refused(out):
                    take_field(out, scene, experiment, field_of)
        wait_for_all()
        field = fit_field_step(run, rank)
        if rank == 0 and plan is not None:  # The network has what field and memory leave.
            memory_step(run, field)
        wait_for_all()
        held_out = held_out_views(run, field)
        network = fit_outpainter_step(run, field, held_out, rank)
    if rank > 0:
        return run
    run.progress('export', 0, EXPORTS, 'views of held-out photos')
    views = calibration_views(run, field, held_out)
    export_step(run, network, views)
    if plan is None:  # Where it cannot be made, the model is there and works alone.
        memory_step(run, field)
    name_memory(run)
    run.figures = write_training_report(run, field, score_step(run), views)
    return run


def fit_field_step(run: TrainingRun, rank: int = 0) -> RadianceField:
    """
    Step 1: fit the radiance field, or read it if it is there.

    rank is the number of this process; several share the fit on GPUs, the first fits alone on
    a CPU.
    """
    path = run.out / 'field.npz'
    device, missing = chosen_device(run.experiment.field.device), not path.exists()
    wait_for_all()
    if missing and (rank == 0 or device != 'cpu'):
        if run.geometry is None:
            _fit_field(run, path, writes=rank == 0)
        elif rank == 0:
            _take_geometry(run, run.geometry, path)
    wait_for_all()
    if rank == 0:
        (run.out / 'field.ckpt').unlink(missing_ok=True)
        shutil.rmtree(run.out / TILES, ignore_errors=True)
    run.seconds, run.log['field'] = read_notes(run.out / 'field.json', 'field.npz')
    return read_field(path, device)


def _fit_field(run: TrainingRun, path: Path, writes: bool) -> None:
    tiles = tiles_of(run.scene, run.experiment, run.hold_out.chosen(len(run.scene.train)))
    if len(tiles) > 1:
        _fit_tiles(run, tiles, path, writes)
        return
    checkpoint = run.out / 'field.ckpt'
    scale, config = run.experiment.field_scale, run.field_config
    if writes and not checkpoint.exists():
        drop_made_of_a_field(run.out)
    with photos_with_depth(run, writes) as photos:  # It reads photos too, and is done with them.
        depths = photos.read_depths(scale)
    images = run.fitted.read_images(
        scale, lambda done: run.progress('photos', done, len(run.fitted), ''))
    trainer = field_trainer(images, run.fitted.intrinsics.scaled(scale), run.fitted.T_world_cam,
                            config, run.experiment.seed, depths,
                            run.fitted.read_all_usable(scale))
    train_with_checkpoints(
        run, trainer, checkpoint, 'field', lambda: trainer.done,
        trainer.train_step,
        lambda: f'{trainer.psnr:.2f} dB on its photos', writes=writes)
    field = trainer.finished()
    if writes:
        write_notes(run.out / 'field.json', run.seconds, run.log['field'])
        field.save(path)


def _fit_tiles(run: TrainingRun, tiles: list[Tile], path: Path, writes: bool) -> None:
    if writes and not (run.out / TILES).exists():
        drop_made_of_a_field(run.out)
    with photos_with_depth(run, writes) as photos:
        tiles = below_floors(tiles, photos, run.experiment.field_scale)
        field, seconds, run.log['field'] = fit_tiles(
            tile_jobs(run.out, tiles, photos, run.experiment, run.field_config, writes),
            run.cluster, run.progress)
    run.seconds += seconds
    if field is not None:
        write_notes(run.out / 'field.json', run.seconds, run.log['field'])
        field.save(path)


def _take_geometry(run: TrainingRun, geometry: GivenGeometry, path: Path) -> None:
    """Leave the field of a mesh or of splats in `path`, as a fit would."""
    started = time.monotonic()
    run.progress('geometry', 0, 1, str(geometry.path))
    with free_where_refused(run.out):
        field = field_of_geometry(geometry, run.scene.turn, run.scene.train, run.field_config)
    drop_made_of_a_field(run.out)
    write_notes(run.out / 'field.json', time.monotonic() - started, [])
    field.save(path)


def fit_outpainter_step(run: TrainingRun, field: RadianceField,
                        held_out: np.ndarray | None = None, rank: int = 0,
                        earlier: Path | None = None) -> nn.Module:
    """
    Do steps 2 and 3: train the outpainter on views rendered where the robot can be.

    rank is the number of this process where several train together; each has its own stream.
    earlier: the checkpoint of a network that this one begins as.
    """
    experiment, started = run.experiment, time.monotonic()
    stream = make_stream(run, field, experiment.seed + 1_000_000 * rank)
    config = experiment.outpaint
    if run.plan is not None:
        stream.render_for(0)  # That is none of the network's minutes.
        spent = run.seconds + time.monotonic() - started
        config = replace(config, minutes=share_network_minutes(run.out, from_first(spent), rank))
    trainer = OutpaintTrainer(run.network_expansion, experiment.network, config,
                              experiment.seed, held_out)
    if earlier is not None:
        begin_as(trainer, earlier)
    run.seconds += time.monotonic() - started  # A checkpoint's time takes its place, where one is.
    log = (TrainingLog(run.out / 'tensorboard')
           if experiment.outpaint.tensorboard and rank == 0 else None)

    learnt = False

    def learn() -> None:
        nonlocal learnt
        learnt = True
        trainer.train_step(stream.batch(trainer.step, trainer.batch_size))
        if log is not None:
            log.note(trainer)

    train_with_checkpoints(
        run, trainer, run.out / 'outpainter.ckpt', 'outpainter', lambda: trainer.done,
        learn, trainer.note, writes=rank == 0)
    if rank == 0 and (learnt or not (run.out / COUNTS_FILE).exists()):
        note_poses(run, stream, trainer.step)
    if log is not None:
        log.close()
    run.log['validation'] = trainer.validation
    run.samples = trainer.step * experiment.outpaint.batch
    run.outpaint_seconds = trainer.seconds
    return trainer.averaged.eval().cpu()


def export_step(run: TrainingRun, network: nn.Module,
                held_out: np.ndarray | None = None) -> None:
    """
    Write the model file with its card; parity is checked on real photos.

    The confidence is calibrated on the held-out views. Raises ModelError where torch and the
    file differ.
    """
    path = run.model_path
    network, factor = at_full_size(network, run.experiment.network), 1.0
    if held_out is not None:
        factor = calibration_factor(network, run.expansion, held_out)
    else:
        run.progress('without calibration', 0, 1, 'no photo is held out of fewer than '
                     f'{run.hold_out.least_photos}: how true the confidence is, nobody measured')
    run.progress('export', 1, EXPORTS, 'the model file')
    function = export_onnx(network, run.expansion, path, factor)
    # Until it is measured, the card says the worst of the export.
    card = ModelCard(
        scene_id=run.scene.name, expansion=run.expansion,
        network=run.experiment.network.name,
        gflop=round((count_flops(path) or 0) / 1e9, 3) or None,
        config_hash=run.experiment.config_hash, parity=Parity(max_abs_error=255, share_within_1=0),
        trained_seconds=run.seconds, neo_ros_version=neo_ros.__version__,
        arbitrary_scale=run.scene.train.arbitrary_scale)
    write_model_card(path, card)
    run.progress('export', 2, EXPORTS, 'is it what was trained?')
    extrapolator = FovExtrapolator.load(path, guided=False)
    frames = real_frames(run, 8)
    worst, share = check_parity(function, extrapolator.expand, frames)
    require_parity(path, worst, share)
    run.progress('export', 3, EXPORTS, 'what images of the scene look like')
    write_model_card(path, replace(
        card, parity=Parity(max_abs_error=worst, share_within_1=share),
        scene_reference=fit_scene_reference(
            RealFrames.of(run, REFERENCE_PHOTOS, run.scene.train),
            lambda image: extrapolator.expand(image).confidence, run.expansion,
            real_usable(run, REFERENCE_PHOTOS, run.scene.train))))
    run.progress('export', EXPORTS, EXPORTS, '')


def score_step(run: TrainingRun) -> Scoring | None:
    """Score the model once on the scene's test frames, if it has any, and note it in the card."""
    if run.scene.test is None:
        return None
    truth = TruthFrames(run.scene.test, run.expansion)
    neo = NeoModel(run.model_path)
    alone: list[Method] = [NeoModel(run.model_path, guided=False)] if neo.guided else []
    photos = (run.fitted.read_shown(i) for i in range(len(run.fitted)))
    methods: list[Method] = [neo, *alone, EdgeReplication(run.expansion),
                             MeanImage(run.expansion, photos)]
    results = evaluate(run.scene.name, truth, methods, progress=lambda done: run.progress(
        'scoring', done, len(truth) * len(methods), ''))
    # The card tells how good the model is; how fast it is depends on the machine.
    scores = {name: round(estimate.mean, 4) for name, estimate in results[0].estimates.items()
              if name != 'milliseconds'}
    write_model_card(run.model_path, replace(neo.card, scores=scores))
    return Scoring(truth, results)
