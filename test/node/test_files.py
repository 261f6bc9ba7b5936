"""What the node ships besides code, and what it loads."""
import ast
import importlib
import importlib.util
from pathlib import Path
import signal
import subprocess
import sys
from types import SimpleNamespace
import xml.etree.ElementTree as ElementTree

from ament_index_python.packages import get_package_prefix, PackageNotFoundError
from camera_messages import noise_image
from live_node import Camera, end, SOURCE, state_of
import neo_ros
from neo_ros.machine.files import share_dir
from neo_ros.node.extrapolator_node import ExtrapolatorNode
from neo_ros.node.fastdds_profile import use_large_image_profile, VARIABLE
from neo_ros.node.interface import INPUTS, OUTPUTS, SERVICES
from neo_ros.node.parameters import declare_parameters
import pytest
from rclpy.parameter import Parameter
from ros_graph import ros_graph, WAIT_S
from tiny_model import write_tiny_model
import yaml

LAUNCH = share_dir() / 'launch' / 'fov_extrapolator.launch.py'
# What `ros2 launch` does: the launch file, then its arguments as NAME:=VALUE.
LAUNCHER = """
import sys
from launch import LaunchDescription, LaunchService
from launch.actions import IncludeLaunchDescription
from launch.launch_description_sources import PythonLaunchDescriptionSource
source = PythonLaunchDescriptionSource(sys.argv[1])
arguments = [tuple(argument.split(':=')) for argument in sys.argv[2:]]
service = LaunchService(argv=sys.argv[2:])
service.include_launch_description(LaunchDescription([
    IncludeLaunchDescription(source, launch_arguments=arguments)]))
sys.exit(service.run())
"""


def loaded(modules, candidates):
    """Import modules in a fresh interpreter; return which of the candidates came along."""
    script = (f'import sys, {modules}; '
              f'print(*[name for name in {candidates!r} if name in sys.modules])')
    root = str(Path(neo_ros.__file__).parent.parent)
    return subprocess.run([sys.executable, '-c', script], cwd=root, check=True, text=True,
                          capture_output=True).stdout.split()


@pytest.mark.parametrize('modules, candidates', [
    ('neo_ros.node.running', ('torch', 'onnx', 'matplotlib', 'rosbags')),
    ('neo_ros.node.bag_player, neo_ros.node.bag_recorder', ('torch', 'onnx', 'matplotlib')),
    ('neo_ros.messages', ('torch', 'onnx', 'rclpy', 'rosbags', 'onnxruntime')),
    ('neo_ros.cli.play, neo_ros.cli.record', ('torch', 'rclpy', 'rosbags', 'numpy')),
], ids=['node', 'player and recorder', 'messages', 'commands'])
def test_only_what_is_needed_is_loaded(modules, candidates):
    assert loaded(modules, candidates) == []


def test_probe_sees_what_is_loaded():
    assert loaded('neo_ros.node.running', ('rclpy', 'torch')) == ['rclpy']


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
    environment: dict[str, str] = {}
    assert use_large_image_profile(environment) is True
    size = ElementTree.parse(environment[VARIABLE]).findtext('.//{*}segment_size')
    assert size is not None and int(size) >= 16 * 2**20
    for name in (VARIABLE, 'FASTDDS_DEFAULT_PROFILES_FILE'):
        environment = {name: 'mine.xml'}
        assert use_large_image_profile(environment) is False
        assert environment == {name: 'mine.xml'}


def test_security_policy_grants_what_the_node_needs_and_nothing_more(tmp_path):
    profile = ElementTree.parse(share_dir() / 'config' / 'sros2_policy.xml').find('.//profile')
    assert profile is not None
    assert (profile.get('ns'), profile.get('node')) == ('/', 'fov_extrapolator')
    granted = {key: {f'/{text}' if text[0] not in '/~' else text
                     for group in profile.findall(f'{kind}s[@{key}="ALLOW"]')
                     for text in group.itertext() if text.strip()}
               for kind, key in (('topic', 'subscribe'), ('topic', 'publish'),
                                 ('service', 'reply'))}
    with ros_graph() as graph:
        # In a namespace of its own: nodes of other tests take a while to be forgotten.
        node = ExtrapolatorNode(context=graph.context, namespace='policy', parameter_overrides=[
            Parameter('model', value=str(write_tiny_model(tmp_path / 'tiny.onnx')))])
        node.autostart()
        by_node = (node.get_name(), node.get_namespace())
        own = f'{node.get_fully_qualified_name()}/'

        def names(found):
            return {name.replace(own, '~/').removeprefix('/policy') for name, _ in found}
        published = graph.spin_until(lambda: len(found := names(
            node.get_publisher_names_and_types_by_node(*by_node))) >= 8 and found)
        served = names(node.get_service_names_and_types_by_node(*by_node))
        subscribed = names(node.get_subscriber_names_and_types_by_node(*by_node))
        node.stop()
        node.destroy_node()
    assert {f'/{output.name}' for output in OUTPUTS.values()} <= published
    assert {service.name for service in SERVICES} <= served
    # Transforms are published where publish_tf asks for it, the bond where a manager does.
    assert published == granted['publish'] - {'/tf', '/bond'} and served == granted['reply']
    assert subscribed <= granted['subscribe']
    # Compressed images, simulated time, transforms and the bond only where a parameter asks; the
    # guides remap image to image_raw.
    inputs = {entry.name if entry.name.startswith('~') else f'/{entry.name}' for entry in INPUTS}
    assert granted['subscribe'] == inputs | {
        '/clock', '/parameter_events', '/tf', '/tf_static', '/bond', '/image_raw',
        '/image_raw/compressed'}


def test_launch_file_compiles_and_has_its_function():
    tree = ast.parse(LAUNCH.read_text())
    compile(tree, str(LAUNCH), 'exec')
    functions = {node.name for node in tree.body if isinstance(node, ast.FunctionDef)}
    assert 'generate_launch_description' in functions


@pytest.fixture
def launch_system():
    """Skip where there is no launch system."""
    launch = importlib.import_module('launch') if importlib.util.find_spec('launch') else None
    if not hasattr(launch, 'LaunchDescription'):
        pytest.skip('launch is not installed (not on PyPI)')
    pytest.importorskip('launch_ros')


def load_launch_file():
    specification = importlib.util.spec_from_file_location('launch_file', LAUNCH)
    assert specification and specification.loader
    module = importlib.util.module_from_spec(specification)
    specification.loader.exec_module(module)
    return module


@pytest.fixture
def launch_file(launch_system):
    return load_launch_file()


def test_launch_file_describes_its_arguments(launch_file):
    names = {argument.name for argument in
             launch_file.generate_launch_description().get_launch_arguments()}
    assert names == {'namespace', 'image', 'camera_info', 'odom', 'model', 'params_file', 'viewer',
                     'autostart', 'use_sim_time'}


@pytest.mark.parametrize('given, more', [
    ({}, []), ({'use_sim_time': 'false'}, []),
    ({'model': 'file:///a.onnx', 'use_sim_time': 'true'}, ['--model', '/a.onnx', '--sim-time']),
], ids=['nothing', 'no simulation', 'a model in simulated time'])
def test_the_viewer_of_the_launch_file_has_its_model_and_its_time(given, more, monkeypatch):
    made, launch_file = launch_stand_in(monkeypatch, given)
    launch_file.start_node(None)
    assert made['ExecuteProcess']['cmd'] == ['neo', 'view', '--topic', '/wide/image', *more]


def test_the_launch_file_hands_on_topics_that_are_named(monkeypatch):
    made, launch_file = launch_stand_in(monkeypatch, {'image': 'image_raw', 'odom': '/odom'})
    launch_file.start_node(None)
    assert made['Node']['remappings'] == [('image', 'image_raw'), ('odom', '/odom')]


def launch_stand_in(monkeypatch, given):
    """Return what the launch file makes, and it, with stand-ins for launch: it is not on PyPI."""
    made: dict[str, dict] = {}

    def stand_in(name):
        return type(name, (), {'__init__': lambda self, *_, **said: made.update({name: said})})

    names = {'launch': ['LaunchContext', 'LaunchDescription'],
             'launch.actions': ['DeclareLaunchArgument', 'ExecuteProcess', 'OpaqueFunction'],
             'launch.conditions': ['IfCondition'], 'launch.substitutions': ['LaunchConfiguration'],
             'launch_ros': [], 'launch_ros.actions': ['Node']}
    for module, classes in names.items():
        monkeypatch.setitem(sys.modules, module, SimpleNamespace(
            **{name: stand_in(name) for name in classes}))
    launch_file = load_launch_file()
    monkeypatch.setattr(launch_file, 'LaunchConfiguration', lambda name: SimpleNamespace(
        perform=lambda context: given.get(name, '')))
    monkeypatch.setattr(launch_file, 'get_package_share_directory', lambda _: str(share_dir()))
    return made, launch_file


@pytest.fixture
def installed(launch_system):
    """Skip where ROS does not know the package."""
    try:
        get_package_prefix('neo_ros')
    except (PackageNotFoundError, OSError):
        pytest.skip('neo_ros is not in the ament index (built by colcon)')


@pytest.mark.usefixtures('installed')
def test_launch_file_starts_the_node(tmp_path):
    model = write_tiny_model(tmp_path / 'tiny.onnx')
    with ros_graph() as graph:
        camera = Camera(graph)
        process = graph.start(
            '-c', LAUNCHER, str(LAUNCH), 'namespace:=robot', f'model:={model}')
        camera.wait_for_node()
        camera.widen(noise_image(SOURCE, 0), 1)
        assert end(process, signal.SIGINT) == 0


@pytest.mark.usefixtures('installed')
def test_launch_file_hands_on_its_switches(tmp_path):
    model = write_tiny_model(tmp_path / 'tiny.onnx')
    with ros_graph() as graph:
        graph.start('-c', LAUNCHER, str(LAUNCH), 'namespace:=robot', f'model:={model}',
                    'autostart:=false', 'use_sim_time:=True')
        graph.spin_until(lambda: graph.node.count_subscribers('/clock'))
        assert state_of(graph) == 'unconfigured'


@pytest.mark.usefixtures('installed')
@pytest.mark.parametrize('argument, words', [
    ('modle:=a.onnx', 'unknown: modle; expected namespace, image'),
    ('autostart:=maybe', "autostart: expected true or false, got 'maybe'"),
], ids=['unknown', 'no switch'])
def test_launch_file_refuses(argument, words):
    with ros_graph() as graph:
        process = graph.start('-c', LAUNCHER, str(LAUNCH), argument)
        text, _ = process.communicate(timeout=WAIT_S)
        assert process.returncode != 0 and words in text
