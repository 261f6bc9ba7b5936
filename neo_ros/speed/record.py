"""One measured speed: the clock around a call, its spread, and the floor below it."""
from collections.abc import Callable, Sequence
from dataclasses import asdict, dataclass, field
import math
import time
from typing import Any

from neo_ros.machine.host import Machine
import numpy as np


@dataclass(frozen=True)
class Effort:
    """
    How long the benchmarks take.

    seconds  at each call that is timed
    frames   of the generated bag
    graph_s  seconds of images through the real node
    voxels   of the synthetic field
    """

    seconds: float = 3.0
    frames: int = 90
    graph_s: float = 15.0
    voxels: int = 3_000_000


QUICK = Effort(seconds=0.05, frames=6, graph_s=1.5, voxels=30_000)


@dataclass(frozen=True)
class Work:
    """
    What a call has to do at least.

    flops      floating-point operations; None = not known
    bytes      read plus written, each once
    footprint  bytes that are touched at all; decides between cache and memory
    """

    flops: float | None
    bytes: float  # noqa: A003
    footprint: float | None = None


@dataclass
class Record:
    """One line of bench.json; see `neo_ros.speed.benchmarks` for the meaning of the fields."""

    benchmark: str
    name: str
    n: int = 0
    mean_ms: float | None = None
    median_ms: float | None = None
    p95_ms: float | None = None
    p99_ms: float | None = None
    max_ms: float | None = None
    rate_hz: float | None = None
    floor_ms: float | None = None
    floor_of: str | None = None
    measured_over_floor: float | None = None
    skipped: str | None = None
    details: dict[str, Any] = field(default_factory=dict)

    @classmethod
    def of(cls, benchmark: str, name: str, durations_ms: Sequence[float] | np.ndarray,
           details: dict[str, Any] | None = None) -> 'Record':
        """Summarise durations; the rate is that of calls one after the other."""
        times = np.asarray(durations_ms, np.float64)
        median, p95, p99, worst = np.percentile(times, [50, 95, 99, 100]).tolist()
        mean = float(times.mean())
        return cls(benchmark, name, len(times), mean, median, p95, p99, worst, 1e3 / mean,
                   details=details or {})

    def with_floor(self, work: Work, machine: Machine, threads: int) -> 'Record':
        """Add the time that the machine needs for the work at its measured best."""
        limits = {'bytes': work.bytes / machine.bandwidth(
            work.bytes if work.footprint is None else work.footprint, threads)}
        if work.flops is not None:
            limits['flops'] = work.flops / machine.flops(threads)
        self.floor_of, seconds = max(limits.items(), key=lambda item: item[1])
        self.floor_ms = 1e3 * seconds
        self.measured_over_floor = self.median_ms / self.floor_ms if self.median_ms else None
        self.details |= {'flops': work.flops, 'bytes': work.bytes}
        return self

    def to_dict(self) -> dict[str, Any]:
        """Return the record for JSON, floats to five significant digits."""
        return _rounded(asdict(self))


def time_calls(call: Callable[[], object], seconds: float, least: int = 3) -> np.ndarray:
    """Return the milliseconds of every call in so many seconds, after one that is not counted."""
    call()
    durations: list[float] = []
    deadline = time.perf_counter() + seconds
    while len(durations) < least or time.perf_counter() < deadline:
        started = time.perf_counter()
        call()
        durations.append(1e3 * (time.perf_counter() - started))
    return np.array(durations)


def _rounded(value: Any) -> Any:
    if isinstance(value, dict):
        return {key: _rounded(item) for key, item in value.items()}
    if isinstance(value, list):
        return [_rounded(item) for item in value]
    if isinstance(value, float):
        return float(f'{value:.5g}') if math.isfinite(value) else None
    return value
