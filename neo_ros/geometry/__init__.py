"""Cameras and views as frozen values; the only room where axes and FOV are converted."""
from neo_ros.geometry.band import Band
from neo_ros.geometry.camera_pose import CameraPose
from neo_ros.geometry.intrinsics import Intrinsics
from neo_ros.geometry.view_expansion import ViewExpansion

__all__ = ['Band', 'CameraPose', 'Intrinsics', 'ViewExpansion']
