"""What others say of where the camera is."""
from types import SimpleNamespace
from typing import Any

from camera_messages import image_message, noise_image
from neo_ros.errors import GeometryError
from neo_ros.geometry import CameraPose
from neo_ros.messages import FrameProcessor
from neo_ros.messages.hints import PoseHints, read_pose
from neo_ros.runtime import WideView
import numpy as np
import pytest
from tiny_model import TINY_EXPANSION

SOURCE, TARGET = TINY_EXPANSION.source, TINY_EXPANSION.target


def header(milliseconds):
    seconds, rest = divmod(milliseconds, 1000)
    return SimpleNamespace(frame_id='', stamp=SimpleNamespace(
        sec=seconds, nanosec=rest * 1_000_000))


def at(milliseconds):
    """Return where a robot is that drives a circle at 1 m/s and 0.5 rad/s."""
    t = milliseconds / 1000
    return CameraPose.from_planar(2 * np.sin(t / 2), 2 - 2 * np.cos(t / 2), 1, t / 2)


@pytest.fixture
def hints():
    hints = PoseHints()
    for milliseconds in range(0, 1000, 50):
        hints.add_odometry(header(milliseconds), at(milliseconds))
    return hints


@pytest.mark.parametrize(('start', 'end'), [(100, 200), (120, 133), (310, 410), (900, 975)])
def test_motion_is_read_between_the_messages(hints, start, end):
    motion = hints.motion(start * 10**6, end * 10**6)
    expected = at(start).inverse() @ at(end).T_world_cam
    assert np.allclose(motion, expected, atol=1e-3)


@pytest.mark.parametrize(('start', 'end'), [(-20, 100), (500, 1500)])
def test_where_odometry_is_silent_no_motion_is_made_up(hints, start, end):
    assert hints.motion(start * 10**6, end * 10**6) is None


def test_two_messages_that_came_at_once_do_not_tell_how_fast_it_goes(hints):
    late = at(950).T_world_cam.copy()
    late[:3, 3] += [0.0, 0.02, 0.0]  # Two centimetres of noise in 0.2 ms.
    hints.add_odometry(SimpleNamespace(frame_id='', stamp=SimpleNamespace(
        sec=0, nanosec=950_200_000)), CameraPose(late))
    motion = hints.motion(900 * 10**6, 965 * 10**6)
    expected = at(900).inverse() @ at(965).T_world_cam
    assert np.abs(motion - expected).max() < 0.03


def test_what_is_known_of_a_moment_says_nothing_of_a_longer_time():
    hints = PoseHints()
    hints.add_odometry(header(950), at(950))
    hints.add_odometry(header(960), at(960))
    assert hints.motion(950 * 10**6, 970 * 10**6) is not None
    assert hints.motion(950 * 10**6, 980 * 10**6) is None


def test_slow_odometry_that_comes_unevenly_is_moved_on():
    hints = PoseHints()
    for milliseconds in (700, 801, 902):
        hints.add_odometry(header(milliseconds), at(milliseconds))
    motion = hints.motion(902 * 10**6, 1052 * 10**6)  # So far in less than two messages.
    assert np.abs(motion - at(902).inverse() @ at(1052).T_world_cam).max() < 0.03
    assert hints.motion(902 * 10**6, 1103 * 10**6) is None


def test_a_hole_is_not_bridged_and_time_that_runs_back_forgets(hints):
    hints.add_odometry(header(2000), at(2000))
    assert hints.motion(900 * 10**6, 1500 * 10**6) is None
    hints.add_odometry(header(100), at(100))
    assert hints.motion(300 * 10**6, 400 * 10**6) is None


def test_of_odometry_that_repeats_its_stamps_the_last_counts():
    hints = PoseHints()
    for milliseconds in range(0, 1000, 50):
        for pose in (at(0), at(milliseconds)):
            hints.add_odometry(header(milliseconds), pose)
    motion = hints.motion(120 * 10**6, 910 * 10**6)
    assert motion is not None
    assert np.allclose(motion, at(120).inverse() @ at(910).T_world_cam, atol=1e-3)


def test_a_prior_is_used_once(hints):
    hints.set_prior(at(0))
    assert hints.take_prior() is not None and hints.take_prior() is None


def test_a_prior_that_waited_too_long_is_not_used(hints, monkeypatch):
    now = 100.0
    monkeypatch.setattr('neo_ros.messages.hints.monotonic', lambda: now)
    for waited, used in ((9.0, True), (11.0, False)):
        hints.set_prior(at(0))
        now += waited
        assert (hints.take_prior() is not None) == used


def test_a_pose_without_a_rotation_is_refused():
    zero = SimpleNamespace(x=0.0, y=0.0, z=0.0, w=0.0)
    with pytest.raises(GeometryError, match='quaternion'):
        read_pose(SimpleNamespace(position=zero, orientation=zero))


class Listener:
    """An extrapolator that keeps the hints of every image."""

    expansion, scene_check = TINY_EXPANSION, None

    def __init__(self):
        self.heard, self.resets = [], 0

    def reset(self):
        self.resets += 1

    def expand(self, image, **given):
        self.heard.append(given)
        return WideView(np.zeros((TARGET.height, TARGET.width, 3), np.uint8),
                        np.zeros((TARGET.height, TARGET.width), np.uint8))


@pytest.mark.parametrize('stamps, paces', [
    ([0, 33, 66, 100, 133], [None] * 5), ([0, 33, 100, 133], [None, None, 67 / 33, 33 / 67]),
    ([0, 30, 60, 30, 60, 90], [None] * 6), ([0, 33, 900, 933], [None] * 4),
    ([5, 5, 5, 38], [None] * 4)],
                         ids=['steady', 'one dropped', 'back in time', 'a pause', 'no clock'])
def test_dropped_images_are_told_by_the_stamps(stamps, paces):
    listener: Any = Listener()
    processor = FrameProcessor(listener)
    for milliseconds in stamps:
        processor.process(image_message(noise_image(SOURCE, 0), header(milliseconds)), None)
    assert [given.get('pace') for given in listener.heard] == paces


@pytest.mark.parametrize('stamps, resets', [
    ([0, 29_000, 58_000], 0), ([0, 31_000, 31_033], 1), ([60_000, 59_100, 59_133], 0),
    ([60_000, 58_900, 58_933], 1), ([0, 0, 0], 0)],
                         ids=['slow', 'a long pause', 'overtaken', 'anew', 'no clock'])
def test_a_camera_that_may_be_anywhere_is_looked_for_anew(stamps, resets):
    listener: Any = Listener()
    processor = FrameProcessor(listener)
    processor.hints = hints = PoseHints()
    for milliseconds in stamps:
        hints.set_prior(at(0))
        processor.process(image_message(noise_image(SOURCE, 0), header(milliseconds)), None)
    assert listener.resets == resets
    assert all('prior' in given for given in listener.heard)


def test_pixels_without_a_header_have_no_pace():
    listener: Any = Listener()
    message = image_message(noise_image(SOURCE, 0))
    del message.header
    FrameProcessor(listener).process(message, None)
    assert listener.heard == [{}]


def test_the_extrapolator_hears_them(hints):
    listener: Any = Listener()
    heard = listener.heard
    processor = FrameProcessor(listener)
    processor.hints = hints
    hints.set_prior(at(0))
    for milliseconds in (100, 200, 5000):
        processor.process(image_message(noise_image(SOURCE, 0), header(milliseconds)), None)
    processor.reset()
    processor.process(image_message(noise_image(SOURCE, 0), header(300)), None)
    assert [set(given) - {'stamp_ns'} for given in heard] == [{'prior'}, {'motion'}, set(), set()]
    assert [given['stamp_ns'] / 1e6 for given in heard] == [100, 200, 5000, 300]
    assert np.allclose(heard[1]['motion'], at(100).inverse() @ at(200).T_world_cam)
