"""Processes are killed when they should be, and what is found afterwards is told."""
import hashlib
from pathlib import Path
import sys

from box_room import write_box_model
from neo_ros.benchmark import kills
from neo_ros.benchmark.kill_victims import journal_of, marks
from neo_ros.benchmark.killing import digests, end, find, kill, neo
from neo_ros.benchmark.kills import Journal, Tally
from neo_ros.benchmark.small_room import AFTER, BEFORE, drive, look, WIDE
from neo_ros.errors import NeoError
from neo_ros.geometry import CameraPose
from neo_ros.machine.result_rows import ResultRows
from neo_ros.memory.journal import JournalWriter, read_journal
from neo_ros.memory.patch import Patch
import numpy as np
import pytest

pytestmark = pytest.mark.slow


def python(code: str) -> list[str]:
    return [sys.executable, '-c', code]


def small_patch(number: int) -> Patch:
    image, depth, post = look(drive()[number], WIDE.source, AFTER)
    return Patch.of(drive()[number], WIDE.source, image, np.where(post, depth, 0).astype(
        np.float32), 10 ** 9 + number, 0)


def test_a_process_is_killed_behind_what_it_was_waited_for(tmp_path: Path) -> None:
    began = tmp_path / 'began'
    endless = python('import pathlib, time\nprint(\'{"records": [1]}\', flush=True)\n'
                     f'pathlib.Path({str(began)!r}).touch()\nwhile True: time.sleep(1)')
    seen: list[bool] = []
    killed = kill(endless, began.exists, 0.01, look=lambda: seen.append(began.exists()))
    assert killed.alive and killed.said == {'records': [1]} and seen == [True]
    # What ended before is not waited for.
    assert not kill(python('pass'), lambda: False).alive
    with pytest.raises(NeoError, match='no such thing'):
        end(python('raise SystemExit("no such thing")'))
    assert end(python('pass')) < 30


def test_a_fresh_process_tells_what_a_journal_holds(tmp_path: Path) -> None:
    model = write_box_model(tmp_path)
    journal = Journal(model)
    patches = [small_patch(number) for number in range(20, 23)]
    writer = JournalWriter(journal.path, journal.sha256, 1 << 20)
    writer.append(patches)
    writer.close()
    journal.records = marks(patches[:2])
    with journal.path.open('ab') as file:
        file.write(b'cut')
    found = find(model)
    assert found is not None and found.cut_short and found.last_ns == 10 ** 9 + 22
    assert found.records == marks(patches) and journal.goes_on(found.records)
    assert not journal.goes_on(found.records[1:]) and not journal.goes_on(journal.records)
    journal.anew()
    assert not journal.size and read_journal(*journal_of(model)) == []
    (tmp_path / 'box.memory').write_bytes(b'gone')
    assert find(model) is None


def test_rows_are_kept_and_not_measured_again(tmp_path: Path,
                                              monkeypatch: pytest.MonkeyPatch) -> None:
    calls: list[tuple[str, int, str]] = []

    def record(what: str, count: int, moment: str, random: np.random.Generator) -> Tally:
        calls.append((what, count, moment))
        return Tally(kills=count, loaded=count)

    monkeypatch.setattr(kills, 'prepare', lambda work: work / 'room.onnx')
    monkeypatch.setattr(kills, 'kill_cameras', lambda model, *rest: record('journal', *rest))
    monkeypatch.setattr(kills, 'kill_updates', lambda work, *rest: record('update', *rest))
    monkeypatch.setattr(kills, 'kill_rewriting', lambda model, *rest: record(*rest))
    rows = tmp_path / 'kills.json'
    for parts in (['compact'], ['journal', 'update', 'compact']):
        kills.measure(tmp_path, ResultRows(rows), 200, 0, parts)
    assert [call[0] for call in calls] == ['compact'] * 2 + ['forget'] + [
        'journal'] * 2 + ['update'] * 2
    assert sum(call[1] for call in calls) == 200
    assert {row['kills'] for row in ResultRows(rows).rows} == {10, 20, 40, 50}


def test_the_room_is_the_one_of_the_memory(tmp_path: Path) -> None:
    pose = CameraPose.from_planar(2.0, 2.0, 1.4, 0.2)
    before, _, post = look(pose, WIDE.source, BEFORE)
    after, depth, moved = look(pose, WIDE.source, AFTER)
    assert post.any() and moved.any() and (depth > 0).all()
    np.testing.assert_array_equal(before[~(post | moved)], after[~(post | moved)])


def test_digests_and_commands(tmp_path: Path) -> None:
    (tmp_path / 'a').mkdir()
    (tmp_path / 'a' / 'b').write_bytes(b'c')
    assert digests(tmp_path) == {'a/b': hashlib.sha256(b'c').hexdigest()}
    assert neo('memory', 'info', tmp_path)[1:] == [
        '-m', 'neo_ros.cli.main', 'memory', 'info', str(tmp_path)]
