"""A scene memory for small views, whose keyframes are no finer than those need."""
import math

import cv2
from neo_ros.memory.keyframe import depth_of, Keyframe, REDUCED
from neo_ros.memory.scene_memory import SceneMemory

# A mesh is as fine as the view, and a texture so many times as fine as the mesh. Finer meshes
# take longer, and of 100 images in rooms that all differ four more are not found.
TEXTURE_FINER = 2


class CoarseMemory:
    """The keyframes of a memory for views of this focal length, pixels, and shorter ones."""

    def __init__(self, memory: SceneMemory, focal: float) -> None:
        self.positions, self.band = memory.positions, memory.band
        self._memory = memory
        texture, mesh = memory.rows
        height = self.band.top - self.band.bottom
        density = min(focal, mesh / height)  # No finer than the memory itself.
        self._size = math.ceil(density * height), math.ceil(density * self.band.width)
        self._reduced = max(reduced for reduced in REDUCED if reduced == 1 or (
            texture >= TEXTURE_FINER * reduced * self._size[0]))

    def keyframe(self, index: int, focal: float = math.inf) -> Keyframe:
        """Return keyframe `index`, whatever the focal length; it must not be changed."""
        return self._memory.small_keyframes.get(
            (self._size[0], index), lambda: self._decode(index))

    def _decode(self, index: int) -> Keyframe:
        texture, coded = self._memory.pictures(index, self._reduced)
        rows, columns = self._size
        coded = cv2.resize(coded, (columns, rows), interpolation=cv2.INTER_NEAREST_EXACT)
        texture = cv2.resize(texture, (TEXTURE_FINER * columns, TEXTURE_FINER * rows),
                             interpolation=cv2.INTER_AREA)
        return Keyframe(self.positions[index], depth_of(coded), texture)
