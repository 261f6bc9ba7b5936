"""Which room may import which, and that robots load no torch and trainers no ROS."""
import ast
from collections.abc import Iterator
from importlib.util import find_spec
from pathlib import Path
import subprocess
import sys

import neo_ros
import pytest

PACKAGE = Path(neo_ros.__file__).parent
# What every room may use.
COMMON = {'errors'}
# Room: the other rooms and the heavy libraries that it may import.
LAW: dict[str, set[str]] = {
    'machine': {'numba', 'ray', 'pycolmap'},
    'pictures': {'machine', 'cv2'},
    'geometry': {'cv2'},
    'scenes': {'geometry', 'machine', 'pictures', 'cv2'},
    'captures': {'geometry', 'machine', 'pictures', 'scenes', 'bags', 'messages', 'reports',
                 'cv2'},
    'flat': {'geometry', 'machine', 'pictures', 'scenes', 'cv2'},
    'reports': {'geometry', 'machine', 'pictures', 'cv2', 'matplotlib'},
    'field': {'geometry', 'machine', 'pictures', 'scenes', 'torch', 'numba', 'scipy', 'cv2'},
    'outpaint': {'geometry', 'machine', 'pictures', 'scenes', 'field', 'runtime', 'torch', 'onnx',
                 'onnxruntime', 'cv2'},
    'memory': {'geometry', 'machine', 'pictures', 'numba', 'cv2'},
    'baking': {'geometry', 'machine', 'scenes', 'field', 'memory', 'numba', 'cv2'},
    'runtime': {'geometry', 'machine', 'pictures', 'memory', 'onnxruntime', 'onnx', 'cv2'},
    'messages': {'geometry', 'pictures', 'cv2'},
    'bags': {'geometry', 'machine', 'runtime', 'messages', 'rosbags', 'mcap', 'cv2'},
    # The player and the recorder of bags are ROS nodes.
    'node': {'geometry', 'machine', 'runtime', 'messages', 'bags', 'rosbags', 'rclpy'},
    # As a ROS node it is told where the model lies in the node's ways.
    'viewer': {'geometry', 'machine', 'pictures', 'scenes', 'runtime', 'messages', 'memory',
               'bags', 'node', 'cv2', 'rclpy'},
    # Of `outpaint` it has the weights of LPIPS, which are a training loss there.
    'evaluation': {'geometry', 'machine', 'pictures', 'scenes', 'field', 'outpaint', 'runtime',
                   'messages', 'memory', 'reports', 'torch', 'cv2', 'matplotlib'},
    'replaying': {'machine', 'memory', 'runtime', 'bags', 'evaluation', 'reports'},
    # What the pipeline is made of.
    'training': {'geometry', 'machine', 'pictures', 'scenes', 'field', 'outpaint', 'runtime',
                 'memory', 'baking', 'reports', 'evaluation', 'experiment', 'torch', 'cv2'},
    # Reads bags, changes what a training left, and trains its network on with the pipeline.
    'updating': {'geometry', 'machine', 'pictures', 'scenes', 'field', 'memory', 'baking',
                 'runtime', 'messages', 'bags', 'reports', 'training', 'pipeline', 'experiment',
                 'numba', 'scipy', 'cv2'},
    # Trains with the pipeline, which itself scores with `evaluation`.
    'benchmark': {'geometry', 'machine', 'pictures', 'scenes', 'captures', 'flat', 'field',
                  'outpaint', 'runtime', 'memory', 'baking', 'messages', 'reports', 'evaluation',
                  'training', 'pipeline', 'experiment', 'bags', 'torch', 'cv2'},
    'speed': {'geometry', 'machine', 'scenes', 'flat', 'field', 'outpaint', 'runtime', 'messages',
              'bags', 'memory', 'baking', 'viewer', 'evaluation', 'torch', 'cv2', 'onnx'},
    # Reads what the others say of themselves; nothing imports it.
    'documents': {'benchmark', 'cli', 'node', 'reports'},
}
HEAVY = {'torch', 'numba', 'scipy', 'cv2', 'onnx', 'onnxscript', 'onnxruntime', 'rosbags',
         'mcap', 'rclpy', 'skimage', 'matplotlib', 'pycolmap', 'ray'}
ROS_PACKAGES = {'rclpy', 'rcl_interfaces', 'ament_index_python', 'launch', 'launch_ros'}
# What needs the train extra: absent from the base install.
TRAINING = {'torch', 'scipy', 'onnx', 'onnxscript', 'skimage', 'pycolmap'}
MODULES = sorted(PACKAGE.rglob('*.py'))


def imported_names(tree: ast.AST) -> Iterator[str]:
    """Yield the dotted names that a module imports, at its top and inside functions."""
    for node in ast.walk(tree):
        if isinstance(node, ast.Import):
            yield from (alias.name for alias in node.names)
        elif isinstance(node, ast.ImportFrom):
            assert node.level == 0, 'relative imports hide the room'
            # `from neo_ros import bags` names its room after the import.
            yield from (f'{node.module}.{alias.name}' for alias in node.names)


def law_names(tree: ast.AST) -> set[str]:
    """Return the rooms, common modules and heavy libraries that a module imports."""
    names = set()
    for name in imported_names(tree):
        top, *rest = name.split('.')
        if top == 'neo_ros':
            names.add(rest[0])
        elif top in ROS_PACKAGES or top.endswith(('_msgs', '_srvs')):
            names.add('rclpy')
        elif top in HEAVY:
            names.add(top)
    return names


def broken(room: str, source: str) -> set[str]:
    """Return what a module of this room imports against the law."""
    return law_names(ast.parse(source)) - LAW[room] - COMMON - {room, '__version__'}


@pytest.mark.parametrize(
    'path', [path for path in MODULES if path.relative_to(PACKAGE).parts[0] in LAW],
    ids=lambda path: str(path.relative_to(PACKAGE)))
def test_modules_keep_to_the_law_of_their_room(path: Path) -> None:
    room = path.relative_to(PACKAGE).parts[0]
    assert broken(room, path.read_text()) == set()


def test_every_folder_is_a_room_with_a_law() -> None:
    folders = {path.relative_to(PACKAGE).parts[0] for path in MODULES if path.parent != PACKAGE}
    assert folders - {'cli'} <= LAW.keys()


@pytest.mark.parametrize(
    'path', [path for path in MODULES if path.parent.name == 'cli'], ids=lambda path: path.name)
def test_commands_import_rooms_only_when_they_run(path: Path) -> None:
    top_level = ast.Module(
        [node for node in ast.parse(path.read_text()).body
         if isinstance(node, ast.Import | ast.ImportFrom)], type_ignores=[])
    assert law_names(top_level) - {'cli', 'machine'} - COMMON - {'__version__'} == set()


@pytest.mark.parametrize('source, found', [
    ('import torch.nn', {'torch'}),
    ('def f():\n    from rclpy.node import Node', {'rclpy'}),
    ('from sensor_msgs.msg import Image', {'rclpy'}),
    ('from neo_ros import evaluation', {'evaluation'}),
    ('from neo_ros.pipeline import train', {'pipeline'}),
    ('from neo_ros.errors import NeoError\nimport numpy, os', set()),
], ids=['heavy', 'inside a function', 'messages', 'room by name', 'top', 'nothing'])
def test_the_law_sees_what_it_forbids(source: str, found: set[str]) -> None:
    assert broken('geometry', source) == found


def loaded_by(module: str) -> set[str]:
    """Import a module in a fresh interpreter; return the names of all that is loaded then."""
    code = f'import sys, {module}; print(*sys.modules)'
    result = subprocess.run([sys.executable, '-c', code], cwd=PACKAGE.parent,
                            capture_output=True, text=True, check=False)
    assert result.returncode == 0, result.stderr
    return set(result.stdout.split())


@pytest.mark.parametrize('module', [
    'neo_ros.runtime', 'neo_ros.node.running', 'neo_ros.node.bag_player',
    'neo_ros.node.bag_recorder', 'neo_ros.bags', 'neo_ros.messages', 'neo_ros.cli.main',
    'neo_ros.evaluation.evaluation_report', 'neo_ros.replaying.many_bags'])
def test_what_runs_on_a_robot_loads_nothing_of_the_training(module: str) -> None:
    # Plots are drawn when a report is written, Ray is asked for with an option.
    assert loaded_by(module) & (TRAINING | {'matplotlib', 'ray'}) == set()


@pytest.mark.parametrize('module', [
    'neo_ros.runtime', 'neo_ros.messages', 'neo_ros.bags', 'neo_ros.cli.main',
    'neo_ros.scenes.scene', 'neo_ros.evaluation.evaluation_report',
    'neo_ros.field.fitting', 'neo_ros.outpaint.fitting', 'neo_ros.pipeline'])
def test_what_needs_no_graph_loads_no_ros(module: str) -> None:
    if module.split('.')[1] in ('field', 'outpaint', 'pipeline') and find_spec('torch') is None:
        pytest.skip('needs torch: the train extra is not installed')
    assert loaded_by(module) & ROS_PACKAGES == set()
