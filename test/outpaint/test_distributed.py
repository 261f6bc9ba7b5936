"""Two processes on gloo train one network: they end with the same weights, and one model."""
import json
import os
from pathlib import Path
import socket
import subprocess
import sys

import neo_ros
from neo_ros.outpaint.distributed import from_first, process_group, processes, wait_for_all
from neo_ros.runtime import FovExtrapolator
import numpy as np
import pytest

pytestmark = pytest.mark.slow

HELPERS = Path(__file__).parents[1] / 'helpers'
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
        NetworkConfig(patch=4, width=8, depth=1, hidden=8),
        OutpaintConfig(batch=4, precision='fp32', minutes=60.0, device='cpu', photometric=0,
                       occluders=0), seed=0)
    share = 4 // trainer.world
    assert trainer.batch_size == share and trainer.rank == rank
    for step in range(3):
        views = np.random.default_rng(step).integers(0, 256, (4, 16, 16, 4), np.uint8)
        views[..., 3] = 255
        trainer.train_step(torch.from_numpy(views[rank * share:(rank + 1) * share]))
    wait_for_all()
    weights = torch.cat([p.flatten() for p in trainer.averaged.parameters()]).detach().numpy()
    np.savez(sys.argv[1] + f'/{rank}.npz', weights=weights, seconds=trainer.seconds,
             first=from_first(float(rank + 7)))


with process_group() as rank:
    learn(rank)
"""


PIPELINE = """
from dataclasses import replace
import json, os, sys
from pathlib import Path
from neo_ros.outpaint import fitting
from tiny_training import TINY, train_tiny

fitting.THREADS, folder = 1, Path(sys.argv[1])
run = train_tiny(Path(sys.argv[2]), folder / 'out', replace(
    TINY, field=replace(TINY.field, steps=200), memory=None,
    outpaint=replace(TINY.outpaint, steps=4, validations=2)), cache_gb=1.0)
(folder / (os.environ['RANK'] + '.json')).write_text(json.dumps(
    {'samples': run.samples, 'figures': run.figures, 'validation': run.log['validation']}))
"""


def run_ranks(folder: Path, count: int, script: str = RANK,
              *arguments: str) -> tuple[list[int], list[str]]:
    """Run processes that train together; returns their exit codes and errors."""
    with socket.socket() as free:
        free.bind(('127.0.0.1', 0))
        port = free.getsockname()[1]
    environment = {**os.environ, 'WORLD_SIZE': str(count), 'MASTER_ADDR': '127.0.0.1',
                   'MASTER_PORT': str(port), 'OMP_NUM_THREADS': '1', 'CUDA_VISIBLE_DEVICES': '',
                   'PYTHONPATH': os.pathsep.join(map(str, (
                       Path(neo_ros.__file__).parent.parent, HELPERS)))}
    running = [subprocess.Popen(
        [sys.executable, '-c', script, str(folder), *arguments], stderr=subprocess.PIPE, text=True,
        env={**environment, 'RANK': str(rank), 'LOCAL_RANK': str(rank)}) for rank in range(count)]
    try:
        errors = [process.communicate(timeout=250)[1] for process in running]
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


def test_two_processes_run_the_pipeline_and_leave_one_model(
        flat_scene: Path, tmp_path: Path) -> None:
    out = tmp_path / 'out'
    codes, errors = run_ranks(tmp_path, 2, PIPELINE, str(flat_scene))
    if 'EADDRINUSE' in ''.join(errors):
        codes, errors = run_ranks(tmp_path, 2, PIPELINE, str(flat_scene))
    assert codes == [0, 0], errors
    first, second = (json.loads((tmp_path / f'{rank}.json').read_text()) for rank in range(2))
    assert first['samples'] == second['samples'] == 4 * 4
    # The first alone exports and scores; the network is one.
    assert first['figures']['ring_psnr'] > 5 and not second['figures']
    assert [(step, psnr) for step, _, psnr in first['validation']] == [
        (step, psnr) for step, _, psnr in second['validation']] and len(first['validation']) == 2
    caches = [out / 'panoramas_3', out / 'panoramas_1000003']
    assert {path.name for path in out.iterdir()} == {
        'run.json', 'field.npz', 'field.json', 'outpainter.ckpt', 'flat.onnx', 'report.html',
        'scores.json', 'poses.json', 'poses.png', *(cache.name for cache in caches)}
    places = [{json.loads(note.read_text())['position'][0] for note in cache.glob('*.json')}
              for cache in caches]
    assert len(places[0]) > 1 and len(places[1]) > 1 and places[0] != places[1]
    model = FovExtrapolator.load(out / 'flat.onnx')
    assert model.card.parity.share_within_1 >= 0.999
    assert model.expand(np.zeros((32, 32, 3), np.uint8)).wide_image.shape == (64, 64, 3)


def test_alone_nothing_is_shared() -> None:
    with process_group() as rank:
        assert rank == 0 and processes() == (0, 1) and from_first(3.5) == 3.5
        wait_for_all()
