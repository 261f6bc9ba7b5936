"""What a camera shows consistently becomes part of the memory; what moves while it is seen not."""
from collections.abc import Callable
from dataclasses import replace
import math
from pathlib import Path
import signal
import subprocess
import sys
import time

from box_board import board_error, DRIVE, teach_board, true_patch, with_board
from box_room import box_memory, EXPANSION, planar, SOURCE, view, write_box_model
from neo_ros.cli.main import app
from neo_ros.errors import ModelError
from neo_ros.geometry import Band
from neo_ros.memory.changes import Changes, without_replaced
from neo_ros.memory.journal import journal_path, JournalWriter, read_journal
from neo_ros.memory.learning import Learner, LearningThresholds
from neo_ros.memory.patch import PARTS, Patch
from neo_ros.memory.patch_finding import PatchThresholds
from neo_ros.memory.rendering import MemoryRenderer
from neo_ros.memory.scene_memory import SceneMemory
from neo_ros.memory.turn import Record, Turn
from neo_ros.runtime import FovExtrapolator, read_model_card
import numpy as np
import pytest
from typer.testing import CliRunner

Where = Callable[[int], float]


def learnt(folder: Path, where: Where) -> tuple[SceneMemory, Path]:
    """Drive past a board whose middle a frame's number tells; return memory and journal."""
    memory, journal = box_memory(), folder / 'a.journal'
    if journal.exists():
        memory.change(Changes(read_journal(journal, 'ab' * 32)))
    learner = Learner(memory, EXPANSION, lambda: JournalWriter(journal, 'ab' * 32, 1 << 20),
                      False, LearningThresholds(batch=10, window=20, metres=0.01))
    renderer = MemoryRenderer(memory)
    for number, pose in enumerate(DRIVE):
        shown = renderer.render(pose, EXPANSION.target)
        learner.see(with_board(pose, SOURCE, where(number))[0], shown.image, shown.depth, pose,
                    np.ones(3, np.float32), 0.9)
    learner.finish()
    return memory, journal


@pytest.mark.slow
def test_a_patch_changes_its_surface_and_nothing_else() -> None:
    memory = box_memory()
    before, rest = board_error(memory)
    memory.change(Changes([true_patch(DRIVE[10])]))
    after, rest_after = board_error(memory)
    assert before > 60 and after < 0.5 * before and rest_after < rest + 0.5
    # Seen through later, it is gone.
    empty = DRIVE[12]
    image, depth = view(empty, SOURCE)
    memory.change(Changes([true_patch(DRIVE[10]), Patch.of(
        empty, SOURCE, image, depth.astype(np.float32), 1, 1)]))
    assert board_error(memory)[0] > 0.9 * before
    memory.change(None)
    assert board_error(memory) == (before, rest)


@pytest.mark.slow
def test_what_was_learnt_is_decoded_before_it_is_shown(monkeypatch: pytest.MonkeyPatch) -> None:
    memory, changes = box_memory(), Changes([true_patch(DRIVE[10])])
    memory.keyframe(0), memory.keyframe(1, focal=10.0)
    drawn = memory.drawn_with(changes)
    memory.change(changes)
    expected = [memory.keyframe(0), memory.keyframe(1, focal=10.0)]
    assert not np.array_equal(expected[0].texture, box_memory().keyframe(0).texture)
    memory.change(changes, drawn)
    monkeypatch.setattr(memory, '_decode', None)  # Nobody waits for it.
    for found, wanted in zip((memory.keyframe(0), memory.keyframe(1, focal=10.0)), expected):
        assert np.array_equal(found.texture, wanted.texture)
        assert np.array_equal(found.depth, wanted.depth)


@pytest.mark.slow
def test_what_stays_is_learnt(tmp_path: Path) -> None:
    before, rest = board_error(box_memory())
    memory, journal = learnt(tmp_path, lambda number: 1.8)
    after, rest_after = board_error(memory)
    assert after < 0.65 * before and rest_after < rest + 1
    again = box_memory()
    again.change(Changes(read_journal(journal, 'ab' * 32)))
    assert board_error(again) == pytest.approx((after, rest_after), abs=0.3)
    # Nothing that could never turn back.
    assert again.changes is not None
    for patch in again.changes.patches:
        _, depth, parts = patch.pictures
        samples = patch.samples
        told = np.bincount(samples.parts[samples.depths[:, 1] > 0], minlength=PARTS)
        assert told[np.unique(parts[depth > 0])].min() >= PatchThresholds().least_samples


@pytest.mark.slow
def test_a_board_that_goes_and_comes_is_shown_as_it_was_seen_last(tmp_path: Path) -> None:
    before, journal = board_error(box_memory())[0], tmp_path / 'a.journal'
    writer = JournalWriter(journal, 'ab' * 32, 1 << 20)
    writer.append([true_patch(one) for one in DRIVE[4:16:4]])
    writer.close()
    size = journal.stat().st_size
    for where, turns in ((99, 1), (1.8, 2), (99, 3)):
        memory, _ = learnt(tmp_path, ([float(where)] * len(DRIVE)).__getitem__)
        again, records = box_memory(), read_journal(journal, 'ab' * 32)
        again.change(Changes(records))
        for one in (memory, again):  # Also after a restart.
            assert (board_error(one)[0] > 0.9 * before) if where == 99 else (
                board_error(one)[0] < 0.5 * before)
        assert sum(isinstance(record, Turn) for record in records) == turns
        # Next to nothing is learnt anew.
        assert journal.stat().st_size < 1.5 * size


@pytest.mark.slow
def test_what_moves_is_not_learnt(tmp_path: Path) -> None:
    before, rest = board_error(box_memory())
    memory, _ = learnt(tmp_path, lambda number: 0.4 + 0.15 * number)
    after, rest_after = board_error(memory)
    assert after > 0.8 * before and rest_after < rest + 1


def test_what_agrees_teaches_nothing(tmp_path: Path) -> None:
    memory, journal = learnt(tmp_path, lambda number: 99)
    assert memory.changes is None and not journal.exists()


def test_what_later_visits_saw_is_left_out() -> None:
    first, second, same = true_patch(DRIVE[10]), true_patch(DRIVE[10], 1), true_patch(DRIVE[11], 1)
    assert without_replaced([first, second, same]) == [second, same]
    assert without_replaced([second, same]) == [second, same]


def test_what_was_shown_again_lies_under_what_came_later_even_when_compacted() -> None:
    """Two halves: the left one goes and comes back, the right one is replaced meanwhile."""
    halves = true_patch(DRIVE[10])
    image, depth, _ = halves.pictures
    parts = np.zeros(depth.shape, np.uint8)
    parts[:, parts.shape[1] // 2:] = 1
    halves = Patch.of(halves.pose, halves.camera, image, depth, 0, 0, parts=parts)
    other = Patch.of(halves.pose, halves.camera, 255 - image, np.where(parts, depth, 0), 1, 1)
    left = Turn(np.full(1, PARTS, np.uint32), 2, 2)
    records: list[Record] = [true_patch(DRIVE[12]), halves, other, left, left]
    compacted = without_replaced([*records, left, left])
    assert len(compacted) < len(records) + 2
    band, position = Band(1.0, -1.0), DRIVE[10].position
    shown = [Changes(some).put_into(position, band, 1, np.full((256, 512, 3), 90, np.uint8),
                                    np.zeros((128, 256), np.uint16))
             for some in (records, compacted)]
    assert not (shown[0][0] == 90).all()
    assert np.array_equal(shown[0][0], shown[1][0]) and np.array_equal(shown[0][1], shown[1][1])


def test_what_shows_nothing_of_it_is_decoded_as_it_was_made_and_no_larger_than_needed(
        monkeypatch: pytest.MonkeyPatch) -> None:
    memory, untouched = box_memory(), box_memory()
    patch = true_patch(DRIVE[10])
    memory.change(Changes([patch]))
    assert not np.array_equal(memory.keyframe(1, focal=10.0).texture,
                              untouched.keyframe(1, focal=10.0).texture)
    # As far as from the next room, whose wall hides it.
    away = replace(patch, pose=planar(40.0, 40.0, 12))
    changes = Changes([away])
    seen = [changes.reaches(position, memory.band, untouched.pictures(index, 1)[1])
            for index, position in enumerate(memory.positions)]
    memory.change(changes)
    monkeypatch.setattr(Changes, 'put_into', None)  # Which takes it in full size.
    assert not any(seen)
    for focal in (10.0, math.inf):
        found, wanted = (one.keyframe(1, focal) for one in (memory, untouched))
        np.testing.assert_array_equal(found.texture, wanted.texture)
        np.testing.assert_array_equal(found.depth, wanted.depth)


def test_what_is_changed_was_reached() -> None:
    random, band = np.random.default_rng(0), Band(1.0, -1.0)
    changed, reached = [], []
    for number in range(60):
        # Where nothing is known anything may be shown.
        depths = np.array([0, 250, 340, 700, 2000][number % 3 > 0:], np.uint16)
        coded = np.ascontiguousarray(
            random.choice(depths, (8, 16)).repeat(8, 0).repeat(8, 1))
        position = DRIVE[10].position + random.uniform(-3, 3, 3)
        changes = Changes([true_patch(DRIVE[random.integers(len(DRIVE))])])
        texture, after = changes.put_into(
            position, band, 1, np.full((128, 256, 3), 90, np.uint8), coded)
        changed.append(not np.array_equal(after, coded) or bool((texture != 90).any()))
        reached.append(changes.reaches(position, band, coded))
        assert reached[-1] or not changed[-1]
    assert any(changed) and not all(reached)


def checksum(model: Path) -> str:
    memory = read_model_card(model).memory
    assert memory is not None
    return memory.sha256


def test_the_command_tells_compacts_and_forgets(tmp_path: Path) -> None:
    model = write_box_model(tmp_path)
    sha256 = checksum(model)
    journal = journal_path(tmp_path / 'box.memory')
    run = CliRunner().invoke
    assert 'nothing was learnt' in run(app, ['memory', 'info', str(model)]).output
    writer = JournalWriter(journal, sha256, 1 << 20)
    writer.append([true_patch(DRIVE[10]), true_patch(DRIVE[10], 1)])
    writer.close()
    assert '2, of 2 times' in run(app, ['memory', 'info', str(model)]).output
    assert '1 of 2 records kept' in run(app, ['memory', 'compact', str(model)]).output.replace(
        '\n', ' ')
    assert len(read_journal(journal, sha256)) == 1
    assert run(app, ['memory', 'forget', str(model)]).exit_code == 0 and not journal.exists()
    (tmp_path / 'box.memory').unlink()
    told = run(app, ['memory', 'info', str(model)])
    assert isinstance(told.exception, ModelError) and 'copy it beside' in str(told.exception)


def test_a_model_shows_what_its_journal_holds(tmp_path: Path) -> None:
    model = write_box_model(tmp_path)
    pose = planar(1.8, 1.7, 12)
    image, _, board = with_board(pose, EXPANSION.target)
    seen = np.ascontiguousarray(EXPANSION.crop(image))
    untaught = FovExtrapolator.load(model).expand(seen).guide
    teach_board(model)
    taught = FovExtrapolator.load(model).expand(seen).guide
    assert untaught is not None and taught is not None
    off = [np.abs(one.image[board] - image[board]).mean() for one in (untaught, taught)]
    assert off[1] < 0.5 * off[0]


def kill_once(folder: Path, after: float) -> int:
    """Kill a process that appends patches after so many seconds; return how many are whole."""
    journal = folder / 'k.journal'
    code = ('import sys; sys.path[:0] = ["test/memory", "test/helpers"]\n'
            'from test_journal import JournalWriter, MEMORY, patch\nfrom pathlib import Path\n'
            f'writer = JournalWriter(Path({str(journal)!r}), MEMORY, 1 << 30)\n'
            'patches = [patch(n) for n in range(50)]\nprint(flush=True)\n'
            'while True:\n    writer.append(patches)\n')
    process = subprocess.Popen([sys.executable, '-c', code], stdout=subprocess.PIPE)
    assert process.stdout and process.stdout.readline()
    time.sleep(after)
    process.send_signal(signal.SIGKILL)
    process.wait()
    process.stdout.close()
    found = read_journal(journal, 'ab' * 32)
    # Whatever was cut off, the next process goes on behind the last whole record.
    writer = JournalWriter(journal, 'ab' * 32, 1 << 30)
    assert len(writer.records) == len(found) and len(writer.append([true_patch(DRIVE[0])])) == 1
    writer.close()
    assert len(read_journal(journal, 'ab' * 32)) == len(found) + 1
    journal.unlink()
    return len(found)


@pytest.mark.slow
@pytest.mark.parametrize('after', [0.0, 0.003, 0.02, 0.05])
def test_killed_at_any_moment_it_holds_whole_patches(tmp_path: Path, after: float) -> None:
    assert kill_once(tmp_path, after) >= 0
