"""What few photos lack: depth at the points that several of them show."""
from contextlib import nullcontext
from pathlib import Path
from tempfile import TemporaryDirectory
import time

from neo_ros.baking.landmarks import find_points
from neo_ros.baking.sparse_model import SparseModel
from neo_ros.geometry import Intrinsics
from neo_ros.pictures.depth import MM_PER_M
from neo_ros.training.memory import WORK
from neo_ros.training.run import TrainingRun
import numpy as np

# With more photos points bring a field nothing: see docs/tried.md.
FEW_PHOTOS = 50
# A point tells of so many radians to each side of it.
SPREAD = 0.008


def depth_of_few(run: TrainingRun, writes: bool = True) -> np.ndarray | None:
    """
    Return depth, as `PosedImages.read_depths`, at the points that a run's photos triangulate to.

    None where they are not few, nothing comes of it, or the field does not look at depth. The
    scene memory is made of the same points: the process that writes, of several, keeps them.
    """
    experiment, started = run.experiment, time.monotonic()
    if len(run.fitted) > FEW_PHOTOS or experiment.field.depth == 0:
        return None
    with nullcontext(run.out / WORK) if writes else TemporaryDirectory() as work:
        found = find_points(run.fitted, experiment.scale, run.expansion.source, Path(work),
                            run.progress)
    depths = None if found is None else depth_of_points(
        found[1], run.fitted.T_world_cam, run.fitted.intrinsics.scaled(experiment.field_scale))
    run.seconds += time.monotonic() - started
    return depths


def depth_of_points(model: SparseModel, T_world_cam: np.ndarray, camera: Intrinsics
                    ) -> np.ndarray:
    """
    Return what photos of a camera show of the points, uint16 (N, H, W) in millimetres.

    A point stands for what is around it, SPREAD radians to each side; the nearest one counts.
    """
    depths = np.zeros((len(T_world_cam), camera.height, camera.width), np.uint16)
    around = round(SPREAD * camera.fx)
    for depth, point_of, T in zip(depths, model.point_of, T_world_cam):
        points = (model.points[point_of[point_of >= 0]] - T[:3, 3]) @ T[:3, :3]
        millimetres = np.rint(points[:, 2] * MM_PER_M)
        points = points[(millimetres > 0) & (millimetres <= np.iinfo(np.uint16).max)]
        points = points[np.argsort(-points[:, 2], kind='stable')]
        columns, rows = np.floor(camera.project(points)).astype(int).T
        for row, column, z in zip(rows, columns, points[:, 2]):
            depth[max(row - around, 0):max(row + around + 1, 0),
                  max(column - around, 0):max(column + around + 1, 0)] = round(z * MM_PER_M)
    return depths
