"""What photos tell of depth by showing the same from beside one another."""
from collections.abc import Iterator, Sequence
from contextlib import contextmanager, nullcontext
from dataclasses import replace
from pathlib import Path
from tempfile import TemporaryDirectory
import time

from neo_ros.baking.landmarks import find_points, photos_for_landmarks
from neo_ros.baking.photo_stereo import photo_depths
from neo_ros.baking.sparse_model import SparseModel
from neo_ros.geometry import Intrinsics
from neo_ros.machine.progress import of_stage
from neo_ros.pictures.depth import MM_PER_M, to_millimetres, write_depth
from neo_ros.scenes.posed_images import PosedImages
from neo_ros.training.memory import WORK
from neo_ros.training.run import TrainingRun
import numpy as np

# A point tells of so many radians to each side of it.
SPREAD = 0.008


@contextmanager
def photos_with_depth(run: TrainingRun, writes: bool = True) -> Iterator[PosedImages]:
    """
    Give the photos that a run's field is fitted to, with depth maps.

    Measured depth, where the capture has any; else that of stereo, and where it tells nothing that
    of the points that the photos triangulate to. Only the photos that landmarks are made of have
    such a map, none where nothing can be triangulated, or the field does not look at depth. The
    scene memory is made of the same points: the process that writes, of several, keeps them, and
    the maps until the memory is made.
    """
    if any(run.fitted.depth_paths) or run.experiment.field.depth == 0:
        yield run.fitted
        return
    with nullcontext(run.out / WORK) if writes else TemporaryDirectory() as work:
        started = time.monotonic()
        photos = _with_stereo(run, Path(work))
        run.seconds += time.monotonic() - started
        yield photos


def _with_stereo(run: TrainingRun, work: Path) -> PosedImages:
    chosen = photos_for_landmarks(run.fitted)
    paths = {index: work / f'stereo/{index:06d}.png' for index in chosen}
    missing = [place for place, path in enumerate(paths.values()) if not path.exists()]
    if missing:
        photos, experiment = run.fitted.subset(chosen), run.experiment
        found = find_points(photos, experiment.scale, run.expansion.source, work, run.progress)
        if found is None:
            return run.fitted
        scale, progress = experiment.field_scale, of_stage(run.progress, 'stereo')
        for done, (place, depth) in enumerate(zip(missing, depth_among(
                photos.read_images(scale), photos.intrinsics.scaled(scale), photos.T_world_cam,
                found[1], missing)), 1):
            write_depth(paths[chosen[place]], depth)
            progress(done, len(missing))
    return replace(run.fitted, depth_paths=tuple(map(paths.get, range(len(run.fitted)))))


def depth_among(images: np.ndarray, camera: Intrinsics, T_world_cam: np.ndarray,
                model: SparseModel, wanted: Sequence[int]) -> Iterator[np.ndarray]:
    """
    Yield the depth of wanted ones of photos, uint16 (H, W), millimetres, 0 = unknown.

    That of stereo, see `photo_depths`, and of the points where it tells nothing.
    """
    at_points = depth_of_points(model, T_world_cam, camera)
    for index, seen in zip(wanted, photo_depths(images, camera, T_world_cam, model, wanted)):
        told = to_millimetres(seen)
        yield np.where(told > 0, told, at_points[index])


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
