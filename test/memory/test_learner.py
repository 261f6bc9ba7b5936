"""Who learns while a camera drives: turns, journals of several, full disks, clocks."""
from collections.abc import Sequence
from concurrent.futures import Future
import os
from pathlib import Path
import time
import weakref

from box_board import board_error, DRIVE, true_patch, with_board
from box_room import box_memory, EXPANSION, SOURCE
from neo_ros.geometry import CameraPose
from neo_ros.memory import learning
from neo_ros.memory.changes import Changes
from neo_ros.memory.journal import (
    HEADER_BYTES, JournalWriter, read_journal, write_journal)
from neo_ros.memory.learning import Learner, LearningThresholds, Learnt
from neo_ros.memory.rendering import MemoryRenderer
from neo_ros.memory.scene_memory import SceneMemory
from neo_ros.memory.turn import Record, Turn
import numpy as np
import pytest


def drive_past(learner: Learner, memory: SceneMemory, poses: Sequence[CameraPose] = DRIVE,
               middle: float = 1.8) -> None:
    renderer = MemoryRenderer(memory)
    for pose in poses:
        shown = renderer.render(pose, EXPANSION.target)
        learner.see(with_board(pose, SOURCE, middle)[0], shown.image, shown.depth, pose,
                    np.ones(3, np.float32), 0.9)


def learner_of(memory: SceneMemory, journal: Path, beside: bool = False, most: int = 1 << 20
               ) -> Learner:
    return Learner(memory, EXPANSION, lambda: JournalWriter(journal, 'ab' * 32, most), beside,
                   LearningThresholds(batch=10, window=20, metres=0.01))


@pytest.mark.slow
def test_what_others_learnt_meanwhile_is_shown_and_what_comes_next_follows_it(
        tmp_path: Path) -> None:
    memory, journal = box_memory(), tmp_path / 'a.journal'
    learner = learner_of(memory, journal)
    theirs = [true_patch(one, batch=3) for one in DRIVE[4:16:4]]
    writer = JournalWriter(journal, 'ab' * 32, 1 << 20)
    writer.append(theirs)
    writer.close()
    drive_past(learner, memory, DRIVE[:11])
    assert memory.changes is not None
    assert board_error(memory)[0] < 0.5 * board_error(box_memory())[0]
    assert [one.to_bytes() for one in memory.changes.records] == [
        one.to_bytes() for one in theirs]
    # The board leaves: their patches turn, by their own numbers.
    renderer = MemoryRenderer(memory)
    for pose in DRIVE:
        shown = renderer.render(pose, EXPANSION.target)
        learner.see(with_board(pose, SOURCE, 99)[0], shown.image, shown.depth, pose,
                    np.ones(3, np.float32), 0.9)
    learner.finish()
    found = read_journal(journal, 'ab' * 32)
    turns = [one for one in found if isinstance(one, Turn)]
    assert len(turns) == 1 and turns[0].batch > 3
    again = box_memory()
    again.change(Changes(found))
    assert board_error(again) == pytest.approx(board_error(memory), abs=0.3)


@pytest.mark.slow
def test_who_stops_after_the_work_was_done_lets_others_write(tmp_path: Path) -> None:
    memory, journal = box_memory(), tmp_path / 'a.journal'
    learner = learner_of(memory, journal, beside=True)
    drive_past(learner, memory, DRIVE[:10])
    assert learner._pending is not None
    learner._pending.result()
    learner.close()
    JournalWriter(journal, 'ab' * 32, 1 << 20).close()


@pytest.mark.slow
def test_a_disk_that_is_full_in_the_middle_leaves_no_two_opinions(
        tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    memory, journal = box_memory(), tmp_path / 'a.journal'
    learner, written = learner_of(memory, journal), list[bytes]()
    write = os.pwrite

    def short(file: int, content: bytes, at: int) -> int:
        written.append(content)
        # The header, a patch, and half of the next one.
        return write(file, content[:len(content) if len(written) < 3 else 9], at)

    with monkeypatch.context() as limited:
        limited.setattr(os, 'pwrite', short)
        drive_past(learner, memory, DRIVE[:11])
    assert len(written) == 3 and memory.changes is None
    for _ in range(2):  # What is on the disk is shown first, then what is new.
        drive_past(learner, memory)
    learner.finish()
    assert memory.changes is not None and len(memory.changes.patches) > 1
    assert [one.to_bytes() for one in memory.changes.records] == [
        one.to_bytes() for one in read_journal(journal, 'ab' * 32)]


@pytest.mark.slow
def test_a_full_journal_costs_no_stereo_and_says_so_once(
        tmp_path: Path, monkeypatch: pytest.MonkeyPatch, caplog: pytest.LogCaptureFixture
        ) -> None:
    memory, journal = box_memory(), tmp_path / 'a.journal'
    learner, asked = learner_of(memory, journal, most=HEADER_BYTES + 1), list[int]()
    find = learning.find_patches

    def watched(shots, *rest):  # type: ignore[no-untyped-def]
        asked.append(len(shots))
        return find(shots, *rest)

    monkeypatch.setattr(learning, 'find_patches', watched)
    for _ in range(3):
        drive_past(learner, memory)
    learner.finish()
    assert len(asked) == 1 and memory.changes is None
    assert caplog.text.count('the journal is full') == 1


@pytest.mark.slow
def test_a_journal_full_of_the_same_is_emptied_of_it_and_learns_on(
        tmp_path: Path, caplog: pytest.LogCaptureFixture) -> None:
    memory, journal, same = box_memory(), tmp_path / 'a.journal', [
        true_patch(pose, batch) for batch in range(12) for pose in DRIVE[4:16:4]]
    write_journal(journal, 'ab' * 32, same)
    memory.change(Changes(read_journal(journal, 'ab' * 32)))
    before, most = board_error(memory, 0.9)[0], journal.stat().st_size
    learner = learner_of(memory, journal, most=most)
    for _ in range(2):
        drive_past(learner, memory, middle=0.9)
    learner.finish()
    assert board_error(memory, 0.9)[0] < 0.7 * before
    found = read_journal(journal, 'ab' * 32)
    assert memory.changes is not None
    assert [one.to_bytes() for one in memory.changes.records] == [
        one.to_bytes() for one in found]
    assert 0 < sum(one.batch < 12 for one in found) < len(same) / 2
    assert journal.stat().st_size <= most and 'the journal is full' not in caplog.text


def test_what_was_written_before_is_kept_decoded_once(tmp_path: Path) -> None:
    memory, journal, opened = box_memory(), tmp_path / 'a.journal', list[weakref.ref[Record]]()
    write_journal(journal, 'ab' * 32, [true_patch(DRIVE[10])])
    memory.change(Changes(read_journal(journal, 'ab' * 32)))
    learner = learner_of(memory, journal)

    def watched() -> JournalWriter:
        writer = JournalWriter(journal, 'ab' * 32, 1 << 20)
        opened.extend(map(weakref.ref, writer.records))
        return writer

    learner._open_journal = watched
    drive_past(learner, memory, DRIVE[:11], middle=0.9)
    assert learner._journal is not None and [one() for one in opened] == [None]
    learner.close()


def test_images_that_waited_for_a_turn_are_no_witnesses_even_if_more_came_than_are_kept(
        tmp_path: Path) -> None:
    memory = box_memory()
    learner = learner_of(memory, tmp_path / 'a.journal')
    learner._pending = Future()
    drive_past(learner, memory)
    learner._new = len(learner._shots) + 5
    learner._pending.set_result(Learnt(learner._changes, {}, others=False, turned=True))
    learner._take_up()
    assert learner._shots == [] and learner._new == 0


def test_an_image_drawn_before_the_memory_changed_is_no_witness(tmp_path: Path) -> None:
    memory = box_memory()
    learner = learner_of(memory, tmp_path / 'a.journal')
    learner._pending = Future()
    learner._pending.set_result(Learnt(
        Changes([true_patch(DRIVE[10])]), {}, others=False, turned=True))
    drive_past(learner, memory, DRIVE[:1])
    assert memory.changes is not None and learner._shots == []
    drive_past(learner, memory, DRIVE[1:2])
    assert len(learner._shots) == 1


@pytest.mark.parametrize('beside, pause_s, kept', [
    (False, 60, 6), (False, 3600, 1), (True, 3600, 6)])
def test_a_replay_counts_time_as_the_camera_did_and_a_robot_by_its_own_clock(
        beside: bool, pause_s: int, kept: int, tmp_path: Path) -> None:
    memory = box_memory()
    learner, renderer = learner_of(memory, tmp_path / 'a.journal', beside), MemoryRenderer(memory)
    for number, pose in enumerate(DRIVE[:6]):
        shown = renderer.render(pose, EXPANSION.target)
        stamp_ns = (number + pause_s * (number == 5)) * 10 ** 9
        learner.see(with_board(pose, SOURCE)[0], shown.image, shown.depth, pose,
                    np.ones(3, np.float32), 0.9, stamp_ns)
    # After ten minutes it is another visit.
    assert len(learner._shots) == kept
    assert 0 <= time.time_ns() - learner._shots[-1].stamp_ns + 10 ** 9 * (
        0 if beside else pause_s + 5) < 60 * 10 ** 9
