"""The demo on a real ROS graph, with a tiny model; the shipped model knows the walk it shows."""
from functools import partial
import json
import math
from pathlib import Path
import time
from types import SimpleNamespace
from urllib.request import urlopen

from bag_files import write_walk_bag
from neo_ros.bags import BagReader, replay
from neo_ros.cli.main import app
from neo_ros.demo import _Graph, DemoResult, run_demo, WALK_SEED, WIDE_TOPIC
from neo_ros.errors import ModelError, NeoError
from neo_ros.evaluation.metrics import score_frame
from neo_ros.flat.demo_flat import build_demo_flat, walking_paths
from neo_ros.flat.scene_writing import render_demo_views, write_demo_scene
from neo_ros.machine.files import share_dir
from neo_ros.messages import read_image
from neo_ros.runtime import FovExtrapolator
from neo_ros.scenes.scene import read_scene
import numpy as np
import pytest
from tiny_model import TINY_EXPANSION, write_tiny_model
from typer.testing import CliRunner

pytestmark = pytest.mark.slow

FRAMES = 12


@pytest.fixture(scope='module')
def model(tmp_path_factory: pytest.TempPathFactory) -> Path:
    path = tmp_path_factory.mktemp('model') / 'demo_flat.onnx'
    write_tiny_model(path, scene_id='demo_flat')
    return path


@pytest.fixture(scope='module')
def demo_folder(model: Path, tmp_path_factory: pytest.TempPathFactory) -> Path:
    out = tmp_path_factory.mktemp('demo')
    pages, rounds = [], []

    def look(address: str) -> None:
        with urlopen(address, timeout=10) as answer:
            pages.append(answer.read().decode())

    def once_more(result: DemoResult) -> bool:
        rounds.append(result)
        return len(rounds) < 2

    result = run_demo(model, out, FRAMES, 5.0, shown_at=look, go_on=once_more)
    assert rounds == [result, result]
    assert [('<title>' in page) for page in pages] == [True]
    assert result.frames_in == FRAMES
    assert result.frames_out >= FRAMES // 2
    assert result.latency_ms['median'] > 0
    return out


def wide_images(bag: Path) -> dict[tuple[int, int], np.ndarray]:
    with BagReader(bag) as reader:
        messages = [message.read() for message in reader.messages([WIDE_TOPIC])]
    return {(m.header.stamp.sec, m.header.stamp.nanosec): read_image(m) for m in messages}


def test_report_and_scores_are_there(demo_folder: Path) -> None:
    scores = json.loads((demo_folder / 'scores.json').read_text())
    assert 5 < scores['scores']['ring_psnr'] < 40
    assert (demo_folder / 'report.html').read_text().count('data:image/') >= 12
    assert (demo_folder / 'strip.png').stat().st_size > 10_000


def test_node_and_replay_give_identical_pixels(model: Path, demo_folder: Path,
                                               tmp_path: Path) -> None:
    walk = next(demo_folder.glob('walk_*'))
    replay(walk, FovExtrapolator.load(model), tmp_path / 'wide')
    replayed, recorded = wide_images(tmp_path / 'wide'), wide_images(demo_folder / 'recorded')
    assert recorded
    for stamp, image in recorded.items():
        np.testing.assert_array_equal(image, replayed[stamp])


def test_a_model_of_another_scene_is_refused(tmp_path: Path) -> None:
    write_tiny_model(tmp_path / 'm.onnx', scene_id='kitchen')
    with pytest.raises(ModelError, match='got one of kitchen'):
        run_demo(tmp_path / 'm.onnx', tmp_path / 'out', FRAMES, 5.0)


def test_a_part_of_the_graph_that_ends_is_told_at_once(
        model: Path, tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    monkeypatch.setenv('ROS_DOMAIN_ID', '77')
    with _Graph(model, tmp_path / 'log') as graph:
        assert graph._environment['ROS_DOMAIN_ID'] != '77', 'it must never reach a robot'
        bag = write_walk_bag(tmp_path / 'bag', TINY_EXPANSION, 3)
        started = time.monotonic()
        # There is something at the place of its bag.
        with graph.process('recorder', ['record', '/x', '--out', str(tmp_path)]):
            with pytest.raises(NeoError, match='recorder ended with code'):
                graph.play(bag, subscribers=9)
    assert time.monotonic() - started < 60


def test_another_camera_gets_a_model_of_its_own(
        tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    def train(scene, experiment, out, progress, minutes):
        trained.append(minutes)
        out.mkdir(exist_ok=True)
        write_tiny_model(out / 'demo_flat.onnx', scene_id=read_scene(scene).name)
        (out / 'plan.json').write_text(json.dumps(
            {'minutes': minutes, 'experiment': {}, 'network_minutes': None}))
        if len(trained) == 1:
            raise NeoError('broken off')
        (out / 'report.html').touch()
        return SimpleNamespace(model_path=out / 'demo_flat.onnx')

    shown: list[Path] = []
    trained: list[float] = []
    monkeypatch.setattr('neo_ros.pipeline.train', train)
    monkeypatch.setattr('neo_ros.demo.run_demo', lambda model, *others: shown.append(model))
    monkeypatch.setattr('neo_ros.demo.write_demo_scene',
                        partial(write_demo_scene, n_train=4, workers=1))
    # What was broken off goes on; what is finished is shown, or trained by other minutes.
    for minutes in ('0.5', '0.5', '0.5', '1'):
        told = CliRunner().invoke(app, ['demo', '--out', str(tmp_path), '--camera', '32x24@69',
                                        '--minutes', minutes])
        assert told.exit_code == int(not shown and len(trained) == 1), told.output
    assert trained == [0.5, 0.5, 1]
    assert shown == [tmp_path / '32x24@69/model/demo_flat.onnx'] * 3 and shown[0].is_file()
    photos = read_scene(tmp_path / '32x24@69/demo_flat').train
    assert (photos.intrinsics.width, photos.intrinsics.height) == (32, 24)
    assert photos.intrinsics.hfov == pytest.approx(math.radians(69))


@pytest.mark.parametrize('arguments, words', [
    (['--camera', '640x480'], 'expected WIDTHxHEIGHT@DEGREES'),
    (['--camera', '640x480@69', '--model', 'a.onnx'], '--camera trains one'),
    (['--minutes', '5'], 'expected only with --camera')])
def test_options_that_do_not_go_together_are_refused(arguments: list[str], words: str) -> None:
    told = CliRunner().invoke(app, ['demo', *arguments])
    assert told.exit_code != 0 and words in str(told.exception or told.output)


@pytest.mark.parametrize('arguments, rounds', [([], 1), (['--watch'], 3)],
                         ids=['not on a terminal', 'watched'])
def test_the_command_shows_the_result_once_and_ends_on_ctrl_c(
        tmp_path: Path, monkeypatch: pytest.MonkeyPatch, arguments: list[str],
        rounds: int) -> None:
    result = DemoResult(12, 11, 5.0, {'median': 20.0, 'p95': 30.0},
                        {'ring_psnr': 25.0, 'ring_ssim': 0.8, 'whole_psnr': 27.0})
    played = []

    def run(model, out, frames, rate, progress, shown_at, go_on):
        shown_at('http://127.0.0.1:1')
        played.append(model.name)
        while go_on(result):
            played.append(model.name)
            if len(played) == 3:
                raise KeyboardInterrupt
        return result

    monkeypatch.setattr('neo_ros.demo.run_demo', run)
    monkeypatch.delenv('DISPLAY', raising=False)
    monkeypatch.delenv('WAYLAND_DISPLAY', raising=False)
    told = CliRunner().invoke(app, ['demo', '--out', str(tmp_path), *arguments])
    assert told.exit_code == 0 and played == ['demo_flat.onnx'] * rounds
    assert told.output.count('11 of 12 frames widened at 5.0 Hz') == 1
    assert 'shown at http://127.0.0.1:1' in told.output
    assert ('until you press Ctrl-C' in told.output) == (rounds > 1)


def test_ctrl_c_before_anything_was_shown_is_no_success(
        tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    def run(*everything):
        raise KeyboardInterrupt

    monkeypatch.setattr('neo_ros.demo.run_demo', run)
    assert CliRunner().invoke(app, ['demo', '--out', str(tmp_path)]).exit_code == 130


def test_the_shipped_model_knows_the_flat() -> None:
    extrapolator = FovExtrapolator.load(share_dir() / 'models' / 'demo_flat.onnx')
    expansion = extrapolator.expansion
    walk = walking_paths(build_demo_flat(), 1, 10, WALK_SEED)[0]
    truth = render_demo_views(expansion.target, walk, workers=1)
    wide = [extrapolator.expand(expansion.crop(image)) for image in truth]
    assert sum(view.guided for view in wide) >= 9
    # The network alone has 18 dB here.
    assert np.mean([score_frame(image, view.wide_image, expansion)['ring_psnr']
                    for image, view in zip(truth, wide)]) > 25
