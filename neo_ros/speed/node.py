"""Speed of the node on a real ROS graph: camera and consumer in one process, node in another."""
from collections.abc import Iterator
from importlib.util import find_spec
import json
import os
from pathlib import Path
import subprocess
import sys
import tempfile
from typing import Any

from neo_ros.errors import NeoError
from neo_ros.flat.demo_flat import build_demo_flat
from neo_ros.flat.visits import CHAIRS, changed_flat
from neo_ros.geometry import Intrinsics, ViewExpansion
from neo_ros.machine.host import Machine
from neo_ros.machine.processes import end_process
from neo_ros.machine.ros_domain import own_domain
from neo_ros.runtime import read_model_card
from neo_ros.speed.images import camera_images, cast_view, PAPER_VIEW, walk_at_30_hz
from neo_ros.speed.model import count_flops, write_stand_in_model
from neo_ros.speed.record import Effort, Record, Work
from neo_ros.speed.runtime import size_name
import numpy as np

RATE_HZ = 30.0
VGA = Intrinsics.from_hfov(640, 480, np.pi / 2)
VGA_VIEW = ViewExpansion.horizontal(VGA, 960)
VGA_WIDE_VIEW = ViewExpansion.to_size(VGA, 1280, 960)
STAGES = ('queue', 'decode', 'infer', 'check', 'publish', 'total')


def measure_node(model: Path, machine: Machine, effort: Effort) -> Iterator[Record]:
    """Run the node at 30 Hz with the given model, with stand-ins of two sizes, and guided."""
    if find_spec('rclpy') is None:
        yield Record('node', 'node', skipped='rclpy is not installed')
        return
    yield measure_graph(model, machine, effort)
    for view in (PAPER_VIEW, VGA_VIEW):
        name = f'{size_name(view)}, 30 Hz, stand-in network'
        if find_spec('onnx') is None:
            yield Record('node', name,
                         skipped="onnx is not installed: pip install '.[train]' in a checkout")
            continue
        with tempfile.TemporaryDirectory() as folder:
            stand_in = write_stand_in_model(Path(folder) / 'stand_in.onnx', view)
            record = measure_graph(stand_in, machine, effort)
        record.name = name
        yield record
    try:
        from neo_ros.speed.guided import write_guided_stand_in
    except ModuleNotFoundError as error:
        yield Record('node', 'guided', skipped=f'{error.name} is not installed: '
                                               "pip install '.[train]' in a checkout")
        return
    for view in (PAPER_VIEW, VGA_VIEW, VGA_WIDE_VIEW):
        with tempfile.TemporaryDirectory() as folder:
            model = write_guided_stand_in(Path(folder), view, walk_at_30_hz(effort.frames))
            images = camera_images(model, effort.frames)
            record = measure_graph(model, machine, effort, images)
            more: list[Record] = []
            if view is PAPER_VIEW:
                more = [*measure_outputs(model, images),
                        *measure_learning(model, machine, effort)]
        record.name = f'{size_name(view)}, 30 Hz, guided'
        yield record
        yield from more


def measure_learning(model: Path, machine: Machine, effort: Effort) -> Iterator[Record]:
    """Measure the node in a flat whose chairs were moved, without and with `learn`."""
    view = read_model_card(model).expansion
    flat = changed_flat(build_demo_flat(), CHAIRS)
    images = np.stack([cast_view(view.source, pose, flat)[0]
                       for pose in walk_at_30_hz(effort.frames)])
    for name, learn in (('chairs moved', False), ('chairs moved, learn', True)):
        record = measure_graph(model, machine, effort, images, learn)
        record.name = f'{size_name(view)}, 30 Hz, guided, {name}'
        yield record


def measure_outputs(model: Path, images: np.ndarray) -> Iterator[Record]:
    """Time what the memory's outputs cost beside the images: made and given to a publisher."""
    with tempfile.TemporaryDirectory() as folder:
        path = Path(folder) / 'images.npy'
        np.save(path, images)
        probe = subprocess.run(
            [sys.executable, '-m', 'neo_ros.node.output_probe', '--model', str(model.resolve()),
             '--images', str(path)], env=_environment(), capture_output=True, text=True,
            timeout=90 + len(images), check=False)
    if probe.returncode:
        raise NeoError(f'node: the measurement of the outputs failed:\n{probe.stderr[-2000:]}')
    size = size_name(read_model_card(model).expansion)
    for name, milliseconds in json.loads(probe.stdout.splitlines()[-1]).items():
        if not milliseconds:
            raise NeoError(f'node: expected messages of wide/{name}, got none: the memory did not '
                           'know the images')
        yield Record.of('node', f'{size}, wide/{name}', milliseconds)


def measure_graph(model: Path, machine: Machine, effort: Effort,
                  images: np.ndarray | None = None, learn: bool = False) -> Record:
    """
    Send images to the node, in a ROS domain of its own; latency is from stamp to receipt.

    images: uint8 RGB (N, h, w, 3); those of `camera_images` by default. learn: as the parameter.
    The consumer subscribes to all four outputs. Raises NeoError where nothing comes back.
    """
    view = read_model_card(model).expansion
    if images is None:
        images = camera_images(model, effort.frames)
    result = run_graph(model, images, effort.graph_s, learn=learn)
    stamps, times = np.array(result['arrivals']).reshape(-1, 2).T
    if len(times) < 2:
        raise NeoError(f'node: expected {result["sent"]} wide images, got {len(times)}')
    record = Record.of('node', f'{size_name(view)}, 30 Hz', (times - stamps) / 1e6)
    intervals = np.diff(times) / 1e6
    stages = _stages(result['diagnostics'])
    median = {stage: spread['median'] for stage, spread in stages.items()}
    record.rate_hz = 1e3 / float(intervals.mean())
    record.details = {
        'model': model.name, 'wanted_rate_hz': RATE_HZ, 'mean_rate_hz': record.rate_hz,
        'sent': result['sent'], 'missed': result['sent'] - len(times),
        'jitter_ms': float(intervals.std()), 'cpu_percent': result['cpu_percent'],
        'idle_cpu_percent': result['idle_cpu_percent'],
        'unwatched_cpu_percent': result['unwatched_cpu_percent'], 'rss_mb': result['rss_mb'],
        'stages_ms': stages, 'outside_inference_ms': median['total'] - median['infer'],
        # Without the wait for the network to be done with the frame before.
        'decode_check_publish_ms': sum(median[stage] for stage in ('decode', 'check', 'publish')),
        'share_outside_inference': 1 - median['infer'] / median['total']}
    moved = view.source.width * view.source.height * 3 + (
        # Colour, mask and confidence are written by the model's side and copied to be sent.
        2 * view.target.width * view.target.height * 5)
    return record.with_floor(
        Work(count_flops(model), model.stat().st_size + moved), machine, 0)


def run_graph(model: Path, images: np.ndarray, seconds: float,
              rate: float = RATE_HZ, everything: bool = False, learn: bool = False
              ) -> dict[str, Any]:
    """
    Run node and camera probe for a while; return what the probe prints.

    everything: all outputs are subscribed, all inputs are fed, see `CameraProbe`.
    """
    environment = _environment()
    with tempfile.TemporaryFile('w+') as log, tempfile.TemporaryDirectory() as folder:
        np.save(Path(folder) / 'images.npy', images)
        node = subprocess.Popen(
            [sys.executable, '-m', 'neo_ros.node.main', '--ros-args',
             '-p', f'model:={model.resolve()}', '-p', f'learn:={str(learn).lower()}'],
            env=environment, stdout=log, stderr=log)
        try:
            probe = subprocess.run(
                [sys.executable, '-m', 'neo_ros.node.camera_probe',
                 '--images', str(Path(folder) / 'images.npy'), '--rate', str(rate),
                 '--seconds', str(seconds), '--pid', str(node.pid),
                 *(['--everything'] if everything else []), *(['--learns'] if learn else [])],
                env=environment, stdout=subprocess.PIPE, stderr=log, text=True,
                timeout=seconds + 90, check=False)
            ended = node.poll()
        finally:
            end_process(node)
        if probe.returncode or ended is not None:
            log.seek(0)
            raise NeoError(f'node: the measurement failed (probe {probe.returncode}, node '
                           f'{ended}):\n{log.read()[-2000:]}')
    return json.loads(probe.stdout.splitlines()[-1])


def _environment() -> dict[str, str]:
    """Never within reach of a robot on the same network."""
    return os.environ | {'ROS_DOMAIN_ID': str(own_domain()),
                         'ROS_AUTOMATIC_DISCOVERY_RANGE': 'LOCALHOST'}


def _stages(diagnostics: dict[str, str]) -> dict[str, dict[str, float]]:
    """Read the node's own latencies, by stage, from the lines of its diagnosis."""
    stages = {}
    for stage in STAGES:
        line = diagnostics.get(f'latency {stage} median/p95/max [ms]')
        if line is None:
            raise NeoError(f'node: expected the latency of {stage} in /diagnostics, got '
                           f'{sorted(diagnostics)}')
        stages[stage] = dict(zip(('median', 'p95', 'max'), map(float, line.split('/'))))
    return stages
