"""
The demo: a robot walks through the built-in flat, its camera is widened on a real ROS graph.

Processes as on a robot: a bag player for the camera, the node, the remote assistant's viewer, and
a recorder. What the recorder got is scored against the truth that the bag holds.
"""
from collections.abc import Callable, Iterator
from contextlib import AbstractContextManager, contextmanager, ExitStack
from dataclasses import dataclass
import functools
import hashlib
from importlib.util import find_spec
import json
import os
from pathlib import Path
import re
import shutil
import subprocess
import sys
import time

from neo_ros.bags import BagReader
from neo_ros.bags.demo_bag import IMAGE_TOPIC, TRUTH_TOPIC, write_demo_bag
from neo_ros.errors import BagError, ModelError, NeoError
from neo_ros.evaluation.metrics import score_frame
from neo_ros.flat.demo_flat import build_demo_flat, walking_paths
from neo_ros.flat.scene_writing import fingerprint, render_demo_views, write_demo_scene
from neo_ros.geometry import Intrinsics, ViewExpansion
from neo_ros.machine.files import make_output_folder, write_bytes
from neo_ros.machine.processes import end_process
from neo_ros.machine.progress import no_stage_progress, of_stage, StageProgress
from neo_ros.machine.ros_domain import own_domain
from neo_ros.messages import read_image
from neo_ros.messages.stamps import stamp_of
from neo_ros.reports.report import Table, Text, write_report
from neo_ros.reports.strips import frame_strip, Strip, write_strip_png
from neo_ros.runtime import read_model_card
import numpy as np

SCENE = 'demo_flat'
# A walk of its own: neither the test frames' seed nor a training pose.
WALK_SEED = 2026
WIDE_TOPIC = '/camera/wide/image'
DISCOVERY_S = 4.0
# What a walk may take beyond its own length; how often a process that has ended is looked for.
PATIENCE_S, LOOK_S = 120.0, 0.5
OTHER_TOPICS = ('/camera/wide/mask', '/camera/wide/confidence', '/camera/wide/camera_info',
                '/camera/wide/status', '/diagnostics')


@dataclass(frozen=True)
class DemoResult:
    """
    What came out of a demo.

    frames      frames in, and wide frames that arrived at the recorder
    rate        wide frames per second
    latency_ms  from the arrival of the camera image at the recorder to that of its wide image
    scores      mean of every score over the wide frames
    """

    frames_in: int
    frames_out: int
    rate: float
    latency_ms: dict[str, float]
    scores: dict[str, float]


def make_demo_bag(path: Path, expansion: ViewExpansion, frames: int, rate: float,
                  progress: Callable[[str, int, int], None]) -> None:
    """Render a walk through the flat, truth included, into an MCAP bag."""
    walk = walking_paths(build_demo_flat(), 1, frames, WALK_SEED)[0]
    images = render_demo_views(
        expansion.target, walk, functools.partial(progress, 'rendering the walk'))
    period_ns = round(1e9 / rate)
    write_demo_bag(path, ((1_000_000_000 + index * period_ns, image, pose)
                          for index, (image, pose) in enumerate(zip(images, walk))), expansion)


def train_demo(camera: Intrinsics, out: Path, minutes: float,
               progress: StageProgress = no_stage_progress) -> Path:
    """
    Photograph the flat with a camera and train a model in so many minutes; return its file.

    Both stay in `out`: what is there is not made again.
    """
    from neo_ros.experiment import Experiment
    from neo_ros.pipeline import train  # torch, which a robot has not.
    from neo_ros.training.time_plan import read_plan

    scene, run = out / SCENE, out / 'model'
    # The report is written last.
    if (run / 'report.html').exists() and read_plan(run).minutes == minutes:
        return run / f'{SCENE}.onnx'
    # Two test frames do: the walk of the demo is what shows how good the model is.
    write_demo_scene(scene, camera=camera, n_paths=1, frames_per_path=2,
                     progress=of_stage(progress, 'images'))
    return train(scene, Experiment(), run, progress, minutes=minutes).model_path


def run_demo(model: Path, out: Path, frames: int, rate: float,
             progress: Callable[[str, int, int], None] = lambda stage, done, total: None,
             shown_at: Callable[[str], None] = lambda address: None,
             go_on: Callable[[DemoResult], bool] = lambda result: False) -> DemoResult:
    """
    Show `model` on a ROS graph and leave bags, report.html and strip.png in `out`.

    `shown_at` gets the address of the viewer's page, if the viewer is installed. While `go_on`
    returns True for the result, the walk is played again, unrecorded.
    Raises NeoError where a process of the graph ends with an error or nothing arrives.
    """
    card = read_model_card(model)
    if card.scene_id != SCENE:
        raise ModelError(f'{model}: expected a model of {SCENE}, got one of {card.scene_id}; '
                         'use neo replay for a bag of your own')
    make_output_folder(out)
    # The walk of a model's view is the same every time; only a finished bag gets its name.
    shown = fingerprint(build_demo_flat(), []) + repr(card.expansion)
    bag = out / (f'walk_{frames}_{rate:g}hz_'
                 + hashlib.sha256(shown.encode()).hexdigest()[:8])
    if not bag.exists():
        partial = out / 'walk.partial' / bag.name  # The file in it is named as its folder.
        shutil.rmtree(partial.parent, ignore_errors=True)
        make_demo_bag(partial, card.expansion, frames, rate, progress)
        partial.rename(bag)
        partial.parent.rmdir()
    recorded = out / 'recorded'
    shutil.rmtree(recorded, ignore_errors=True)
    with _Graph(model, out / 'graph.log') as graph:
        if graph.address is not None:
            shown_at(graph.address)
        progress('playing it over ROS', 0, 1)
        with graph.process('recorder', ['record', IMAGE_TOPIC, WIDE_TOPIC, *OTHER_TOPICS,
                                        '--out', str(recorded)]):
            # The node's two inputs and the recorder's camera topic.
            graph.play(bag, subscribers=3)
            time.sleep(1.0)  # The last frames are on their way.
        progress('playing it over ROS', 1, 1)
        result = score_recording(bag, recorded, card.expansion, out)
        while go_on(result):
            graph.play(bag, subscribers=0)  # The node listens while somebody looks at the page.
    return result


class _Graph:
    """A ROS graph with the node and the viewer; every part is a process."""

    def __init__(self, model: Path, log: Path) -> None:
        self.address: str | None = None
        self._model, self._log = model, log
        # A graph of its own: the demo must never reach a robot on the same network.
        self._environment = os.environ | {'ROS_DOMAIN_ID': str(own_domain()),
                                          'ROS_AUTOMATIC_DISCOVERY_RANGE': 'LOCALHOST'}
        self._running: dict[str, subprocess.Popen] = {}
        self._stack = ExitStack()

    def __enter__(self) -> '_Graph':
        self._lines = self._stack.enter_context(open(self._log, 'w'))
        try:
            self._stack.enter_context(self._process('node', [
                '-m', 'neo_ros.node.main', '--ros-args', '-r', '__ns:=/camera',
                '-r', 'image:=image_raw', '-p', f'model:={self._model.resolve()}']))
            if find_spec('aiohttp') is not None:
                viewer = self._stack.enter_context(self._process('viewer', [
                    '-m', 'neo_ros.cli.main', 'view', '--topic', WIDE_TOPIC, '--sim-time',
                    '--port', '0'], stdout=subprocess.PIPE))
                assert viewer.stdout is not None
                self.address = next(iter(re.findall(r'http\S+', viewer.stdout.readline())), None)
        except BaseException:
            self._stack.close()
            raise
        return self

    def __exit__(self, *error: object) -> None:
        self._stack.close()

    def process(self, name: str, command: list[str]) -> AbstractContextManager[subprocess.Popen]:
        """Run a command of `neo` beside the graph until the context ends."""
        return self._process(name, ['-m', 'neo_ros.cli.main', *command])

    def play(self, bag: Path, subscribers: int) -> None:
        """Play a bag to its end; raises NeoError if a process of the graph has failed."""
        # The node widens only for subscribers: its outputs must have been discovered, too.
        command = ['play', str(bag), '--wait-for-subscribers', str(subscribers),
                   '--delay', str(DISCOVERY_S)]
        with BagReader(bag) as reader:
            first_ns, last_ns = reader.span_ns
        limit = time.monotonic() + (last_ns - first_ns) / 1e9 + PATIENCE_S
        with self.process('player', command) as player:
            while player.poll() is None:
                # Without the node the player would wait for it for ever.
                self._check()
                if time.monotonic() > limit:
                    raise self._failure('the walk did not come to its end')
                time.sleep(LOOK_S)
            self._check()

    def _check(self) -> None:
        codes = {name: process.poll() for name, process in self._running.items()}
        failed = [f'{name} ended with code {code}' for name, code in codes.items() if code]
        if failed:
            raise self._failure(', '.join(failed))

    def _failure(self, words: str) -> NeoError:
        return NeoError(f'demo: {words}:\n{self._log.read_text()[-2000:]}')

    @contextmanager
    def _process(self, name: str, command: list[str],
                 stdout: int | None = None) -> Iterator[subprocess.Popen]:
        process = subprocess.Popen(
            [sys.executable, *command], env=self._environment, text=True,
            stdout=self._lines if stdout is None else stdout,
            stderr=self._lines if stdout is not None else subprocess.STDOUT)
        self._running[name] = process
        try:
            yield process
        finally:
            del self._running[name]
            end_process(process)


def score_recording(bag: Path, recorded: Path, expansion: ViewExpansion, out: Path) -> DemoResult:
    """Join recording and truth by header stamp, score, and write the report and the strip."""
    with BagReader(bag) as reader:
        images = (message.read() for message in reader.messages([TRUTH_TOPIC]))
        truth = {stamp_of(image.header): read_image(image) for image in images}
    arrived: dict[str, dict[int, int]] = {IMAGE_TOPIC: {}, WIDE_TOPIC: {}}
    wide = {}
    with BagReader(recorded) as reader:
        for message in reader.messages(list(arrived)):
            content = message.read()
            arrived[message.topic.name][stamp_of(content.header)] = message.stamp_ns
            if message.topic.name == WIDE_TOPIC:
                wide[stamp_of(content.header)] = read_image(content)
    stamps = sorted(wide.keys() & truth.keys())
    if len(stamps) < 2:
        raise BagError(f'{recorded}: expected wide images from the node, got {len(wide)}; '
                       f'see {recorded.parent / "graph.log"}')
    frames = [score_frame(truth[stamp], wide[stamp], expansion) for stamp in stamps]
    delays = [(arrived[WIDE_TOPIC][stamp] - arrived[IMAGE_TOPIC][stamp]) / 1e6
              for stamp in stamps if stamp in arrived[IMAGE_TOPIC]]
    times = sorted(arrived[WIDE_TOPIC].values())
    result = DemoResult(
        len(truth), len(wide), (len(times) - 1) / ((times[-1] - times[0]) / 1e9),
        {'median': float(np.median(delays)), 'p95': float(np.percentile(delays, 95)),
         'max': float(max(delays))},
        {name: float(np.mean([frame[name] for frame in frames])) for name in frames[0]})
    _write_pages(result, expansion, stamps, truth, wide, frames, out)
    return result


def _write_pages(result: DemoResult, expansion: ViewExpansion, stamps: list[int],
                 truth: dict[int, np.ndarray], wide: dict[int, np.ndarray],
                 frames: list[dict[str, float]], out: Path) -> None:
    order = np.argsort([frame['ring_psnr'] for frame in frames])
    picks = {'Best frame': order[-1], 'Median frame': order[len(order) // 2],
             'Worst frame': order[0]}

    def strip(title: str, index: int) -> Strip:
        stamp = stamps[index]
        note = f'ring PSNR {frames[index]["ring_psnr"]:.2f} dB'
        return frame_strip(f'{title}, second {(stamp - stamps[0]) / 1e9:.1f}', expansion,
                           expansion.crop(truth[stamp]), wide[stamp], truth[stamp], note)

    ranked = [strip(title, int(index)) for title, index in picks.items()]
    walk = [strip('The walk', int(index))
            for index in np.linspace(0, len(stamps) - 1, 6).round()]
    write_strip_png(out / 'strip.png', walk)
    latency = result.latency_ms
    table = Table(('figure', 'value'), [
        ('camera frames played', str(result.frames_in)),
        ('wide frames received', f'{result.frames_out} at {result.rate:.1f} Hz'),
        ('latency, camera image to wide image',
         f'median {latency["median"]:.1f} ms, p95 {latency["p95"]:.1f} ms'),
        *((name.replace('_', ' '), f'{value:.3f}') for name, value in result.scores.items())])
    write_report(out / 'report.html', 'A walk through the demo flat', [
        Text('The frame is what the camera sees; all around it is what the model remembers of '
             'the flat. Every image went over ROS: bag player, node, recorder.'),
        table, *ranked, *walk])
    write_bytes(out / 'scores.json', json.dumps(
        {**result.__dict__, 'frames': frames}, indent=1).encode())
