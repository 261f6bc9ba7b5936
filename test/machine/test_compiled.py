"""Compiled kernels are kept on disk, whatever the disk and numba do."""
from collections.abc import Collection, Iterator
from contextlib import suppress
import errno
import importlib
import math
import os
from pathlib import Path
import shutil
import subprocess
import sys
import threading
from typing import Any
import warnings

from neo_ros.machine import compiled
import numba
from numba import config
from numba.core import caching
from numba.core.caching import CacheImpl, IndexDataCacheFile
import numpy as np
import pytest

HEAD = 'from neo_ros.machine.compiled import njit\n\n\n@njit()\n'


@pytest.fixture(autouse=True)
def cache_folder(tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> Iterator[Path]:
    (tmp_path / 'doubling_kernels.py').write_text(HEAD + 'def double(x):\n    return 2 * x\n')
    monkeypatch.syspath_prepend(str(tmp_path))
    monkeypatch.setattr(config, 'CACHE_DIR', str(tmp_path / 'cache'))
    compiled._warn.cache_clear()
    compiled._cache_class.cache_clear()
    yield tmp_path / 'cache'
    compiled._cache_class.cache_clear()


def doubled_by_fresh_kernels() -> int:
    """Import the kernels once more, as a new process does, and run them."""
    sys.modules.pop('doubling_kernels', None)
    importlib.invalidate_caches()
    return importlib.import_module('doubling_kernels').double(21)


def full_disk(*arguments: object) -> None:
    raise OSError(errno.ENOSPC, 'No space left on device')


@pytest.mark.parametrize('owner, name, replacement, reason', [
    (CacheImpl, '_locator_classes', [], 'can be written'),
    (IndexDataCacheFile, '_save_data', full_disk, 'No space left'),
], ids=['read-only', 'full'])
def test_a_disk_that_keeps_no_compiled_code_costs_time_only(
        monkeypatch: pytest.MonkeyPatch, owner: object, name: str, replacement: object,
        reason: str) -> None:
    monkeypatch.setattr(owner, name, replacement)
    with pytest.warns(RuntimeWarning, match=f'{reason}.*NUMBA_CACHE_DIR') as warned:
        assert doubled_by_fresh_kernels() == 42
    assert len(warned) == 1


@pytest.mark.parametrize('pattern', ['*.nbi', '*.nbc'])
def test_compiled_code_that_a_power_cut_broke_is_made_again(
        cache_folder: Path, pattern: str) -> None:
    assert doubled_by_fresh_kernels() == 42
    broken, = cache_folder.rglob(pattern)
    whole = broken.stat().st_size
    broken.write_bytes(b'')
    assert doubled_by_fresh_kernels() == 42
    # The same code may take some bytes more when it is compiled again.
    assert broken.stat().st_size == pytest.approx(whole, rel=0.1)


def test_a_kernel_calls_no_other_whose_code_may_differ_where_it_is_compiled_now(
        monkeypatch: pytest.MonkeyPatch) -> None:
    monkeypatch.setattr(compiled, 'kept_on_disk', lambda *_: None)  # Its code can be looked at.

    @compiled.njit()
    def called_often(values: Any) -> float:
        total = 0.0
        for value in values:  # More than is inlined of itself.
            for other in values:
                total += math.exp(value - other) * math.sin(value) / (2 + math.cos(other))
                total += math.atan(value + other) * math.exp(-other) / (2 + math.sin(value))
                total -= math.sin(value * other) / (1 + math.exp(other)) * math.cos(value)
                if value > other:
                    total += math.tan(value) / (3 + math.cos(value * other)) * math.exp(-value)
                elif value < -other:
                    total -= math.atan(value) / (3 + math.sin(value + other)) * math.exp(value)
        return total

    @compiled.njit()
    def caller(values: Any) -> Any:
        return called_often(values) + called_often(values[1:]) + called_often(values[2:])

    assert math.isfinite(caller(np.linspace(-1, 1, 5)))
    code = caller.inspect_asm(caller.signatures[0]).splitlines()
    assert code and not [line for line in code
                         if 'called_often' in line and 'NumbaEnv' not in line]


def test_kernels_are_compiled_anew_when_what_they_call_has_changed(tmp_path: Path) -> None:
    called = tmp_path / 'called_kernels.py'
    (tmp_path / 'calling_kernels.py').write_text(
        'from called_kernels import grow\n' + HEAD + 'def four(x):\n    return 2 * grow(x)\n')
    for factor, expected in ((2, 4), (30, 60)):
        called.write_text(HEAD + f'def grow(x):\n    return {factor} * x\n')
        for name in ('called_kernels', 'calling_kernels'):
            sys.modules.pop(name, None)
        importlib.invalidate_caches()
        assert importlib.import_module('calling_kernels').four(1) == expected


def test_numba_has_every_private_part_that_is_used() -> None:
    def double(x: int) -> int:
        return 2 * x

    try:
        compiled.kept_on_disk(numba.njit(double), double)
    except (ImportError, AttributeError) as error:
        pytest.fail(f'numba {numba.__version__} lacks a private part that machine/compiled.py '
                    f'uses: {error}; mend kept_on_disk, or bound numba in setup.py below it')


def test_what_is_kept_is_found_again() -> None:
    assert doubled_by_fresh_kernels() == 42
    assert doubled_by_fresh_kernels() == 42
    double = sys.modules['doubling_kernels'].double
    assert sum(double.stats.cache_hits.values()) == 1
    assert not double.stats.cache_misses


def test_two_that_keep_code_at_once_do_not_mix_it(
        cache_folder: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    assert doubled_by_fresh_kernels() == 42
    double = sys.modules['doubling_kernels'].double
    shutil.rmtree(cache_folder)
    assert double(2.5) == 5.0
    shutil.rmtree(cache_folder)
    # Without the lock both read the index before either writes it.
    both_have_read = threading.Barrier(2)
    write_index = IndexDataCacheFile._save_index

    def write_index_late(*arguments: Any) -> None:
        with suppress(threading.BrokenBarrierError):
            both_have_read.wait(timeout=0.5)
        write_index(*arguments)

    monkeypatch.setattr(IndexDataCacheFile, '_save_index', write_index_late)
    savers = []
    for overload in double.overloads.items():
        another = numba.njit(double.py_func)
        compiled.kept_on_disk(another, double.py_func)
        savers.append(threading.Thread(target=another._cache.save_overload, args=overload))
    for saver in savers:
        saver.start()
    for saver in savers:
        saver.join()
    assert doubled_by_fresh_kernels() == 42
    fresh = sys.modules['doubling_kernels'].double
    assert fresh(2.5) == 5.0
    assert sum(fresh.stats.cache_hits.values()) == 2


@pytest.mark.parametrize('owner, name', [
    (caching, 'FunctionCache'), (caching.Cache, 'flush'), (caching.Cache, 'save_overload')],
    ids=['class', 'flush', 'save'])
def test_another_numba_costs_time_only_and_the_warning_names_what_is_gone(
        monkeypatch: pytest.MonkeyPatch, owner: object, name: str) -> None:
    monkeypatch.delattr(owner, name)
    if owner is caching.Cache:  # Its abstract base has one of the name, too.
        monkeypatch.delattr(caching._Cache, name)
    with pytest.warns(RuntimeWarning, match=f'numba {numba.__version__} lacks.*{name}'):
        assert doubled_by_fresh_kernels() == 42


def test_an_attribute_that_is_gone_is_not_made_up() -> None:
    class Elsewhere:
        """As a dispatcher whose cache has moved."""

    with pytest.raises(AttributeError, match='_cache'):
        compiled._replace(Elsewhere(), '_cache', None)


WAITING = ('OMP_WAIT_POLICY', 'OPENBLAS_THREAD_TIMEOUT', 'OPENCV_THREAD_POOL_ACTIVE_WAIT_WORKER')


def without(names: Collection[str]) -> dict[str, str]:
    """Return the environment without these variables."""
    return {name: value for name, value in os.environ.items() if name not in names}


@pytest.mark.parametrize('told, expected', [
    ({}, 'passive 18 0'), (dict(zip(WAITING, ('active', '26', '9'))), 'active 26 9')],
                         ids=['default', 'told'])
def test_threads_that_wait_sleep_unless_told_otherwise(
        told: dict[str, str], expected: str) -> None:
    shown = subprocess.run(
        [sys.executable, '-c', f'import neo_ros, os; print(*map(os.environ.get, {WAITING}))'],
        env=without(WAITING) | told, capture_output=True, text=True, check=True)
    assert shown.stdout.strip() == expected


# A process of its own, for OpenBLAS reads the variable when numpy is loaded.
IDLE_AFTER_BLAS = """
import time
import neo_ros
import numpy as np
a, burnt = np.ones((512, 512), np.float32), 0.0
for _ in range(20):
    a @ a
    before = time.process_time()
    time.sleep(0.02)
    burnt += time.process_time() - before
print(burnt)
"""


@pytest.mark.skipif(len(os.sched_getaffinity(0)) < 2, reason='OpenBLAS has no other threads')
def test_threads_of_numpy_do_not_burn_a_core_after_a_product() -> None:
    told = subprocess.run([sys.executable, '-c', IDLE_AFTER_BLAS],
                          env=without(WAITING), capture_output=True, text=True, check=True)
    # Of 0.4 s; left to itself OpenBLAS takes all of them.
    assert float(told.stdout) < 0.1


def test_without_compilation_there_is_nothing_to_keep(monkeypatch: pytest.MonkeyPatch) -> None:
    monkeypatch.setattr(config, 'DISABLE_JIT', 1)
    with warnings.catch_warnings():
        warnings.simplefilter('error')
        assert doubled_by_fresh_kernels() == 42
