"""Matrices in text files: 16 (or 12) numbers, row by row, camera to world."""
from pathlib import Path

from neo_ros.errors import GeometryError, SceneError
from neo_ros.geometry import CameraPose
from neo_ros.geometry.camera_pose import OPENGL_FROM_OPENCV
import numpy as np


def read_matrix(path: Path) -> np.ndarray:
    """Read the numbers of a text file as a 3x3, 3x4 or 4x4 matrix, float64."""
    try:
        text = path.read_text()
    except (OSError, UnicodeDecodeError) as error:
        raise SceneError(f'{path}: cannot read: {error}') from error
    return parse_matrix(text, str(path))


def parse_matrix(text: str, where: str) -> np.ndarray:
    """Read 9, 12 or 16 numbers as a matrix; `where` names them in errors."""
    try:
        numbers = np.array([float(word) for word in text.replace(',', ' ').split()])
    except ValueError as error:
        raise SceneError(f'{where}: expected numbers: {error}') from error
    shapes = {9: (3, 3), 12: (3, 4), 16: (4, 4)}
    if numbers.size not in shapes:
        raise SceneError(f'{where}: expected 9, 12 or 16 numbers, got {numbers.size}')
    return numbers.reshape(shapes[numbers.size])


def pose_or_lost(matrix: np.ndarray, where: str, opengl: bool = False) -> CameraPose | None:
    """
    Take a camera-to-world matrix; None for a lost pose (values that are not finite).

    Trackers write -inf or nan where they were lost. Raises SceneError for matrices that are no
    rotation, or mirrored: they mean another convention, in all frames.
    """
    if not np.isfinite(matrix).all():
        return None
    try:
        pose = CameraPose(matrix)
    except GeometryError as error:
        raise SceneError(f'{where}: {error}') from error
    return CameraPose(pose.T_world_cam @ OPENGL_FROM_OPENCV) if opengl else pose
