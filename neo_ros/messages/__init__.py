"""
ROS messages to numpy and back, duck-typed: rclpy messages and rosbags' dataclasses alike.

Nothing here imports rclpy or rosbags.
"""
from neo_ros.messages.camera_fit import CameraFit
from neo_ros.messages.camera_info import (
    camera_info_fields,
    camera_info_of,
    expand_camera_info,
    is_same_camera,
    read_camera_info,
)
from neo_ros.messages.compressed_image import (
    encode_jpeg,
    jpeg_fields,
    read_compressed_image,
)
from neo_ros.messages.frame_processor import FrameProcessor, WideFrame
from neo_ros.messages.image import image_fields, MONO8, read_image, RGB8
from neo_ros.messages.scene_watch import SceneWatch

__all__ = [
    'camera_info_fields',
    'camera_info_of',
    'CameraFit',
    'encode_jpeg',
    'expand_camera_info',
    'FrameProcessor',
    'image_fields',
    'is_same_camera',
    'jpeg_fields',
    'MONO8',
    'read_camera_info',
    'read_compressed_image',
    'read_image',
    'RGB8',
    'SceneWatch',
    'WideFrame',
]
