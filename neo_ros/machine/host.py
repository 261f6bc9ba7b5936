"""What the machine can do at its best: the floor that benchmarks are held against."""
from concurrent.futures import ThreadPoolExecutor
from dataclasses import dataclass
import functools
from importlib.metadata import PackageNotFoundError, version
import os
from pathlib import Path
import platform
import subprocess
import sys
import time
from typing import Any

from neo_ros import __version__
import numpy as np

PACKAGES = ('numpy', 'onnxruntime', 'opencv-python-headless', 'rosbags', 'numba', 'torch', 'onnx')
# A BLAS fixes its threads when it is loaded: a process of its own for each count.
MATMUL = """
import sys, time
import numpy as np
best = 0.0
# Small ones get through between two turns of a neighbour, large ones show many cores at work.
for size in (512, 1024):
    a = np.random.default_rng(0).random((size, size), np.float32)
    out = a @ a
    deadline = time.perf_counter() + float(sys.argv[1]) / 2
    while time.perf_counter() < deadline:
        started = time.perf_counter()
        np.matmul(a, a, out=out)
        best = max(best, 2 * size ** 3 / (time.perf_counter() - started))
print(best)
"""
THREAD_VARIABLES = ('OPENBLAS_NUM_THREADS', 'OMP_NUM_THREADS', 'MKL_NUM_THREADS')
# What fits here is copied over and over in the cache of one core, what does not in memory.
CACHED_BYTES, MEMORY_BYTES = 1 << 20, 1 << 27


def core_count() -> int:
    """Cores that this process may use."""
    return len(os.sched_getaffinity(0)) if hasattr(os, 'sched_getaffinity') else (
        os.cpu_count() or 1)


@dataclass(frozen=True)
class Machine:
    """
    The best rates measured, by number of threads.

    matmul_gflops  float32 matrix product in NumPy's BLAS, 1e9 operations a second
    memory_gb_s    copy of 128 MB, cache_gb_s of 1 MB a thread: read plus written, 1e9 bytes/s
    """

    matmul_gflops: dict[int, float]
    memory_gb_s: dict[int, float]
    cache_gb_s: dict[int, float]

    def is_busy(self, load_average: float) -> bool:
        """Tell whether others use the cores, by the load before the measurements or by these."""
        most = max(self.matmul_gflops)
        outrun = most > 1 and self.matmul_gflops[most] < 1.3 * self.matmul_gflops[1]
        return outrun or load_average > most / 2

    def flops(self, threads: int) -> float:
        """Floating-point operations per second; `threads` = 0 means all cores."""
        return 1e9 * _best(self.matmul_gflops, threads)

    def bandwidth(self, footprint: float, threads: int) -> float:
        """Bytes per second for data of this size in bytes; `threads` = 0 means all cores."""
        rates = self.cache_gb_s if footprint <= 2 * CACHED_BYTES else self.memory_gb_s
        return 1e9 * _best(rates, threads)


def measure_machine(seconds: float) -> Machine:
    """Measure every rate for about so many seconds, with one thread and with all."""
    counts = sorted({1, core_count()})
    return Machine(
        {threads: _matmul_rate(threads, seconds) / 1e9 for threads in counts},
        {threads: _copy_rate(MEMORY_BYTES, threads, seconds) / 1e9 for threads in counts},
        {threads: _copy_rate(CACHED_BYTES * threads, threads, seconds) / 1e9
         for threads in counts})


def describe_host(machine: Machine, load_average: float) -> dict[str, Any]:
    """Return what a figure's reader must know of the machine; see `neo_ros.speed.benchmarks`."""
    return {
        'cpu': host(), 'cores': core_count(), 'platform': platform.platform(),
        'load_average_1min': load_average, 'busy': machine.is_busy(load_average),
        'python': platform.python_version(), 'neo_ros': __version__,
        'versions': {name: _version(name) for name in PACKAGES}, 'commit': commit(),
        **{name: {str(threads): round(rate, 2) for threads, rate in rates.items()}
           for name, rates in vars(machine).items()}}


def _best(rates: dict[int, float], threads: int) -> float:
    """Return the best rate with at most so many threads: on a busy machine fewer may do more."""
    return max(rate for count, rate in rates.items() if not threads or count <= threads)


def _matmul_rate(threads: int, seconds: float) -> float:
    result = subprocess.run(
        [sys.executable, '-c', MATMUL, str(seconds)], check=True, text=True,
        env=os.environ | dict.fromkeys(THREAD_VARIABLES, str(threads)), stdout=subprocess.PIPE)
    return float(result.stdout)


def _copy_rate(size: int, threads: int, seconds: float) -> float:
    """Bytes read plus written per second at the best of all copies; NumPy releases the GIL."""
    sources = [np.ones(size // threads, np.uint8) for _ in range(threads)]
    copies = [np.zeros_like(source) for source in sources]
    # A small copy takes less time than handing it to a thread.
    repeats = max(1, (1 << 26) // size)

    def copy(index: int) -> None:
        for _ in range(repeats):
            np.copyto(copies[index], sources[index])

    best, deadline = 0.0, time.perf_counter() + seconds
    with ThreadPoolExecutor(threads) as pool:
        while time.perf_counter() < deadline or not best:
            started = time.perf_counter()
            list(pool.map(copy, range(threads)))
            best = max(best, 2 * size * repeats / (time.perf_counter() - started))
    return best


def _version(package: str) -> str | None:
    try:
        return version(package)
    except PackageNotFoundError:
        return None


@functools.cache
def commit() -> str | None:
    """
    Return the commit of the source checkout, None for an installed package.

    As it was when first asked: what runs was loaded then. With -dirty where code or settings
    differ from it; results that a run writes do not count.
    """
    root = Path(__file__).resolve().parents[2]
    if not (root / '.git').exists():
        return None
    try:
        name, changed = (subprocess.run(
            ['git', '-C', str(root), *command], capture_output=True, text=True, timeout=10,
            check=True).stdout.strip() for command in (
                ('rev-parse', '--short', 'HEAD'),
                ('status', '--porcelain', 'neo_ros', 'config')))
    except (OSError, subprocess.SubprocessError):
        return None
    return f'{name}-dirty' if changed else name


def host() -> str:
    """Describe the machine that the figures were taken on, with the GPU if it is used."""
    name = platform.processor() or platform.machine()
    try:
        lines = Path('/proc/cpuinfo').read_text().splitlines()
        name = next(line.split(':')[1].strip() for line in lines if 'model name' in line)
    except (OSError, StopIteration, IndexError):
        pass  # Not Linux, or a processor that does not say its name.
    return f'{name}, {os.cpu_count()} cores{_gpu_in_use()}'


def _gpu_in_use() -> str:
    # Who has not loaded torch uses no GPU here, and is not made to load it.
    torch = sys.modules.get('torch')
    if torch is None or not torch.cuda.is_initialized():
        return ''
    return f', {torch.cuda.get_device_name()}'
