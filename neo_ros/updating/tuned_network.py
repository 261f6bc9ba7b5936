"""The network of an updated run, trained on with views of what is there now."""
from dataclasses import replace
from pathlib import Path

from neo_ros.experiment import Experiment
from neo_ros.field.device import chosen_device, read_field
from neo_ros.machine.progress import StageProgress
from neo_ros.pipeline import export_step, fit_outpainter_step
from neo_ros.runtime.model_card import read_model_card, write_model_card
from neo_ros.scenes.scene import Scene
from neo_ros.training.memory import name_memory
from neo_ros.training.run import TrainingRun
from neo_ros.training.views import calibration_views, held_out_views

CHECKPOINT = 'outpainter.ckpt'


def tune_network(folder: Path, scene: Scene, experiment: Experiment, minutes: float,
                 progress: StageProgress) -> None:
    """
    Train the network of a run, updated in `folder`, for some minutes and export it anew.

    It begins as the network of before. Memory, lineage and view stay.
    """
    before = read_model_card(folder / f'{scene.name}.onnx')
    # An updated scene has no test frames any more, which may have told the view.
    scene = replace(scene, test=None)
    run = TrainingRun(scene, replace(experiment, outpaint=replace(
        experiment.outpaint, minutes=minutes)), folder, progress, view=before.expansion)
    field = read_field(folder / 'field.npz', chosen_device(experiment.field.device))
    earlier = folder / f'earlier_{CHECKPOINT}'
    (folder / CHECKPOINT).rename(earlier)
    held_out = held_out_views(run, field)
    network = fit_outpainter_step(run, field, held_out, earlier=earlier)
    earlier.unlink()
    run.seconds += before.trained_seconds
    export_step(run, network, calibration_views(run, field, held_out))
    name_memory(run)
    write_model_card(run.model_path, replace(
        read_model_card(run.model_path), updates=before.updates))
