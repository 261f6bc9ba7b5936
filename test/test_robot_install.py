"""What runs on a robot needs nothing that rosdep does not bring on Ubuntu 24.04."""
from pathlib import Path
import subprocess
import sys

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
