"""
Start the field-of-view extrapolator of one camera, and a viewer if wanted.

ros2 launch neo_ros fov_extrapolator.launch.py namespace:=camera image:=image_rect model:=M.onnx
"""
from pathlib import Path
import sys

from ament_index_python.packages import get_package_share_directory
from launch import LaunchContext, LaunchDescription
from launch.actions import DeclareLaunchArgument, ExecuteProcess, OpaqueFunction
from launch.conditions import IfCondition
from launch.substitutions import LaunchConfiguration
from launch_ros.actions import Node
from neo_ros.node.file_place import find_model

# Name: default and description. Empty: what params_file says.
ARGUMENTS = {
    'namespace': ('', 'Namespace of the camera and of the wide topics'),
    'image': ('image', 'Image of the camera; image/compressed follows it'),
    'camera_info': ('', 'Calibration of the camera; empty: camera_info beside the image'),
    'odom': ('', 'Odometry of the camera or of base_frame; empty: odom in the namespace'),
    'model': ('', 'Model (ONNX file of "neo train"); empty: what params_file says'),
    'params_file': ('', 'YAML file with the parameters of the node; empty: the one that ships'),
    'autostart': ('', 'Configure and activate on start; empty: what params_file says'),
    'use_sim_time': ('', 'Take the time of /clock; empty: what params_file says'),
    'viewer': ('false', 'Show the wide image in a browser, at http://127.0.0.1:8600'),
}


def generate_launch_description() -> LaunchDescription:
    """Describe the node and its arguments."""
    return LaunchDescription([
        OpaqueFunction(function=refuse_unknown_arguments),
        *(DeclareLaunchArgument(name, default_value=default, description=description)
          for name, (default, description) in ARGUMENTS.items()),
        OpaqueFunction(function=start_node)])


def refuse_unknown_arguments(context: LaunchContext) -> None:
    """Raise RuntimeError for what was given to this file and is not of it, such as a typo."""
    if not any(Path(word).name == Path(__file__).name for word in sys.argv):
        return  # Included by another file, whose arguments are its own business.
    given = [word.partition(':=')[0] for word in context.argv if ':=' in word]
    if unknown := [name for name in given if name not in ARGUMENTS]:
        raise RuntimeError(f'unknown: {", ".join(unknown)}; expected {", ".join(ARGUMENTS)}')


def start_node(context: LaunchContext) -> list[Node | ExecuteProcess]:
    """Start the node once the arguments are known: empty ones change nothing."""
    given = {name: value for name in ARGUMENTS
             if (value := LaunchConfiguration(name).perform(context))}
    shipped = Path(get_package_share_directory('neo_ros')) / 'config' / 'fov_extrapolator.yaml'
    parameters: dict[str, str | bool] = {
        name: _read_switch(name, given[name])
        for name in ('autostart', 'use_sim_time') if name in given}
    if 'model' in given:
        parameters['model'] = given['model']
    namespace = given.get('namespace', '').strip('/')
    wide_image = '/'.join(['', *([namespace] if namespace else []), 'wide/image'])
    view = ['neo', 'view', '--topic', wide_image]
    if 'model' in given:  # Its memory has a map.
        view += ['--model', find_model(given['model'])]
    if parameters.get('use_sim_time'):
        view.append('--sim-time')
    return [
        Node(
            package='neo_ros', executable='fov_extrapolator', output='screen',
            namespace=namespace,
            parameters=[given.get('params_file', str(shipped)), parameters],
            remappings=[(name, given[name]) for name in ('image', 'camera_info', 'odom')
                        if name in given]),
        ExecuteProcess(cmd=view, output='screen',
                       condition=IfCondition(LaunchConfiguration('viewer')))]


def _read_switch(name: str, value: str) -> bool:
    if value.lower() not in ('true', 'false'):
        raise RuntimeError(f'{name}: expected true or false, got {value!r}')
    return value.lower() == 'true'
