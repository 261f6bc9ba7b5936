"""The scene memory: what a robot keeps of a scene to see it again from other poses."""
from collections.abc import Iterable, Iterator, Mapping, Sequence
from dataclasses import dataclass
from functools import cached_property, partial
import hashlib
import io
import logging
import math
from pathlib import Path
from typing import Any
from zipfile import ZIP_STORED, ZipFile

import cv2
from neo_ros.errors import ImageRejected, ModelError
from neo_ros.geometry import Band
from neo_ros.geometry.camera_pose import check_transform
from neo_ros.machine.files import whole_file
from neo_ros.machine.regular_file import MAX_BYTES, read_model_bytes
from neo_ros.memory.changes import Changes
from neo_ros.memory.decoded import DecodedKeyframes
from neo_ros.memory.keyframe import (
    compress, decode_image, depth_of, FINER, Keyframe, REDUCED)
from neo_ros.memory.landmarks import Landmarks, MOST_LANDMARKS
from neo_ros.pictures.header import compressed_image_size, PNG_START
import numpy as np

logger = logging.getLogger(__name__)
SCHEMA = 1
LARGE_BYTES = 50 << 20
# What a file may ask for, pixels: far above what a camera of 4000x3000 pixels would need.
MOST_TEXTURE, MOST_MESH, MOST_GLANCES = 1 << 29, 1 << 20, 1 << 26
# A size in the file that may be any but 0.
ANY = -1


@dataclass(frozen=True, eq=False)
class Glances:
    """
    Small pictures of the scene, to find out where a camera is.

    pictures uint8 grey (M, h, w) of the model's source view from T_world_cam (M, 4, 4).
    """

    pictures: np.ndarray
    T_world_cam: np.ndarray


class SceneMemory:
    """
    Keyframes of one scene on a sparse grid, compressed; decoded when they are needed.

    positions (K, 3) world metres; band, the part of the sphere that all of them show; glances;
    landmarks, or None where the photos have none.
    """

    def __init__(self, positions: np.ndarray, band: Band, textures: Sequence[bytes],
                 depths: Sequence[bytes], glances: Glances,
                 landmarks: Landmarks | None = None) -> None:
        self.positions, self.band = positions, band
        self.glances, self.landmarks = glances, landmarks
        self._textures, self._depths = textures, depths
        self.changes: Changes | None = None
        self.version = 0  # Counts the changes: who keeps keyframes looks at it.
        self._decoded = {reduced: DecodedKeyframes() for reduced in REDUCED}
        self._shapes: dict[int, tuple[tuple[int, ...], ...]] = {}

    def keyframe(self, index: int, focal: float = math.inf) -> Keyframe:
        """
        Return keyframe `index` for a view of this focal length, pixels; it must not be changed.

        For a small view its texture is averaged, to no less than FINER times as fine as the view:
        so it takes little memory, and has no detail that would flicker there.
        """
        reduced = self._reduction(focal)
        return self._decoded[reduced].get(index, lambda: self._decode(index, reduced))

    def decode_ahead(self, indices: Iterable[int], focal: float) -> None:
        """Let another thread decode keyframes that a view of this focal length will show soon."""
        reduced = self._reduction(focal)
        for index in indices:
            self._decoded[reduced].ahead(index, partial(self._decode, index, reduced))

    def change(self, changes: Changes | None) -> None:
        """Show what has changed since the memory was made; only the thread that draws may."""
        self.changes, self.version = changes, self.version + 1
        self._decoded = {reduced: DecodedKeyframes() for reduced in REDUCED}

    def pictures(self, index: int, reduced: int) -> tuple[np.ndarray, np.ndarray]:
        """
        Decode keyframe `index`: texture uint8 RGB, so many times REDUCED, and depth's PNG, uint16.

        Raises ModelError for what is damaged.
        """
        if self.changes is not None:
            return self.changes.put_into(self.positions[index], self.band, reduced,
                                         *self._pictures(index, 1))
        return self._pictures(index, reduced)

    def _pictures(self, index: int, reduced: int) -> tuple[np.ndarray, np.ndarray]:
        texture = decode_image(self._textures[index], REDUCED[reduced])
        coded = decode_image(self._depths[index], cv2.IMREAD_UNCHANGED)
        if texture is None or coded is None or coded.dtype != np.uint16 or coded.ndim != 2:
            raise _damaged(index)
        return cv2.cvtColor(texture, cv2.COLOR_BGR2RGB, texture), coded

    def each(self) -> Iterator[Keyframe]:
        """Yield all keyframes, decoded now and not kept; any thread may do so."""
        for index in range(len(self.positions)):
            yield self._decode(index, 1)

    def _reduction(self, focal: float) -> int:
        if not math.isfinite(focal):
            return 1
        texture, mesh = self.rows
        pixels = texture / (self.band.top - self.band.bottom)
        return max(reduced for reduced in REDUCED if reduced == 1 or (
            texture % (mesh * reduced) == 0 and pixels / reduced >= FINER * focal))

    @cached_property
    def rows(self) -> tuple[int, int]:
        """Rows of a texture and of its mesh, which is stored as a PNG."""
        return (compressed_image_size(self._textures[0], MOST_TEXTURE)[1],
                int.from_bytes(self._depths[0][20:24], 'big'))

    def _decode(self, index: int, reduced: int) -> Keyframe:
        texture, coded = self.pictures(index, reduced)
        if not _is_finer(texture.shape, coded.shape):
            raise _damaged(index)
        # The compiled loops trust that all are of the same size.
        shapes = (texture.shape, coded.shape)
        expected = self._shapes.setdefault(reduced, shapes)
        if shapes != expected:
            raise ModelError(
                f'scene memory: keyframe {index}: expected texture and depth of the shapes '
                f'{expected} as the others, got {shapes}; export it again')
        return Keyframe(self.positions[index], depth_of(coded), texture)

    @classmethod
    def from_keyframes(cls, keyframes: Sequence[Keyframe], band: Band,
                       glances: Glances) -> 'SceneMemory':
        """Compress keyframes of one band and size."""
        textures, depths = zip(*map(compress, keyframes))
        return cls(np.stack([keyframe.position for keyframe in keyframes]), band, textures,
                   depths, glances)

    def replaced(self, keyframes: Mapping[int, Keyframe], landmarks: Landmarks | None
                 ) -> 'SceneMemory':
        """Return the memory with other keyframes at these places, and other landmarks."""
        textures, depths = list(self._textures), list(self._depths)
        for index, keyframe in keyframes.items():
            textures[index], depths[index] = compress(keyframe)
        return SceneMemory(self.positions, self.band, textures, depths, self.glances, landmarks)

    def write(self, path: Path) -> str:
        """Write the memory; returns the file's SHA-256, for the model's card."""
        content = io.BytesIO()
        band = self.band
        landmarks: dict[str, Any] = {}
        if self.landmarks is not None:
            landmarks = {'landmarks': self.landmarks.points,
                         'landmark_descriptors': self.landmarks.descriptors}
        np.savez(
            content, schema=SCHEMA, positions=self.positions,
            band=np.array([band.top, band.bottom, band.low, band.width], np.float64),
            textures=np.frombuffer(b''.join(self._textures), np.uint8),
            depths=np.frombuffer(b''.join(self._depths), np.uint8),
            texture_sizes=[len(item) for item in self._textures],
            depth_sizes=[len(item) for item in self._depths],
            glances=self.glances.pictures, glance_poses=self.glances.T_world_cam, **landmarks)
        data = content.getbuffer()
        if len(data) > MAX_BYTES:
            raise ModelError(
                f'{path}: expected a scene memory of at most {MAX_BYTES >> 20} MB, got '
                f'{len(data) >> 20} MB; set memory.distance to more')
        if len(data) > LARGE_BYTES:
            logger.warning('%s: the scene memory has %d MB, a room should not need more than %d; '
                           'a larger memory.distance makes it smaller', path, len(data) >> 20,
                           LARGE_BYTES >> 20)
        try:
            with whole_file(path) as partial:
                partial.write_bytes(data)
        except OSError as error:
            raise ModelError(f'{path}: cannot write the scene memory: {error.strerror}') from error
        return hashlib.sha256(data).hexdigest()

    @classmethod
    def read(cls, path: Path, sha256: str) -> 'SceneMemory':
        """
        Read what `write` wrote, and only that.

        Raises ModelError as `read_model_bytes` does, when it is not the file that `sha256` tells
        of, and when this version cannot read it.
        """
        try:
            content = read_model_bytes(path, 'scene memory')
        except ModelError as error:
            raise ModelError(f'{error}; copy it again and keep it beside the model file') from None
        found = hashlib.sha256(content).hexdigest()
        if found != sha256:
            raise ModelError(f'{path}: expected the scene memory with sha256 {sha256}, as the '
                             f'model card says, got {found}; copy model and memory together')
        try:
            with _archive(content) as data:
                schema = int(_field(data, 'schema', np.int64, ()))
                if schema == SCHEMA:
                    return cls._from_fields(data)
        except Exception as error:  # zipfile and numpy raise a dozen types.
            raise ModelError(f'{path}: expected a scene memory: {error}; export it again'
                             ) from error
        raise ModelError(f'{path}: expected a scene memory of schema {SCHEMA}, got {schema}; '
                         'update neo_ros')

    @classmethod
    def _from_fields(cls, data: Mapping[str, np.ndarray]) -> 'SceneMemory':
        """Check everything that the compiled loops trust; raises ValueError."""
        positions = _field(data, 'positions', np.float64, (ANY, 3))
        top, bottom, low, width = _field(data, 'band', np.float64, (4,)).tolist()
        if not (-math.pi / 2 <= bottom < top <= math.pi / 2 and 0 < width <= 2 * math.pi):
            raise ValueError('band: expected a part of the sphere, got elevations '
                             f'{bottom} to {top} and a width of {width}')
        textures, depths = (_split(
            name, _field(data, f'{name}s', np.uint8, (ANY,)),
            _field(data, f'{name}_sizes', np.int64, (len(positions),)))
            for name in ('texture', 'depth'))
        _check_pictures(textures, depths)
        pictures = _field(data, 'glances', np.uint8, (ANY, ANY, ANY))
        poses = _field(data, 'glance_poses', np.float64, (len(pictures), 4, 4))
        if pictures.size > MOST_GLANCES:
            raise ValueError(f'glances: expected at most {MOST_GLANCES} pixels, got '
                             f'{pictures.size}')
        for pose in poses:
            check_transform(pose, 'glance_poses')
        landmarks = None
        if 'landmarks' in data:
            points = _field(data, 'landmarks', np.float32, (ANY, 3))
            if len(points) > MOST_LANDMARKS:
                raise ValueError(
                    f'landmarks: expected at most {MOST_LANDMARKS}, got {len(points)}')
            landmarks = Landmarks(points, _field(
                data, 'landmark_descriptors', np.uint8, (len(points), 128)))
        return cls(positions, Band(top, bottom, low, width), textures, depths,
                   Glances(pictures, poses), landmarks)


def _check_pictures(textures: Sequence[bytes], depths: Sequence[bytes]) -> None:
    """Raise ValueError where what would be decoded is of another kind, or far too large."""
    # Where a PNG has its width, height, and bits of one grey channel.
    sizes = {coded[16:26] for coded in depths}
    if len(sizes) > 1:
        raise ValueError('depths: expected keyframes of one size, got several')
    header = sizes.pop()
    columns, rows = (int.from_bytes(header[at:at + 4], 'big') for at in (0, 4))
    if any(not coded.startswith(PNG_START) for coded in depths) or header[8:] != b'\x10\0' \
            or not 0 < columns * rows <= MOST_MESH:
        raise ValueError(f'depths: expected grey 16-bit PNG of at most {MOST_MESH} pixels')
    for coded in textures:
        try:
            compressed_image_size(coded, MOST_TEXTURE)
        except ImageRejected as rejection:
            raise ValueError(f'textures: {rejection}') from None


def _archive(content: bytes) -> Any:
    """Open what `np.savez` wrote; what is packed could unpack to more than fits in memory."""
    with ZipFile(io.BytesIO(content)) as archive:
        if any(item.compress_type != ZIP_STORED for item in archive.infolist()):
            raise ValueError('its arrays are packed')
    return np.load(io.BytesIO(content), allow_pickle=False)


def _field(data: Mapping[str, np.ndarray], name: str, dtype: type, shape: tuple[int, ...]
           ) -> np.ndarray:
    """Return an array of finite numbers of this dtype and shape; ANY: of one or more."""
    found = data[name]
    if found.dtype != dtype or found.ndim != len(shape) or not all(
            size == wanted or (wanted == ANY and size > 0)
            for size, wanted in zip(found.shape, shape)):
        raise ValueError(f'{name}: expected {np.dtype(dtype)} {shape}, got {found.dtype} '
                         f'{found.shape}'.replace(str(ANY), 'any'))
    if found.dtype.kind == 'f' and not np.isfinite(found).all():
        raise ValueError(f'{name}: expected finite numbers')
    return found


def _damaged(index: int) -> ModelError:
    return ModelError(f'scene memory: keyframe {index} is damaged; export it again')


def _is_finer(texture: tuple[int, ...], depth: tuple[int, ...]) -> bool:
    """Tell whether a texture is a whole number of times as large as its depth, a mesh."""
    rows, columns = depth
    times = texture[0] // rows
    return min(depth) > 1 and times > 0 and texture[:2] == (times * rows, times * columns)


def _split(name: str, content: np.ndarray, sizes: np.ndarray) -> list[bytes]:
    """Cut bytes into pieces of these sizes; raises ValueError if they do not add up."""
    if sizes.min() < 1 or sizes.max() > len(content) or sizes.sum() != len(content):
        raise ValueError(f'{name}_sizes: expected sizes that add up to {len(content)} bytes')
    ends = np.cumsum(sizes)
    return [content[end - size:end].tobytes() for end, size in zip(ends, sizes)]
