"""The mailbox gives the newest item and lets nobody wait for ever."""
import threading

from hypothesis import given, strategies as st
from neo_ros.node.one_slot import Mailbox


@given(st.lists(st.integers(), min_size=1))
def test_newest_item_wins_and_every_replaced_one_is_told(items):
    mailbox: Mailbox = Mailbox()
    replaced = [mailbox.put(item) for item in items]
    assert replaced == [False] + [True] * (len(items) - 1)
    assert mailbox.take() == items[-1]
    assert mailbox.put('next') is False


def test_take_waits_for_an_item():
    mailbox: Mailbox = Mailbox()
    taken: list = []
    reader = threading.Thread(target=lambda: taken.append(mailbox.take()))
    reader.start()
    mailbox.put('frame')
    reader.join(5)
    assert taken == ['frame']


def test_close_wakes_the_reader_and_loses_what_is_inside():
    mailbox: Mailbox = Mailbox()
    taken: list = []
    reader = threading.Thread(target=lambda: taken.append(mailbox.take()))
    reader.start()
    mailbox.close()
    reader.join(5)
    mailbox.put('late')
    assert taken == [None] and mailbox.take() is None
