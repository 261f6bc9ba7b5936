"""What the figures of a flat that changes are made of."""
from functools import partial
import hashlib
import json
from pathlib import Path
import shutil

from neo_ros.benchmark import lives
from neo_ros.benchmark.lives import become_a_day_older, RULES, walks_of
from neo_ros.benchmark.lives_scores import ScoreRules, turned_wrong, Walks, write_rows
from neo_ros.flat.visits import CHAIRS, Visit
from neo_ros.geometry import CameraPose, Intrinsics
from neo_ros.memory.journal import journal_path, read_journal, write_journal
from neo_ros.memory.patch import Patch
from neo_ros.memory.turn import PAUSE_NS, Turn
import numpy as np
import pytest
from tiny_model import write_tiny_model

CAMERA = Intrinsics.from_hfov(8, 8, 1.6)


@pytest.mark.slow
def test_walks_are_cast_once_and_keep_off_what_was_moved(
        tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    before, after = (walks_of(Visit(changes), RULES.test_seed, 6, CAMERA, tmp_path, name)
                     for name, changes in (('day', ()), ('moved', CHAIRS)))
    assert np.array_equal(before.T, after.T) and len(before.images) == len(before.T) > 10
    assert set(before.walk) <= set(range(6))
    for chair in CHAIRS:
        away = np.linalg.norm(before.T[:, :2, 3] - chair.goal, axis=1)
        assert away.min() >= RULES.nearest
    apart = np.abs(before.images.astype(int) - after.images).mean(-1) > ScoreRules.changed
    assert 0 < apart.mean() < 0.2
    monkeypatch.setattr(lives, '_cast', None)
    again = walks_of(Visit(), RULES.test_seed, 6, CAMERA, tmp_path, 'day')
    assert np.array_equal(again.images, before.images)


def test_a_false_change_was_right_before_and_is_in_the_ring() -> None:
    truth = np.full((1, 4, 4, 3), 100, np.uint8)
    old = truth.copy()
    old[0, 0] = 200  # Has changed: what is learnt there is no false change.
    shown, taught = truth.copy(), truth.copy()
    shown[0, 1, 0] = 200   # Was wrong before.
    taught[0, :2] = 10
    taught[0, 3, 3] = 160  # Outside the ring.
    ring = np.ones((4, 4), bool)
    ring[3, 3] = False
    walks = Walks(truth, np.eye(4)[None], np.zeros(1, int))
    before = Walks(old, walks.T, walks.walk)
    assert turned_wrong(walks, before, [shown[0]], [taught[0]], ring) == pytest.approx(3 / 11)
    assert turned_wrong(walks, before, [taught[0]], [shown[0]], ring) == 0


def test_what_was_learnt_on_a_visit_is_older_on_the_next(tmp_path: Path) -> None:
    memory = tmp_path / 'flat.memory'
    memory.write_bytes(b'a memory')
    checksum, now = hashlib.sha256(b'a memory').hexdigest(), 10 ** 18
    seen = Patch.of(CameraPose(np.eye(4)), CAMERA, np.zeros((8, 8, 3), np.uint8),
                    np.ones((8, 8), np.float32), now, 3)
    write_journal(journal_path(memory), checksum,
                  [seen, Turn(np.zeros(1, np.uint32), now + 1, 4)])
    become_a_day_older(memory.with_suffix('.onnx'))
    patch, turn = read_journal(journal_path(memory), checksum)
    assert now - patch.stamp_ns > PAUSE_NS and turn.stamp_ns - patch.stamp_ns == 1
    assert isinstance(patch, Patch) and patch.to_bytes()[8:] == seen.to_bytes()[8:]


def test_rows_that_were_not_measured_again_stay(tmp_path: Path) -> None:
    out = tmp_path / 'rows.json'
    first = [{'scene': 'flat', 'visit': 1, 'mode': mode, 'x': 0} for mode in ('none', 'update')]
    write_rows(out, first)
    write_rows(out, [{**first[0], 'x': 1}, {**first[0], 'visit': 2}])
    assert json.loads(out.read_text()) == [
        {**first[0], 'x': 1}, first[1], {**first[0], 'visit': 2}]


def test_a_measurement_goes_on_where_it_was_broken_off(
        tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    (tmp_path / 'run').mkdir()
    model, steps, broken = write_tiny_model(tmp_path / 'run' / 'tiny.onnx'), list[str](), [True]

    def drive(model: Path, path: Walks) -> None:
        known = model.with_suffix('.memory.journal')
        known.write_text((known.read_text() if known.exists() else '') + 'x')
        steps.append(f'learnt {known.read_text()}')

    def update(command: list[str]) -> float:
        newest, after = Path(command[-4]), Path(command[-1])
        steps.append(f'updated {newest.relative_to(tmp_path)}')
        if newest.name == 'run':  # On the second visit nothing has changed.
            shutil.copytree(newest, after)
        return 60.0

    def rows_of(scene: str, visit: int, models: dict[str, Path], *_: object) -> object:
        if visit == 1 and broken.pop():
            raise KeyboardInterrupt
        return [{'scene': scene, 'visit': visit, 'mode': mode,
                 'model': str(path.relative_to(tmp_path))} for mode, path in models.items()], {}

    nothing = Walks(np.zeros((1, 8, 8, 3), np.uint8), np.eye(4)[None], np.zeros(1, int))
    for name, one in (('walks_of', lambda *_, **__: nothing), ('as_bag', lambda *_: None),
                      ('drive', drive), ('end', update), ('rows_of', rows_of),
                      ('become_a_day_older', lambda _: None)):
        monkeypatch.setattr(lives, name, one)
    go = partial(lives.measure, model.parent, tmp_path / 'work', driven=1,
                 out=tmp_path / 'rows.json', retrain=None)
    with pytest.raises(KeyboardInterrupt):
        go(visits=2)
    broken.append(False)
    go(visits=3)
    again = ['learnt xx', 'updated work/0/update']
    assert steps == ['learnt x', 'updated run', *again, *again,
                     'learnt xxx', 'updated work/0/update']
    go(visits=1, without=['update'])  # It has that, and more.
    assert len(steps) == 8
    shutil.rmtree(tmp_path / 'work')
    go(visits=1, without=['update'])
    go(visits=1)  # What is missing makes the visit anew.
    assert steps[8:] == ['learnt x', 'learnt x', 'updated run']
    assert [row['model'] for row in json.loads((tmp_path / 'rows.json').read_text())
            if row['mode'] == 'update'] == ['work/0/update/tiny.onnx'] * 3
