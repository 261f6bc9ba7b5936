from pathlib import Path
from types import SimpleNamespace
from typing import Any

from neo_ros.errors import NeoError, SceneError
from neo_ros.geometry import Intrinsics, ViewExpansion
from neo_ros.outpaint.fitting import OutpaintConfig, OutpaintTrainer
from neo_ros.outpaint.network import NetworkConfig
from neo_ros.training.checkpoint import (
    checkpoint_errors, read_checkpoint, read_notes, train_with_checkpoints, write_checkpoint)
import numpy as np
import pytest
import torch

STATE = {'step': 7, 'psnr': 21.25, 'log': [[1, 2.5]], 'shape': [2, 3],
         'trainer': {'grid': np.arange(6, dtype=np.float32).reshape(2, 3),
                     'skip': np.array([3, 0, 255], np.uint8),
                     'network': {'weight': torch.ones(2, 2, dtype=torch.bfloat16)}}}


def test_states_come_back_with_arrays_as_tensors(tmp_path: Path) -> None:
    write_checkpoint(tmp_path / 'a.ckpt', STATE)
    found = read_checkpoint(tmp_path / 'a.ckpt')
    assert [path.name for path in tmp_path.iterdir()] == ['a.ckpt']
    assert {key: found[key] for key in ('step', 'psnr', 'log', 'shape')} == {
        'step': 7, 'psnr': 21.25, 'log': [[1, 2.5]], 'shape': [2, 3]}
    np.testing.assert_array_equal(np.asarray(found['trainer']['grid']),
                                  STATE['trainer']['grid'])  # type: ignore[index]
    assert found['trainer']['skip'].dtype == torch.uint8
    assert found['trainer']['network']['weight'].dtype == torch.bfloat16


@pytest.mark.parametrize('content', [b'', b'no checkpoint', None], ids=['empty', 'text', 'cut'])
def test_broken_checkpoints_are_named(tmp_path: Path, content: bytes | None) -> None:
    path = tmp_path / 'a.ckpt'
    write_checkpoint(path, STATE)
    path.write_bytes(path.read_bytes()[:-300] if content is None else content)
    with pytest.raises(NeoError, match='a.ckpt: expected a checkpoint of neo train'):
        read_checkpoint(path)


class Payload:
    """Something whose unpickling would run code."""


def test_checkpoints_run_no_code(tmp_path: Path) -> None:
    torch.save({'step': Payload()}, tmp_path / 'a.ckpt')
    with pytest.raises(NeoError, match='a.ckpt: expected a checkpoint'):
        read_checkpoint(tmp_path / 'a.ckpt')


def test_a_checkpoint_that_cannot_be_written_leaves_the_old_one(tmp_path: Path) -> None:
    write_checkpoint(tmp_path / 'a.ckpt', STATE)
    before = (tmp_path / 'a.ckpt').read_bytes()
    with pytest.raises(NeoError, match='none/b.ckpt: cannot write the checkpoint'):
        write_checkpoint(tmp_path / 'none' / 'b.ckpt', STATE)
    with pytest.raises(AttributeError):
        write_checkpoint(tmp_path / 'a.ckpt', {'step': lambda: None})
    assert (tmp_path / 'a.ckpt').read_bytes() == before


def outpainter(width: int = 8) -> OutpaintTrainer:
    return OutpaintTrainer(
        ViewExpansion.to_size(Intrinsics(8, 8, 4, 4, 4, 4), 16, 16),
        NetworkConfig(patch=4, width=width, depth=1, hidden=8),
        OutpaintConfig(steps=1, batch=1, device='cpu'), seed=0)


def whole_state() -> dict[str, Any]:
    return {'seconds': 1.0, 'log': [], 'trainer': outpainter().state()}


@pytest.mark.parametrize('state, message', [
    ([1, 2], 'TypeError'),
    ({'a': 1}, "KeyError.'seconds'."),
    ({**whole_state(), 'seconds': None}, 'TypeError'),
    ({**whole_state(), 'log': None}, 'TypeError'),
    ({**whole_state(), 'trainer': {'step': 1}}, "KeyError.'loss'."),
    ({**whole_state(), 'trainer': {**outpainter().state(), 'averaged': 3}}, 'TypeError'),
    ({**whole_state(), 'trainer': {**outpainter().state(), 'optimizer': 3}}, 'AttributeError'),
    ({**whole_state(), 'trainer': outpainter(width=12).state()}, 'size mismatch'),
], ids=['list', 'other keys', 'no seconds', 'no log', 'half', 'no weights', 'no optimizer',
        'other sizes'])
def test_checkpoints_of_something_else_are_named(
        tmp_path: Path, state: Any, message: str) -> None:
    torch.save(state, tmp_path / 'a.ckpt')
    run: Any = SimpleNamespace(seconds=0.0, log={'outpainter': []})
    with pytest.raises(NeoError, match=f'a.ckpt: expected a checkpoint .*{message}.*; delete it'):
        train_with_checkpoints(run, outpainter(), tmp_path / 'a.ckpt', 'outpainter',
                               lambda: (1, 1), lambda: None, lambda: '')


def test_a_full_device_is_no_fault_of_the_checkpoint(tmp_path: Path) -> None:
    with pytest.raises(torch.OutOfMemoryError), checkpoint_errors(tmp_path / 'a.ckpt'):
        raise torch.OutOfMemoryError


@pytest.mark.parametrize('text', [
    None, '', '[]', 'null', '{"seconds": null, "log": []}', '{"seconds": 1, "log": null}',
    '{"seconds": 1}'])
def test_notes_of_something_else_are_named(tmp_path: Path, text: str | None) -> None:
    if text is not None:
        (tmp_path / 'field.json').write_text(text)
    with pytest.raises(SceneError, match='field.json: expected the notes .*delete field.npz to'):
        read_notes(tmp_path / 'field.json', 'field.npz')
