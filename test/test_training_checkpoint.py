from pathlib import Path

from neo_ros.errors import NeoError
from neo_ros.training.checkpoint import read_checkpoint, write_checkpoint
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
