"""What a camera shows consistently becomes part of the memory; what moves while it is seen not."""
from collections.abc import Callable, Sequence
from concurrent.futures import Future
from dataclasses import replace
import os
from pathlib import Path
import signal
import subprocess
import sys
import time

from box_board import DRIVE, teach_board, true_patch, with_board
from box_room import box_memory, EXPANSION, planar, SOURCE, view, write_box_model
from neo_ros.cli.main import app
from neo_ros.errors import ModelError
from neo_ros.geometry import Band, CameraPose
from neo_ros.memory import learning
from neo_ros.memory.changes import Changes, without_replaced
from neo_ros.memory.contradiction import contradicted, contradiction, ContradictionThresholds
from neo_ros.memory.journal import (
    HEADER_BYTES, journal_path, JournalWriter, read_journal)
from neo_ros.memory.learning import Learner, LearningThresholds, Learnt
from neo_ros.memory.patch import PARTS, Patch
from neo_ros.memory.patch_finding import _as_before, PatchThresholds
from neo_ros.memory.rendering import MemoryRenderer
from neo_ros.memory.scene_memory import SceneMemory
from neo_ros.memory.stereo import confirm, Shot, StereoThresholds
from neo_ros.memory.stereo_kernels import choose
from neo_ros.memory.turn import Record, Turn
from neo_ros.runtime import FovExtrapolator, read_model_card
import numpy as np
import pytest
from typer.testing import CliRunner

Where = Callable[[int], float]
LIMITS = ContradictionThresholds()


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


def error(memory: SceneMemory, middle: float = 1.8) -> tuple[float, float]:
    """Return the mean error of the board and of the rest, from a pose beside the drive."""
    pose = planar(1.8, 1.7, 12)
    truth, _, board = with_board(pose, EXPANSION.target, middle)
    off = np.abs(MemoryRenderer(memory).render(pose, EXPANSION.target).image - truth).mean(-1)
    return float(off[board].mean()), float(off[~board].mean())


@pytest.mark.slow
def test_a_patch_changes_its_surface_and_nothing_else() -> None:
    memory = box_memory()
    before, rest = error(memory)
    memory.change(Changes([true_patch(DRIVE[10])]))
    after, rest_after = error(memory)
    assert before > 60 and after < 0.5 * before and rest_after < rest + 0.5
    # Seen through later, it is gone.
    empty = DRIVE[12]
    image, depth = view(empty, SOURCE)
    memory.change(Changes([true_patch(DRIVE[10]), Patch.of(
        empty, SOURCE, image, depth.astype(np.float32), 1, 1)]))
    assert error(memory)[0] > 0.9 * before
    memory.change(None)
    assert error(memory) == (before, rest)


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
    before, rest = error(box_memory())
    memory, journal = learnt(tmp_path, lambda number: 1.8)
    after, rest_after = error(memory)
    assert after < 0.65 * before and rest_after < rest + 1
    again = box_memory()
    again.change(Changes(read_journal(journal, 'ab' * 32)))
    assert error(again) == pytest.approx((after, rest_after), abs=0.3)
    # Nothing that could never turn back.
    assert again.changes is not None
    for patch in again.changes.patches:
        _, depth, parts = patch.pictures
        samples = patch.samples
        told = np.bincount(samples.parts[samples.depths[:, 1] > 0], minlength=PARTS)
        assert told[np.unique(parts[depth > 0])].min() >= PatchThresholds().least_samples


@pytest.mark.slow
def test_a_board_that_goes_and_comes_is_shown_as_it_was_seen_last(tmp_path: Path) -> None:
    before, journal = error(box_memory())[0], tmp_path / 'a.journal'
    writer = JournalWriter(journal, 'ab' * 32, 1 << 20)
    writer.append([true_patch(one) for one in DRIVE[4:16:4]])
    writer.close()
    size = journal.stat().st_size
    for where, turns in ((99, 1), (1.8, 2), (99, 3)):
        memory, _ = learnt(tmp_path, ([float(where)] * len(DRIVE)).__getitem__)
        again, records = box_memory(), read_journal(journal, 'ab' * 32)
        again.change(Changes(records))
        for one in (memory, again):  # Also after a restart.
            assert (error(one)[0] > 0.9 * before) if where == 99 else (
                error(one)[0] < 0.5 * before)
        assert sum(isinstance(record, Turn) for record in records) == turns
        # Next to nothing is learnt anew.
        assert journal.stat().st_size < 1.5 * size


@pytest.mark.slow
def test_what_moves_is_not_learnt(tmp_path: Path) -> None:
    before, rest = error(box_memory())
    memory, _ = learnt(tmp_path, lambda number: 0.4 + 0.15 * number)
    after, rest_after = error(memory)
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


def test_what_shows_nothing_of_it_is_decoded_no_larger_than_needed(
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
    found, wanted = (one.keyframe(1, focal=10.0) for one in (memory, untouched))
    assert not any(seen)
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


def test_a_thin_thing_that_left_contradicts_as_one_that_came() -> None:
    wall = np.full((40, 40, 3), 200, np.float32)
    bar, aside = wall.copy(), wall.copy()
    bar[:, 20:23], aside[:, 18:21] = 40, 40
    known = np.ones((40, 40), bool)
    for image, shown, found in ((bar, wall, True), (wall, bar, True), (bar, aside, False)):
        off = contradicted(contradiction(image, shown, known))
        assert off[:, 20:23].all() == found and off.any() == found


@pytest.mark.parametrize('behind, stands', [(90, True), (200, False)])
def test_what_came_in_the_colour_of_what_is_behind_it_is_not_seen_through(
        behind: int, stands: bool) -> None:
    shape = (SOURCE.height, SOURCE.width)
    depths, shots = [], []
    for number in range(6):  # Three see something two metres away, three the wall at four.
        came = number < 3
        image = np.full((*shape, 3), 90 if came else behind, np.float32)
        depths.append(np.full(shape, 2.0 if came else 0, np.float32))
        shots.append(Shot(planar(1.9, 1.5 + 0.1 * number, 0), image, image,
                          np.full(shape, 4, np.float32), np.full(shape, came),
                          np.zeros(shape, np.float32), 0))
    found = confirm(shots, 0, np.stack(depths), SOURCE, SOURCE.pixel_rays(), StereoThresholds())
    middle = found[20:40, 28:36]
    assert (middle > 0).all() == stands and middle.any() == stands


@pytest.mark.parametrize('best, known', [(0, False), (1, True), (6, True), (7, False)])
def test_a_least_cost_at_an_end_of_the_range_is_no_depth(best: int, known: bool) -> None:
    # The sky, or the dark below a table, is alike at all depths, and a little more so far away.
    total = np.abs(np.arange(8, dtype=np.float32) - best)[None, None]
    inverse = np.linspace(1 / 14, 1 / 0.6, 8, dtype=np.float32)
    depth, off = np.empty((1, 1), np.float32), np.empty((1, 1), np.float32)
    choose(total, total, inverse, depth, off)
    assert depth[0, 0] == pytest.approx(1 / inverse[best] if known else 0) and off[0, 0] == 0


@pytest.mark.parametrize('made, same_depth, stays', [
    ('brighter', True, True), ('brighter', False, False), ('repainted', True, False),
    ('of another hue', True, False)], ids=str)
def test_a_surface_in_the_sun_is_no_change(made: str, same_depth: bool, stays: bool) -> None:
    pose = planar(1.9, 1.7, 35)
    shown, depth = (one.astype(np.float32) for one in view(pose, SOURCE))
    part = (slice(20, 44), slice(16, 48))
    image = shown.copy()
    image[part] = {'brighter': 1.5 * shown[part],
                   'of another hue': shown[part] * np.array([0.4, 1, 1.5], np.float32),
                   'repainted': np.random.default_rng(0).uniform(0, 255, shown[part].shape)}[made]
    seen = np.zeros_like(depth)
    seen[part] = depth[part] if same_depth else 0.7 * depth[part]
    # Where the window ends neighbours differ.
    found = _as_before(compared(pose, image, shown, depth), seen, PatchThresholds())[24:40, 20:44]
    assert (found.mean() > 0.95) if stays else (found.mean() < 0.3)


@pytest.mark.parametrize('repainted', [False, True])
def test_a_shelf_beside_somebody_is_no_change_if_it_is_only_blurred(repainted: bool) -> None:
    # Colours of the shelf are a little off, as where a memory is blurred.
    pose, random = planar(1.9, 1.7, 35), np.random.default_rng(0)
    depth = np.full((SOURCE.height, SOURCE.width), 3, np.float32)
    shown, seen = np.repeat(128 + 0 * depth[..., None], 3, -1), depth.copy()
    image = shown + random.choice([-14, 14], depth.shape)[..., None].astype(np.float32)
    image[:, 30:40], seen[:, 30:40] = 250, 1.5
    if repainted:
        image[20:40, 50:] = random.choice([0, 255], image[20:40, 50:].shape)
    shot = compared(pose, image, shown, depth)
    assert shot.contradicted.all()  # It goes together with who stands before it.
    found = _as_before(shot, seen, PatchThresholds())
    assert found[:, :30].all() and not found[:, 30:40].any()
    assert found[22:38, 52:62].mean() == (0 if repainted else 1)


def compared(pose: CameraPose, image: np.ndarray, shown: np.ndarray, depth: np.ndarray) -> Shot:
    score = contradiction(image, shown, depth > 0, LIMITS)
    return Shot(pose, image, shown, depth, contradicted(score, LIMITS), score, 0)


def drive_past(learner: Learner, memory: SceneMemory, poses: Sequence[CameraPose] = DRIVE) -> None:
    renderer = MemoryRenderer(memory)
    for pose in poses:
        shown = renderer.render(pose, EXPANSION.target)
        learner.see(with_board(pose, SOURCE)[0], shown.image, shown.depth, pose,
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
    assert memory.changes is not None and error(memory)[0] < 0.5 * error(box_memory())[0]
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
    assert error(again) == pytest.approx(error(memory), abs=0.3)


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
