"""Checkpoints of a training: nested dicts of numbers, texts, numpy arrays and tensors."""
from collections.abc import Callable, Iterator
from contextlib import contextmanager
import json
from pathlib import Path
import time
from typing import Any, Protocol

from neo_ros.errors import NeoError, SceneError
from neo_ros.machine.files import whole_file, write_bytes
from neo_ros.machine.progress import StageProgress
from neo_ros.outpaint.fitting import OutpaintTrainer
import numpy as np
import torch

CHECKPOINT_SECONDS = 60.0


class Watched(Protocol):
    """A run, or a part of one: how long it took, its logs, and who watches it."""

    seconds: float
    log: dict[str, list[list[float]]]
    progress: StageProgress


def write_checkpoint(path: Path, state: dict[str, Any]) -> None:
    """Write a checkpoint; a kill or a full disk in between leaves the old file whole."""
    try:
        with whole_file(path) as partial:
            torch.save(_arrays_to_tensors(state), partial)
    except (OSError, RuntimeError) as error:
        raise NeoError(f'{path}: cannot write the checkpoint: {error}') from error


def read_checkpoint(path: Path) -> dict[str, Any]:
    """Read what `write_checkpoint` wrote (arrays come back as tensors); runs no code in it."""
    with checkpoint_errors(path):
        return torch.load(path, map_location='cpu', weights_only=True)


@contextmanager
def checkpoint_errors(path: Path) -> Iterator[None]:
    """Name the file in any error of reading a checkpoint, or of going on from what was in it."""
    try:
        yield
    except (MemoryError, torch.OutOfMemoryError):
        raise  # That is no fault of the file.
    except Exception as error:  # Of a broken file or another's state, torch raises many types.
        raise NeoError(f'{path}: expected a checkpoint of neo train: {error!r}; '
                       'delete it to start this step again') from error


def _arrays_to_tensors(value: Any) -> Any:
    if isinstance(value, dict):
        return {key: _arrays_to_tensors(item) for key, item in value.items()}
    if isinstance(value, np.ndarray):
        return torch.from_numpy(value)
    return value


def train_with_checkpoints(run: Watched, trainer: Any, checkpoint: Path, stage: str,
                           done_of: Callable[[], tuple[int, int]], take_step: Callable[[], Any],
                           note: Callable[[], str], writes: bool = True,
                           beside: dict[str, Any] | None = None) -> None:
    """
    Call `take_step` until it is all done; the state is on disk once a minute and at the end.

    done_of tells how far the trainer is, and where it ends; of several processes one writes.
    beside: what the checkpoint keeps beside the trainer; a broken-off run finds it there again.
    """
    beside = {} if beside is None else beside
    run.log.setdefault(stage, [])
    if checkpoint.exists():
        state = read_checkpoint(checkpoint)
        with checkpoint_errors(checkpoint):
            # B1's checkpoints had no log once.
            run.seconds, run.log[stage] = float(state['seconds']), list(state.get('log', []))
            trainer.restore(state['trainer'])
            beside.update({name: state[name] for name in beside})

    def save() -> None:
        write_checkpoint(checkpoint, {'seconds': run.seconds, 'log': run.log[stage],
                                      'trainer': trainer.state(), **beside})

    saved = last = time.monotonic()
    done, total = done_of()
    fresh = done < total
    while done < total:
        take_step()
        now = time.monotonic()
        run.seconds, last = run.seconds + now - last, now
        before, (done, total) = done, done_of()
        every = max(total // 200, 1)
        if done // every > before // every:
            run.log[stage].append([trainer.step, run.seconds, trainer.figure])
        run.progress(stage, done, total, note())
        if writes and now - saved > CHECKPOINT_SECONDS:
            save()
            saved = time.monotonic()
    if fresh and writes:
        save()


def begin_as(trainer: OutpaintTrainer, checkpoint: Path) -> None:
    """Give a new trainer the network of a training that had ended, or was broken off."""
    state = read_checkpoint(checkpoint)
    with checkpoint_errors(checkpoint):
        for network in (trainer.network, trainer.averaged):
            network.load_state_dict(state['trainer']['averaged'])


def write_notes(path: Path, seconds: float, log: list[list[float]]) -> None:
    """Write how long a run had taken when a step was done, and the step's log."""
    write_bytes(path, json.dumps({'seconds': seconds, 'log': log}).encode())


def read_notes(path: Path, result: str) -> tuple[float, list[list[float]]]:
    """Read what `write_notes` wrote beside the file `result`; SceneError for anything else."""
    try:
        notes = json.loads(path.read_text())
        return float(notes['seconds']), list(notes['log'])
    except (OSError, ValueError, KeyError, TypeError) as error:
        raise SceneError(f'{path}: expected the notes of a finished step: {error}; '
                         f'delete {result} to do this step again') from error
