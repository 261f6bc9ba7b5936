"""
ROS messages to numpy and back, duck-typed: rclpy messages and rosbags' dataclasses alike.

Nothing here imports rclpy or rosbags.
"""
from neo_ros.messages.camera_info import (
    camera_info_fields,
    check_same_camera,
    expand_camera_info,
    read_camera_info,
)
from neo_ros.messages.frame_processor import FrameProcessor, WideFrame
from neo_ros.messages.image import image_fields, MONO8, read_image, RGB8

__all__ = [
    'camera_info_fields',
    'check_same_camera',
    'expand_camera_info',
    'FrameProcessor',
    'image_fields',
    'MONO8',
    'read_camera_info',
    'read_image',
    'RGB8',
    'WideFrame',
]
