"""The scene memory: what a robot keeps of a scene to see it again from other poses."""
from collections.abc import Sequence
from dataclasses import dataclass
import hashlib
import io
import os
from pathlib import Path
from zipfile import BadZipFile

import cv2
from neo_ros.errors import ModelError
from neo_ros.geometry import Band
from neo_ros.model_bytes import read_model_bytes
import numpy as np

SCHEMA = 1
# Inverse depth is stored in so many steps from infinity to CLOSEST metres; finer ones would be
# noise that does not compress.
STEPS = 4095
CLOSEST = 0.25
JPEG_QUALITY = 92
# Decoded keyframes that are kept; a robot walks through them one by one.
CACHED = 24


@dataclass(frozen=True, eq=False)
class Keyframe:
    """
    A panorama with depth, seen from `position` (3,), world metres.

    depth float32 (h, w), metres along the ray, 0 = unknown; texture uint8 RGB (n h, n w, 3).
    """

    position: np.ndarray
    depth: np.ndarray
    texture: np.ndarray


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

    positions (K, 3) world metres; band, the part of the sphere that all of them show; glances.
    """

    def __init__(self, positions: np.ndarray, band: Band, textures: Sequence[bytes],
                 depths: Sequence[bytes], glances: Glances) -> None:
        self.positions, self.band, self.glances = positions, band, glances
        self._textures, self._depths = textures, depths
        # The last one used is the last. An lru_cache of a method would keep this object alive.
        self._decoded: dict[int, Keyframe] = {}

    def keyframe(self, index: int) -> Keyframe:
        """Return keyframe `index`; it must not be changed."""
        found = self._decoded.pop(index, None) or self._decode(index)
        self._decoded[index] = found
        if len(self._decoded) > CACHED:
            del self._decoded[next(iter(self._decoded))]
        return found

    def _decode(self, index: int) -> Keyframe:
        texture = _decode_image(self._textures[index], cv2.IMREAD_COLOR_RGB)
        coded = _decode_image(self._depths[index], cv2.IMREAD_UNCHANGED)
        if texture is None or coded is None or coded.dtype != np.uint16 or coded.ndim != 2 \
                or texture.shape[0] % coded.shape[0] or texture.shape[1] % coded.shape[1]:
            raise ModelError(f'scene memory: keyframe {index} is damaged; export it again')
        depth = np.where(coded > 0, STEPS * CLOSEST / np.maximum(coded, 1), 0)
        return Keyframe(self.positions[index], depth.astype(np.float32), texture)

    @classmethod
    def from_keyframes(cls, keyframes: Sequence[Keyframe], band: Band,
                       glances: Glances) -> 'SceneMemory':
        """Compress keyframes of one band and size."""
        textures, depths = [], []
        for keyframe in keyframes:
            nearness = STEPS * CLOSEST / np.maximum(keyframe.depth, CLOSEST)
            coded = np.where(keyframe.depth > 0, np.maximum(nearness + 0.5, 1), 0)
            textures.append(_encode('.jpg', keyframe.texture[..., ::-1],
                                    [cv2.IMWRITE_JPEG_QUALITY, JPEG_QUALITY]))
            depths.append(_encode('.png', coded.astype(np.uint16), []))
        return cls(np.stack([keyframe.position for keyframe in keyframes]), band, textures,
                   depths, glances)

    def write(self, path: Path) -> str:
        """Write the memory; returns the file's SHA-256, for the model's card."""
        content = io.BytesIO()
        band = self.band
        np.savez(
            content, schema=SCHEMA, positions=self.positions,
            band=[band.top, band.bottom, band.low, band.width],
            textures=np.frombuffer(b''.join(self._textures), np.uint8),
            depths=np.frombuffer(b''.join(self._depths), np.uint8),
            texture_sizes=[len(item) for item in self._textures],
            depth_sizes=[len(item) for item in self._depths],
            glances=self.glances.pictures, glance_poses=self.glances.T_world_cam)
        partial = path.with_suffix('.partial')
        try:
            partial.write_bytes(content.getvalue())
            os.replace(partial, path)
        except OSError as error:
            partial.unlink(missing_ok=True)
            raise ModelError(f'{path}: cannot write the scene memory: {error.strerror}') from error
        return hashlib.sha256(content.getvalue()).hexdigest()

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
            with np.load(io.BytesIO(content), allow_pickle=False) as data:
                if int(data['schema']) != SCHEMA:
                    raise ModelError(f'{path}: expected a scene memory of schema {SCHEMA}, got '
                                     f'{int(data["schema"])}; update neo_ros')
                return cls(
                    data['positions'], Band(*(float(x) for x in data['band'])),
                    _split(data['textures'], data['texture_sizes']),
                    _split(data['depths'], data['depth_sizes']),
                    Glances(data['glances'], data['glance_poses']))
        except (OSError, ValueError, KeyError, EOFError, BadZipFile) as error:
            raise ModelError(f'{path}: expected a scene memory: {error}') from error


def _encode(kind: str, image: np.ndarray, options: list[int]) -> bytes:
    done, coded = cv2.imencode(kind, image, options)
    if not done:
        raise ModelError(f'scene memory: OpenCV cannot write {kind}')
    return coded.tobytes()


def _decode_image(content: bytes, flags: int) -> np.ndarray | None:
    return cv2.imdecode(np.frombuffer(content, np.uint8), flags)


def _split(content: np.ndarray, sizes: np.ndarray) -> list[bytes]:
    ends = np.cumsum(sizes)
    return [content[end - size:end].tobytes() for end, size in zip(ends, sizes)]
