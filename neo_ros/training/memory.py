"""Beyond the paper: the scene memory that guides a run's network, with its landmarks."""
from dataclasses import asdict, replace
import glob
import json
import math
from pathlib import Path
import shutil
import time
from typing import Any

from neo_ros.baking.keyframes import MemoryConfig
from neo_ros.baking.landmarks import find_landmarks
from neo_ros.baking.memory_baking import bake_memory
from neo_ros.baking.twin_search import find_twins
from neo_ros.baking.worker_files import SharedScene
from neo_ros.errors import ModelError
from neo_ros.field.radiance_field import RadianceField
from neo_ros.machine.files import sha256_of, write_bytes
from neo_ros.machine.progress import of_stage
from neo_ros.runtime.model_card import MemoryFile, read_model_card, write_model_card
from neo_ros.training.run import TrainingRun
from neo_ros.training.time_plan import most_memory_seconds
from neo_ros.training.views import make_sampler

# What is made on the way to the memory, and how long it took, in the output folder.
WORK, NOTES = 'memory_work', 'memory.json'


def memory_step(run: TrainingRun, field: RadianceField) -> None:
    """Make the scene memory that guides the network, with its landmarks, if it is not there."""
    config = run.experiment.memory
    if config is None:
        shutil.rmtree(run.out / WORK, ignore_errors=True)  # The field left points.
        return
    path, notes = run.memory_path, run.out / NOTES
    seconds = memory_seconds(notes, config) if path.exists() else None
    if seconds is None:
        scale, started = run.experiment.scale, time.monotonic()
        landmarks = find_landmarks(run.fitted, scale, run.expansion.source, run.out / WORK,
                                   run.progress)
        scene = SharedScene.unpack(run.out / 'field.npz', run.fitted, scale, run.out / WORK)
        spent = time.monotonic() - started
        left = math.inf if config.minutes is None else 60 * config.minutes - spent
        if run.plan is not None:  # Matches and stereo before the field may have taken more.
            left = min(left, most_memory_seconds(run.plan, run.seconds + spent))
        memory = bake_memory(
            field, scene.read_photos(), run.expansion, make_sampler(run, field), config,
            run.experiment.seed, run.out / WORK / f'keyframes_{config.distance}',
            run.progress, seconds=left, scene=scene if run.cluster else None)
        memory.landmarks = landmarks
        memory.twins = find_twins(memory, run.expansion, of_stage(run.progress, 'look-alikes'))
        memory.write(path)
        seconds = time.monotonic() - started
        write_bytes(notes, json.dumps({'seconds': seconds, **asdict(config)}).encode())
        shutil.rmtree(run.out / WORK, ignore_errors=True)
    run.seconds += seconds


def name_memory(run: TrainingRun) -> None:
    """Name the memory in the cards of the model and of what was exported beside it."""
    if run.experiment.memory is None:
        return
    path = run.memory_path
    file = MemoryFile(file=path.name, sha256=sha256_of(path))
    news: dict[str, Any] = {'memory': file, 'trained_seconds': run.seconds}
    write_model_card(run.model_path, replace(read_model_card(run.model_path), **news))
    # What `neo export` wrote beside the model is guided by the same memory.
    for model in run.out.glob(f'{glob.escape(run.model_path.stem)}.*.onnx'):
        try:
            card = read_model_card(model)
        except ModelError:
            continue  # An export that was broken off.
        write_model_card(model, replace(card, **news))


def memory_seconds(notes: Path, config: MemoryConfig) -> float | None:
    """Return how long a scene memory took, None where it was not made, or of other settings."""
    try:
        found = json.loads(notes.read_text())
        seconds = float(found.pop('seconds'))
        settings = {'minutes': None, **found}  # Those of before knew none.
        return seconds if asdict(config).items() <= settings.items() else None
    except (OSError, ValueError, KeyError, AttributeError):
        return None
