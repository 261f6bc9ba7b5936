"""The command line: its help, its errors, and the way from a scene to a replayed bag."""
from dataclasses import replace
import errno
import json
import os
from pathlib import Path
import re
import subprocess
import sys

import neo_ros
from neo_ros.cli.main import app, main
from neo_ros.geometry import CameraPose
from neo_ros.scenes.scene import read_scene
from neo_ros.scenes.transforms_json import write_transforms
from neo_ros.training.run import TrainingRun
import numpy as np
import pytest
from scene_files import write_capture, write_picture
from typer.testing import CliRunner

COMMANDS = ['bag', 'bag-info', 'bench', 'benchmark', 'compare', 'demo', 'evaluate', 'export',
            'field-curve', 'floor', 'import', 'inspect', 'play', 'record', 'replay', 'soak',
            'train', 'update', 'view']


def run_main(monkeypatch: pytest.MonkeyPatch, *arguments: object) -> int:
    """Run `neo` with these arguments in this process; returns its exit code."""
    monkeypatch.setattr(sys, 'argv', ['neo', *map(str, arguments)])
    with pytest.raises(SystemExit) as ended:
        main()
    return int(ended.value.code or 0)


def test_help_names_every_command_and_the_way_to_a_model() -> None:
    result = CliRunner().invoke(app, ['--help'])
    assert result.exit_code == 0
    for command in COMMANDS:
        assert f' {command} ' in result.output
    assert sorted(found.name or found.callback.__name__ for found in app.registered_commands
                  if found.callback is not None) == COMMANDS
    for step in ('neo demo', 'neo import', 'neo train', 'neo evaluate', 'neo replay'):
        assert step in result.output


@pytest.mark.parametrize('command', COMMANDS)
def test_every_command_explains_itself(command: str) -> None:
    result = CliRunner().invoke(app, [command, '--help'])
    assert result.exit_code == 0
    assert 'Usage' in result.output and len(result.output) > 300


def test_errors_of_a_process_are_one_line_and_exit_code_2(tmp_path: Path) -> None:
    result = subprocess.run(
        [sys.executable, '-m', 'neo_ros.cli.main', 'inspect', str(tmp_path / 'none.onnx')],
        capture_output=True, text=True, timeout=100)
    assert result.returncode == 2
    assert result.stderr == f'neo: {tmp_path}/none.onnx: no such model file\n'


def spoiled_config(tmp_path: Path, text: str) -> Path:
    (tmp_path / 'e.yaml').write_text(text)
    return tmp_path / 'e.yaml'


@pytest.mark.parametrize('case, message', [
    ('missing scene', 'none: expected a scene folder, there is none'),
    ('scene without photos', 'expected transforms_train.json or transforms.json; make one with'),
    ('unknown key', 'field.speed: Unexpected keyword argument, got 1'),
    ('broken YAML', 'e.yaml: expected a YAML file'),
    ('unwritable folder', 'file/out: cannot write: Not a directory; choose another'),
    ('missing config', 'none.yaml: expected a YAML file'),
])
def test_what_train_cannot_do_is_one_clear_line(
        tmp_path: Path, monkeypatch: pytest.MonkeyPatch, capsys: pytest.CaptureFixture[str],
        case: str, message: str) -> None:
    write_capture(tmp_path / 'scene', 3)
    (tmp_path / 'file').write_text('')
    scene, out = tmp_path / 'scene', tmp_path / 'out'
    config = spoiled_config(tmp_path, 'network: {patch: 1, depth: 1}')
    if case == 'missing scene':
        scene = tmp_path / 'none'
    elif case == 'scene without photos':
        scene = tmp_path
    elif case == 'unknown key':
        config = spoiled_config(tmp_path, 'field: {speed: 1}')
    elif case == 'broken YAML':
        config = spoiled_config(tmp_path, 'field: [\nseed: {')
    elif case == 'unwritable folder':
        out = tmp_path / 'file' / 'out'
    elif case == 'missing config':
        config = tmp_path / 'none.yaml'
    code = run_main(monkeypatch, 'train', scene, '--config', config, '--out', out)
    errors = capsys.readouterr().err
    assert code == 2 and message in errors
    assert errors.startswith('neo: ') and errors.count('\n') == 1
    assert not out.exists()


@pytest.mark.parametrize('arguments, message', [
    (['view', '--rate', '2'], '--rate: expected only with --bag; leave it out'),
    (['view', '--rectify'], '--rectify: expected only with --bag; leave it out'),
    (['train', 'x', '--out', 'y', '--geometry', 'x.ply', '--field-of', 'z'],
     '--field-of: --geometry takes the place of a field; leave it out'),
    (['train', 'x', '--out', 'y', '--minutes', '5', '--field-of', 'z'],
     '--field-of: --minutes plans a field of its own; leave it out'),
    (['train', 'x', '--out', 'y', '--geometry-axes', 'x,y,z'],
     '--geometry-axes: expected only with --geometry; leave it out'),
    (['view', '--bag', 'x', '--sim-time'], '--sim-time: expected only without --bag'),
    (['floor', 'scene', 'map.yaml', '--origin', '0', '0', '1'], '--origin: expected with an'),
    (['import', 'demo', 'x', '--level'], '--level: the demo has its own'),
])
def test_options_that_would_be_ignored_are_refused(
        tmp_path: Path, monkeypatch: pytest.MonkeyPatch, capsys: pytest.CaptureFixture[str],
        arguments: list[str], message: str) -> None:
    write_capture(tmp_path / 'scene', 3)
    monkeypatch.chdir(tmp_path)
    assert run_main(monkeypatch, *arguments) == 2
    assert message in capsys.readouterr().err


def test_each_storey_of_a_building_has_its_map(
        tmp_path: Path, monkeypatch: pytest.MonkeyPatch, capsys: pytest.CaptureFixture[str]
        ) -> None:
    scene, bright = tmp_path / 'scene', ['--resolution', '0.1', '--origin', '-3', '-3', '0']
    capture = write_capture(scene, 21)
    # Eleven photos below, ten above, as high as a robot's camera is on either.
    write_transforms(scene / 'transforms_train.json', replace(capture, poses=tuple(
        CameraPose.from_planar(pose.position[0], pose.position[1], 1.5 + 3 * (number > 10), 0.0)
        for number, pose in enumerate(capture.poses))))
    write_picture(tmp_path / 'map.png', np.full((60, 60, 3), 255, np.uint8))

    def floor(*options: str) -> int:
        return run_main(monkeypatch, 'floor', scene, tmp_path / 'map.png', *bright, *options)

    for storey, message in (('1', 'expected the maps of the storeys below 1 first'),
                            ('2', 'expected 0 to 1, for the photos are of 2 storeys, got 2')):
        assert floor('--storey', storey) == 2
        assert f'--storey: {message}' in capsys.readouterr().err
    assert floor() == floor('--storey', '1') == 0
    assert '100% of the photos stand on it; camera at 4.50 m' in capsys.readouterr().out
    found = read_scene(scene)
    assert found.walkable is not None and found.walkable.camera_height == 1.5
    assert [above.camera_height for above in found.upper] == [4.5]
    assert floor('--storey', '1', '--camera-height', '4.2') == 0
    assert read_scene(scene).upper[0].camera_height == 4.2


@pytest.mark.parametrize('arguments', [
    [], ['nothing'], ['train'], ['bag', 'scene', '--rate', '0'],
], ids=['no command', 'unknown command', 'no scene', 'rate out of range'])
def test_wrong_usage_is_exit_code_2(
        monkeypatch: pytest.MonkeyPatch, arguments: list[str]) -> None:
    assert run_main(monkeypatch, *arguments) == 2


@pytest.mark.parametrize('module, message', [
    ('torch', 'torch is not installed; this command needs the extra train: make train-setup, or'),
    ('pydantic', 'pydantic is not installed; this command needs the extra train: make'),
    ('onnxscript', 'onnxscript is not installed; this command needs the extra train: make'),
    ('rclpy', 'this command needs ROS 2 Jazzy: source it'),
], ids=str)
def test_a_missing_extra_is_named(
        monkeypatch: pytest.MonkeyPatch, capsys: pytest.CaptureFixture[str], module: str,
        message: str) -> None:
    def command() -> None:
        raise ModuleNotFoundError(f'No module named {module!r}', name=module)

    monkeypatch.setattr('neo_ros.cli.main.app', command)
    assert run_main(monkeypatch) == 2
    assert message in capsys.readouterr().err


def test_a_missing_module_of_our_own_is_no_missing_extra(monkeypatch: pytest.MonkeyPatch) -> None:
    def command() -> None:
        raise ModuleNotFoundError("No module named 'neo_ros.lost'", name='neo_ros.lost')

    monkeypatch.setattr('neo_ros.cli.main.app', command)
    with pytest.raises(ModuleNotFoundError):
        main()


@pytest.mark.parametrize('number, file, message', [
    (errno.ENOSPC, None, 'neo: the disk: No space left on device; make room, and give'),
    (errno.EACCES, '/a/pairs.txt', 'neo: /a/pairs.txt: Permission denied; choose a place')])
def test_a_disk_that_takes_nothing_is_told_in_a_line(
        number: int, file: str | None, message: str, monkeypatch: pytest.MonkeyPatch,
        capsys: pytest.CaptureFixture[str]) -> None:
    def command() -> None:
        raise OSError(number, os.strerror(number), file)

    monkeypatch.setattr('neo_ros.cli.main.app', command)
    assert run_main(monkeypatch) == 2
    assert capsys.readouterr().err.startswith(message)


def test_other_errors_of_files_are_bugs_and_show_where(monkeypatch: pytest.MonkeyPatch) -> None:
    def command() -> None:
        raise OSError(errno.EBADF, os.strerror(errno.EBADF))

    monkeypatch.setattr('neo_ros.cli.main.app', command)
    with pytest.raises(OSError, match='Bad file'):
        main()


def test_a_bag_of_the_scene_is_replayed_with_its_model(
        tiny_run: TrainingRun, tmp_path: Path) -> None:
    scene, model = tiny_run.out.parent / 'scene', tiny_run.model_path
    bag, wide = tmp_path / 'bag', tmp_path / 'wide'
    made = CliRunner().invoke(app, ['bag', str(scene), '--model', str(model), '--out', str(bag)])
    assert made.exit_code == 0, made.output
    assert '6 frames' in ' '.join(made.output.split()) and 'neo replay' in made.output
    replayed = CliRunner().invoke(app, [
        'replay', str(bag), '--model', str(model), '--out', str(wide), '--truth-topic',
        '/camera/wide/image_raw'])
    assert replayed.exit_code == 0, replayed.output
    assert '/camera/image_raw: 6 frames' in replayed.output
    scores = json.loads((wide / 'scores.json').read_text())
    assert len(scores['frames']) == 6 and scores['scene_id'] == 'scene'
    # The bag holds the scene's test frames to the bit: the same scores as in the training. It
    # does not tell that another walk begins with the fourth.
    frames = json.loads((tiny_run.out / 'scores.json').read_text())['methods'][0]['frames']
    assert [frame['ring_psnr'] for frame in scores['frames'][:3]] == pytest.approx(
        [frame['ring_psnr'] for frame in frames[:3]])


def test_inspect_checks_the_scene_memory(tiny_run: TrainingRun, tmp_path: Path) -> None:
    shown = CliRunner().invoke(app, ['inspect', str(tiny_run.model_path)], env={'COLUMNS': '200'})
    assert shown.exit_code == 0 and 'scene.memory: ' in shown.output
    alone = tmp_path / 'scene.onnx'
    alone.write_bytes(tiny_run.model_path.read_bytes())
    missing = CliRunner().invoke(app, ['inspect', str(alone)])
    assert 'keep it beside the model' in str(missing.exception)


def test_bags_need_test_frames_and_a_free_place(
        tiny_run: TrainingRun, tmp_path: Path, monkeypatch: pytest.MonkeyPatch,
        capsys: pytest.CaptureFixture[str]) -> None:
    write_capture(tmp_path / 'photos', 3)
    for scene, out, message in (
            (tmp_path / 'photos', tmp_path / 'bag', 'add transforms_test.json'),
            (tiny_run.out.parent / 'scene', tmp_path, 'the output exists already')):
        code = run_main(monkeypatch, 'bag', scene, '--model', tiny_run.model_path, '--out', out)
        assert code == 2 and message in capsys.readouterr().err


def test_options_are_written_as_old_versions_of_typer_read_them() -> None:
    """Ubuntu 24.04 has typer 0.9, which knows Optional[X] and not X | None."""
    for file in (Path(neo_ros.__file__).parent / 'cli').glob('*.py'):
        assert not re.search(r'Annotated\[[^,]*\| None', file.read_text()), file.name
