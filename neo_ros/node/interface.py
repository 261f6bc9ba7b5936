"""What the node offers to a ROS graph: its topics and services, for the code and for the docs."""
from typing import NamedTuple

from diagnostic_msgs.msg import DiagnosticArray
from sensor_msgs.msg import CameraInfo, CompressedImage, Image
from std_srvs.srv import SetBool, Trigger


class Endpoint(NamedTuple):
    """A topic or a service: its name, its type, and what it is for."""

    name: str
    kind: type
    words: str


IMAGE = Endpoint(
    'image', Image, 'the camera, with `transport` raw, in any of the encodings of '
    '[camera images](../guides/captures.md#camera-images)')
COMPRESSED_IMAGE = Endpoint(
    'image/compressed', CompressedImage,
    'the camera, with `transport` compressed: JPEG, PNG, WebP or TIFF')
CAMERA_INFO = Endpoint(
    'camera_info', CameraInfo, 'its calibration; without one the image must have the size that '
    'the model takes')
INPUTS = (IMAGE, COMPRESSED_IMAGE, CAMERA_INFO)

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
}
DIAGNOSTICS = Endpoint(
    '/diagnostics', DiagnosticArray, '1 Hz: state, rates, latency by stage, drops, rejects by '
    'reason, model, how unlike the trained scene the images are')

ENABLE = Endpoint('~/enable', SetBool, 'stop and resume the taking of frames')
RELOAD_MODEL = Endpoint(
    '~/reload_model', Trigger, 'load the file of the parameter `model` again, after it was '
    'replaced; the old one stays until the new one has passed its checks')
SERVICES = (ENABLE, RELOAD_MODEL)
