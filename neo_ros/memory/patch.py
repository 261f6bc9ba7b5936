"""What one image of the camera showed of a change: its colours, and how far away they are."""
from dataclasses import dataclass
from functools import cached_property
import struct
from typing import NamedTuple

import cv2
from neo_ros.errors import ImageRejected, ModelError, NeoError
from neo_ros.geometry import CameraPose, Intrinsics
from neo_ros.memory.keyframe import code_of, decode_image, depth_of, encode_image, JPEG_QUALITY
from neo_ros.pictures.header import compressed_image_size, PNG_START
import numpy as np

# Stamp, batch, pose, size and camera, sizes of the two pictures, and of what was before.
_HEAD = struct.Struct('<qI12d2H4d3I')
MOST_PIXELS = 1 << 17
MOST_METRES = 1e6
# Focal lengths and how far off the middle is, pixels: the compiled loops trust them.
LEAST_FOCAL, MOST_FOCAL, MOST_OFF = 0.1, 1e5, 1e5
MOST_BATCHES = 1 << 31
# A patch has so many parts at most: their numbers stand above the bits of its depths.
PARTS, DEPTH_BITS = 16, 12
# What was before is kept of every so many-th pixel, along both sides: depth and colour, 5 bytes.
EVERY, SAMPLE_BYTES = 3, 5


class Pictures(NamedTuple):
    """
    What a patch shows: image uint8 RGB (h, w, 3), depth float32 (h, w), 0 = not changed.

    parts uint8 (h, w): the number of the part that a pixel belongs to, below PARTS.
    """

    image: np.ndarray
    depth: np.ndarray
    parts: np.ndarray


class Samples(NamedTuple):
    """
    Some pixels of a patch twice: what it saw (0), and what the memory showed before (1).

    parts uint8 (N,); points float32 (N, 2, 3), world metres; colours float32 (N, 2, 3), grey
    levels; depths float32 (N, 2), metres from the patch's camera, 0 = nothing was known.
    """

    parts: np.ndarray
    points: np.ndarray
    colours: np.ndarray
    depths: np.ndarray

    @property
    def nearer(self) -> np.ndarray:
        """The points (N, 3) of the thing that came, or left: whichever is nearer."""
        left = (self.depths[:, 1] > 0) & (self.depths[:, 1] < self.depths[:, 0])
        return self.points[np.arange(len(left)), left.astype(int)]


@dataclass(frozen=True, eq=False)
class Patch:
    """
    A part of an image that contradicted the memory, in the memory's exposure.

    camera: of this part, pixels; its pictures are compressed: `texture` a JPEG, RGB, `depths` a
    PNG as a keyframe's, along the optical axis, 0 = not changed, and parts. before: what the
    memory showed at its samples, depths and colours. batch: patches of one number were seen in
    one go, and add to each other; later ones replace earlier ones.
    """

    pose: CameraPose
    camera: Intrinsics
    texture: bytes
    depths: bytes
    before: bytes
    stamp_ns: int
    batch: int

    @classmethod
    def of(cls, pose: CameraPose, camera: Intrinsics, image: np.ndarray, depth: np.ndarray,
           stamp_ns: int, batch: int, before: tuple[np.ndarray, np.ndarray] | None = None,
           parts: np.ndarray | None = None) -> 'Patch':
        """
        Compress image uint8 RGB (h, w, 3) and depth float32 (h, w), metres, 0 = not changed.

        before: image and depth, alike, of what the memory showed there; parts: as Pictures'.
        """
        # Its pixels are as coarse as a view's: none can do without its own colour.
        quality = [cv2.IMWRITE_JPEG_QUALITY, JPEG_QUALITY,
                   cv2.IMWRITE_JPEG_SAMPLING_FACTOR, cv2.IMWRITE_JPEG_SAMPLING_FACTOR_444]
        coded = code_of(depth)
        where = _sampled(coded)
        image_before, depth_before = before or (np.zeros_like(image), np.zeros_like(depth))
        kept = code_of(depth_before)[where].astype('<u2').tobytes() + image_before[where].tobytes()
        if parts is not None:
            coded |= np.where(coded > 0, parts.astype(np.uint16) << DEPTH_BITS, np.uint16(0))
        return cls(pose, camera, encode_image('.jpg', image[..., ::-1], quality),
                   encode_image('.png', coded, []), kept, stamp_ns, batch)

    @cached_property
    def pictures(self) -> Pictures:
        """What it shows; ModelError where it is damaged, or does not fit what was before."""
        image = decode_image(self.texture, cv2.IMREAD_COLOR)
        coded = decode_image(self.depths, cv2.IMREAD_UNCHANGED)
        size = (self.camera.height, self.camera.width)
        if image is None or coded is None or coded.dtype != np.uint16 or not (
                image.shape[:2] == coded.shape == size):
            raise ModelError('journal: the pictures of a change are damaged')
        depth = coded & ((1 << DEPTH_BITS) - 1)
        if SAMPLE_BYTES * len(_sampled(depth)[0]) != len(self.before):
            raise ModelError('journal: what was before a change does not fit it')
        return Pictures(cv2.cvtColor(image, cv2.COLOR_BGR2RGB), depth_of(depth),
                        (coded >> DEPTH_BITS).astype(np.uint8))

    @cached_property
    def samples(self) -> Samples:
        """Some of its pixels, and what was before."""
        image, depth, parts = self.pictures
        where, camera = _sampled(depth), self.camera
        count = len(where[0])
        depths = np.stack([depth[where], depth_of(np.frombuffer(self.before, '<u2', count))], -1)
        rays = np.stack([(where[1] + 0.5 - camera.cx) / camera.fx,
                         (where[0] + 0.5 - camera.cy) / camera.fy, np.ones(count)], -1)
        T = self.pose.T_world_cam
        points = (rays[:, None] * depths[..., None]) @ T[:3, :3].T + T[:3, 3]
        before = np.frombuffer(self.before, np.uint8, offset=2 * count).reshape(count, 3)
        return Samples(parts[where], points.astype(np.float32), np.stack(
            [image[where], before], 1).astype(np.float32), depths)

    def to_bytes(self) -> bytes:
        """Return what `from_bytes` reads."""
        camera = self.camera
        return _HEAD.pack(
            self.stamp_ns, self.batch, *self.pose.T_world_cam[:3].ravel(), camera.width,
            camera.height, camera.fx, camera.fy, camera.cx, camera.cy, len(self.texture),
            len(self.depths), len(self.before)) + self.texture + self.depths + self.before

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
        texture, depths, before = values[18:]
        if len(content) != _HEAD.size + texture + depths + before:
            raise ValueError('record: its pictures do not fill it')
        start, middle, end = np.cumsum([_HEAD.size, texture, depths]).tolist()
        patch = cls(pose, camera, content[start:middle], content[middle:end], content[end:],
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


def _sampled(depth: np.ndarray) -> tuple[np.ndarray, np.ndarray]:
    """Return rows and columns of the samples of depths (h, w), 0 = not changed."""
    rows, columns = np.nonzero(depth[::EVERY, ::EVERY])
    return EVERY * rows, EVERY * columns


BROKEN = (ValueError, ImageRejected, NeoError, struct.error)
