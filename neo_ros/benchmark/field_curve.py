"""
How good a radiance field is after how many minutes, beside a public implementation.

Every point is a training of its own, as its schedule depends on its length. Where nerfstudio is
installed, its nerfacto (see `neo_ros.benchmark.nerfacto`) trains on the same photos for the
minutes that ours really took, on the CPU; it is left out where ours is fitted on a GPU.
"""
from collections.abc import Callable, Sequence
from dataclasses import replace
from importlib.util import find_spec
from pathlib import Path
import tempfile
from typing import Any

from neo_ros.benchmark.protocols import SCALES, split_checksums
from neo_ros.benchmark.scoring import load_scorers
from neo_ros.evaluation.evaluate import Scorer, TruthFrames
from neo_ros.experiment import Experiment
from neo_ros.field.device import chosen_device, field_trainer, on_device
from neo_ros.field.rendering import render_view
from neo_ros.geometry import CameraPose, Intrinsics, ViewExpansion
from neo_ros.machine.evenly import evenly
from neo_ros.machine.files import make_output_folder
from neo_ros.machine.host import host
from neo_ros.machine.progress import StageProgress
from neo_ros.machine.result_rows import ResultRows
from neo_ros.pictures.exposure import exposure_gain
from neo_ros.scenes.scene import read_scene
from neo_ros.training.photo_depth import photos_with_depth
from neo_ros.training.run import TrainingRun
import numpy as np
import torch

# Shows float32 RGB (H, W, 3) in [0, 1] of a view at a pose.
Renderer = Callable[[Intrinsics, CameraPose], np.ndarray]
# Trains for so many seconds, and tells its stage: returns what renders, steps and minutes.
Fitter = Callable[[TrainingRun, float, str], tuple[Renderer, dict[str, Any]]]


def measure_field_curve(scene: Path, experiment: Experiment, scale: str,
                        minutes: Sequence[float], views: int, out: Path,
                        progress: StageProgress) -> str:
    """
    Train the experiment's field for each of the times, and score it; returns a table.

    scale: full, half or quarter of the photos. views: test frames, and held-out photos, that
    are looked at, evenly spread. Rows go into the JSON file `out`; those that it has of the same
    machine, photos, test frames and settings are not measured again. Raises NeoError where scene
    or settings are wrong.
    """
    make_output_folder(out.parent)
    results = ResultRows(out)
    fitters = _fitters(experiment, progress)
    with tempfile.TemporaryDirectory() as folder:
        run = TrainingRun(read_scene(scene), replace(experiment, scale=SCALES[scale]),
                          Path(folder), progress)
        test = TruthFrames(run.scene.test, run.expansion).images
        checksums = split_checksums(run.scene.train, test, run.scene.expansion)
        scorers = list(load_scorers(progress).values())
        here = _host(experiment)
        for budget in minutes:
            seconds = 60 * budget
            for name, fit in fitters.items():
                key = {'scene': run.scene.name, 'scale': scale, 'implementation': name,
                       'budget_minutes': budget, 'views': views, 'checksums': checksums,
                       'config_hash': run.experiment.config_hash, 'host': here}
                row = results.find(key)
                if row is None:
                    stage = f'{run.scene.name}, {name}, {budget:g} min'
                    render, measured = fit(run, seconds, stage)
                    row = results.add({
                        **key, **measured, **score(run, render, views, scorers, stage)})
                seconds = 60 * row['minutes']
    return markdown(results.rows)


def _host(experiment: Experiment) -> str:
    """Describe the machine, with the GPU if the field is fitted on it."""
    if chosen_device(experiment.field.device) == 'cuda' and torch.cuda.is_available():
        torch.cuda.init()  # Only one that is in use is named.
    return host()


def _fitters(experiment: Experiment, progress: StageProgress) -> dict[str, Fitter]:
    """Return by name what can be fitted here at equal conditions."""
    fitters: dict[str, Fitter] = {'neo_ros': fit_own}
    if find_spec('nerfstudio') is None:
        return fitters
    if chosen_device(experiment.field.device) == 'cuda':
        progress('without nerfacto', 0, 1, 'it runs on the CPU here, our field on the GPU; to '
                 'compare them set field.device to cpu')
        return fitters
    from neo_ros.benchmark.nerfacto import fit_nerfacto
    return fitters | {'nerfacto': fit_nerfacto}


def fit_own(run: TrainingRun, seconds: float, stage: str) -> tuple[Renderer, dict[str, Any]]:
    """Fit our field for so many seconds; returns it with its steps and minutes."""
    config = replace(run.field_config, minutes=seconds / 60)
    scale = run.experiment.field_scale
    with photos_with_depth(run) as photos:
        depths = photos.read_depths(scale)
    images = run.fitted.read_images(scale)
    trainer = field_trainer(images, run.fitted.intrinsics.scaled(scale),
                            run.fitted.T_world_cam, config, run.experiment.seed,
                            depths, run.fitted.read_all_usable(scale))
    while trainer.done[0] < trainer.done[1]:
        trainer.train_step()
        run.progress(stage, *trainer.done, f'{trainer.psnr:.2f} dB on its photos')
    field = on_device(trainer.finished(), chosen_device(config.device))
    return (lambda view, pose: render_view(field, view, pose).image,
            {'steps': trainer.step, 'minutes': trainer.seconds / 60})


def score(run: TrainingRun, render: Renderer, views: int, scorers: Sequence[Scorer],
          stage: str) -> dict[str, float]:
    """
    Score what a field shows at true poses, nothing pasted; means over the views.

    Returns held_out_* (photos that were not fitted) and whole_* and ring_* of the wide test
    frames. One gain per channel takes out differences of exposure: that of a test frame is from
    the observed window, that of a held-out photo from all of its truth.
    """
    scores: list[dict[str, float]] = []
    scale = run.experiment.scale
    if run.held_out is not None:
        camera = run.held_out.intrinsics.scaled(scale)
        # Of any expansion to the photo: the scores of the whole image are the same.
        photo_view = ViewExpansion.inside(camera, 0, 0, camera.width // 2, camera.height // 2)
        for index in evenly(len(run.held_out), views):
            photo = run.held_out.read_image(index, scale)
            usable = run.held_out.read_usable(index, scale)
            shown = 255 * render(camera, run.held_out.poses[index])
            image = _gained(shown, shown, photo, usable)
            scores.append({name.replace('whole', 'held_out'): value for scorer in scorers
                           for name, value in scorer(photo, image, photo_view, usable).items()
                           if name.startswith('whole')})
    frames = TruthFrames(run.scene.test, run.expansion)
    chosen = evenly(len(frames), views)
    for done, index in enumerate(chosen, 1):
        narrow_image, truth = frames.read(index)
        shown = 255 * render(run.expansion.target, frames.images.poses[index])
        usable = frames.read_usable(index)
        image = _gained(shown, run.expansion.crop(shown), narrow_image,
                        None if usable is None else run.expansion.crop(usable))
        scores.append({name: value for scorer in scorers
                       for name, value in scorer(truth, image, run.expansion, usable).items()})
        run.progress(f'{stage}: views', done, len(chosen), '')
    names = sorted({name for one in scores for name in one})
    return {name: float(np.mean([one[name] for one in scores if name in one])) for name in names}


def markdown(rows: list[dict[str, Any]]) -> str:
    """Return the rows as a table."""
    lines = ['| scene | field | minutes | held-out photos, dB | SSIM | LPIPS | wide views, dB '
             '| SSIM | LPIPS |', '|---|---|---|---|---|---|---|---|---|']
    for row in sorted(rows, key=lambda row: (
            row['scene'], row['implementation'] != 'neo_ros', row['minutes'])):
        figures = ' | '.join(
            '' if row.get(name) is None else f'{row[name]:.{digits}f}'
            for name, digits in (('minutes', 1), ('held_out_psnr', 2), ('held_out_ssim', 3),
                                 ('held_out_lpips_vgg', 3), ('whole_psnr', 2),
                                 ('whole_ssim', 3), ('whole_lpips_vgg', 3)))
        lines.append(f'| {row["scene"]} | {row["implementation"]} | {figures} |')
    return '\n'.join(lines)


def _gained(shown: np.ndarray, window: np.ndarray, observed: np.ndarray,
            usable: np.ndarray | None) -> np.ndarray:
    """Bring what a field shows to the exposure that `window` has in the photo `observed`."""
    if usable is not None:
        window, observed = window[usable], observed[usable]
    return np.clip(shown * exposure_gain(window, observed) + 0.5, 0, 255).astype(np.uint8)
