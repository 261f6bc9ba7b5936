"""
What the scene memory knows of one frame, as messages: pose, depth, status.

`make(msgtype, **fields)` builds a message, such as 'std_msgs/msg/Header': of rclpy's classes or of
rosbags'. Pixels are flat uint8 arrays and levels integers; `make` turns them into what it needs.
"""
from collections.abc import Callable, Mapping
from typing import Any, Protocol

from neo_ros.geometry import CameraPose
from neo_ros.geometry.camera_pose import quaternion_from_rotation
from neo_ros.messages.frame_processor import WideFrame
from neo_ros.messages.scene_watch import WatchThresholds
import numpy as np

Make = Callable[..., Any]
DEPTH_ENCODING = '32FC1'
POSE, HEADER = 'geometry_msgs/msg/PoseWithCovarianceStamped', 'std_msgs/msg/Header'
STATUS, OK, WARN = 'diagnostic_msgs/msg/DiagnosticArray', 0, 1
# The frame of a scene of arbitrary scale must not be taken for a map in metres.
MAP_FRAME, UNSCALED_FRAME = 'map', 'scene'
# The task of the node's own diagnosis; a status is named "node: task".
WIDENING = 'widening'


class Panorama(Protocol):
    """A sphere as `memory.panorama.Panorama` describes it."""

    image: np.ndarray
    kinds: np.ndarray


def default_scene_frame(arbitrary_scale: bool) -> str:
    """Return the frame of poses where none is named."""
    return UNSCALED_FRAME if arbitrary_scale else MAP_FRAME


def stamped(make: Make, header: Any, frame_id: str) -> Any:
    """Return a header of the same time in another frame."""
    return make(HEADER, stamp=header.stamp, frame_id=frame_id)


def pose_message(make: Make, header: Any, pose: CameraPose, covariance: np.ndarray,
                 frame_id: str) -> Any:
    """
    Return a PoseWithCovarianceStamped of an optical frame (REP-103) at the header's time.

    covariance (6, 6): x, y, z, then rotations about x, y, z, along the axes of `frame_id`.
    """
    x, y, z = pose.position.tolist()
    quaternion = quaternion_from_rotation(pose.T_world_cam[:3, :3]).tolist()
    return make(
        POSE, header=stamped(make, header, frame_id), pose=make(
            'geometry_msgs/msg/PoseWithCovariance',
            pose=make('geometry_msgs/msg/Pose',
                      position=make('geometry_msgs/msg/Point', x=x, y=y, z=z),
                      orientation=make('geometry_msgs/msg/Quaternion',
                                       **dict(zip('xyzw', quaternion)))),
            covariance=np.ascontiguousarray(covariance, np.float64).reshape(36)))


def depth_fields(depth: np.ndarray) -> dict[str, Any]:
    """
    Return the Image fields below the header of a depth image, float32 (H, W), metres (REP-118).

    32FC1 along the optical axis, NaN = unknown. `data` is a view of `depth` where it can be.
    """
    little = np.ascontiguousarray(depth, '<f4')
    return {'height': depth.shape[0], 'width': depth.shape[1], 'encoding': DEPTH_ENCODING,
            'is_bigendian': 0, 'step': 4 * depth.shape[1],
            'data': little.view(np.uint8).reshape(-1)}


def status_lines(frame: WideFrame, age_ms: float | None = None) -> dict[str, str]:
    """
    Return what is true of one frame, ready for KeyValues.

    Without an age no times are told: those of a replay say nothing of a robot, and no two runs
    have the same.
    """
    times = {} if age_ms is None else {
        **{f'{stage} [ms]': f'{spent:.2f}' for stage, spent in frame.stages_ms.items()},
        'age [ms]': f'{age_ms:.1f}'}
    guide = frame.guide
    return {
        'guided': str(frame.guided).lower(),
        'found': (guide.found if guide is not None
                  else 'ambiguous' if frame.ambiguous else 'not'),
        'agreement': f'{guide.agreement:.3f}' if guide is not None else 'unknown',
        'landmarks matched': str(guide.landmarks) if guide is not None else 'unknown',
        'out of the scene': ('unknown' if frame.out_of_scene is None
                             else f'{frame.out_of_scene:.2f}'),
        'camera': frame.camera_note,
        **times,
    }


def status_message(make: Make, header: Any, name: str, frame: WideFrame,
                   age_ms: float | None = None) -> Any:
    """
    Return a DiagnosticArray with one status of one frame, under the header of its image.

    age_ms: since the image's stamp, where a clock tells.
    """
    level, words = OK, 'the network alone'
    if frame.guided:
        words = f'guided by the scene memory: {frame.guide.found if frame.guide else "unknown"}'
    elif frame.ambiguous:
        words = 'the network alone: several places of the scene look like this'
    if (frame.out_of_scene or 0) > WatchThresholds().unlike_above:
        level, words = WARN, 'the image is unlike the trained scene'
    return diagnostics_message(make, header, f'{name}: frame', level, words,
                               status_lines(frame, age_ms))


def diagnostics_message(make: Make, header: Any, name: str, level: int, words: str,
                        lines: Mapping[str, str], hardware_id: str = '') -> Any:
    """Return a DiagnosticArray of one status."""
    return make(STATUS, header=header, status=[make(
        'diagnostic_msgs/msg/DiagnosticStatus', level=level, name=name, message=words,
        hardware_id=hardware_id, values=[
            make('diagnostic_msgs/msg/KeyValue', key=key, value=value)
            for key, value in lines.items()])])
