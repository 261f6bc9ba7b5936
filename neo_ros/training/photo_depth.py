"""What photos tell of depth by showing the same from beside one another."""
from contextlib import nullcontext
from pathlib import Path
from tempfile import TemporaryDirectory
import time

from neo_ros.baking.landmarks import find_points, photos_for_landmarks
from neo_ros.baking.photo_stereo import photo_depths
from neo_ros.baking.sparse_model import SparseModel
from neo_ros.geometry import Intrinsics
from neo_ros.machine.progress import of_stage
from neo_ros.pictures.depth import MM_PER_M, to_millimetres
from neo_ros.training.memory import WORK
from neo_ros.training.run import TrainingRun
import numpy as np

# A point tells of so many radians to each side of it.
SPREAD = 0.008


def depth_of_photos(run: TrainingRun, images: np.ndarray, writes: bool = True
                    ) -> np.ndarray | None:
    """
    Return depth, as `PosedImages.read_depths`, that a run's photos tell of one another.

    images: the photos as the field sees them, uint8 (N, H, W, 3). Depth is that of stereo, and
    where it tells nothing that of the points that the photos triangulate to. Only the photos that
    landmarks are made of have any. None where nothing comes of it, or the field does not look at
    depth. The scene memory is made of the same points: the process that writes, of several, keeps
    them.
    """
    experiment, started = run.experiment, time.monotonic()
    if experiment.field.depth == 0:
        return None
    chosen = photos_for_landmarks(run.fitted)
    photos = run.fitted.subset(chosen)
    with nullcontext(run.out / WORK) if writes else TemporaryDirectory() as work:
        found = find_points(photos, experiment.scale, run.expansion.source, Path(work),
                            run.progress)
    depths = None
    if found is not None:
        camera = photos.intrinsics.scaled(experiment.field_scale)
        depths = np.zeros(images.shape[:3], np.uint16)
        depths[chosen] = depth_of_points(found[1], photos.T_world_cam, camera)
        progress = of_stage(run.progress, 'stereo')
        for done, (index, seen) in enumerate(zip(chosen, photo_depths(
                images[chosen], camera, photos.T_world_cam, found[1])), 1):
            told = to_millimetres(seen)
            np.copyto(depths[index], told, where=told > 0)
            progress(done, len(chosen))
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
