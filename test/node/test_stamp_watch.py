"""Ages, frozen stamps, and images that got lost on their way to the node."""
import re

from neo_ros.node.stamp_watch import judge_stamps, StampReport, StampWatch
import numpy as np
import pytest

MS = 1_000_000
BEGIN = 1_700_000_000_000 * MS


class Bench:
    """A watch with a clock that stands at the last image."""

    def __init__(self):
        self.time = 0.0
        self.watch = StampWatch(lambda: self.time)

    def send(self, milliseconds, came=lambda number: True, infos=False):
        """Send frames at these times; `came` says which images arrived."""
        for number, at in enumerate(milliseconds):
            self.time = at / 1000
            stamp = BEGIN + round(at) * MS
            if infos:
                self.watch.add_info(stamp)
            if came(number):
                self.watch.add_image(stamp, 20.0, 100)
        return self.watch.report()


@pytest.fixture
def bench():
    return Bench()


def at_30_hz(jitter_ms=0.0):
    jitter = np.random.default_rng(0).uniform(-jitter_ms, jitter_ms, 150)
    return np.arange(150) * 1000 / 30 + jitter + 10


@pytest.mark.parametrize('jitter_ms', [0, 5, 10])
def test_a_camera_that_loses_nothing(bench, jitter_ms):
    report = bench.send(at_30_hz(jitter_ms))
    assert report.rate == pytest.approx(30, rel=0.15)
    # Some of the longest gaps are taken for two.
    assert report.lost <= (0 if jitter_ms < 10 else 20)
    assert judge_stamps(report, 'x') == ''


@pytest.mark.parametrize('share', [0.3, 0.5, 0.7])
def test_lost_images_are_counted_by_the_gaps(bench, share):
    kept = np.random.default_rng(1).random(150) >= share
    report = bench.send(at_30_hz(2), lambda number: kept[number])
    settled = kept[:135]  # The last half second may still come.
    assert report.lost == pytest.approx((~settled).sum(), abs=8)
    assert report.rate == pytest.approx(30, rel=0.15)
    assert judge_stamps(report, 'do this').endswith(
        f'{report.lost} of {report.sent} images got lost before this node (0.0 MB each): do this')


def test_nearly_all_are_lost_where_camera_infos_tell(bench):
    report = bench.send(at_30_hz(), lambda number: number % 40 == 0, infos=True)
    assert (report.images, report.infos) == (4, 150)
    assert 125 < report.lost < report.sent < 140 and report.by_infos


def test_camera_infos_alone_tell_that_images_are_missing(bench):
    report = bench.send(at_30_hz(), lambda number: False, infos=True)
    assert judge_stamps(report, 'do this') == 'camera_info comes, the images do not: do this'
    assert judge_stamps(StampReport(infos=1), 'x') == ''  # A latched one.


def test_camera_infos_of_other_stamps_are_no_images(bench):
    for number in range(20):
        bench.watch.add_info(BEGIN + number * 77 * MS)
    assert bench.send(at_30_hz()).lost == 0


def test_where_nobody_tells_the_time_no_age_is_known(bench):
    for number in range(20):
        bench.watch.add_image(BEGIN + number * 33 * MS, None, 100)
    assert bench.watch.report().age_ms is None


def test_a_pause_and_a_bag_that_begins_anew_are_no_losses(bench):
    times = at_30_hz()
    assert bench.send(np.concatenate([times[:60], times[100:]])).lost == 0
    bench.watch.forget()
    for number in list(range(1000, 1060)) + list(range(60)):
        bench.time += 1 / 30
        bench.watch.add_image(BEGIN + number * 33 * MS, 20.0, 100)
    assert bench.watch.report().lost == 0


def test_what_is_older_than_the_window_is_forgotten(bench):
    bench.send(at_30_hz())
    bench.time += 5.1
    assert bench.watch.report() == StampReport()


@pytest.mark.parametrize('changes, words', [
    ({}, ''),
    ({'same': 2}, ''),
    ({'same': 3}, 'the last 3 images have one stamp'),
    ({'age_ms': 1500.0}, '1.5 s old when they come'),
    ({'age_ms': -250.0}, '0.2 s ahead of the clock'),
    ({'age_ms': -50.0}, ''),
    ({'unstamped': True, 'age_ms': 1e12}, 'no stamps'),
    ({'sent': 100, 'lost': 20}, ''),
    ({'sent': 100, 'lost': 21, 'age_ms': 1500.0}, 'old when they come: .*; 21 of 100 images got'),
    ({'sent': 100, 'lost': 21, 'by_infos': True}, 'got lost .*: x, unless somebody throttles'),
    ({'age_ms': None}, ''),
], ids=str)
def test_verdict(changes, words):
    report = StampReport(images=50, bytes=1000, age_ms=20.0, same=1)._replace(**changes)
    found = judge_stamps(report, 'x')
    assert (found == '') if not words else re.search(words, found)
