"""The landmarks of a memory where the scene has changed: those of what left go, new ones come."""
from importlib.util import find_spec
from pathlib import Path

from neo_ros.baking.keyframes import Photos
from neo_ros.baking.photo_bank import of_scene, PhotoBank
from neo_ros.baking.sparse_model import read_sparse_model
from neo_ros.errors import SceneError
from neo_ros.field.voxel_field import VoxelField
from neo_ros.geometry import CameraPose, Intrinsics
from neo_ros.machine.progress import no_progress, Progress
from neo_ros.memory.landmarks import Landmarks, magnification
from neo_ros.memory.local_features import find_features
from neo_ros.scenes.posed_images import PosedImages
from neo_ros.updating.changed_space import ChangedSpace
import numpy as np


def changed_landmarks(old: Landmarks | None, field: VoxelField, space: ChangedSpace,
                      photos: Photos, source: Intrinsics, work: Path,
                      progress: Progress = no_progress) -> Landmarks | None:
    """
    Return the old landmarks outside of a space, and those that new photos show in it.

    None where none is left, or there were none. source: the robot's camera, which will look for
    them; work: a folder for features and matches.
    """
    if old is None:
        return None
    stay = old.subset(~space.holds(field, old.points))
    found = _triangulated(photos, source, work, progress)
    if found is None:
        return Landmarks.joined([stay])
    return Landmarks.joined([stay, found.subset(space.holds(field, found.points))])


def _triangulated(photos: Photos, source: Intrinsics, work: Path, progress: Progress
                  ) -> Landmarks | None:
    """Return what photos show at their known poses; None where that is nothing."""
    count, usable = len(photos.images), photos.usable
    if find_spec('pycolmap') is None or count < 2:
        return None
    magnify = magnification(source)
    features = [of_scene(find_features(image, magnify), None if usable is None else usable[index])
                for index, image in enumerate(photos.images)]
    if not any(len(one.points) for one in features):
        return None
    bank = PhotoBank(PosedImages(
        photos.intrinsics, (Path(),) * count, tuple(map(CameraPose, photos.T_world_cam)),
        (0,) * count), 1.0, features, magnify)
    try:
        model = read_sparse_model(bank, work, progress)
    except SceneError:
        return None  # Nothing could be triangulated.
    return Landmarks.from_observations(
        model.points, np.concatenate(model.point_of),
        np.concatenate([one.descriptors for one in features]))
