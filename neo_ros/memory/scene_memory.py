"""The scene memory: what a robot keeps of a scene to see it again from other poses."""
from collections.abc import Iterable, Iterator, Mapping, Sequence
from dataclasses import dataclass
from functools import cached_property, partial
import hashlib
import logging
import math
from pathlib import Path
from typing import Any

import cv2
from neo_ros.errors import ModelError
from neo_ros.geometry import Band
from neo_ros.geometry.camera_pose import check_transform
from neo_ros.machine.files import whole_file
from neo_ros.memory.changes import Changes
from neo_ros.memory.decoded import DecodedKeyframes, Key
from neo_ros.memory.keyframe import (
    compress, decode_image, depth_of, FINER, Keyframe, on_own_pages, Packed, REDUCED)
from neo_ros.memory.landmarks import Landmarks
from neo_ros.memory.memory_checks import (
    check_kept, check_pictures, MOST_TEXTURE, read_twins)
from neo_ros.memory.memory_file import ANY, MemoryFields, MOST_BYTES, open_memory_file
from neo_ros.memory.patch import MOST_METRES
from neo_ros.memory.twins import NO_TWINS, Twins
from neo_ros.pictures.header import compressed_image_size
import numpy as np

logger = logging.getLogger(__name__)
SCHEMA = 1
LARGE_BYTES = 64 << 20
# Of small keyframes so many bytes are kept decoded. A search looks at places all over a building:
# 58 KB each, those of 2,000 square metres are all kept.
SMALL_BYTES = 128 << 20


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
    landmarks, or None where the photos have none; twins, its places that look alike.
    """

    def __init__(self, positions: np.ndarray, band: Band, textures: Sequence[bytes],
                 depths: Sequence[bytes], glances: Glances,
                 landmarks: Landmarks | None = None, twins: Twins = NO_TWINS) -> None:
        self.positions, self.band = positions, band
        self.glances, self.landmarks, self.twins = glances, landmarks, twins
        self._textures, self._depths = textures, depths
        self.changes: Changes | None = None
        self.version = 0  # Counts the changes: a view that was drawn before one is told by it.
        self._forget_decoded()
        self._shapes: dict[int, tuple[tuple[int, ...], ...]] = {}

    def keyframe(self, index: int, focal: float = math.inf) -> Keyframe:
        """
        Return keyframe `index` for a view of this focal length, pixels; it must not be changed.

        For a small view its texture is averaged, to no less than FINER times as fine as the view:
        so it takes little memory, and has no detail that would flicker there.
        """
        reduced = self._reduction(focal)
        return self._decoded.get(
            (reduced, index), lambda: self._decode(index, reduced, self.changes))

    def decode_ahead(self, indices: Iterable[int], focal: float) -> None:
        """Let another thread decode keyframes that a view of this focal length will show soon."""
        reduced = self._reduction(focal)
        for index in indices:
            self._decoded.ahead(
                (reduced, index), partial(self._decode, index, reduced, self.changes))

    def change(self, changes: Changes | None, drawn: Mapping[Key, Keyframe] = {}) -> None:
        """
        Show what has changed since the memory was made; only the thread that draws may.

        drawn: keyframes of `drawn_with`, for these changes.
        """
        self.changes, self.version = changes, self.version + 1
        self._forget_decoded()
        for key, keyframe in drawn.items():
            self._decoded.put(key, keyframe)

    def _forget_decoded(self) -> None:
        self.small_keyframes = DecodedKeyframes(SMALL_BYTES)  # Those of a `CoarseMemory`.
        self._decoded = DecodedKeyframes(beside=self.small_keyframes)

    def drawn_with(self, changes: Changes) -> dict[Key, Keyframe]:
        """Decode what is drawn now as it will be with these changes; any thread may do so."""
        return {(reduced, index): self._decode(index, reduced, changes)
                for reduced, index in self._decoded.last_used}

    def pictures(self, index: int, reduced: int) -> tuple[np.ndarray, np.ndarray]:
        """
        Decode keyframe `index`: texture uint8 RGB, so many times REDUCED, and depth's PNG, uint16.

        Raises ModelError for what is damaged.
        """
        return self._pictures(index, reduced, self.changes)

    def _pictures(self, index: int, reduced: int, changes: Changes | None
                  ) -> tuple[np.ndarray, np.ndarray]:
        coded = decode_image(self._depths[index], cv2.IMREAD_UNCHANGED)
        if coded is None or coded.dtype != np.uint16 or coded.ndim != 2:
            raise _damaged(index)
        position = self.positions[index]
        # Most keyframes of a large floor show nothing of a change: they are as they were made.
        if changes is not None and not changes.reaches(position, self.band, coded):
            changes = None
        texture = decode_image(self._textures[index], REDUCED[
            reduced if changes is None else 1])
        if texture is None:
            raise _damaged(index)
        cv2.cvtColor(texture, cv2.COLOR_BGR2RGB, texture)
        if changes is None:
            return texture, coded
        return changes.put_into(position, self.band, reduced, texture, coded)

    def each(self, focal: float = math.inf, changed: bool = True) -> Iterator[Keyframe]:
        """
        Yield all keyframes as `keyframe` does, but do not keep them; any thread may do so.

        changed: as they are shown now; else as they were made, which is fast.
        """
        reduced = self._reduction(focal)
        for index in range(len(self.positions)):
            yield self._decode(index, reduced, self.changes if changed else None)

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

    def _decode(self, index: int, reduced: int, changes: Changes | None) -> Keyframe:
        texture, coded = self._pictures(index, reduced, changes)
        if not _is_finer(texture.shape, coded.shape):
            raise _damaged(index)
        # The compiled loops trust that all are of the same size.
        shapes = (texture.shape, coded.shape)
        expected = self._shapes.setdefault(reduced, shapes)
        if shapes != expected:
            raise ModelError(
                f'scene memory: keyframe {index}: expected texture and depth of the shapes '
                f'{expected} as the others, got {shapes}; export it again')
        return Keyframe(
            self.positions[index], on_own_pages(depth_of(coded)), on_own_pages(texture))

    @classmethod
    def from_keyframes(cls, keyframes: Sequence[Keyframe], band: Band,
                       glances: Glances) -> 'SceneMemory':
        """Compress keyframes of one band and size."""
        textures, depths = zip(*map(compress, keyframes))
        return cls(np.stack([keyframe.position for keyframe in keyframes]), band, textures,
                   depths, glances)

    def replaced(self, keyframes: Mapping[int, Packed], landmarks: Landmarks | None
                 ) -> 'SceneMemory':
        """Return the memory with other keyframes at these places, and other landmarks."""
        textures, depths = list(self._textures), list(self._depths)
        for index, packed in keyframes.items():
            textures[index], depths[index] = packed
        return SceneMemory(self.positions, self.band, textures, depths, self.glances, landmarks,
                           self.twins)

    def with_more(self, positions: np.ndarray, keyframes: Sequence[Packed],
                  glances: Sequence[Glances], landmarks: Landmarks | None) -> 'SceneMemory':
        """Return the memory with more keyframes of its size and glances, and other landmarks."""
        every = (self.glances, *glances)
        return SceneMemory(
            np.concatenate([self.positions, positions]), self.band,
            [*self._textures, *(texture for texture, _ in keyframes)],
            [*self._depths, *(depth for _, depth in keyframes)],
            Glances(np.concatenate([part.pictures for part in every]),
                    np.concatenate([part.T_world_cam for part in every])), landmarks, self.twins)

    def write(self, path: Path) -> str:
        """Write the memory, if it can be read; returns its SHA-256, for the model's card."""
        try:
            check_kept(self.glances.pictures.size,
                       0 if self.landmarks is None else len(self.landmarks.points))
        except ValueError as error:
            raise ModelError(f'{path}: {error}') from None
        band = self.band
        more: dict[str, Any] = {}
        if self.landmarks is not None:
            more = {'landmarks': self.landmarks.points,
                    'landmark_descriptors': self.landmarks.descriptors}
        if len(self.twins):
            more |= {'twins': self.twins.T, 'twin_areas': self.twins.areas,
                     'twin_poses': self.twins.T_world_cam}
        try:
            with whole_file(path) as partial:
                with partial.open('wb') as file:
                    np.savez(
                        file, schema=SCHEMA, positions=self.positions,
                        band=np.array([band.top, band.bottom, band.low, band.width], np.float64),
                        textures=np.frombuffer(b''.join(self._textures), np.uint8),
                        depths=np.frombuffer(b''.join(self._depths), np.uint8),
                        texture_sizes=[len(item) for item in self._textures],
                        depth_sizes=[len(item) for item in self._depths],
                        glances=self.glances.pictures, glance_poses=self.glances.T_world_cam,
                        **more)
                size = partial.stat().st_size
                if size > MOST_BYTES:
                    raise ModelError(
                        f'{path}: expected a scene memory of at most {MOST_BYTES >> 20} MB, got '
                        f'{size >> 20} MB; set memory.distance to more')
                with partial.open('rb') as file:
                    sha256 = hashlib.file_digest(file, 'sha256').hexdigest()
        except OSError as error:
            raise ModelError(f'{path}: cannot write the scene memory: {error.strerror}') from error
        if size > LARGE_BYTES:
            logger.warning('%s: the scene memory has %d MB, a room should not need more than %d; '
                           'in a new training a larger memory.distance makes it smaller',
                           path, size >> 20, LARGE_BYTES >> 20)
        return sha256

    @classmethod
    def read(cls, path: Path, sha256: str) -> 'SceneMemory':
        """
        Open what `write` wrote, and only that; its keyframes are read when they are drawn.

        Raises ModelError as `open_memory_file` does, and when this version cannot read it.
        """
        with open_memory_file(path, sha256) as fields:
            schema = int(fields.read('schema', np.int64, ()))
            if schema == SCHEMA:
                return cls._from_fields(fields)
        raise ModelError(f'{path}: expected a scene memory of schema {SCHEMA}, got {schema}; '
                         'update neo_ros')

    @classmethod
    def _from_fields(cls, fields: MemoryFields) -> 'SceneMemory':
        """Check everything that the compiled loops trust; raises ValueError."""
        positions = fields.read('positions', np.float64, (ANY, 3))
        if np.abs(positions).max() > MOST_METRES:
            raise ValueError(f'positions: expected keyframes within {MOST_METRES:g} m of the '
                             f'origin, got one at {np.abs(positions).max():g}')
        top, bottom, low, width = fields.read('band', np.float64, (4,)).tolist()
        if not (-math.pi / 2 <= bottom < top <= math.pi / 2 and 0 < width <= 2 * math.pi):
            raise ValueError('band: expected a part of the sphere, got elevations '
                             f'{bottom} to {top} and a width of {width}')
        textures, depths = (fields.pieces(name, len(positions)) for name in ('texture', 'depth'))
        check_pictures(textures, depths)
        pictures = fields.read('glances', np.uint8, (ANY, ANY, ANY))
        poses = fields.read('glance_poses', np.float64, (len(pictures), 4, 4))
        check_kept(pictures.size)
        for pose in poses:
            check_transform(pose, 'glance_poses')
        landmarks = None
        if 'landmarks' in fields:
            points = fields.read('landmarks', np.float32, (ANY, 3))
            check_kept(pictures.size, len(points))
            landmarks = Landmarks(points, fields.read(
                'landmark_descriptors', np.uint8, (len(points), 128)))
        return cls(positions, Band(top, bottom, low, width), textures, depths,
                   Glances(pictures, poses), landmarks, read_twins(fields))


def _damaged(index: int) -> ModelError:
    return ModelError(f'scene memory: keyframe {index} is damaged; export it again')


def _is_finer(texture: tuple[int, ...], depth: tuple[int, ...]) -> bool:
    """Tell whether a texture is a whole number of times as large as its depth, a mesh."""
    rows, columns = depth
    times = texture[0] // rows
    return min(depth) > 1 and times > 0 and texture[:2] == (times * rows, times * columns)
