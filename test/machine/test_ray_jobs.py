"""Jobs on Ray before there is a cluster; with one: test/replaying/test_cluster.py."""
import socket

from neo_ros.errors import ConfigError
from neo_ros.machine.ray_jobs import map_on_ray
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
