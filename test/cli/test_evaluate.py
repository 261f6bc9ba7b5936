import json

import cv2
from neo_ros.cli.evaluate import evaluate
from neo_ros.errors import SceneError
from neo_ros.geometry import CameraPose
from neo_ros.runtime import read_model_card
from neo_ros.scenes.posed_images import PosedImages
from neo_ros.scenes.transforms_json import write_transforms
import numpy as np
import pytest
from tiny_model import TINY_EXPANSION, write_tiny_model
import typer
from typer.testing import CliRunner

APP = typer.Typer()
APP.command()(evaluate)


def write_images(folder, name, intrinsics, count):
    rng = np.random.default_rng(count)
    paths = tuple(folder / f'{name}_{i}.png' for i in range(count))
    for path in paths:
        coarse = rng.integers(0, 256, (6, 8, 3)).astype(np.uint8)
        assert cv2.imwrite(str(path), cv2.resize(coarse, (intrinsics.width, intrinsics.height)))
    poses = tuple(CameraPose.from_planar(i, 0, 1.5, 0) for i in range(count))
    images = PosedImages(intrinsics, paths, poses, tuple(i % 2 for i in range(count)))
    write_transforms(folder / f'transforms_{name}.json', images)


@pytest.fixture
def scene(tmp_path):
    folder = tmp_path / 'room'
    folder.mkdir()
    write_images(folder, 'train', TINY_EXPANSION.source, 3)
    write_images(folder, 'test', TINY_EXPANSION.target, 4)
    return folder


@pytest.fixture
def model(tmp_path):
    return write_tiny_model(tmp_path / 'tiny.onnx')


def test_a_scene_is_scored_beside_the_floors(scene, model, tmp_path):
    out = tmp_path / 'out'
    result = CliRunner().invoke(APP, [
        str(scene), '--model', str(model), '--out', str(out), '--frames', '3'])
    assert result.exit_code == 0, result.output
    scores = json.loads((out / 'scores.json').read_text())
    rows, confidence = scores['rows'], scores['confidence']
    assert f'confidence: off by {confidence["expected_calibration_error"]:.1f} of 255' in (
        result.output)
    assert [(row['method'], row['n_frames'], row['scene']) for row in rows] == [
        (name, 3, 'room')
        for name in (read_model_card(model).network, 'edge_replication', 'mean_image')]
    assert all(f'{row["ring_psnr"]:.2f}' in result.output for row in rows)
    assert 'mean_image' in (out / 'report.html').read_text()


def test_what_the_memory_knew_is_said(tiny_run, tmp_path):
    scene, out = tiny_run.out.parent / 'scene', tmp_path / 'out'
    result = CliRunner().invoke(APP, [
        str(scene), '--model', str(tiny_run.model_path), '--out', str(out)])
    assert result.exit_code == 0, result.output
    guided, alone = json.loads((out / 'scores.json').read_text())['methods'][:2]
    known = [frame['guided'] for frame in guided['frames']]
    assert len(known) == 6 and set(known) <= {0.0, 1.0}
    assert 'guided' not in alone['estimates']
    assert f'guided: the memory knew {sum(known) / 6:.0%} of the frames' in result.output


def test_a_scene_without_test_frames_says_so(scene, model):
    (scene / 'transforms_test.json').unlink()
    result = CliRunner().invoke(APP, [str(scene), '--model', str(model)])
    assert isinstance(result.exception, SceneError)
    assert 'transforms_test.json' in str(result.exception)
