"""`neo replay` and `neo inspect` on a small bag and a small model."""
import json
import math
from pathlib import Path

from bag_files import walk_frames, write_walk_bag
from camera_bags import CameraBag
from neo_ros.bags import BagReader, BagWriter
from neo_ros.bags.camera_topics import find_image_topic
from neo_ros.bags.replay import MOST_REJECTED
from neo_ros.cli.inspect import inspect
from neo_ros.cli.replay import replay
from neo_ros.errors import BagError, ModelError
from neo_ros.evaluation.metrics import score_frame
from neo_ros.geometry import Intrinsics, ViewExpansion
from neo_ros.runtime import FovExtrapolator
import numpy as np
import pytest
from tiny_model import write_tiny_model
import typer
from typer.testing import CliRunner

EXPANSION = ViewExpansion.to_size(Intrinsics.from_hfov(32, 24, math.pi / 2), 64, 48)


@pytest.fixture
def app() -> typer.Typer:
    application = typer.Typer()
    application.command()(replay)
    application.command()(inspect)
    return application


def test_replay_writes_a_bag_and_the_scores(tmp_path: Path, app: typer.Typer) -> None:
    bag = write_walk_bag(tmp_path / 'bag', EXPANSION, 4)
    model = write_tiny_model(tmp_path / 'm.onnx', EXPANSION)
    out = tmp_path / 'out'
    result = CliRunner().invoke(app, [
        'replay', str(bag), '--model', str(model), '--out', str(out),
        '--truth-topic', '/camera/wide/image_raw'])
    assert result.exit_code == 0, result.output
    assert '/camera/image_raw: 4 frames' in result.output
    assert (out / 'metadata.yaml').is_file()
    scores = json.loads((out / 'scores.json').read_text())
    assert len(scores['frames']) == 4
    assert scores['scene_id'] == 'tiny'
    extrapolator = FovExtrapolator.load(model)
    stamp_ns, truth, _ = walk_frames(EXPANSION, 4)[2]
    wide_image = extrapolator.expand(EXPANSION.crop(truth)).wide_image
    expected = {'stamp_ns': stamp_ns, **score_frame(truth, wide_image, EXPANSION)}
    assert expected.items() <= scores['frames'][2].items()
    ring = [frame['ring_psnr'] for frame in scores['frames']]
    assert scores['mean']['ring_psnr'] == pytest.approx(sum(ring) / 4)


def test_replay_without_truth_writes_no_scores(tmp_path: Path, app: typer.Typer) -> None:
    bag = write_walk_bag(tmp_path / 'bag', EXPANSION, 2)
    model = write_tiny_model(tmp_path / 'm.onnx', EXPANSION)
    result = CliRunner().invoke(app, [
        'replay', str(bag), '--model', str(model), '--out', str(tmp_path / 'out'), '--no-copy'])
    assert result.exit_code == 0, result.output
    assert not (tmp_path / 'out' / 'scores.json').exists()


def test_a_replay_that_widens_nothing_fails_and_is_not_in_the_way(
        tmp_path: Path, app: typer.Typer) -> None:
    seen = [wide for _, wide, _ in walk_frames(EXPANSION, 1)]
    with CameraBag(tmp_path / 'bag') as bag:
        bag.info('/camera/camera_info', 0, Intrinsics.from_hfov(64, 48, 2.0), d=np.full(5, 1e-3))
        for stamp in range(MOST_REJECTED + 20):
            bag.image('/camera/image_raw', stamp, seen[0])
    arguments = ['replay', str(tmp_path / 'bag'), '--out', str(tmp_path / 'out'), '--model',
                 str(write_tiny_model(tmp_path / 'm.onnx', EXPANSION))]
    result = CliRunner().invoke(app, arguments)
    assert isinstance(result.exception, BagError)
    # It ends early: the other images have the same calibration.
    assert f'no image could be widened; rejected: {MOST_REJECTED} x camera_info' in str(
        result.exception)
    assert '--rectify' in str(result.exception) and not (tmp_path / 'out').exists()
    result = CliRunner().invoke(app, [*arguments, '--rectify'])
    assert result.exit_code == 0, result.output
    assert f'{MOST_REJECTED + 20} frames' in result.output


def test_a_camera_that_nobody_described_is_told_and_not_rectified(
        tmp_path: Path, app: typer.Typer) -> None:
    with CameraBag(tmp_path / 'bag') as bag:
        bag.image('/camera/image_raw', 0, walk_frames(EXPANSION, 1)[0][1][:24, :32])
        bag.info('/eye/info', 0, EXPANSION.source)
    arguments = ['replay', str(tmp_path / 'bag'), '--out', str(tmp_path / 'out'), '--model',
                 str(write_tiny_model(tmp_path / 'm.onnx', EXPANSION))]
    result = CliRunner().invoke(app, [*arguments, '--rectify'])
    assert isinstance(result.exception, BagError) and not (tmp_path / 'out').exists()
    assert 'expected a camera_info beside /camera/image_raw' in str(result.exception)
    assert '--info-topic: /eye/info' in str(result.exception)
    result = CliRunner().invoke(app, arguments)
    assert result.exit_code == 0, result.output
    assert 'no camera_info: the camera is assumed' in ' '.join(result.output.split())
    with BagReader(tmp_path / 'out') as reader:
        status = next(reader.messages(['/diagnostics'])).read().status[0]
    assert status.level == 1 and 'no camera_info' in status.message


def test_score_finds_the_truth_or_takes_the_camera_itself(
        tmp_path: Path, app: typer.Typer) -> None:
    expansion = ViewExpansion.to_size(Intrinsics.from_hfov(64, 48, math.pi / 2), 128, 96)
    bag = write_walk_bag(tmp_path / 'bag', expansion, 4)
    model = write_tiny_model(tmp_path / 'm.onnx', expansion)
    arguments = ['--model', str(model), '--score']
    result = CliRunner().invoke(
        app, ['replay', str(bag), *arguments, '--out', str(tmp_path / 'truth')])
    assert result.exit_code == 0, result.output
    assert 'Scored against the wide images of /camera/wide/image_raw' in result.output
    with BagReader(bag) as reader, BagWriter(tmp_path / 'narrow') as writer:
        topic = find_image_topic(reader, '/camera/image_raw')
        writer.copy_topic(topic)
        for message in reader.messages([topic.name]):
            writer.write_cdr(topic, message.stamp_ns, message.cdr)
    result = CliRunner().invoke(app, [
        'replay', str(tmp_path / 'narrow'), *arguments, '--out', str(tmp_path / 'self'),
        '--start', '0.1', '--every', '2', '--side-by-side', str(tmp_path / 'a.mp4')])
    assert result.exit_code == 0, result.output
    assert 'here it widens 53.1 to 90.0' in ' '.join(result.output.split())
    scores = json.loads((tmp_path / 'self' / 'scores.json').read_text())
    assert [frame['seconds'] for frame in scores['frames']] == [0, pytest.approx(0.2)]
    assert scores['focal_length_ratio'] == 2 and scores['truth_topic'] is None
    assert (tmp_path / 'a.mp4').stat().st_size > 1000


def test_inspect_prints_the_card_and_a_timing(tmp_path: Path, app: typer.Typer) -> None:
    model = write_tiny_model(tmp_path / 'm.onnx', EXPANSION, scene_id='kitchen',
                             scores={'ring_psnr': 21.5})
    result = CliRunner().invoke(app, ['inspect', str(model)])
    assert result.exit_code == 0, result.output
    for text in ('kitchen', '32x24 pixels', '64x48 pixels', '90.00', '126.87', '21.500',
                 'GFLOP per image', 'time per image'):
        assert text in result.output


def test_inspect_refuses_what_is_no_model(tmp_path: Path, app: typer.Typer) -> None:
    (tmp_path / 'm.onnx').write_bytes(b'nothing')
    result = CliRunner().invoke(app, ['inspect', str(tmp_path / 'm.onnx')])
    assert isinstance(result.exception, ModelError)
