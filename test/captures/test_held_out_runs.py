"""Runs of photos that are held back for tests."""
import json

from neo_ros.captures.held_out_runs import hold_out_runs, middle_columns, split_runs
from neo_ros.cli.main import app
from neo_ros.errors import ConfigError, SceneError
from neo_ros.geometry import Intrinsics
from neo_ros.scenes.scene import read_scene
from neo_ros.scenes.transforms_json import read_transforms
import pytest
from scene_files import write_capture
from typer.testing import CliRunner


@pytest.fixture
def capture(tmp_path):
    write_capture(tmp_path / 'capture', 60)
    return tmp_path / 'capture'


def test_runs_and_their_neighbours_are_kept_from_training(capture):
    photos = read_transforms(capture / 'transforms_train.json')
    train, test = split_runs(photos, 3)
    names = [path.name for path in photos.image_paths]
    held = [names.index(path.name) for path in test.image_paths]
    assert held == [9, 10, 29, 30, 49, 50]
    assert test.path_ids == (0, 0, 1, 1, 2, 2)
    kept = [names.index(path.name) for path in train.image_paths]
    assert min(abs(a - b) for a in kept for b in held) == 3
    assert len(kept) == 60 - 3 * (2 + 2 * 2)


def test_few_photos_lie_farther_apart(capture):
    photos = read_transforms(capture / 'transforms_train.json').subset(range(30))
    train, test = split_runs(photos, 3)
    assert len(test) == 3 * 2 and len(train) == 30 - 3 * (2 + 2 * 1)


def test_a_short_capture_is_refused(capture):
    photos = read_transforms(capture / 'transforms_train.json')
    with pytest.raises(SceneError, match='6 runs .* 2 left out .* half of the 60 photos'):
        split_runs(photos, 6)


@pytest.mark.parametrize(('width', 'source'), [(320, 160), (640, 320), (1296, 656), (30, 28)])
def test_the_view_is_the_middle_of_the_columns(width, source):
    expansion = middle_columns(Intrinsics.from_hfov(width, 40, 1.2))
    assert (expansion.source.width, expansion.source.height) == (source, 40)
    assert expansion.left == expansion.right and expansion.target.width == width


@pytest.mark.slow
def test_the_import_holds_runs_back_again_and_again(capture, tmp_path):
    scene = tmp_path / 'scene'
    for _ in range(2):
        result = CliRunner().invoke(app, ['import', str(capture), str(scene), '--test-runs', '2'])
        assert result.exit_code == 0, result.output
        assert '6 photos in 2 runs are test frames' in ' '.join(result.output.split())
    found = read_scene(scene)
    assert found.test is not None and found.expansion is not None
    assert len(found.train) == 60 - 2 * (3 + 2 * 2) and len(found.test) == 6
    assert not set(found.train.image_paths) & set(found.test.image_paths)
    assert found.expansion.source.width < found.expansion.target.width
    # A scene is a capture, too: settings are tuned on runs of its training photos.
    dev = tmp_path / 'dev'
    result = CliRunner().invoke(app, ['import', str(scene), str(dev), '--test-runs', '1'])
    assert result.exit_code == 0, result.output
    trained = {path.name for path in found.train.image_paths}
    held_out = read_scene(dev).test
    assert held_out is not None
    assert {path.name for path in held_out.image_paths} <= trained


@pytest.mark.slow
def test_an_import_without_test_runs_has_no_test_frames(capture, tmp_path):
    scene = tmp_path / 'scene'
    for options in (['--test-runs', '2'], []):
        result = CliRunner().invoke(app, ['import', str(capture / 'transforms_train.json'),
                                          str(scene), *options])
        assert result.exit_code == 0, result.output
    assert len(read_scene(scene).train) == 60 and read_scene(scene).test is None


def test_runs_are_taken_in_the_order_of_the_names(capture):
    file = capture / 'transforms_train.json'
    document = json.loads(file.read_text())
    in_order = split_runs(read_transforms(file), 3)
    # As text 10.png comes before 2.png.
    document['frames'].sort(key=lambda frame: frame['file_path'])
    file.write_text(json.dumps(document))
    for found, expected in zip(hold_out_runs(capture, 3), in_order):
        assert found.image_paths == expected.image_paths


def test_the_demo_has_test_frames_already(tmp_path):
    result = CliRunner().invoke(app, ['import', 'demo', str(tmp_path), '--test-runs', '2'])
    assert isinstance(result.exception, ConfigError)
