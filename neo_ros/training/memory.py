"""Beyond the paper: the scene memory that guides a run's network, with its landmarks."""
from dataclasses import asdict
import glob
import hashlib
from importlib.util import find_spec
import json
from pathlib import Path
import shutil
import time
from typing import Optional

from neo_ros.errors import ModelError, SceneError
from neo_ros.evaluation.photo_bank import read_photo_bank
from neo_ros.evaluation.sparse_model import read_sparse_model
from neo_ros.field.memory_baking import bake_memory, MemoryConfig, Photos
from neo_ros.field.voxel_field import RadianceField
from neo_ros.machine.files import write_bytes
from neo_ros.memory.landmarks import Landmarks, magnification
from neo_ros.runtime.model_card import MemoryFile, read_model_card, write_model_card
from neo_ros.training.run import TrainingRun
from neo_ros.training.views import make_sampler
import numpy as np

# What is made on the way to the memory, and how long it took, in the output folder.
WORK, NOTES = 'memory_work', 'memory.json'
# Photos that landmarks are triangulated from: matching takes 10 ms a pair, 15 pairs a photo.
LANDMARK_PHOTOS = 400


def memory_step(run: TrainingRun, field: RadianceField) -> None:
    """
    Make the scene memory that guides the network, if it is not there yet, and name it in the card.

    Without it, or where it cannot be made, the model is there and works alone.
    """
    config = run.experiment.memory
    if config is None:
        return
    path, notes = run.model_path.with_suffix('.memory'), run.out / NOTES
    seconds = memory_seconds(notes, config) if path.exists() else None
    if seconds is None:
        scale, started = run.experiment.scale, time.monotonic()
        landmarks = find_landmarks(run)
        photos = Photos(run.fitted.read_images(scale), run.fitted.intrinsics.scaled(scale),
                        run.fitted.T_world_cam)
        memory = bake_memory(
            field, photos, run.expansion, make_sampler(run, field), config, run.experiment.seed,
            run.out / WORK / f'keyframes_{config.distance}',
            lambda done, total: run.progress('memory', done, total, ''))
        memory.landmarks = landmarks
        memory.write(path)
        seconds = time.monotonic() - started
        write_bytes(notes, json.dumps({'seconds': seconds, **asdict(config)}).encode())
        shutil.rmtree(run.out / WORK, ignore_errors=True)
    run.seconds += seconds
    file = MemoryFile(file=path.name, sha256=hashlib.sha256(path.read_bytes()).hexdigest())
    news = {'memory': file, 'trained_seconds': run.seconds}
    write_model_card(run.model_path, read_model_card(run.model_path).model_copy(update=news))
    # What `neo export` wrote beside the model is guided by the same memory.
    for model in run.out.glob(f'{glob.escape(run.model_path.stem)}.*.onnx'):
        try:
            card = read_model_card(model)
        except ModelError:
            continue  # An export that was broken off.
        write_model_card(model, card.model_copy(update=news))


def memory_seconds(notes: Path, config: MemoryConfig) -> Optional[float]:
    """Return how long a scene memory took, None where it was not made, or of other settings."""
    try:
        found = json.loads(notes.read_text())
        return float(found.pop('seconds')) if asdict(config).items() <= found.items() else None
    except (OSError, ValueError, KeyError, AttributeError):
        return None


def find_landmarks(run: TrainingRun) -> Optional[Landmarks]:
    """Triangulate what the photos show from their known poses; None where that gives nothing."""
    if find_spec('pycolmap') is None:
        run.progress('without landmarks', 0, 1, 'pycolmap is not installed')
        return None
    chosen = np.linspace(0, len(run.fitted) - 1, min(len(run.fitted), LANDMARK_PHOTOS))
    photos = run.fitted.subset(chosen.round().astype(int).tolist())
    try:
        bank = read_photo_bank(
            photos, run.experiment.scale, run.out / WORK / 'features.npz',
            lambda done, total: run.progress('features', done, total, ''),
            magnification(run.expansion.source))
        model = read_sparse_model(bank, run.out / WORK / 'sparse',
                                  lambda done, total: run.progress('matches', done, total, ''))
    except SceneError as error:
        run.progress('without landmarks', 0, 1, str(error))
        return None
    return Landmarks.from_observations(
        model.points, np.concatenate(model.point_of),
        np.concatenate([one.descriptors for one in bank.features]))
