"""What the node ships besides code, and what it loads."""
import ast
import importlib
import importlib.util
from pathlib import Path
import subprocess
import sys
import xml.etree.ElementTree as ElementTree

import neo_ros
from neo_ros.node.fastdds_profile import use_large_image_profile, VARIABLE
from neo_ros.node.parameters import declare_parameters
from neo_ros.paths import share_dir
import pytest
from ros_graph import ros_graph
import yaml

LAUNCH = share_dir() / 'launch' / 'fov_extrapolator.launch.py'


def loaded(modules, candidates):
    """Import modules in a fresh interpreter; return which of the candidates came along."""
    script = (f'import sys, {modules}; '
              f'print(*[name for name in {candidates!r} if name in sys.modules])')
    root = str(Path(neo_ros.__file__).parent.parent)
    return subprocess.run([sys.executable, '-c', script], cwd=root, check=True, text=True,
                          capture_output=True).stdout.split()


@pytest.mark.parametrize('modules, candidates', [
    ('neo_ros.node.main', ('torch', 'onnx', 'matplotlib', 'rosbags')),
    ('neo_ros.node.bag_player, neo_ros.node.bag_recorder', ('torch', 'onnx', 'matplotlib')),
    ('neo_ros.messages', ('torch', 'onnx', 'rclpy', 'rosbags', 'onnxruntime')),
    ('neo_ros.cli.play, neo_ros.cli.record', ('torch', 'rclpy', 'rosbags', 'numpy')),
], ids=['node', 'player and recorder', 'messages', 'commands'])
def test_only_what_is_needed_is_loaded(modules, candidates):
    assert loaded(modules, candidates) == []


def test_probe_sees_what_is_loaded():
    assert loaded('neo_ros.node.main', ('rclpy', 'torch')) == ['rclpy']


def test_shipped_parameters_are_the_defaults():
    shipped = yaml.safe_load((share_dir() / 'config' / 'fov_extrapolator.yaml').read_text())
    with ros_graph() as graph:
        before = set(graph.node._parameters)
        declare_parameters(graph.node)
        declared = {name: parameter.value for name, parameter in graph.node._parameters.items()
                    if name not in before}
        for name in declared:
            assert graph.node.describe_parameter(name).description
    assert shipped['/**']['ros__parameters'] == declared
    assert all(type(declared[name]) is type(value)
               for name, value in shipped['/**']['ros__parameters'].items())


def test_profile_is_used_unless_the_user_has_one():
    environment = {}
    assert use_large_image_profile(environment) is True
    transports = ElementTree.parse(environment[VARIABLE]).findall('.//{*}segment_size')
    assert int(transports[0].text) >= 16 * 2**20
    for name in (VARIABLE, 'FASTDDS_DEFAULT_PROFILES_FILE'):
        environment = {name: 'mine.xml'}
        assert use_large_image_profile(environment) is False
        assert environment == {name: 'mine.xml'}


def test_launch_file_compiles_and_has_its_function():
    tree = ast.parse(LAUNCH.read_text())
    compile(tree, str(LAUNCH), 'exec')
    functions = {node.name for node in tree.body if isinstance(node, ast.FunctionDef)}
    assert 'generate_launch_description' in functions


def test_launch_file_describes_its_arguments(monkeypatch):
    launch = importlib.import_module('launch') if importlib.util.find_spec('launch') else None
    if not hasattr(launch, 'LaunchDescription'):
        pytest.skip('launch is not installed (not on PyPI)')
    pytest.importorskip('launch_ros')
    specification = importlib.util.spec_from_file_location('launch_file', LAUNCH)
    module = importlib.util.module_from_spec(specification)
    specification.loader.exec_module(module)
    monkeypatch.setattr(module, 'get_package_share_directory', lambda name: str(share_dir()))
    names = {argument.name for argument in
             module.generate_launch_description().get_launch_arguments()}
    assert names == {'namespace', 'image', 'camera_info', 'model', 'params_file'}
