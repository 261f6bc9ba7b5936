"""The node under load for a long time, to see if it grows, falls silent, or falls behind."""
from collections.abc import Iterator
from contextlib import contextmanager
from pathlib import Path
import subprocess
import sys
from typing import Any

from neo_ros.errors import NeoError
from neo_ros.speed.images import camera_images
from neo_ros.speed.node import RATE_HZ, run_graph
import numpy as np

# Of the walk that is sent to and fro, for a model with a memory.
FRAMES = 90
# Shares of the run that are compared: of an hour, the first and the last ten minutes.
PART = 1 / 6
# A beat of the diagnostics, sent every second, counts as missed when so much of a second passes
# without one.
BEAT_TIMEOUT_S = 1.9
MOST_GROWTH, MOST_SLOWER = 0.02, 0.10


def soak(model: Path, seconds: float, hogs: int = 0, rate: float = RATE_HZ) -> dict[str, Any]:
    """
    Send images to the node for so many seconds, with `hogs` processes that burn a core each.

    All outputs are subscribed, the map, too, and all inputs fed: odometry, priors, requests to
    search anew.

    Returns for JSON: seconds, hogs, wanted_rate_hz, mean_rate_hz, sent, missed; latency_ms from
    stamp to receipt (mean, median, p95, p99, max) of the whole run and of its first and last
    sixth; jitter_ms (standard deviation of the intervals), cpu_percent (100 = one core); heard
    (messages by topic); rss_mb (median of the first, the third and the last sixth) and rss_growth
    from the third on, when all caches are full; beats and missed_beats of the diagnostics, the
    time before the first and after the last included; `steady`: no beat missed, memory grown by
    less than 2 %, images in the first and in the last sixth, and p99 of the last within 10 % of
    the first. Raises NeoError where nothing comes back.
    """
    with _busy_processes(hogs):
        result = run_graph(model, camera_images(model, FRAMES), seconds, rate,
                           everything=True)
    stamps, times = np.array(result['arrivals'], np.int64).reshape(-1, 2).T
    beats, memory = np.array(result['beats']).reshape(-1, 2).T
    if len(times) < 2 or len(beats) < 2:
        raise NeoError(f'soak: expected {result["sent"]} wide images and {seconds:.0f} beats of '
                       f'the diagnostics, got {len(times)} and {len(beats)}')
    latency = (times - stamps) / 1e6
    since = (stamps - result['first_sent']) / 1e9
    first, last = since < PART * seconds, since >= (1 - PART) * seconds
    part = max(round(len(memory) * PART), 1)
    rss = {'first': float(np.median(memory[:part])),
           'third': float(np.median(memory[2 * part:][:part])),
           'last': float(np.median(memory[-part:]))}
    latencies = {'whole': _spread(latency), 'first': _spread(latency[first]),
                 'last': _spread(latency[last])}
    ended = result['ended']
    gaps = np.diff([ended - seconds, *beats, ended])
    missed_beats = int((gaps > BEAT_TIMEOUT_S).sum())
    growth = rss['last'] / rss['third'] - 1
    intervals = np.diff(times) / 1e6
    return {
        'model': model.name, 'seconds': seconds, 'hogs': hogs, 'wanted_rate_hz': rate,
        'mean_rate_hz': 1e3 / float(intervals.mean()), 'sent': result['sent'],
        'missed': result['sent'] - len(times), 'latency_ms': latencies,
        'jitter_ms': float(intervals.std()), 'cpu_percent': result['cpu_percent'],
        'heard': result['heard'], 'rss_mb': rss, 'rss_growth': growth, 'beats': len(beats),
        'missed_beats': missed_beats,
        'steady': bool(missed_beats == 0 and growth < MOST_GROWTH and first.any() and last.any()
                       and latencies['last']['p99']
                       < (1 + MOST_SLOWER) * latencies['first']['p99'])}


def _spread(values: np.ndarray) -> dict[str, float]:
    if not len(values):
        return {}
    median, p95, p99, worst = np.percentile(values, [50, 95, 99, 100]).tolist()
    return {'mean': float(values.mean()), 'median': median, 'p95': p95, 'p99': p99, 'max': worst}


@contextmanager
def _busy_processes(count: int) -> Iterator[None]:
    processes = [subprocess.Popen([sys.executable, '-c', 'while True: pass'])
                 for _ in range(count)]
    try:
        yield
    finally:
        for process in processes:
            process.kill()
            process.wait()
