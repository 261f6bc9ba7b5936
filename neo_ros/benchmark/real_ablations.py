"""
What each part of the camera's model brings to the field of a real capture, on dev walks.

    neo import CAPTURE DEV --test-runs 3
    python -m neo_ros.benchmark.real_ablations DEV

One field for each row of `ABLATIONS`, all of as many steps and with one seed; walks are runs of
the capture's own photos that were held out, never the scene's test walks. They are scored at the
poses that came with them, and at those that the camera's view is best aligned at (`aligned_`), as
a robot finds its own; one gain a channel is from the camera's view. Minutes are those of the
processor. Prints the rows and writes results/real_ablations.json; run again after an interruption,
it goes on with the next row.
"""
from collections.abc import Mapping
from dataclasses import replace
from pathlib import Path
import sys
import tempfile
import time
from typing import Any

from neo_ros.benchmark.aligned_pose import aligned_pose
from neo_ros.benchmark.field_curve import score
from neo_ros.benchmark.scoring import load_scorers
from neo_ros.errors import SceneError
from neo_ros.evaluation.evaluate import TruthFrames
from neo_ros.evaluation.metrics import score_frame
from neo_ros.experiment import Experiment
from neo_ros.field.config import FieldConfig
from neo_ros.field.radiance_field import RadianceField
from neo_ros.field.rendering import render_view
from neo_ros.geometry import CameraPose
from neo_ros.machine.progress import no_stage_progress
from neo_ros.machine.result_rows import ResultRows
from neo_ros.pictures.exposure import exposure_gain
from neo_ros.pipeline import fit_field_step
from neo_ros.scenes.upright import read_upright_scene
from neo_ros.training.run import TrainingRun
import numpy as np

RESULTS = Path('results/real_ablations.json')
BASE = Experiment(scale=0.25, field=FieldConfig(
    voxels=1_000_000, steps=1000, sh_degree=1, exposure=True))
# Name of a row: what differs from BASE.field.
ABLATIONS: dict[str, dict[str, Any]] = {
    'exposure': {},
    'robust 0.3': {'robust': 0.3},
    'sharpness': {'sharpness': 1.0},
    'vignetting': {'vignetting': True},
    'no exposure': {'exposure': False},
}
VIEWS = 11  # test frames, and held-out photos, that a field is scored on


def measure(scene: Path, base: Experiment = BASE,
            ablations: Mapping[str, dict[str, Any]] = ABLATIONS, results: Path = RESULTS
            ) -> list[dict[str, Any]]:
    """Fit, score and note the rows that the file `results` lacks; returns all of them."""
    found = read_upright_scene(scene)
    if found.test is None:
        raise SceneError(f'{scene}: expected runs held out as test frames, made by: '
                         f'neo import CAPTURE {scene} --test-runs 3')
    kept = ResultRows(results)
    scorers = [score for name, score in load_scorers(no_stage_progress).items()
               if name != 'lpips_alex']
    for name, settings in ablations.items():
        experiment = replace(base, field=replace(base.field, **settings))
        key = {'scene': found.name, 'photos': len(found.train), 'name': name,
               'steps': experiment.field.steps, 'seed': experiment.seed}
        if kept.find(key) is not None:
            continue
        with tempfile.TemporaryDirectory() as folder:
            run = TrainingRun(found, experiment, Path(folder), no_stage_progress)
            started = time.process_time()
            field = fit_field_step(run)
            minutes = (time.process_time() - started) / 60
            scores = score(run, lambda view, pose: render_view(field, view, pose).image, VIEWS,
                           [score_frame], name)
            aligned = _aligned(run, field)
            scores |= {f'aligned_{measure}': value for measure, value in score(
                run, lambda view, pose: render_view(
                    field, view, aligned[pose.T_world_cam.tobytes()]).image,
                VIEWS, scorers, name).items()}
        print(kept.add({**key, 'cpu_minutes': minutes, **scores}), flush=True)
    return kept.rows


def _aligned(run: TrainingRun, field: RadianceField) -> dict[bytes, CameraPose]:
    """Return by the poses of test frames and held-out photos those that they look most like."""
    frames, scale = TruthFrames(run.scene.test, run.expansion), run.experiment.scale
    views = [(frames.read(i)[0], _window_usable(frames, i), run.expansion.source,
              frames.images.poses[i]) for i in range(len(frames))]
    if run.held_out is not None:
        camera = run.held_out.intrinsics.scaled(scale)
        views += [(*run.held_out.read_shown(i, scale), camera, pose)
                  for i, pose in enumerate(run.held_out.poses)]
    random, found = np.random.default_rng(0), {}
    for image, usable, camera, pose in views:
        shown = 255 * render_view(field, camera, pose, 1).image
        T = aligned_pose(field, image, camera, pose.T_world_cam,
                         exposure_gain(shown[usable], image[usable]), random, usable)
        found[pose.T_world_cam.tobytes()] = CameraPose.nearest(T)
    return found


def _window_usable(frames: TruthFrames, index: int) -> np.ndarray:
    """Return which pixels of a frame's narrow input show the scene, bool (h, w)."""
    usable = frames.read_usable(index)
    source = frames.expansion.source
    return (np.ones((source.height, source.width), bool) if usable is None
            else frames.expansion.crop(usable))


def main() -> None:
    """Measure the scene that the command line names, and keep the figures."""
    if len(sys.argv) != 2:
        sys.exit('usage: python -m neo_ros.benchmark.real_ablations DEV')
    measure(Path(sys.argv[1]))


if __name__ == '__main__':
    main()
