"""What one image of the camera showed of a change: its colours, and how far away they are."""
from dataclasses import dataclass
from functools import cached_property
import struct

import cv2
from neo_ros.errors import ImageRejected, ModelError, NeoError
from neo_ros.geometry import CameraPose, Intrinsics
from neo_ros.memory.keyframe import code_of, decode_image, depth_of, encode_image, JPEG_QUALITY
from neo_ros.pictures.header import compressed_image_size, PNG_START
import numpy as np

# Stamp, batch, pose, size and camera, sizes of the two pictures.
_HEAD = struct.Struct('<qI12d2H4d2I')
MOST_PIXELS = 1 << 17
MOST_METRES = 1e6
# Focal lengths and how far off the middle is, pixels: the compiled loops trust them.
LEAST_FOCAL, MOST_FOCAL, MOST_OFF = 0.1, 1e5, 1e5
MOST_BATCHES = 1 << 31


@dataclass(frozen=True, eq=False)
class Patch:
    """
    A part of an image that contradicted the memory, in the memory's exposure.

    camera: of this part, pixels; its pictures are compressed: `texture` a JPEG, RGB, `depths` a
    PNG as a keyframe's, along the optical axis, 0 = not changed. batch: patches of one number
    were seen in one go, and add to each other; later ones replace earlier ones.
    """

    pose: CameraPose
    camera: Intrinsics
    texture: bytes
    depths: bytes
    stamp_ns: int
    batch: int

    @classmethod
    def of(cls, pose: CameraPose, camera: Intrinsics, image: np.ndarray, depth: np.ndarray,
           stamp_ns: int, batch: int) -> 'Patch':
        """Compress image uint8 RGB (h, w, 3) and depth float32 (h, w), metres, 0 = not changed."""
        # Its pixels are as coarse as a view's: none can do without its own colour.
        quality = [cv2.IMWRITE_JPEG_QUALITY, JPEG_QUALITY,
                   cv2.IMWRITE_JPEG_SAMPLING_FACTOR, cv2.IMWRITE_JPEG_SAMPLING_FACTOR_444]
        return cls(pose, camera, encode_image('.jpg', image[..., ::-1], quality),
                   encode_image('.png', code_of(depth), []), stamp_ns, batch)

    @cached_property
    def pictures(self) -> tuple[np.ndarray, np.ndarray]:
        """Its image uint8 RGB (h, w, 3), and depth float32 (h, w); ModelError where damaged."""
        image = decode_image(self.texture, cv2.IMREAD_COLOR)
        coded = decode_image(self.depths, cv2.IMREAD_UNCHANGED)
        size = (self.camera.height, self.camera.width)
        if image is None or coded is None or coded.dtype != np.uint16 or not (
                image.shape[:2] == coded.shape == size):
            raise ModelError('journal: the pictures of a change are damaged')
        return cv2.cvtColor(image, cv2.COLOR_BGR2RGB), depth_of(coded)

    def to_bytes(self) -> bytes:
        """Return what `from_bytes` reads."""
        camera = self.camera
        return _HEAD.pack(
            self.stamp_ns, self.batch, *self.pose.T_world_cam[:3].ravel(), camera.width,
            camera.height, camera.fx, camera.fy, camera.cx, camera.cy, len(self.texture),
            len(self.depths)) + self.texture + self.depths

    @classmethod
    def from_bytes(cls, content: bytes) -> 'Patch':
        """Check all that is trusted later; raises ValueError, ImageRejected or NeoError."""
        if len(content) < _HEAD.size:
            raise ValueError('record: too short')
        stamp_ns, batch, *values = _HEAD.unpack_from(content)
        if not all(abs(value) <= MOST_METRES for value in values[:12]):
            raise ValueError('record: its pose is out of range')
        pose = CameraPose(np.array(values[:12]).reshape(3, 4))
        camera = Intrinsics(*values[12:18])
        texture, depths = values[18:]
        if len(content) != _HEAD.size + texture + depths:
            raise ValueError('record: its pictures do not fill it')
        start = _HEAD.size
        patch = cls(pose, camera, content[start:start + texture], content[start + texture:],
                    stamp_ns, batch)
        if camera.width * camera.height > MOST_PIXELS:
            raise ValueError('record: its size is out of range')
        if not (LEAST_FOCAL <= min(camera.fx, camera.fy) and max(camera.fx, camera.fy)
                <= MOST_FOCAL and max(abs(camera.cx), abs(camera.cy)) <= MOST_OFF):
            raise ValueError('record: its camera is out of range')
        if batch >= MOST_BATCHES:  # Later ones count on from it.
            raise ValueError('record: its batch is out of range')
        if compressed_image_size(patch.texture, MOST_PIXELS) != (camera.width, camera.height):
            raise ValueError('record: its image has another size')
        # Where a PNG has its width and height, and bits of one grey channel.
        expected = struct.pack('>2I2B', camera.width, camera.height, 16, 0)
        if not patch.depths.startswith(PNG_START) or patch.depths[16:26] != expected:
            raise ValueError('record: its depths are no grey 16-bit PNG of its size')
        return patch


BROKEN = (ValueError, ImageRejected, NeoError, struct.error)
