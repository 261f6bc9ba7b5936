"""What the node offers to a ROS graph: its topics and services, for the code and for the docs."""
from typing import NamedTuple

from diagnostic_msgs.msg import DiagnosticArray
from geometry_msgs.msg import PoseWithCovarianceStamped
from nav_msgs.msg import OccupancyGrid, Odometry
from sensor_msgs.msg import CameraInfo, CompressedImage, Image, PointCloud2
from std_srvs.srv import SetBool, Trigger

NODE_NAME = 'fov_extrapolator'


class Endpoint(NamedTuple):
    """A topic or a service: its name, its type, and what it is for."""

    name: str
    kind: type
    words: str


IMAGE = Endpoint(
    'image', Image, 'the camera, with `image_transport` raw, in any of the encodings of '
    '[camera images](captures.md#camera-images)')
COMPRESSED_IMAGE = Endpoint(
    'image/compressed', CompressedImage,
    'the camera, with `image_transport` compressed: JPEG, PNG, WebP or TIFF; follows a remapped '
    '`image`')
CAMERA_INFO = Endpoint(
    'camera_info', CameraInfo, 'its calibration, latched or not; lies beside a remapped `image`. '
    'Without one the image must have the size that the model takes')
PRIOR = Endpoint(
    '~/prior', PoseWithCovarianceStamped,
    "optional: where the robot is, within metres, as RViz's initialpose; in `scene_frame`, x "
    'forward; of `base_frame`, or without one of the camera, whose height does not count. Is '
    'dropped where the image does not agree')
ODOMETRY = Endpoint(
    'odom', Odometry, 'optional: predicts the motion between images; of the frame of the images, '
    'or of `base_frame`')
INPUTS = (IMAGE, COMPRESSED_IMAGE, CAMERA_INFO, PRIOR, ODOMETRY)

OUTPUTS = {
    'image': Endpoint('wide/image', Image, 'rgb8, the widened image'),
    'compressed': Endpoint('wide/image/compressed', CompressedImage,
                           'the same as JPEG, for thin links'),
    'mask': Endpoint('wide/mask', Image,
                     'mono8, 255 = made up by the model, 0 = seen by the camera'),
    'confidence': Endpoint('wide/confidence', Image,
                           'mono8, 255 = sure; lower where the image is unlike the scene'),
    'camera_info': Endpoint(
        'wide/camera_info', CameraInfo, 'the same focal length, a larger image; cx, cy moved by '
        'the growth at the left and the top; no distortion, binning or ROI'),
    'pose': Endpoint(
        'wide/pose', PoseWithCovarianceStamped, "the camera's optical frame in `scene_frame`; "
        'silent while the network works alone'),
    'base_pose': Endpoint('wide/base_pose', PoseWithCovarianceStamped,
                          'the same of `base_frame`, where that is set'),
    'depth': Endpoint(
        'wide/depth', Image, '32FC1, metres along the optical axis, as remembered; NaN = unknown, '
        'not sure, or contradicted by the last images'),
    'points': Endpoint('wide/points', PointCloud2,
                       'the same as points: x, y, z, rgb, confidence (255 = sure)'),
    'panorama': Endpoint(
        'wide/panorama', Image, 'rgb8, equirectangular: the whole sphere around the camera in '
        "`scene_frame`'s axes, +x in the middle; the live image in its place"),
    'panorama_mask': Endpoint('wide/panorama_mask', Image,
                              'mono8, 255 = seen now, 128 = remembered, 0 = unknown'),
    'status': Endpoint(
        'wide/status', DiagnosticArray, 'what is true of this image: guided, how it was found, '
        'agreement, landmarks, out of the scene, milliseconds, age'),
}
MAP = Endpoint(
    'wide/map', OccupancyGrid, 'latched: the scene from above, out of the memory, in '
    '`scene_frame`; 0 = floor, 100 = something stands there, -1 = unknown')
DIAGNOSTICS = Endpoint(
    '/diagnostics', DiagnosticArray, '1 Hz: state, rates, latency by stage, drops, rejects by '
    'reason, model, how unlike the trained scene the images are')

ENABLE = Endpoint('~/enable', SetBool, 'stop and resume the taking of frames')
RELOAD_MODEL = Endpoint(
    '~/reload_model', Trigger, 'load the file of the parameter `model` again, after it was '
    'replaced; the old one stays until the new one has passed its checks')
RELOCALIZE = Endpoint(
    '~/relocalize', Trigger, 'forget where the camera is; the next image is searched for in the '
    'whole scene')
SERVICES = (ENABLE, RELOAD_MODEL, RELOCALIZE)
