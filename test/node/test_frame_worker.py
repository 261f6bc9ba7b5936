"""The worker never queues, survives bad frames, and stops at once."""
import threading
import time
from types import SimpleNamespace

from camera_messages import header_without_a_clock, image_message, noise_image
from neo_ros.errors import ModelError
from neo_ros.messages.frame_processor import FrameProcessor
from neo_ros.node.frame_statistics import Statistics
from neo_ros.node.frame_worker import Frame, FrameWorker, Wanted
from neo_ros.runtime import WideView
import numpy as np
import pytest
from tiny_model import TINY_EXPANSION

SOURCE, TARGET = TINY_EXPANSION.source, TINY_EXPANSION.target
WAIT_S = 5


class GatedExtrapolator:
    """A network that works as slowly as the test lets it."""

    expansion = TINY_EXPANSION
    scene_check = None
    guided = False

    def __init__(self):
        self.resets = 0
        self.entered = threading.Semaphore(0)
        self.gate = threading.Semaphore(0)

    def reset(self):
        self.resets += 1

    def expand(self, image, prior=None, motion=None, pace=1.0, stamp_ns=None):
        self.entered.release()
        assert self.gate.acquire(timeout=WAIT_S)
        if image[0, 0, 0] == 13:
            raise RuntimeError('the network broke')
        if image[0, 0, 0] == 14:
            raise ModelError('the memory was changed')
        return WideView(np.zeros((TARGET.height, TARGET.width, 3), np.uint8),
                        np.zeros((TARGET.height, TARGET.width), np.uint8), self.guided)


class KeptOutputs:
    """Keeps the headers that were published."""

    def __init__(self, wanted=Wanted()):
        self._wanted = wanted
        self.headers = []
        self.published = threading.Semaphore(0)

    def wanted(self):
        return self._wanted

    def publish(self, header, frame, wanted):
        self.headers.append(header.frame_id)
        self.published.release()


@pytest.fixture
def bench():
    extrapolator, outputs, statistics = GatedExtrapolator(), KeptOutputs(), Statistics()
    reports: list[str] = []
    worker = FrameWorker(FrameProcessor(extrapolator), outputs, statistics, reports.append)
    worker.start()
    yield SimpleNamespace(worker=worker, extrapolator=extrapolator, outputs=outputs,
                          statistics=statistics, reports=reports)
    for _ in range(10):
        extrapolator.gate.release()
    assert worker.stop(WAIT_S)


def frame(header, first_value=0, **changes):
    image = noise_image(SOURCE, 0)
    image[0, 0, 0] = first_value
    return Frame(image_message(image, header_without_a_clock(header), **changes), None,
                 time.perf_counter())


def test_newest_frame_wins_over_a_slow_network(bench):
    bench.worker.submit(frame(0))
    assert bench.extrapolator.entered.acquire(timeout=WAIT_S)
    for header in range(1, 8):
        bench.worker.submit(frame(header))
    for _ in range(2):
        bench.extrapolator.gate.release()
        assert bench.outputs.published.acquire(timeout=WAIT_S)
    assert bench.outputs.headers == [0, 7]
    counts = bench.statistics.snapshot()
    assert (counts.received, counts.dropped) == (8, 6)


def test_only_frames_that_are_widened_tell_of_the_memory(bench):
    bench.outputs._wanted = Wanted(image=False, compressed=False, confidence=False)
    bench.worker.submit(frame('mask'))
    assert bench.outputs.published.acquire(timeout=WAIT_S)
    bench.outputs._wanted = Wanted()
    bench.extrapolator.guided = True
    bench.extrapolator.gate.release()
    bench.worker.submit(frame('wide'))
    assert bench.outputs.published.acquire(timeout=WAIT_S)
    assert bench.worker.stop(WAIT_S)
    counts = bench.statistics.snapshot()
    assert (counts.published, counts.guided) == (2, 1)


def test_bad_frames_are_counted_and_good_ones_pass_after_them(bench):
    for _ in range(5):
        bench.extrapolator.gate.release()
    bad = [frame('bad', encoding='yuv'), frame('bad', data=b''), frame('bad', width=5),
           frame('bad', first_value=14), frame('bad', first_value=13)]
    for number, wrong in enumerate(bad, start=1):
        bench.worker.submit(wrong)
        deadline = time.monotonic() + WAIT_S
        while len(bench.reports) < number and time.monotonic() < deadline:
            time.sleep(0.005)
    bench.worker.submit(frame('good'))
    assert bench.outputs.published.acquire(timeout=WAIT_S)
    assert bench.outputs.headers == ['good']
    assert bench.statistics.snapshot().rejected == {
        'encoding': 1, 'empty': 1, 'size': 1, 'model': 1, 'internal': 1}
    assert 'the network broke' in bench.reports[-1]


def test_stop_in_the_middle_of_inference_publishes_nothing(bench):
    bench.worker.submit(frame(0))
    assert bench.extrapolator.entered.acquire(timeout=WAIT_S)
    assert bench.worker.stop(0.01) is False
    bench.extrapolator.gate.release()
    assert bench.worker.stop(WAIT_S) is True
    assert bench.outputs.headers == []
    assert bench.statistics.snapshot().published == 0


def test_a_worker_waits_for_the_network_that_a_stopped_one_still_uses(bench):
    bench.worker.submit(frame('old'))
    assert bench.extrapolator.entered.acquire(timeout=WAIT_S)
    assert bench.worker.stop(0.01) is False
    outputs = KeptOutputs()
    successor = FrameWorker(bench.worker.processor, outputs, bench.statistics, print)
    successor.start()
    successor.submit(frame('new'))
    assert not bench.extrapolator.entered.acquire(timeout=0.2)
    for _ in range(2):
        bench.extrapolator.gate.release()
    assert outputs.published.acquire(timeout=WAIT_S)
    assert successor.stop(WAIT_S)
    assert (bench.outputs.headers, outputs.headers) == ([], ['new'])


def test_nothing_is_done_while_nobody_subscribes():
    outputs, statistics = KeptOutputs(Wanted(*[False] * 5)), Statistics()
    extrapolator = GatedExtrapolator()
    worker = FrameWorker(FrameProcessor(extrapolator), outputs, statistics, print)
    worker.start()
    worker.submit(frame(0, encoding='unknown'))
    time.sleep(0.05)
    assert worker.stop(WAIT_S)
    assert not extrapolator.entered.acquire(blocking=False)
    assert statistics.snapshot().rejected == {} and outputs.headers == []


def test_max_fps_takes_the_newest_frame_when_its_time_has_come(bench):
    bench.worker.max_fps = 5
    for _ in range(10):
        bench.extrapolator.gate.release()
    started = time.monotonic()
    bench.worker.submit(frame(0))
    assert bench.outputs.published.acquire(timeout=WAIT_S)
    bench.worker.submit(frame(1))
    bench.worker.submit(frame(2))
    assert bench.outputs.published.acquire(timeout=WAIT_S)
    assert time.monotonic() - started >= 0.2
    assert bench.outputs.headers == [0, 2]


def test_max_fps_may_be_raised_while_it_waits(bench):
    bench.worker.max_fps = 1e-11
    for _ in range(2):
        bench.extrapolator.gate.release()
    bench.worker.submit(frame(0))
    assert bench.outputs.published.acquire(timeout=WAIT_S)
    bench.worker.submit(frame(1))
    assert not bench.outputs.published.acquire(timeout=0.2)
    bench.worker.max_fps = 30
    assert bench.outputs.published.acquire(timeout=WAIT_S)
    assert bench.outputs.headers == [0, 1]


def resets_after(bench, header):
    """Let an image be widened; return how often the camera has been searched for anew."""
    bench.worker.submit(frame(header))
    bench.extrapolator.gate.release()
    assert bench.outputs.published.acquire(timeout=WAIT_S)
    return bench.extrapolator.resets


def test_a_camera_that_nobody_followed_may_be_elsewhere(bench):
    assert [resets_after(bench, 'first'), resets_after(bench, 'second')] == [1, 1]
    asked = threading.Event()

    def nothing():
        asked.set()
        return Wanted(*[False] * 5)

    with pytest.MonkeyPatch.context() as patch:
        patch.setattr(bench.outputs, 'wanted', nothing)
        bench.worker.submit(frame('unseen'))
        assert asked.wait(WAIT_S)
    assert [resets_after(bench, 'third'), resets_after(bench, 'fourth')] == [2, 2]
    bench.worker.forget()
    assert resets_after(bench, 'fifth') == 3


def test_a_camera_whose_mask_alone_is_wanted_is_not_followed(bench):
    assert resets_after(bench, 'first') == 1
    bench.outputs._wanted = Wanted(image=False, compressed=False, confidence=False)
    assert resets_after(bench, 'mask') == 1
    bench.outputs._wanted = Wanted()
    assert [resets_after(bench, 'third'), resets_after(bench, 'fourth')] == [2, 2]


def test_max_fps_may_become_none_at_any_moment():
    class Changing(FrameWorker):
        """Its limit goes away whenever somebody has looked at it."""

        looks = 0

        @property
        def max_fps(self):
            self.looks += 1
            return 1000.0 * (self.looks % 2)

        @max_fps.setter
        def max_fps(self, value):
            pass

    outputs, extrapolator = KeptOutputs(), GatedExtrapolator()
    worker = Changing(FrameProcessor(extrapolator), outputs, Statistics(), print)
    worker.start()
    for header in range(2):
        extrapolator.gate.release()
        worker.submit(frame(header))
        assert outputs.published.acquire(timeout=WAIT_S)
    assert worker.stop(WAIT_S)


def test_latency_is_split_into_stages(bench):
    bench.extrapolator.gate.release()
    bench.worker.submit(frame(0))
    assert bench.outputs.published.acquire(timeout=WAIT_S)
    assert bench.worker.stop(WAIT_S)
    spread = bench.statistics.snapshot().latency_ms
    assert list(spread) == ['queue', 'decode', 'infer', 'check', 'publish', 'total']
    parts = sum(spread[stage].max for stage in ('queue', 'decode', 'infer', 'check', 'publish'))
    assert parts <= spread['total'].max * 1.01 + 1
