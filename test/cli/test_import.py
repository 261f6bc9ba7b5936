"""`neo import` from end to end on small captures."""
import json
import math
from pathlib import Path
import re

from capture_files import (
    demo_photos, Photos, write_bag, write_image, write_seven_scenes, write_transforms_capture)
from neo_ros.cli.import_scene import import_scene
from neo_ros.errors import ConfigError, SceneError
from neo_ros.flat.scene_writing import render_demo_views
from neo_ros.geometry import CameraPose, Intrinsics
from neo_ros.scenes.scene import read_scene
from neo_ros.scenes.upright import stood_up, tilt
import numpy as np
import pytest
import typer
from typer.testing import CliRunner


def run(*arguments: object) -> str:
    app = typer.Typer()
    app.command()(import_scene)
    result = CliRunner().invoke(app, [str(argument) for argument in arguments])
    if result.exception is not None:
        raise result.exception
    return ' '.join(result.output.split())


def test_a_bag_becomes_a_scene_with_a_report(tmp_path: Path) -> None:
    output = run(write_bag(tmp_path / 'bag', demo_photos()), tmp_path / 'scene')
    assert 'poses from /tf: camera_optical_frame in map' in output
    assert '5 photos of 64x48 pixels, no test frames' in output
    assert '5 photos are few' in output
    assert (tmp_path / 'scene/capture.html').is_file()
    assert len(read_scene(tmp_path / 'scene').train) == 5


@pytest.mark.slow
def test_the_next_command_is_on_one_line_and_trains_elsewhere(
        tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    monkeypatch.chdir(tmp_path)
    source, app = write_seven_scenes(tmp_path / 'source', demo_photos()), typer.Typer()
    app.command()(import_scene)
    for scene, command in (('out/hall', 'neo train out/hall --out out/hall_model'),
                           ('a long way to/the scene of a corridor with many doors', (
                               "neo train 'a long way to/the scene of a corridor with many doors' "
                               "--out 'out/the scene of a corridor with many doors'"))):
        result = CliRunner().invoke(app, [str(source), scene])
        assert result.output.splitlines()[-1] == f'Next: {command}'


def test_large_photos_are_trained_on_in_minutes(
        tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    source = write_seven_scenes(tmp_path / 'source', demo_photos())
    monkeypatch.setattr('neo_ros.cli.import_scene.SMALL', 32)
    assert run(source, tmp_path / 'hall').endswith('--minutes 30')


def test_keyframes_are_chosen_on_the_way(tmp_path: Path) -> None:
    output = run(write_bag(tmp_path / 'bag', demo_photos()), tmp_path / 'scene',
                 '--keyframe-distance', '0.25', '--keyframe-angle', '90')
    assert '2 keyframes chosen of 5 frames' in output
    found = read_scene(tmp_path / 'scene').train
    assert len(found) == 2
    assert found.poses[0].position[0] < 2.85 < found.poses[1].position[0]


@pytest.mark.slow
def test_an_imported_scene_can_be_imported_again(tmp_path: Path) -> None:
    run(write_seven_scenes(tmp_path / 'source', demo_photos()), tmp_path / 'a')
    run(tmp_path / 'a', tmp_path / 'b')
    a, b = read_scene(tmp_path / 'a').train, read_scene(tmp_path / 'b').train
    np.testing.assert_array_equal(a.read_images(), b.read_images())
    assert a.path_ids == b.path_ids == (0, 0, 0, 1, 1)


def turned(folder: Path, T: np.ndarray) -> Path:
    source = write_transforms_capture(folder, demo_photos())
    document = json.loads((source / 'transforms.json').read_text())
    for frame in document['frames']:
        frame['transform_matrix'] = (T @ np.array(frame['transform_matrix'])).tolist()
    (source / 'transforms.json').write_text(json.dumps(document))
    return source


@pytest.mark.slow
def test_a_world_that_is_not_level_is_pointed_out_and_levelled(tmp_path: Path) -> None:
    c, s = math.cos(1.2), math.sin(1.2)
    source = turned(tmp_path / 'source', np.array([
        [1, 0, 0, 0], [0, c, -s, 0], [0, s, c, 0], [0, 0, 0, 1]]))
    assert 'import with --level' in run(source, tmp_path / 'a')
    assert 'import with --level' not in run(source, tmp_path / 'b', '--level')
    assert tilt(list(read_scene(tmp_path / 'a').train.poses)) > 1
    assert tilt(list(read_scene(tmp_path / 'b').train.poses)) < 0.05


def test_the_report_shows_the_world_as_trainings_stand_it_up(tmp_path: Path) -> None:
    # x of the walk becomes z, and y points up.
    source = turned(tmp_path / 'source', np.array([
        [0, 1, 0, 0], [0, 0, 1, 0], [1, 0, 0, 0], [0, 0, 0, 1]]))
    assert 'Extent: 0.0 x 0.4 x 0.0 m' in run(source, tmp_path / 'scene')


def test_a_model_that_is_not_in_metres_is_scaled_and_not_turned(tmp_path: Path) -> None:
    source = write_transforms_capture(tmp_path / 'source', demo_photos())
    assert 'all lengths are multiplied by 2.5' in run(
        source, tmp_path / 'scene', '--scale', '2.5', '--keyframe-distance', '0.2')
    found = read_scene(tmp_path / 'scene').train
    assert len(found) == 5 and not found.z_up  # steps are now 0.25 m long
    expected = np.stack([pose.T_world_cam for pose in demo_photos().poses])
    expected[:, :3, 3] *= 2.5
    np.testing.assert_allclose(found.T_world_cam, expected, atol=1e-9)


@pytest.mark.parametrize('arguments, error, message', [
    (['--format', 'polaroid'], ConfigError, "expected scene, transforms.*'polaroid'"),
    (['--format', 'scannet'], SceneError, 'color'),
    (['--format', 'scene', '--level'], ConfigError, 'copied as it is'),
    (['--format', 'scene', '--scale', '2'], ConfigError, '--scale: for captures'),
    *[(['--scale', value], ConfigError, 'expected a number > 0, got')
      for value in ('0', '-1', 'nan', 'inf')],
    *[([option, '-5'], ConfigError, f'{option}: expected a number > 0, got -5')
      for option in ('--keyframe-distance', '--keyframe-angle')],
    (['--size', '64'], ConfigError, '--size: expected only with "demo"'),
    (['--rooms', '4'], ConfigError, '--rooms: expected only with "demo"'),
    (['--pose-topic', '/odom'], ConfigError, '--pose-topic: expected only with a bag'),
], ids=['unknown format', 'another format', 'a scene cannot be levelled', 'nor scaled',
        'scale 0', 'negative scale', 'no scale', 'infinite scale', 'negative step',
        'negative turn', 'no demo', 'no building', 'no bag'])
def test_a_wrong_format_is_named(tmp_path: Path, arguments: list[str], error: type[Exception],
                                 message: str) -> None:
    source = write_transforms_capture(tmp_path / 'source', demo_photos())
    with pytest.raises(error, match=message):
        run(source, tmp_path / 'scene', *arguments)


@pytest.mark.slow
def test_photos_become_a_scene_and_stay_where_they_are(tmp_path: Path) -> None:
    pytest.importorskip('pycolmap', reason='needs pycolmap (the train extra)')
    camera = Intrinsics.from_hfov(240, 180, math.radians(75))
    walk = [CameraPose.from_planar(2.2 + 0.09 * i, 1.1, 1.5, 1.2 + 0.03 * i) for i in range(6)]
    for index, image in enumerate(render_demo_views(camera, walk, workers=1)):
        write_image(tmp_path / f'room/images/{index}.png', image)
    before = [path.read_bytes() for path in sorted((tmp_path / 'room/images').iterdir())]
    with pytest.raises(SceneError, match='another folder than the source'):
        run(tmp_path / 'room', tmp_path / 'room')
    output = run(tmp_path / 'room', tmp_path / 'scene')
    assert '6 of 6 photos' in output and 'arbitrary, not metres' in output
    assert len(read_scene(tmp_path / 'scene').train) == 6
    assert re.search(r'Extent: \S+ x \S+ x \S+ units ', output)
    run(tmp_path / 'scene', tmp_path / 'copy')
    run(tmp_path / 'scene/transforms_train.json', tmp_path / 'again')
    for name in ('copy', 'again'):
        assert read_scene(tmp_path / name).train.arbitrary_scale
    output = run(tmp_path / 'room', tmp_path / 'scene', '--scale', '0.5')
    assert re.search(r'Extent: \S+ x \S+ x \S+ m ', output)
    after = [path.read_bytes() for path in sorted((tmp_path / 'room/images').iterdir())]
    assert after == before


def test_the_report_names_images_that_are_left_out(tmp_path: Path) -> None:
    source = write_transforms_capture(tmp_path / 'source', demo_photos())
    (source / 'images/3.png').write_bytes(b'no image')
    note = '1 images cannot be read and are left out: '
    assert note in run(source, tmp_path / 'scene')
    assert f'{note}{source}/images/3.png' in (tmp_path / 'scene/capture.html').read_text()


def test_the_demo_is_in_metres(tmp_path: Path) -> None:
    with pytest.raises(ConfigError, match='--scale: the demo has its own'):
        run('demo', tmp_path / 'scene', '--scale', '2')


def test_a_source_that_is_not_there_is_named(tmp_path: Path) -> None:
    with pytest.raises(SceneError, match='no such file or folder'):
        run(tmp_path / 'nothing', tmp_path / 'scene')


@pytest.mark.slow
def test_a_camera_on_its_side_does_not_turn_the_world_of_a_bag(tmp_path: Path) -> None:
    roll = np.array([[0.0, -1, 0, 0], [1, 0, 0, 0], [0, 0, 1, 0], [0, 0, 0, 1]])
    photos = demo_photos()
    rolled = Photos(photos.images, tuple(
        CameraPose(pose.T_world_cam @ roll) for pose in photos.poses))
    output = run(write_bag(tmp_path / 'bag', rolled), tmp_path / 'scene')
    assert 'which points up in this format; if it does not, import with --level' in output
    scene = read_scene(tmp_path / 'scene')
    assert stood_up(scene) is scene


@pytest.mark.parametrize('camera', ['640', '640x480', '640x480@0', '8x480@69', '640x480@180'])
def test_a_camera_of_the_demo_that_is_none_is_refused(tmp_path: Path, camera: str) -> None:
    with pytest.raises(ConfigError, match='--camera: expected WIDTHxHEIGHT@DEGREES'):
        run('demo', tmp_path / 'scene', '--camera', camera)
    assert not (tmp_path / 'scene').exists()


@pytest.mark.slow
def test_a_computed_scene_is_never_taken_for_a_real_one(tmp_path: Path) -> None:
    output = run('demo', tmp_path / 'scene', '--rooms', '1', '--size', '16', '--photos', '60')
    assert 'This scene is synthetic' in output
    assert 'This scene is synthetic' in (tmp_path / 'scene/capture.html').read_text()


def test_a_building_without_floors_is_refused(tmp_path: Path) -> None:
    with pytest.raises(SceneError, match='floors: expected 1 to 20, got 0'):
        run('demo', tmp_path / 'scene', '--rooms', '2', '--floors', '0')
