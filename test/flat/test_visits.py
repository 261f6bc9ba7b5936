"""The flat on later days: a door, light, and somebody who walks before the camera."""
from pathlib import Path

from neo_ros.flat.demo_flat import build_demo_flat
from neo_ros.flat.light import _direct, _light_samples, LightSources
from neo_ros.flat.visits import (
    DOOR_PLACE, somebody, Visit, visited_flat, VISITS, with_more)
from neo_ros.geometry import CameraPose, Intrinsics
import numpy as np
import pytest

CAMERA = Intrinsics.from_hfov(48, 36, 1.6)
# In the living room, looking at the doorway to the bedroom.
BEFORE_THE_DOOR = CameraPose.from_planar(DOOR_PLACE[0] - 2.5, DOOR_PLACE[1], 1.5, 0.0)
MIDDLE = (slice(12, 24), slice(18, 30))


def test_a_closed_door_hides_the_other_room(tmp_path: Path) -> None:
    depth = {closed: visited_flat(Visit(closed=closed), tmp_path).depth(CAMERA, BEFORE_THE_DOOR)
             for closed in (False, True)}
    assert depth[True][MIDDLE].max() == pytest.approx(2.48, abs=0.02)
    assert np.median(depth[False][MIDDLE]) > 4
    assert (depth[True] == depth[False])[:, :6].all()


def test_somebody_stands_before_the_camera_and_moves() -> None:
    flat = build_demo_flat()
    empty, one, later = (
        (flat if step is None else with_more(flat, somebody(BEFORE_THE_DOOR, step))).depth(
            CAMERA, BEFORE_THE_DOOR) for step in (None, 0, 4))
    there, then = one < empty, later < empty
    assert 0.02 < there.mean() < 0.2 and one[there] == pytest.approx(2, abs=0.3)
    assert (there & then).sum() < 0.5 * there.sum()


@pytest.mark.parametrize('light', ['evening', 'sun'])
def test_light_is_what_was_baked_and_the_outside_follows(tmp_path: Path, light: str) -> None:
    day = build_demo_flat()
    np.save(tmp_path / f'light_{light}.npy', np.zeros_like(day.light.values))
    flat = visited_flat(Visit(light=light), tmp_path)
    assert not flat.light.values.any() and day.light.values.any()
    assert (flat.outside < 1) == (light == 'evening') and flat.exposure != 1
    image, depth = flat.render(CAMERA, BEFORE_THE_DOOR)
    before, same = day.render(CAMERA, BEFORE_THE_DOOR)
    assert (depth == same).all() and image.mean() < 0.3 * before.mean()


def test_the_sun_shines_through_windows_only() -> None:
    solids = build_demo_flat().solids
    up = (0.0, 0.0, 1.0)
    # On the roof, in the middle of a room, and behind a window of the south.
    points = np.array([(2.0, 2.0, 3.0), (2.0, 3.5, 0.02), (4.2, 0.4, 1.2)])
    light = _direct(solids, points, np.tile(up, (3, 1)),
                    _light_samples(LightSources((), (), (0.0, -1.0, 1.2)), 16))
    assert light[0, 0] == pytest.approx(9 * 1.2 / np.hypot(1, 1.2), rel=0.1)
    assert light[1].max() == 0 and light[2, 0] > 3


def test_the_schedule_has_every_kind_of_change() -> None:
    assert VISITS[0] == Visit()
    assert {visit.light for visit in VISITS} == {'day', 'evening', 'sun'}
    assert any(visit.closed for visit in VISITS) and any(visit.people for visit in VISITS)
