"""A scene memory for small views, whose keyframes are no finer than those need."""
import math

import cv2
from neo_ros.errors import ModelError
from neo_ros.memory.keyframe import decode_image, depth_of, Keyframe, REDUCED
from neo_ros.memory.scene_memory import SceneMemory
import numpy as np

# A mesh is so many times as fine as the view, a texture as the mesh.
MESH_FINER, TEXTURE_FINER = 2.0, 2
# Keyframes that are kept: each has a quarter of a megabyte for such views.
KEPT = 256


class CoarseMemory:
    """The keyframes of a memory for views of this focal length, pixels, and shorter ones."""

    def __init__(self, memory: SceneMemory, focal: float) -> None:
        self.positions, self.band = memory.positions, memory.band
        self._memory = memory
        texture, mesh = memory.rows
        height = self.band.top - self.band.bottom
        density = min(MESH_FINER * focal, mesh / height)  # No finer than the memory itself.
        self._size = math.ceil(density * height), math.ceil(density * self.band.width)
        self._reduced = max(reduced for reduced in REDUCED if reduced == 1 or (
            texture >= TEXTURE_FINER * reduced * self._size[0]))
        self._kept: dict[int, Keyframe] = {}

    def keyframe(self, index: int, focal: float = math.inf) -> Keyframe:
        """Return keyframe `index`, whatever the focal length; it must not be changed."""
        found = self._kept.get(index)
        if found is None:
            if len(self._kept) >= KEPT:
                del self._kept[next(iter(self._kept))]
            found = self._kept[index] = self._decode(index)
        return found

    def _decode(self, index: int) -> Keyframe:
        jpeg, png = self._memory.compressed(index)
        texture = decode_image(jpeg, REDUCED[self._reduced])
        coded = decode_image(png, cv2.IMREAD_UNCHANGED)
        if texture is None or coded is None or coded.dtype != np.uint16 or coded.ndim != 2:
            raise ModelError(f'scene memory: keyframe {index} is damaged; export it again')
        rows, columns = self._size
        coded = cv2.resize(coded, (columns, rows), interpolation=cv2.INTER_NEAREST_EXACT)
        texture = cv2.resize(texture, (TEXTURE_FINER * columns, TEXTURE_FINER * rows),
                             interpolation=cv2.INTER_AREA)
        return Keyframe(self.positions[index], depth_of(coded),
                        cv2.cvtColor(texture, cv2.COLOR_BGR2RGB, texture))
