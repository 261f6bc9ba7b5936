"""Drawing the scene memory from new poses, against exact views of a box room."""
from box_room import BAND, box_memory, EXPANSION, keyframe, planar, view
from neo_ros.geometry import CameraPose
from neo_ros.machine import compiled
from neo_ros.memory.keyframe import Keyframe
from neo_ros.memory.rendering import MemoryRenderer
from neo_ros.memory.scene_memory import Glances, SceneMemory
from numba import get_num_threads, set_num_threads
import numpy as np
import pytest

NO_GLANCES = Glances(np.zeros((1, 4, 4), np.uint8), np.eye(4)[None])


@pytest.fixture(scope='module')
def renderer() -> MemoryRenderer:
    return MemoryRenderer(box_memory())


@pytest.mark.parametrize('pose', [
    planar(1.2, 1.2, 0), planar(1.7, 1.7, 45), planar(2.6, 1.9, 200), planar(2.2, 2.2, -90),
], ids=['at a keyframe', 'between four', 'looking back', 'to the wall'])
def test_a_view_shows_what_is_there(renderer: MemoryRenderer, pose: CameraPose) -> None:
    truth, depth = view(pose, EXPANSION.target)
    guide = renderer.render(pose, EXPANSION.target, 3)
    known = guide.depth > 0
    assert known.mean() > 0.99
    assert np.abs(guide.image - truth)[known].mean() < 3
    assert np.median(np.abs(guide.depth - depth)[known] / depth[known]) < 0.005


def test_a_tilted_camera_sees_the_same_room(renderer: MemoryRenderer) -> None:
    roll = np.radians(20)
    T = planar(1.9, 1.6, 30).T_world_cam.copy()
    T[:3, :3] = T[:3, :3] @ np.array(
        [[np.cos(roll), -np.sin(roll), 0], [np.sin(roll), np.cos(roll), 0], [0, 0, 1]])
    truth, _ = view(CameraPose(T), EXPANSION.source)
    guide = renderer.render(CameraPose(T), EXPANSION.source, 3)
    assert np.abs(guide.image - truth)[guide.depth > 0].mean() < 3


@pytest.mark.parametrize('x, y', [(1.7, 1.7), (2.2, 1.2), (0.0, 9.0)])
def test_the_nearest_keyframes_come_first(renderer: MemoryRenderer, x: float, y: float) -> None:
    position = planar(x, y, 0).position
    away = np.linalg.norm(renderer.memory.positions - position, axis=1).round(9)
    order = np.argsort(away, kind='stable')
    for count in range(1, len(order) + 2):
        found = renderer.nearest(position, count)
        assert away[found].tolist() == away[order[:count]].tolist()


def test_walls_are_not_seen_from_behind(renderer: MemoryRenderer) -> None:
    outside = planar(-1.0, 2.0, 0)
    guide = renderer.render(outside, EXPANSION.source, 6)
    known = guide.depth > 0
    assert known.any()
    # The wall before the camera, one metre away, lets it look in at the far one.
    assert guide.depth[known].min() > 1.2
    assert guide.depth[32, 32] == pytest.approx(6.0, rel=0.01)


def test_directions_that_no_keyframe_shows_are_unknown() -> None:
    frame = keyframe(np.array([2.0, 2.0, 1.4]))
    half = frame.depth.copy()
    half[:, half.shape[1] // 2:] = 0
    memory = SceneMemory.from_keyframes([Keyframe(frame.position, half, frame.texture)], BAND,
                                        NO_GLANCES)
    shown = [MemoryRenderer(memory).render(planar(2.0, 2.0, yaw), EXPANSION.source, 1).depth > 0
             for yaw in (90, -90)]
    assert sorted(known.mean() for known in shown) == [0, pytest.approx(1, abs=0.05)]


def test_a_gap_behind_something_near_is_filled_and_marked() -> None:
    frame = keyframe(np.array([2.0, 2.0, 1.4]))
    # A post half a metre before the camera, in the middle of the panorama: azimuth 0.
    depth = frame.depth.copy()
    middle = depth.shape[1] // 2
    depth[:, middle - 5:middle + 5] = 0.5
    memory = SceneMemory.from_keyframes([Keyframe(frame.position, depth, frame.texture)], BAND,
                                        NO_GLANCES)
    guide = MemoryRenderer(memory).render(planar(2.0, 1.8, 0), EXPANSION.source, 1)
    assert (guide.depth > 0).mean() > 0.97
    assert 0.02 < guide.stretched.mean() < 0.5
    assert not MemoryRenderer(memory).render(
        planar(2.0, 2.0, 0), EXPANSION.source, 1).stretched.any()


@pytest.mark.parametrize('times', [0.25, 1, 16])
def test_a_slanted_wall_is_whole_in_views_of_any_size(renderer: MemoryRenderer, times: float
                                                      ) -> None:
    view = EXPANSION.source.scaled(times)
    guide = renderer.render_from([0], planar(1.7, 1.7, 45), view)
    assert not guide.stretched.any()


@pytest.mark.skipif(compiled.ALL_THREADS < 2, reason='one processor')
def test_the_number_of_threads_changes_no_bit(renderer: MemoryRenderer) -> None:
    before = get_num_threads()
    views = []
    try:
        for threads in (1, compiled.ALL_THREADS):
            set_num_threads(threads)
            views.append(renderer.render(planar(1.8, 1.5, 70), EXPANSION.target, 3))
    finally:
        set_num_threads(before)
    assert np.array_equal(views[0].image, views[1].image)
    assert np.array_equal(views[0].depth, views[1].depth)
