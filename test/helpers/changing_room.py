"""The room of `benchmark/small_room.py` as a perfect field would remember it."""
from box_room import BAND
from neo_ros.benchmark.small_room import cast_with_post, HEIGHT, Place
from neo_ros.memory.keyframe import Keyframe
from neo_ros.memory.scene_memory import Glances, SceneMemory
import numpy as np


def remembered(post: Place) -> SceneMemory:
    """Remember the room by perfect keyframes."""
    positions = [np.array([x, y, HEIGHT]) for x in (1.0, 1.6, 2.2) for y in (0.8, 2.0, 3.2)]
    keyframes, size = [], (int((BAND.top - BAND.bottom) * 40), int(BAND.width * 40))
    for position in positions:
        _, depth, _ = cast_with_post(position, BAND.rays(*size), post)
        colour, _, _ = cast_with_post(position, BAND.rays(2 * size[0], 2 * size[1]), post)
        keyframes.append(Keyframe(position, depth.astype(np.float32), colour))
    none = Glances(np.zeros((1, 16, 16), np.uint8), np.eye(4)[None])
    return SceneMemory.from_keyframes(keyframes, BAND, none)
