"""Bags on Ray, embedded: the same bytes as in one process, and a worker that is killed."""
import math
import os
from pathlib import Path
import signal
import sys
import threading
from typing import Any

from bag_files import write_walk_bag
from cluster_jobs import cores, die, halve
from neo_ros.errors import ConfigError, NeoError
from neo_ros.geometry import Intrinsics, ViewExpansion
from neo_ros.machine.ray_jobs import map_on_ray
from neo_ros.replaying.bag_replayer import ReplayOptions
from neo_ros.replaying.many_bags import replay_bags
import pytest
from tiny_model import write_tiny_model

EXPANSION = ViewExpansion.to_size(Intrinsics.from_hfov(32, 24, math.pi / 2), 64, 48)
OPTIONS = ReplayOptions(score=True)


def write_inputs(folder: Path, frames: int, count: int) -> tuple[Path, list[Path]]:
    """Write a model, and so many bags of so many frames and a few more."""
    return write_tiny_model(folder / 'm.onnx', EXPANSION), [
        write_walk_bag(folder / 'in' / f'bag_{place}', EXPANSION, frames + place)
        for place in range(count)]


def files(folder: Path) -> dict[str, bytes]:
    """Return the content of all files of a folder."""
    return {str(path.relative_to(folder)): path.read_bytes() for path in folder.rglob('*')
            if path.is_file()}


@pytest.mark.slow
def test_a_cluster_gives_the_same_bytes(tmp_path: Path, ray: Any) -> None:
    model, bags = write_inputs(tmp_path, 2, 3)
    bags.insert(1, tmp_path / 'in' / 'nowhere')
    here = replay_bags(bags, model, tmp_path / 'here', OPTIONS)
    there = replay_bags(bags, model, tmp_path / 'there', OPTIONS, cluster=True)
    assert here == there
    assert [bool(row.error) for row in there] == [False, True, False, False]
    assert files(tmp_path / 'here') == files(tmp_path / 'there')


@pytest.mark.slow
def test_a_killed_workers_bag_is_done_again(tmp_path: Path, ray: Any) -> None:
    model, bags = write_inputs(tmp_path, 120, 2)
    out = tmp_path / 'there'
    began: set[str] = set()
    killed: list[str] = []

    def kill_first() -> None:
        """Kill the first worker that has written a part of a bag; note who begins which bag."""
        while not (out / 'bags.json').exists() and not stop.wait(0.005):
            for storage in (out / '.partial').glob('*/*/*.mcap'):
                began.add(storage.parent.parent.name)
                if not killed and storage.stat().st_size > 100_000:
                    holders = holders_of(storage)
                    if holders:
                        os.kill(holders[0], signal.SIGKILL)
                        killed.append(storage.parent.name)

    stop = threading.Event()
    watch = threading.Thread(target=kill_first)
    watch.start()
    try:
        there = replay_bags(bags, model, out, OPTIONS, cluster=True)
    finally:
        stop.set()
        watch.join()
    assert len(killed) == 1
    assert [row.error for row in there] == ['', '']
    # The killed bag was begun twice, the other once.
    assert sorted(name.partition('.')[0] for name in began) == sorted(['bag_0', 'bag_1', *killed])
    assert there == replay_bags(bags, model, tmp_path / 'here', OPTIONS)
    assert files(tmp_path / 'here') == files(out)


def holders_of(path: Path) -> list[int]:
    """Return the other processes that have a file open."""
    found = []
    for handle in Path('/proc').glob('[0-9]*/fd/*'):
        try:
            if handle.readlink() == path and int(handle.parts[2]) != os.getpid():
                found.append(int(handle.parts[2]))
        except OSError:  # It has ended, or is somebody else's.
            pass
    return found


@pytest.mark.slow
def test_a_job_that_always_kills_its_worker_is_given_up(tmp_path: Path, ray: Any) -> None:
    ((index, found),) = map_on_ray(die, [str(tmp_path)], retries=1)
    assert index == 0 and isinstance(found, NeoError)
    assert 'given up after 2 attempts' in str(found)
    assert len(list(tmp_path.iterdir())) == 2


@pytest.mark.slow
def test_a_job_that_raises_says_so(ray: Any) -> None:
    found = dict(map_on_ray(halve, [4, 5]))
    assert found[0] == 2 and str(found[1]) == 'ValueError: 5 is odd'


@pytest.mark.slow
def test_a_job_takes_one_core(ray: Any) -> None:
    assert list(map_on_ray(cores, [0])) == [(0, 1)]


def test_without_ray_the_extra_is_named(tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    model, bags = write_inputs(tmp_path, 1, 2)
    monkeypatch.setitem(sys.modules, 'ray', None)
    with pytest.raises(ConfigError, match=r'--cluster: ray is not installed.*\[cluster\]'):
        replay_bags(bags, model, tmp_path / 'out', OPTIONS, cluster=True)
    assert not (tmp_path / 'out').exists()
