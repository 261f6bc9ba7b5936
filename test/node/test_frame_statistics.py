"""Counters, rates over the window, and latencies by stage."""
from neo_ros.node.frame_statistics import KEPT_FRAMES, Statistics, WINDOW_S
import pytest


class HandClock:
    """A clock that a test turns."""

    time = 100.0

    def __call__(self):
        return self.time


def test_rates_are_those_of_the_window():
    clock = HandClock()
    statistics = Statistics(clock)
    for _ in range(100):
        clock.time += 0.1
        statistics.count_received()
        statistics.count_published({'total': 1.0})
    counts = statistics.snapshot()
    assert (counts.received, counts.published) == (100, 100)
    assert counts.rate_in == pytest.approx(10, rel=0.03)
    clock.time += WINDOW_S + 0.1
    later = statistics.snapshot()
    assert (later.rate_in, later.rate_out, later.recent_received) == (0, 0, 0)
    assert later.received == 100


def test_rate_just_after_the_start_counts_the_time_that_passed():
    clock = HandClock()
    statistics = Statistics(clock)
    for _ in range(10):
        clock.time += 0.1
        statistics.count_received()
    assert statistics.snapshot().rate_in == pytest.approx(10)


def test_refusals_are_counted_by_reason():
    statistics = Statistics(HandClock())
    for reason in ('size', 'step', 'size'):
        statistics.count_rejected(reason, f'bad {reason}')
    statistics.count_dropped()
    counts = statistics.snapshot()
    assert counts.rejected == {'size': 2, 'step': 1}
    assert (counts.last_rejection, counts.recent_rejected, counts.dropped) == ('bad size', 3, 1)


def test_latencies_are_of_the_last_frames():
    statistics = Statistics(HandClock())
    statistics.count_published({'infer': 1e6})
    for value in range(KEPT_FRAMES):
        statistics.count_published({'infer': float(value), 'queue': 1.0})
    spread = statistics.snapshot().latency_ms
    assert spread['infer'] == pytest.approx(
        ((KEPT_FRAMES - 1) / 2, 0.95 * (KEPT_FRAMES - 1), KEPT_FRAMES - 1))
    assert spread['queue'] == (1, 1, 1)


def test_no_frame_yet_has_no_latency():
    assert Statistics(HandClock()).snapshot().latency_ms == {}


def test_what_the_images_were_like_is_that_of_the_window():
    clock = HandClock()
    statistics = Statistics(clock)
    for _ in range(2):
        statistics.count_published({}, 1.0, True, 'resampled')
    clock.time += WINDOW_S + 0.1
    more: tuple[tuple[float | None, bool | None], ...] = (
        (0.2, True), (0.4, False), (None, False), (None, False), (None, None))
    for score, guided in more:
        statistics.count_published({}, score, guided, 'as the model takes it')
    counts = statistics.snapshot()
    assert (counts.out_of_scene, counts.guided) == (pytest.approx(0.3), 0.25)
    assert counts.camera_note == 'as the model takes it'
    clock.time += WINDOW_S + 0.1
    assert statistics.snapshot().out_of_scene is None
    assert statistics.snapshot().guided is None


def test_another_model_is_not_judged_by_what_the_last_one_said():
    statistics = Statistics(HandClock())
    assert statistics.snapshot().camera_note == 'unknown'
    statistics.count_published({'infer': 500}, 0.9, False, 'resampled')
    statistics.forget_model()
    counts = statistics.snapshot()
    assert (counts.out_of_scene, counts.latency_ms, counts.camera_note) == (None, {}, 'unknown')
    assert (counts.published, counts.recent_published) == (1, 1)
    statistics.count_published({}, guided=True)
    assert statistics.snapshot().guided == 1
    statistics.count_rejected('camera', 'another camera')
    assert statistics.snapshot().camera_note == 'rejected'


def test_rates_are_of_the_time_since_images_are_taken():
    clock = HandClock()
    statistics = Statistics(clock)
    clock.time += 60
    statistics.begin()
    for _ in range(30):
        clock.time += 1 / 30
        statistics.count_received()
    assert statistics.snapshot().rate_in == pytest.approx(30)
