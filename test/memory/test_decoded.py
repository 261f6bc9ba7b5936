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
    monkeypatch.setattr(decoded, 'CACHED_BYTES', 10 * size)
    frames = DecodedKeyframes()
    last = [frames.get((2, index), keyframe) for index in range(10)]
    for index in range(20):
        frames.get((1, index), keyframe)
    again: list[tuple[int, int]] = []

    def decode(key: tuple[int, int]) -> Keyframe:
        again.append(key)
        return keyframe()
    # Seven of the others were used later; but those that are drawn are kept of each.
    assert [frames.get((2, index), fail) for index in range(7, 10)] == last[7:]
    for index in range(13, 20):
        frames.get((1, index), fail)
    frames.get((1, 12), lambda: decode((1, 12)))
    assert again == [(1, 12)]


def test_what_others_keep_is_spared(monkeypatch: pytest.MonkeyPatch) -> None:
    size = keyframe().depth.nbytes + keyframe().texture.nbytes
    monkeypatch.setattr(decoded, 'CACHED_BYTES', 10 * size)
    small = DecodedKeyframes(4 * size)
    frames = DecodedKeyframes(beside=small)
    for index in range(10):
        frames.get((1, index), keyframe)
    for index in range(5):
        small.get((7, index), keyframe)
    assert (frames.kept_bytes, small.kept_bytes) == (10 * size, 4 * size)
    frames.get((1, 10), keyframe)
    assert frames.kept_bytes == 6 * size
    frames.ahead((1, 11), fail)  # No room beside six that are drawn.
    assert [frames.get((1, index), fail) is not None for index in range(5, 11)]
