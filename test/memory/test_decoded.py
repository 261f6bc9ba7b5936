"""Keyframes are decoded once, ahead where that is asked for, and the latest ones are kept."""
import threading

from neo_ros.memory import decoded
from neo_ros.memory.decoded import DecodedKeyframes, LEAST_CACHED
from neo_ros.memory.keyframe import Keyframe
import numpy as np
import pytest


def keyframe() -> Keyframe:
    return Keyframe(np.zeros(3), np.zeros((2, 2), np.float32), np.zeros((2, 2, 3), np.uint8))


def fail() -> Keyframe:
    raise AssertionError('decoded once more')


def test_what_was_decoded_ahead_is_not_decoded_again() -> None:
    frames, ahead = DecodedKeyframes(), keyframe()
    frames.get((1, 0), keyframe)
    where: list[str] = []

    def decode() -> Keyframe:
        where.append(threading.current_thread().name)
        return ahead
    frames.ahead((1, 1), decode)
    frames.ahead((1, 1), fail)
    frames.ahead((1, 0), fail)
    assert frames.get((1, 1), fail) is ahead and frames.get((1, 1), fail) is ahead
    assert len(where) == 1 and where[0].startswith('keyframes')


def test_a_keyframe_that_is_asked_for_while_it_is_decoded_is_waited_for() -> None:
    frames, ahead, started = DecodedKeyframes(), keyframe(), threading.Event()
    frames.get((1, 0), keyframe)

    def decode() -> Keyframe:
        started.wait()
        return ahead
    frames.ahead((1, 1), decode)
    threading.Timer(0.05, started.set).start()
    assert frames.get((1, 1), fail) is ahead


def test_a_damaged_one_fails_when_it_is_asked_for_and_is_tried_again() -> None:
    frames, whole = DecodedKeyframes(), keyframe()
    frames.get((1, 0), keyframe)
    frames.ahead((1, 1), fail)
    with pytest.raises(AssertionError, match='once more'):
        frames.get((1, 1), keyframe)
    assert frames.get((1, 1), lambda: whole) is whole


def test_nothing_that_is_drawn_gives_way_to_what_may_be(monkeypatch: pytest.MonkeyPatch) -> None:
    monkeypatch.setattr(decoded, 'CACHED_BYTES', 1)
    frames = DecodedKeyframes()
    shown = [frames.get((1, index), keyframe) for index in range(LEAST_CACHED)]
    for index in range(LEAST_CACHED, 9):
        frames.ahead((1, index), fail)
    assert [frames.get((1, index), fail) for index in range(LEAST_CACHED)] == shown


def test_what_is_kept_of_all_reductions_has_room_together(monkeypatch: pytest.MonkeyPatch) -> None:
    size = keyframe().depth.nbytes + keyframe().texture.nbytes
    monkeypatch.setattr(decoded, 'CACHED_BYTES', 14 * size)
    frames = DecodedKeyframes()
    last = [frames.get((2, index), keyframe) for index in range(10)]
    for index in range(20):
        frames.get((1, index), keyframe)
    again: list[tuple[int, int]] = []

    def decode(key: tuple[int, int]) -> Keyframe:
        again.append(key)
        return keyframe()
    # The others were used later, and eleven are kept; but of each those that are drawn.
    assert [frames.get((2, index), fail) for index in range(7, 10)] == last[7:]
    for index in range(9, 20):
        frames.get((1, index), fail)
    frames.get((1, 8), lambda: decode((1, 8)))
    assert again == [(1, 8)]


@pytest.mark.parametrize('kept, room', [(3, 0), (4, 7), (8, 8)])
def test_large_ones_have_room_to_be_decoded_ahead(
        kept: int, room: int, monkeypatch: pytest.MonkeyPatch) -> None:
    """Six that are drawn, now and next, and one ahead need seven; up to twice as many are kept."""
    size = keyframe().depth.nbytes + keyframe().texture.nbytes
    monkeypatch.setattr(decoded, 'CACHED_BYTES', kept * size)
    frames, ahead = DecodedKeyframes(), keyframe()
    for index in range(9):
        frames.get((1, index), keyframe)
    frames.ahead((1, 9), lambda: ahead)
    if not room:
        assert frames.get((1, 9), keyframe) is not ahead
        return
    assert frames.get((1, 9), fail) is ahead
    for index in range(10 - room, 10):
        frames.get((1, index), fail)
    with pytest.raises(AssertionError, match='once more'):
        frames.get((1, 9 - room), fail)
