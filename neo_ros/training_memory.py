"""Beyond the paper: the scene memory that guides a run's network, with its landmarks."""
import hashlib
from importlib.util import find_spec
import shutil
import time
from typing import Optional, TYPE_CHECKING

from neo_ros.checkpoint import read_notes, write_notes
from neo_ros.errors import SceneError
from neo_ros.evaluation.photo_bank import read_photo_bank
from neo_ros.evaluation.sparse_model import read_sparse_model
from neo_ros.field.memory_baking import bake_memory, Photos
from neo_ros.field.voxel_field import RadianceField
from neo_ros.memory.landmarks import Landmarks, magnification
from neo_ros.runtime.model_card import MemoryFile
from neo_ros.training_views import make_sampler
import numpy as np

if TYPE_CHECKING:
    from neo_ros.pipeline import TrainingRun

# What is made on the way to the landmarks, in the output folder.
WORK = 'landmarks'
# Photos that landmarks are triangulated from: matching takes 10 ms a pair, 15 pairs a photo.
LANDMARK_PHOTOS = 400


def memory_step(run: 'TrainingRun', field: RadianceField) -> Optional[MemoryFile]:
    """Make the scene memory that guides the network, if it is not there yet."""
    config = run.experiment.memory
    if config is None:
        return None
    path, notes = run.model_path.with_suffix('.memory'), run.out / 'memory.json'
    if path.exists() and notes.exists():
        run.seconds, _ = read_notes(notes, path.name)
    else:
        scale, before, started = run.experiment.scale, run.seconds, time.monotonic()
        photos = Photos(run.fitted.read_images(scale), run.fitted.intrinsics.scaled(scale),
                        run.fitted.T_world_cam)
        memory = bake_memory(
            field, photos, run.expansion, make_sampler(run, field), config, run.experiment.seed,
            lambda done, total: run.progress('memory', done, total, ''))
        memory.landmarks = find_landmarks(run)
        memory.write(path)
        shutil.rmtree(run.out / WORK, ignore_errors=True)
        run.seconds += time.monotonic() - started
        # The log says when it began: its minutes are not the network's.
        write_notes(notes, run.seconds, [[0, before, 0.0]])
    return MemoryFile(file=path.name, sha256=hashlib.sha256(path.read_bytes()).hexdigest())


def find_landmarks(run: 'TrainingRun') -> Optional[Landmarks]:
    """Triangulate what the photos show from their known poses; None where that gives nothing."""
    if find_spec('pycolmap') is None:
        run.progress('without landmarks', 0, 1, 'pycolmap is not installed')
        return None
    chosen = np.linspace(0, len(run.fitted) - 1, min(len(run.fitted), LANDMARK_PHOTOS))
    photos = run.fitted.subset(chosen.round().astype(int).tolist())
    bank = read_photo_bank(
        photos, run.experiment.scale, run.out / WORK / 'features.npz',
        lambda done, total: run.progress('features', done, total, ''),
        magnification(run.expansion.source))
    try:
        model = read_sparse_model(bank, run.out / WORK / 'sparse',
                                  lambda done, total: run.progress('matches', done, total, ''))
    except SceneError as error:
        run.progress('without landmarks', 0, 1, str(error))
        return None
    return Landmarks.from_observations(
        model.points, np.concatenate(model.point_of),
        np.concatenate([one.descriptors for one in bank.features]))
