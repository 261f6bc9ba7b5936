"""Two processes on gloo train one network: they end with the same weights."""
import os
from pathlib import Path
import socket
import subprocess
import sys

import neo_ros
from neo_ros.outpaint.distributed import from_first, process_group, processes, wait_for_all
import numpy as np

RANK = """
import sys
import numpy as np, torch
from neo_ros.geometry import Intrinsics, ViewExpansion
from neo_ros.outpaint import fitting
from neo_ros.outpaint.distributed import from_first, process_group, wait_for_all
from neo_ros.outpaint.fitting import OutpaintConfig, OutpaintTrainer
from neo_ros.outpaint.network import NetworkConfig

fitting.THREADS = 1


def learn(rank):
    trainer = OutpaintTrainer(
        ViewExpansion.to_size(Intrinsics(8, 8, 4, 4, 4, 4), 16, 16),
        NetworkConfig(patch=4, width=8, depth=1, memory=8),
        OutpaintConfig(batch=4, precision='fp32', minutes=60.0, device='cpu', photometric=0,
                       occluders=0), seed=0)
    share = 4 // trainer.world
    assert trainer.batch_size == share and trainer.rank == rank
    for step in range(3):
        views = np.random.default_rng(step).integers(0, 256, (4, 16, 16, 4), np.uint8)
        views[..., 3] = 255
        trainer.train_step(views[rank * share:(rank + 1) * share])
    wait_for_all()
    weights = torch.cat([p.flatten() for p in trainer.averaged.parameters()]).detach().numpy()
    np.savez(sys.argv[1] + f'/{rank}.npz', weights=weights, seconds=trainer.seconds,
             first=from_first(float(rank + 7)))


with process_group() as rank:
    learn(rank)
"""


def run_ranks(folder: Path, count: int) -> tuple[list[int], list[str]]:
    """Run processes that train together; returns their exit codes and errors."""
    with socket.socket() as free:
        free.bind(('127.0.0.1', 0))
        port = free.getsockname()[1]
    environment = {**os.environ, 'WORLD_SIZE': str(count), 'MASTER_ADDR': '127.0.0.1',
                   'MASTER_PORT': str(port), 'OMP_NUM_THREADS': '1', 'CUDA_VISIBLE_DEVICES': '',
                   'PYTHONPATH': str(Path(neo_ros.__file__).parent.parent)}
    running = [subprocess.Popen(
        [sys.executable, '-c', RANK, str(folder)], stderr=subprocess.PIPE, text=True,
        env={**environment, 'RANK': str(rank), 'LOCAL_RANK': str(rank)}) for rank in range(count)]
    try:
        errors = [process.communicate(timeout=100)[1] for process in running]
    finally:
        for process in running:
            process.kill()
    return [process.returncode for process in running], errors


def test_two_processes_learn_one_network(tmp_path: Path) -> None:
    codes, errors = run_ranks(tmp_path, 2)
    if 'EADDRINUSE' in ''.join(errors):  # Somebody took the port before they did.
        codes, errors = run_ranks(tmp_path, 2)
    assert codes == [0, 0], errors
    first, second = (np.load(tmp_path / f'{rank}.npz') for rank in range(2))
    np.testing.assert_array_equal(first['weights'], second['weights'])
    assert first['seconds'] == second['seconds'] > 0 and second['first'] == 7
    (tmp_path / 'alone').mkdir()
    assert run_ranks(tmp_path / 'alone', 1)[0] == [0]
    alone = np.load(tmp_path / 'alone' / '0.npz')['weights']
    np.testing.assert_allclose(first['weights'], alone, atol=1e-5)


def test_alone_nothing_is_shared() -> None:
    with process_group() as rank:
        assert rank == 0 and processes() == (0, 1) and from_first(3.5) == 3.5
        wait_for_all()
