"""Checkpoints of a training: nested dicts of numbers, texts, numpy arrays and tensors."""
import os
from pathlib import Path
from typing import Any

from neo_ros.errors import NeoError
import numpy as np
import torch


def write_checkpoint(path: Path, state: dict[str, Any]) -> None:
    """Write a checkpoint; a kill or a full disk in between leaves the old file whole."""
    partial = path.with_suffix('.partial')
    try:
        torch.save(_arrays_to_tensors(state), partial)
        os.replace(partial, path)
    except (OSError, RuntimeError) as error:
        partial.unlink(missing_ok=True)
        raise NeoError(f'{path}: cannot write the checkpoint: {error}') from error


def read_checkpoint(path: Path) -> dict[str, Any]:
    """Read what `write_checkpoint` wrote (arrays come back as tensors); runs no code in it."""
    try:
        return torch.load(path, map_location='cpu', weights_only=True)
    except Exception as error:  # torch raises several types for a broken file.
        raise NeoError(f'{path}: expected a checkpoint of neo train: {error}; '
                       'delete it to start this step again') from error


def _arrays_to_tensors(value: Any) -> Any:
    if isinstance(value, dict):
        return {key: _arrays_to_tensors(item) for key, item in value.items()}
    if isinstance(value, np.ndarray):
        return torch.from_numpy(value)
    return value
