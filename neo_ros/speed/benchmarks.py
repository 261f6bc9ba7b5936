"""
How fast every part is on this machine, held against what the machine can do.

`run_benchmarks` returns what `neo bench` writes as JSON:

schema_version  1
quick           True: too short to be quoted
host            cpu, cores, platform, python, neo_ros, versions of packages, commit;
                load_average_1min before the start, busy (by that load, or because all cores
                computed little more than one: others were at work, the figures are not to be
                quoted and the floors may be too high);
                matmul_gflops, memory_gb_s, cache_gb_s: best rates measured, by threads, see
                `host.Machine`
records         a list, one per thing measured:
  benchmark             expand, messages, networks, guided, replay, field, gpu or node
  name                  what was measured
  n                     how many times
  mean_ms, median_ms, p95_ms, p99_ms, max_ms
                        of one call; of a frame for replay; from the image's stamp to the receipt
                        of its wide image for node
  rate_hz               calls, or frames, per second
  floor_ms, floor_of    time that the machine needs at its measured best for the 'flops' or for
                        the 'bytes' of the work, whichever takes longer; null where not known
  measured_over_floor   median_ms / floor_ms
  skipped               why it was not measured, else null; then the figures are null
  details               what is particular to it: flops and bytes of the floor (flops null: the
                        onnx package is missing, so the floor is too low); rays_per_s,
                        samples_per_ray; of the stream views_per_s (wanted are 20, and 1000 of
                        512x512 on a GPU),
                        psnr_against_rendered of its views, training_views_per_s of a training and
                        share_of_stream of its time; of a replay model_rate_hz of the extrapolator
                        alone, share_of_model_rate (0.9 is wanted) and share_in_model of its time;
                        of the node missed (images without an answer), mean_rate_hz, jitter_ms
                        (standard deviation of the intervals between wide images), cpu_percent
                        (100 = one core), rss_mb,
                        stages_ms (the node's own, over its last 300 frames),
                        outside_inference_ms and share_outside_inference (with the wait for the
                        frame before), decode_check_publish_ms (without)

The field is synthetic, see `field.box_room`; its steps are those of the last stage without
the occupancy update after every hundredth. All inputs are drawn from fixed seeds.
"""
from collections.abc import Callable, Iterator, Sequence
from importlib import import_module
import json
import os
from pathlib import Path
from typing import Any

from neo_ros.errors import ConfigError
from neo_ros.machine.files import write_bytes
from neo_ros.machine.host import describe_host, Machine, measure_machine
from neo_ros.runtime import read_model_card
from neo_ros.speed.node import measure_node
from neo_ros.speed.record import Effort, QUICK, Record
from neo_ros.speed.runtime import measure_expand, measure_messages, measure_replay

SCHEMA_VERSION = 1
TRAIN_EXTRA = ('onnx', 'scipy', 'torch')


def measure_trained(name: str, *arguments: Any) -> Iterator[Record]:
    """Call `NAME.measure_NAME` of this room, which needs the train extra; without it say so."""
    try:
        module = import_module(f'neo_ros.speed.{name}')
    except ModuleNotFoundError as error:
        if error.name not in TRAIN_EXTRA:
            raise
        yield Record(name, name, skipped=(
            f"{error.name} is not installed: pip install '.[train]' in a checkout"))
        return
    yield from getattr(module, f'measure_{name}')(*arguments)


BENCHMARKS: dict[str, Callable[[Path, Machine, Effort], Iterator[Record]]] = {
    'expand': measure_expand,
    'messages': lambda model, machine, effort: measure_messages(machine, effort),
    'networks': lambda model, machine, effort: measure_trained('networks', machine, effort),
    'guided': lambda model, machine, effort: measure_trained('guided', effort),
    'replay': lambda model, machine, effort: measure_replay(model, effort),
    'field': lambda model, machine, effort: measure_trained('field', machine, effort),
    'gpu': lambda model, machine, effort: measure_trained('gpu', effort),
    'node': measure_node,
}
NEED_MODEL = {'expand', 'replay', 'node'}


def run_benchmarks(model: Path, only: Sequence[str] = (), quick: bool = False,
                   report: Callable[[str, int, int], None] = lambda name, done, total: None
                   ) -> dict[str, Any]:
    """
    Measure the named benchmarks, or all; see the module for what is returned.

    `report(name, done, total)` is called as it goes on. Raises ConfigError for names that do not
    exist and ModelError for a model that cannot be used, before anything is measured.
    """
    if unknown := sorted(set(only) - BENCHMARKS.keys()):
        raise ConfigError(f'only: expected some of {", ".join(BENCHMARKS)}, '
                          f'got {", ".join(unknown)}')
    names = [name for name in BENCHMARKS if not only or name in only]
    if NEED_MODEL & set(names):
        read_model_card(model)
    effort = QUICK if quick else Effort()
    total = len(names) + 1
    report('machine', 0, total)
    load_average = os.getloadavg()[0]
    machine = measure_machine(min(effort.seconds, 1.5))
    host = describe_host(machine, load_average)
    records: list[Record] = []
    for done, name in enumerate(names, 1):
        report(name, done, total)
        records += BENCHMARKS[name](model, machine, effort)
    report('done', total, total)
    return {'schema_version': SCHEMA_VERSION, 'quick': quick, 'host': host,
            'records': [record.to_dict() for record in records]}


def write_benchmarks(path: Path, results: dict[str, Any]) -> None:
    """Write the JSON file; raises NeoError with the reason when that fails."""
    write_bytes(path, (json.dumps(results, indent=1) + '\n').encode())
