"""Every image meets the camera_info of its frame, and of its stamp where one comes per image."""
from types import SimpleNamespace

from neo_ros.node.camera_pairing import CAMERA_INFO_WAIT_S, CameraPairing
import pytest


def message(seconds=0, frame='eye', words=''):
    stamp = SimpleNamespace(sec=seconds, nanosec=0)
    return SimpleNamespace(header=SimpleNamespace(stamp=stamp, frame_id=frame), words=words)


class Bench:
    """A pairing, what it handed over, a clock and a graph."""

    def __init__(self):
        self.taken: list[tuple[int, str | None]] = []
        self.time, self.announced = 0.0, True
        self.pairing = CameraPairing(
            lambda image, info: self.taken.append((image.header.stamp.sec, info and info.words)),
            lambda: self.announced, lambda: self.time)

    def image(self, seconds, frame='eye'):
        self.pairing.add_image(message(seconds, frame))
        return self.taken

    def info(self, words, seconds=0, frame='eye'):
        self.pairing.add_info(message(seconds, frame, words))
        return self.taken


@pytest.fixture
def bench():
    return Bench()


def test_without_a_publisher_of_camera_info_nothing_waits(bench):
    bench.announced = False
    assert bench.image(1) == [(1, None)]
    assert not bench.pairing.waits


def test_the_newest_of_the_first_images_waits(bench):
    assert bench.image(1) == bench.image(2) == []
    assert bench.pairing.waits
    assert bench.info('a') == [(2, 'a')]
    assert bench.image(3)[1:] == [(3, 'a')] and not bench.pairing.waits


def test_the_wait_ends(bench):
    bench.image(1)
    bench.time = CAMERA_INFO_WAIT_S + 0.1
    assert bench.image(2) == [(2, None)]
    bench.info('late')
    assert bench.image(3)[1:] == [(3, 'late')]


def test_another_frame_is_another_camera(bench):
    bench.info('left', frame='left')
    assert bench.image(1, frame='right') == []
    bench.time = CAMERA_INFO_WAIT_S + 0.1
    assert bench.image(2, frame='right') == [(2, None)]
    assert bench.pairing.mismatch == (
        'camera_info is of the frame left, the images are of right')
    bench.info('right', frame='/right')
    bench.info('left', frame='left')
    assert bench.image(3, frame='right')[1:] == [(3, 'right')]
    assert bench.image(4, frame='left')[2:] == [(4, 'left')] and bench.pairing.mismatch == ''


@pytest.mark.parametrize('of_image, of_info', [
    ('', 'eye'), ('eye', ''), ('', ''), ('/eye', 'eye')])
def test_no_frame_fits_every_frame(bench, of_image, of_info):
    bench.info('a', frame=of_info)
    assert bench.image(1, frame=of_image) == [(1, 'a')]


@pytest.mark.parametrize('image_first', [True, False])
def test_a_camera_that_zooms_is_paired_by_stamp(bench, image_first):
    for number in range(1, 6):
        if image_first:
            bench.image(number)
        bench.info(f'zoom {number}', number)
        if not image_first:
            bench.image(number)
    assert bench.taken == [(number, f'zoom {number}') for number in range(1, 6)]


def test_a_lost_camera_info_holds_up_one_image_only(bench):
    for number in (1, 2):
        bench.image(number)
        bench.info(f'{number}', number)
    bench.image(3)  # Its camera_info is lost.
    assert bench.image(4)[2:] == [(3, '2'), (4, '2')]
    bench.info('4', 4)
    bench.image(5)
    assert bench.info('5', 5)[4:] == [(5, '5')]


def test_a_latched_one_that_comes_twice_changes_nothing(bench):
    for _ in range(2):
        bench.info('a', 7)
    assert [bench.image(number)[-1] for number in (8, 9)] == [(8, 'a'), (9, 'a')]
    for number in (10, 11):
        bench.image(number)
        for _ in range(2):
            bench.info(f'{number}', number)
    # The first image of a camera that pairs by stamp cannot know that yet.
    assert bench.taken[2:] == [(10, 'a'), (11, '11')]


def test_frames_without_end_are_forgotten(bench):
    for number in range(1000):
        bench.info('a', number, frame=f'{number}')
    assert len(bench.pairing._infos) <= 16
    assert bench.image(1, frame='999') == [(1, 'a')]
