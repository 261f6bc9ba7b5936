"""
Start the field-of-view extrapolator of one camera, and a viewer if wanted.

ros2 launch neo_ros fov_extrapolator.launch.py namespace:=camera image:=image_rect model:=M.onnx
"""
from pathlib import Path

from ament_index_python.packages import get_package_share_directory
from launch import LaunchContext, LaunchDescription
from launch.actions import DeclareLaunchArgument, ExecuteProcess, OpaqueFunction
from launch.conditions import IfCondition
from launch.substitutions import LaunchConfiguration
from launch_ros.actions import Node


def generate_launch_description() -> LaunchDescription:
    """Describe the node and its arguments."""
    parameters = Path(get_package_share_directory('neo_ros')) / 'config' / 'fov_extrapolator.yaml'
    arguments = {
        'namespace': ('', 'Namespace of the camera and of the wide topics'),
        'image': ('image', 'Image of the camera; image/compressed follows it'),
        'camera_info': ('', 'Calibration of the camera; empty: camera_info beside the image'),
        'model': ('', 'Model (ONNX file of "neo train"); empty: what params_file says'),
        'params_file': (str(parameters), 'YAML file with the parameters of the node'),
        'viewer': ('false', 'Show the wide image in a browser, at http://127.0.0.1:8600'),
    }
    return LaunchDescription([
        DeclareLaunchArgument(name, default_value=default, description=description)
        for name, (default, description) in arguments.items()
    ] + [OpaqueFunction(function=start_node)])


def start_node(context: LaunchContext) -> list[Node | ExecuteProcess]:
    """Start the node once the arguments are known: empty ones change nothing."""
    model = LaunchConfiguration('model').perform(context)
    namespace = LaunchConfiguration('namespace').perform(context).strip('/')
    camera_info = LaunchConfiguration('camera_info').perform(context)
    wide_image = '/'.join(['', *([namespace] if namespace else []), 'wide/image'])
    return [
        Node(
            package='neo_ros', executable='fov_extrapolator', output='screen',
            namespace=namespace,
            parameters=[LaunchConfiguration('params_file'),
                        *([{'model': model}] if model else [])],
            remappings=[('image', LaunchConfiguration('image')),
                        *([('camera_info', camera_info)] if camera_info else [])]),
        ExecuteProcess(cmd=['neo', 'view', '--topic', wide_image], output='screen',
                       condition=IfCondition(LaunchConfiguration('viewer')))]
