"""What a memory file may hold: the compiled loops trust it, and a robot has to keep it."""
from collections.abc import Sequence

from neo_ros.errors import ImageRejected
from neo_ros.geometry.camera_pose import check_transform
from neo_ros.memory.landmarks import MOST_LANDMARKS
from neo_ros.memory.memory_file import ANY, MemoryFields
from neo_ros.memory.twins import NO_TWINS, Twins
from neo_ros.pictures.header import compressed_image_size, PNG_START
import numpy as np

# What a file may ask for, pixels: far above what a camera of 4000x3000 pixels would need.
MOST_TEXTURE, MOST_MESH, MOST_GLANCES = 1 << 29, 1 << 20, 1 << 26


def read_twins(fields: MemoryFields) -> Twins:
    """Return the places that look alike, NO_TWINS of older memories; raises ValueError."""
    if 'twins' not in fields:
        return NO_TWINS
    ways = fields.read('twins', np.float64, (ANY, 4, 4))
    poses = fields.read('twin_poses', np.float64, (len(ways), 4, 4))
    for name, transforms in (('twins', ways), ('twin_poses', poses)):
        for T in transforms:
            check_transform(T, name)
    return Twins(ways, fields.read('twin_areas', np.float64, (len(ways), 2, 3)), poses)


def check_kept(pixels: int, landmarks: int = 0) -> None:
    """Raise ValueError where a robot would have to keep too much beside the keyframes."""
    if pixels > MOST_GLANCES:
        raise ValueError(f'glances: expected at most {MOST_GLANCES} pixels, got {pixels}; set '
                         'memory.distance to more')
    if landmarks > MOST_LANDMARKS:
        raise ValueError(f'landmarks: expected at most {MOST_LANDMARKS}, got {landmarks}; train '
                         'a model for each part of the scene')


def check_pictures(textures: Sequence[bytes], depths: Sequence[bytes]) -> None:
    """Raise ValueError where what would be decoded is of another kind, or far too large."""
    # Where a PNG has its width, height, and bits of one grey channel.
    sizes, kinds = set[bytes](), set[bytes]()
    for coded in depths:
        sizes.add(coded[16:26])
        kinds.add(coded[:len(PNG_START)])
    if len(sizes) > 1:
        raise ValueError('depths: expected keyframes of one size, got several')
    header = sizes.pop()
    columns, rows = (int.from_bytes(header[at:at + 4], 'big') for at in (0, 4))
    if kinds != {PNG_START} or header[8:] != b'\x10\0' \
            or not 0 < columns * rows <= MOST_MESH:
        raise ValueError(f'depths: expected grey 16-bit PNG of at most {MOST_MESH} pixels')
    for coded in textures:
        try:
            compressed_image_size(coded, MOST_TEXTURE)
        except ImageRejected as rejection:
            raise ValueError(f'textures: {rejection}') from None
