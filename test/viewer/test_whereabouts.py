"""Where the camera was, and where its motion leads."""
from neo_ros.geometry import CameraPose
from neo_ros.viewer.whereabouts import Place, PoseJoiner, Whereabouts
import numpy as np
import pytest


def at(x: float, captured: float) -> Place:
    return Place(CameraPose.from_planar(x, 2.0, 1.5, 0.3), captured)


def walked(speed: float, seconds: float = 3.0) -> Whereabouts:
    """Return a straight walk along x at 10 Hz, which ends at time `seconds`."""
    where = Whereabouts()
    for step in range(round(10 * seconds) + 1):
        where.put(at(speed * step / 10, step / 10))
    return where


@pytest.mark.parametrize('speed', [0.0, 0.5, -1.2])
@pytest.mark.parametrize('ahead', [0.3, 1.0, 2.0])
def test_a_steady_motion_is_continued(speed: float, ahead: float) -> None:
    found = walked(speed).predicted(3.0 + ahead)
    assert found is not None
    assert found == pytest.approx([speed * (3.0 + ahead), 2.0, 1.5])


def test_a_prediction_ends_after_two_seconds_and_a_jump_leads_nowhere() -> None:
    where = walked(0.5)
    assert where.predicted(60.0) == pytest.approx([0.5 * 5.0, 2.0, 1.5])
    where.put(at(8.0, 3.1))  # Searched for, and found in another room.
    assert where.predicted(4.0) == pytest.approx([8.0, 2.0, 1.5])


def test_nothing_leads_nowhere_and_one_place_stays() -> None:
    where = Whereabouts()
    assert where.predicted(1.0) is None and where.last is None and where.recent(1.0) == []
    where.put(at(1.0, 5.0))
    assert where.predicted(6.0) == pytest.approx([1.0, 2.0, 1.5])


def test_the_last_seconds_are_kept_the_newest_first() -> None:
    where = walked(0.5, 20.0)
    recent = where.recent(20.0)
    assert 5 <= len(recent) <= where.thresholds.kept
    times = [place.captured for place in recent]
    assert times == sorted(times, reverse=True) and min(np.diff(times[::-1])) > 0.6
    assert where.last not in recent
    assert where.recent(40.0) == []


def test_time_that_runs_back_starts_anew() -> None:
    where = walked(0.5)
    where.put(at(7.0, 0.1))
    assert where.predicted(0.6) == pytest.approx([7.0, 2.0, 1.5])
    assert where.recent(0.6) == []


@pytest.mark.parametrize('pose_first', [False, True])
def test_image_and_pose_of_a_stamp_make_a_place(pose_first: bool) -> None:
    where = Whereabouts()
    joiner = PoseJoiner(where)
    pose, image = at(1.0, 0).pose, np.zeros((2, 2, 3), np.uint8)
    joiner.add_pose(6, at(9.0, 0).pose)  # Of an image that was lost.
    if pose_first:
        joiner.add_pose(7, pose)
    joiner.add_image(7, 12.5, lambda: image)
    if not pose_first:
        assert where.last is None
        joiner.add_pose(7, pose)
    place = where.last
    assert place is not None and place.pose is pose and place.captured == 12.5
    assert place.read_image() is image
