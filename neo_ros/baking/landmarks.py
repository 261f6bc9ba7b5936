"""The landmarks of a scene memory: points that several photos show, from their known poses."""
from importlib.util import find_spec
from pathlib import Path

from neo_ros.baking.photo_bank import PhotoBank, read_photo_bank
from neo_ros.baking.sparse_model import read_sparse_model, SparseModel
from neo_ros.errors import SceneError
from neo_ros.geometry import Intrinsics
from neo_ros.machine.evenly import evenly
from neo_ros.machine.progress import of_stage, StageProgress
from neo_ros.memory.landmarks import Landmarks, magnification
from neo_ros.scenes.posed_images import PosedImages
import numpy as np

# A room is seen well in so many photos; a larger floor needs so many a square metre.
LEAST_PHOTOS, PHOTOS_A_SQUARE_METRE = 400, 12
FLOOR_HEIGHT = 3.0


def find_landmarks(photos: PosedImages, scale: float, source: Intrinsics, work: Path,
                   progress: StageProgress) -> Landmarks | None:
    """
    Triangulate what the photos show at this scale; None where that gives nothing.

    source  the camera of the robot, which will look for them
    work    keeps features and matches, so that a run that was broken off goes on
    """
    found = find_points(photos.subset(photos_for_landmarks(photos)), scale, source, work, progress)
    if found is None:
        return None
    bank, model = found
    return Landmarks.from_observations(
        model.points, np.concatenate(model.point_of),
        np.concatenate([one.descriptors for one in bank.features]))


def photos_for_landmarks(photos: PosedImages) -> list[int]:
    """Return as many photos as the floor needs, evenly chosen: matching takes 0.15 s a photo."""
    return evenly(len(photos), _photos_for(photos.T_world_cam[:, :3, 3])).tolist()


def find_points(photos: PosedImages, scale: float, source: Intrinsics, work: Path,
                progress: StageProgress) -> tuple[PhotoBank, SparseModel] | None:
    """Return the features of all photos and what they triangulate to, see `find_landmarks`."""
    if find_spec('pycolmap') is None:
        progress('without landmarks', 0, 1, 'pycolmap is not installed')
        return None
    try:
        bank = read_photo_bank(photos, scale, work / 'features.npz',
                               of_stage(progress, 'features'), magnification(source))
        return bank, read_sparse_model(bank, work / 'sparse', of_stage(progress, 'matches'))
    except SceneError as error:
        progress('without landmarks', 0, 1, str(error))
        return None


def _photos_for(positions: np.ndarray) -> int:
    """Return how many of photos that were taken at positions (N, 3) landmarks are made of."""
    squares = np.unique(np.floor(positions / (1.0, 1.0, FLOOR_HEIGHT)), axis=0)
    return max(LEAST_PHOTOS, PHOTOS_A_SQUARE_METRE * len(squares))
