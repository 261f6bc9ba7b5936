"""Reading ahead and writing behind keep the order, pass errors on and never hang."""
import threading
import time

from neo_ros.bags.background import read_ahead, WriteBehind
from neo_ros.errors import BagError
import pytest


def test_everything_comes_in_order() -> None:
    assert list(read_ahead(range(500), depth=3)) == list(range(500))
    done: list[int] = []
    with WriteBehind(depth=3) as behind:
        for i in range(500):
            behind.submit(done.append, i)
    assert done == list(range(500))


def test_the_source_is_read_ahead_but_not_further_than_allowed() -> None:
    taken: list[int] = []

    def source():
        for i in range(100):
            taken.append(i)
            yield i

    items = read_ahead(source(), depth=5)
    assert next(items) == 0
    deadline = time.monotonic() + 60
    while len(taken) < 7 and time.monotonic() < deadline:
        time.sleep(0.01)
    time.sleep(0.1)
    assert len(taken) == 7  # One was handed out, five wait, one does not fit.
    items.close()
    assert not any(thread.name == 'read ahead' for thread in threading.enumerate())


def test_an_error_of_the_source_comes_after_what_was_read() -> None:
    def source():
        yield 1
        raise BagError('no more')

    items = read_ahead(source())
    assert next(items) == 1
    with pytest.raises(BagError, match='no more'):
        next(items)


def _fail() -> None:
    raise BagError('disk full')


def test_an_error_of_a_call_is_raised_by_the_next_one_and_at_the_end() -> None:
    done: list[int] = []
    with pytest.raises(BagError, match='disk full'):
        with WriteBehind(depth=2) as behind:
            behind.submit(_fail)
            for i in range(10_000):
                behind.submit(done.append, i)
    assert done == []
    with pytest.raises(BagError, match='disk full'):
        with WriteBehind() as behind:
            behind.submit(_fail)


def test_what_waits_is_dropped_when_the_block_fails() -> None:
    done: list[int] = []
    go = threading.Event()
    with pytest.raises(RuntimeError, match='stop'):
        with WriteBehind() as behind:
            behind.submit(go.wait, 10)
            behind.submit(done.append, 1)
            threading.Timer(0.2, go.set).start()
            raise RuntimeError('stop')
    assert done == []
