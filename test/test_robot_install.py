"""What runs on a robot needs nothing that rosdep does not bring on Ubuntu 24.04."""
import ast
from collections.abc import Iterator
import os
from pathlib import Path
import re
import subprocess
import sys
from xml.etree import ElementTree

from bag_files import write_sqlite_bag, write_walk_bag
from neo_ros.bags import BagReader
from neo_ros.runtime import read_model_card
import pytest

pytestmark = pytest.mark.slow

ROOT = Path(__file__).parents[1]
# Newer versions of typer import pydantic themselves, those of Ubuntu do not.
WITHOUT = """
import builtins
real_import = builtins.__import__
def guarded_import(name, globals=None, *rest, **named):
    importer = (globals or {}).get('__name__', '')
    if name.split('.')[0] in ('pydantic', 'apsw') and importer.split('.')[0] in (
            'neo_ros', '__main__'):
        raise ModuleNotFoundError(f'{importer} needs {name}')
    return real_import(name, globals, *rest, **named)
builtins.__import__ = guarded_import
"""
ROOMS = ('machine', 'pictures', 'geometry', 'memory', 'runtime', 'messages', 'bags', 'node',
         'viewer')
# What rosdep calls the modules that a robot's rooms import; all others are ROS packages of their
# own name. All are keys of Ubuntu 24.04 in rosdep/base.yaml and python.yaml of ros/rosdistro, or
# packages of Jazzy (looked up in August 2026). None: no key, and only some robots need it.
KEYS = {
    'OpenEXR': None, 'aiohttp': 'python3-aiohttp', 'av': None, 'cv2': 'python3-opencv',
    'jinja2': 'python3-jinja2',
    'lz4': 'mcap-ros2-support', 'matplotlib': 'python3-matplotlib', 'mcap': 'mcap-ros2-support',
    'mcap_protobuf': None, 'numba': 'python3-numba', 'numpy': 'python3-numpy', 'onnx': None,
    'onnxruntime': 'python3-onnxruntime-pip', 'pillow_heif': None, 'pycolmap': None,
    'ray': None, 'rich': 'python3-rich',
    'rosbags': 'python3-rosbags-pip', 'tf2_ros': 'tf2_ros_py', 'typer': 'python3-typer',
    'yaml': 'python3-yaml', 'yarl': 'python3-aiohttp', 'zstandard': 'mcap-ros2-support'}
PYPI_NAMES = {'opencv-python-headless': 'cv2', 'pyyaml': 'yaml'}
COMMANDS = ('play', 'record', 'replay', 'view', 'inspect', 'bag-info')


def run_without(code: str, *arguments: str) -> str:
    """Run code where neo_ros finds neither pydantic nor apsw; return what it prints."""
    result = subprocess.run([sys.executable, '-c', WITHOUT + code, *arguments], cwd=ROOT,
                            capture_output=True, text=True, check=False)
    assert result.returncode == 0, result.stderr
    return result.stdout


def command(*arguments: str) -> str:
    return run_without('from neo_ros.cli.main import main\nmain()', *arguments)


def test_the_packages_are_really_hidden() -> None:
    with pytest.raises(AssertionError, match='ModuleNotFoundError.*pydantic'):
        run_without('import pydantic')


def test_the_rooms_of_a_robot_can_be_imported() -> None:
    modules = sorted(
        '.'.join(path.relative_to(ROOT).with_suffix('').parts)
        for room in ROOMS for path in (ROOT / 'neo_ros' / room).rglob('*.py'))
    assert len(modules) > 50
    run_without(f'from importlib import import_module\nfor name in {modules}: '
                'import_module(name)')


@pytest.mark.parametrize(('tests', 'skipped'), [
    (['test/messages', 'test/bags', 'test/node', 'test/viewer'], False),
    (['test/outpaint/test_network.py', 'test/runtime/test_model_file.py'], True),
], ids=["a robot's rooms", "the trainer's"])
def test_tests_that_need_the_trainer_are_skipped_and_no_others(
        tmp_path: Path, tests: list[str], skipped: bool) -> None:
    for name in ('torch', 'onnx'):
        (tmp_path / f'{name}.py').write_text(f'raise ModuleNotFoundError(name={name!r})')
    paths = os.pathsep.join([str(tmp_path), os.environ.get('PYTHONPATH', '')])
    result = subprocess.run(
        [sys.executable, '-m', 'pytest', '--collect-only', '-q', '-rs', *tests], cwd=ROOT,
        env={**os.environ, 'PYTHONPATH': paths}, capture_output=True, text=True)
    assert result.returncode == (5 if skipped else 0), result.stdout  # 5: no test was found.
    assert ('of the extra train' in result.stdout) == skipped


def imported_names(tree: ast.AST) -> Iterator[str]:
    """Yield the modules that a file imports."""
    for node in ast.walk(tree):
        if isinstance(node, ast.Import):
            yield from (alias.name for alias in node.names)
        elif isinstance(node, ast.ImportFrom) and node.module:
            yield node.module


def imported_packages(*folders: Path) -> set[str]:
    """Return the packages that the modules below import, at their top and inside functions."""
    trees = [ast.parse(path.read_text()) for folder in folders for path in folder.rglob('*.py')]
    names = {name for tree in trees for name in imported_names(tree)}
    return ({name.partition('.')[0] for name in names} - sys.stdlib_module_names - {'neo_ros'})


def test_rosdep_brings_what_a_robot_imports_and_nothing_else() -> None:
    manifest = ElementTree.parse(ROOT / 'package.xml')
    listed = {entry.text for entry in manifest.iterfind('exec_depend')}
    imported = imported_packages(*(ROOT / 'neo_ros' / room for room in ROOMS), ROOT / 'launch')
    shown = imported_packages(ROOT / 'neo_ros/cli', ROOT / 'neo_ros/reports') & KEYS.keys()
    needed = {KEYS.get(name, name) for name in imported | shown} - {None}
    # A recording of /tf needs its messages, which nobody imports by name.
    assert listed == needed | {'tf2_msgs'}


def test_rosdep_brings_what_pip_would() -> None:
    setup = ast.parse((ROOT / 'setup.py').read_text())
    required, = (ast.literal_eval(node.value) for node in setup.body
                 if isinstance(node, ast.Assign) and ast.unparse(node.targets[0]) == 'ROBOT')
    names = {re.split('[<>=]', requirement)[0] for requirement in required}
    assert {PYPI_NAMES.get(name, name) for name in names} <= {
        name for name, key in KEYS.items() if key is not None}


@pytest.mark.parametrize('name', COMMANDS)
def test_the_commands_of_a_robot_say_what_they_do(name: str) -> None:
    assert 'Usage' in command(name, '--help')


def test_the_shipped_model_replays_a_bag(tmp_path: Path) -> None:
    model = ROOT / 'models' / 'demo_flat.onnx'
    bag = write_walk_bag(tmp_path / 'bag', read_model_card(model).expansion, 2)
    command('replay', str(bag), '--model', str(model), '--out', str(tmp_path / 'wide'))
    with BagReader(tmp_path / 'wide') as replayed:
        counts = {topic.name: topic.count for topic in replayed.topics}
    assert [count for name, count in counts.items() if name.endswith('wide/image')] == [2]


def test_a_sqlite_bag_that_was_cut_is_read(tmp_path: Path) -> None:
    database = write_sqlite_bag(tmp_path / 'bag', 400) / 'bag.db3'
    database.write_bytes(database.read_bytes()[:-5000])
    assert 'lost' in command('bag-info', str(database.parent))
