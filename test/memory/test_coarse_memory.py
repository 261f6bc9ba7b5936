"""Keyframes for small views: few vertices, and the same room."""
from box_room import BAND, box_memory, planar, view
import cv2
from neo_ros.errors import ModelError
from neo_ros.geometry import Intrinsics
from neo_ros.memory.coarse_memory import CoarseMemory
from neo_ros.memory.keyframe import compress
from neo_ros.memory.rendering import MemoryRenderer
from neo_ros.memory.scene_memory import SceneMemory
import numpy as np
import pytest

SMALL = Intrinsics.from_hfov(16, 16, np.pi / 2)


def test_a_small_view_is_that_of_the_whole_memory_with_fewer_vertices():
    memory = box_memory()
    coarse = CoarseMemory(memory, SMALL.fx)
    few, many = coarse.keyframe(0).depth, memory.keyframe(0).depth
    # As fine as the view: 8 pixels a radian of the 40 that there are.
    assert few.shape == (int(np.ceil(8 * 2.2)), int(np.ceil(8 * BAND.width)))
    assert few.size < many.size / 24
    pose = planar(1.9, 1.6, 30)
    drawn = MemoryRenderer(coarse).render(pose, SMALL)
    large = view(pose, Intrinsics.from_hfov(64, 64, np.pi / 2))[0].astype(np.float32)
    true = cv2.resize(large, (16, 16), interpolation=cv2.INTER_AREA)
    assert (drawn.depth > 0).all()
    assert np.abs(drawn.image - true).mean() < 6
    assert np.median(np.abs(drawn.depth - view(pose, SMALL)[1])) < 0.05
    assert coarse.keyframe(0) is coarse.keyframe(0)


def test_it_is_never_finer_than_the_memory():
    memory = box_memory()
    shape = CoarseMemory(memory, 1000.0).keyframe(0).depth.shape
    assert all(abs(one - other) <= 1 for one, other in zip(
        shape, memory.keyframe(0).depth.shape))


def test_a_damaged_keyframe_is_named():
    memory = box_memory()
    textures, depths = zip(*(compress(memory.keyframe(index)) for index in range(2)))
    broken = SceneMemory(memory.positions[:2], memory.band, [textures[0], b'\xff\xd8'], depths,
                         memory.glances)
    with pytest.raises(ModelError, match='keyframe 1 is damaged'):
        CoarseMemory(broken, SMALL.fx).keyframe(1)
