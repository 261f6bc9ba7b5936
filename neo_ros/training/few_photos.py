"""What few photos lack: depth at the points that several of them show."""
import time

from neo_ros.baking.landmarks import find_points
from neo_ros.baking.sparse_model import depth_of_points
from neo_ros.training.memory import WORK
from neo_ros.training.run import TrainingRun
import numpy as np

# With more photos points bring a field nothing: see docs/tried.md.
FEW_PHOTOS = 50


def depth_of_few(run: TrainingRun) -> np.ndarray | None:
    """
    Return depth, as `PosedImages.read_depths`, at the points that a run's photos triangulate to.

    None where they are not few, nothing comes of it, or the field does not look at depth. The
    scene memory is made of the same points: they are kept for it.
    """
    experiment, started = run.experiment, time.monotonic()
    if len(run.fitted) > FEW_PHOTOS or experiment.field.depth == 0:
        return None
    found = find_points(run.fitted, experiment.scale, run.expansion.source, run.out / WORK,
                        run.progress)
    depths = None if found is None else depth_of_points(
        found[1], run.fitted.T_world_cam, run.fitted.intrinsics.scaled(experiment.field_scale))
    run.seconds += time.monotonic() - started
    return depths
