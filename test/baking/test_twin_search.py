"""Rooms that look alike are found when a memory is made, and doubted when a robot is lost."""
from pathlib import Path

from box_room import AWAY, box_memory, EXPANSION, planar, twin_memory
from neo_ros.baking.twin_search import _exact, _Pair, find_twins, TwinRules
from neo_ros.errors import ModelError
from neo_ros.geometry import CameraPose
from neo_ros.memory.looking import Looker
from neo_ros.memory.scene_memory import SceneMemory
from neo_ros.memory.thresholds import GuideThresholds
from neo_ros.memory.twins import NO_TWINS, Twins
import numpy as np
import pytest

pytestmark = pytest.mark.slow


@pytest.fixture(scope='module', params=[False, True], ids=['equal', 'own picture'])
def found(request: pytest.FixtureRequest) -> Twins:
    return find_twins(twin_memory(own_picture=request.param), EXPANSION)


def test_each_of_two_rooms_leads_to_the_other(found: Twins) -> None:
    """A picture in one of them changes nothing: from other views they are equal."""
    assert len(found) == 1
    for start, sign in ((planar(1.9, 1.7, 35), 1), (planar(1.9 + AWAY, 1.7, 35), -1)):
        other, = found.of(start)
        assert np.linalg.norm(other.position - start.position - [sign * AWAY, 0, 0]) < 0.02
        assert other.forward @ start.forward > 0.9999


def test_it_is_told_from_where_they_look_alike(found: Twins) -> None:
    for T, pose in zip(found.T, found.T_world_cam):
        there = CameraPose.nearest(T @ pose)
        assert abs(abs(there.position[0] - pose[0, 3]) - AWAY) < 0.1
    assert not found.of(planar(1.9, 1.7 + AWAY, 0))  # It is in none of the rooms.


def test_a_room_alone_has_no_twin() -> None:
    said: list[tuple[int, int]] = []
    memory = box_memory()
    assert find_twins(memory, EXPANSION, lambda *done: said.append(done)) is NO_TWINS
    assert said[-1] == (len(memory.positions), len(memory.positions))


def test_a_memory_file_keeps_its_twins(tmp_path: Path, found: Twins) -> None:
    memory = twin_memory(own_picture=False)
    memory.twins = found
    path = tmp_path / 'twins.memory'
    again = SceneMemory.read(path, memory.write(path)).twins
    for name in ('T', 'areas', 'T_world_cam'):
        np.testing.assert_array_equal(getattr(again, name), getattr(found, name))
    memory.twins = Twins(2 * found.T, found.areas, found.T_world_cam)
    with pytest.raises(ModelError, match='twins'):
        SceneMemory.read(path, memory.write(path))


def test_many_views_tell_the_way_to_a_twin_that_one_told_badly() -> None:
    memory = twin_memory(own_picture=False)
    looker = Looker(memory, EXPANSION, GuideThresholds())
    views = [planar(1.4 + 0.25 * step, 1.7, 60 * step) for step in range(5)]
    badly = planar(1.4 + AWAY + 0.15, 1.6, 2).T_world_cam @ views[0].inverse()
    way = _exact(_Pair(badly, views), looker, TwinRules())
    for view in views:
        there = CameraPose.nearest(way @ view.T_world_cam)
        assert np.linalg.norm(there.position - view.position - [AWAY, 0, 0]) < 0.02
        assert there.forward @ view.forward > 0.9999
