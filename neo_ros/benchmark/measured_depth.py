"""
What measured depth brings: fields and memories of the demo flat with its depth maps and without.

    neo import demo FLAT --depth
    python -m neo_ros.benchmark.measured_depth FLAT models/demo_flat.onnx WORK

The depth has the faults of a depth camera (`flat/depth_sensor.py`). Fields of several lengths are
fitted to the same photos; of the longest two memories are made, and the model's network is guided
by each. Minutes are those of the processor: what else runs does not count; NUMBA_NUM_THREADS=1
makes them comparable. Prints the rows and writes results/measured_depth.json; run again after an
interruption, it goes on with the next row.
"""
from collections.abc import Callable
from dataclasses import replace
from pathlib import Path
import shutil
import sys
import time
from typing import Any

from neo_ros.baking.keyframes import MemoryConfig
from neo_ros.benchmark.field_curve import score
from neo_ros.benchmark.true_depth import demo_depth, field_depth, is_demo_flat
from neo_ros.errors import SceneError
from neo_ros.evaluation.baselines import NeoModel
from neo_ros.evaluation.evaluate import evaluate, TruthFrames
from neo_ros.evaluation.geometry import score_geometry
from neo_ros.evaluation.metrics import score_frame
from neo_ros.evaluation.stability import DepthOf
from neo_ros.experiment import Experiment
from neo_ros.field.config import FieldConfig
from neo_ros.field.radiance_field import RadianceField
from neo_ros.field.rendering import render_view
from neo_ros.machine.progress import no_stage_progress, StageProgress
from neo_ros.machine.result_rows import ResultRows
from neo_ros.pipeline import fit_field_step
from neo_ros.runtime import FovExtrapolator
from neo_ros.scenes.upright import read_upright_scene
from neo_ros.training.memory import memory_step, name_memory
from neo_ros.training.run import TrainingRun
import numpy as np

RESULTS = Path('results/measured_depth.json')
STEPS = (800, 400, 200)  # of a fit; the longest, which says most, first
VIEWS = 25                   # test frames, and held-out photos, that a field is scored on
MEMORY = MemoryConfig(distance=0.6)  # a quarter of the keyframes: only the two are compared


def measure(scene: Path, model: Path, work: Path, base: Experiment,
            steps: tuple[int, ...] = STEPS, results: Path = RESULTS,
            progress: StageProgress = no_stage_progress) -> list[dict[str, Any]]:
    """
    Fit, score and note the rows that the file `results` lacks; returns all of them.

    base: the settings of the field but steps and weight of the depth. Raises SceneError for
    another scene than a demo flat with depth.
    """
    found = read_upright_scene(scene)
    if not is_demo_flat(scene) or not any(found.train.depth_paths):
        raise SceneError(f'{scene}: expected the demo flat with depth, made by: '
                         f'neo import demo {scene} --depth')
    kept = ResultRows(results)
    for count in steps:
        for weight in (base.field.depth, 0.0):
            key = {'scene': found.name, 'photos': len(found.train), 'steps': count,
                   'depth_weight': weight, 'depth': 'measured' if weight else 'none'}
            if kept.find(key) is not None:
                continue
            experiment = replace(base, memory=MEMORY, field=replace(
                base.field, steps=count, depth=weight))
            run = TrainingRun(found, experiment, work / f'{count}_{weight:g}', progress)
            run.out.mkdir(parents=True, exist_ok=True)
            # A fit that was broken off begins anew: the time of all of it counts.
            (run.out / 'field.ckpt').unlink(missing_ok=True)
            row = _row(run, model if count == max(steps) else None)
            print(kept.add({**key, **row}), flush=True)
    return kept.rows


def _row(run: TrainingRun, model: Path | None) -> dict[str, float]:
    """Fit and score a field; with a model also the memory that is made of it."""
    fitted, started = (run.out / 'field.npz').exists(), time.process_time()
    field = fit_field_step(run)
    row = {} if fitted else {'cpu_minutes': (time.process_time() - started) / 60}
    scores = score(run, lambda view, pose: render_view(field, view, pose).image, VIEWS,
                   [score_frame], 'field')
    row |= {'field_held_out_psnr': scores['held_out_psnr'], 'field_ring_psnr': scores['ring_psnr']}
    frames = TruthFrames(run.scene.test, run.expansion)
    true_depth = demo_depth(frames)
    row['field_depth_error_median'] = _depth_error(frames, field, true_depth)
    if model is None:
        return row
    shutil.copyfile(model, run.model_path)
    memory_step(run, field)
    name_memory(run)
    result, = evaluate(run.scene.name, frames, [NeoModel(run.model_path)],
                       progress=_counted(run, 'scoring', len(frames)))
    geometry = score_geometry(run.scene.name, frames, FovExtrapolator.load(run.model_path),
                              true_depth, progress=_counted(run, 'geometry', len(frames)))
    return row | {'guided_ring_psnr': result.estimates['ring_psnr'].mean,
                  'guided_depth_error_median': geometry['depth_error_median'],
                  'position_cm_median': geometry['position_cm_median']}


def _counted(run: TrainingRun, stage: str, total: int) -> Callable[[int], None]:
    return lambda done: run.progress(stage, done, total, '')


def _depth_error(frames: TruthFrames, field: RadianceField, true_depth: DepthOf) -> float:
    """Return the median of the ring's relative errors of depth."""
    own, ring, errors = field_depth(frames, field), frames.expansion.extrapolated_mask, []
    for index in np.unique(np.linspace(0, len(frames) - 1, VIEWS).astype(int)):
        true, depth = true_depth(int(index))[ring], own(int(index))[ring]
        errors.append(np.abs(depth / true - 1)[np.isfinite(depth) & np.isfinite(true)])
    return float(np.median(np.concatenate(errors)))


def main() -> None:
    """Measure what the command line names, and keep the figures."""
    if len(sys.argv) != 4:
        sys.exit('usage: python -m neo_ros.benchmark.measured_depth FLAT MODEL.onnx WORK')
    scene, model, work = (Path(argument) for argument in sys.argv[1:])
    measure(scene, model, work, Experiment(field=FieldConfig(voxels=4_000_000)))


if __name__ == '__main__':
    main()
