"""Jobs on Ray before there is a cluster; with one: test/replaying/test_cluster.py."""
from pathlib import Path
import socket
from typing import NamedTuple

from neo_ros.errors import ConfigError, NeoError
from neo_ros.machine import ray_jobs
from neo_ros.machine.ray_jobs import check_ray, make_on_ray, map_on_ray
import pytest


def test_a_cluster_that_is_not_there_is_named(monkeypatch: pytest.MonkeyPatch) -> None:
    ray = pytest.importorskip('ray', reason='needs Ray: the extra cluster is not installed')
    monkeypatch.setattr(ray, 'is_initialized', lambda: False)
    with socket.socket() as bound:  # Nobody listens there, and nobody else can.
        bound.bind(('127.0.0.1', 0))
        address = f'127.0.0.1:{bound.getsockname()[1]}'
        monkeypatch.setenv('RAY_ADDRESS', address)
        with pytest.raises(ConfigError, match=f'RAY_ADDRESS: .* cluster at {address}, got: .*ref'):
            list(map_on_ray(abs, [1]))
        with pytest.raises(ConfigError, match=f'RAY_ADDRESS: .* cluster at {address}, got: .*ref'):
            check_ray()  # Before the long work that comes before the first job.


class Job(NamedTuple):
    out: Path


def test_what_a_worker_wrote_has_to_be_there(
        tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    jobs = [Job(tmp_path / name) for name in 'ab']
    monkeypatch.setattr(ray_jobs, 'map_on_ray', lambda function, jobs: (
        (index, None) for index in range(len(jobs))))
    jobs[0].out.touch()
    made = make_on_ray(lambda job: None, jobs, 'it was not made')
    assert next(made) == 0
    with pytest.raises(NeoError, match='/b: its worker wrote it, but it is not there: --out must'):
        next(made)


def test_where_nothing_is_to_be_made_no_cluster_is_asked(monkeypatch: pytest.MonkeyPatch) -> None:
    monkeypatch.setattr(ray_jobs, 'map_on_ray', None)
    assert list(make_on_ray(lambda job: None, list[Job](), 'it was not made')) == []
