"""The journal of a memory: whole records only, of this memory alone, whatever the file holds."""
from collections.abc import Sequence
from pathlib import Path
import struct
import zlib

from hypothesis import given, settings, strategies as st
from neo_ros.errors import ModelError
from neo_ros.geometry import CameraPose, Intrinsics
from neo_ros.memory import journal
from neo_ros.memory.changes import Changes
from neo_ros.memory.journal import (
    compact_journal, delete_learnt, HEADER_BYTES, JournalWriter, MAGIC, most_bytes, PATCH,
    read_journal, write_journal)
from neo_ros.memory.patch import PARTS, Patch
from neo_ros.memory.turn import Record, Turn
import numpy as np
import pytest

MEMORY, OTHER = 'ab' * 32, 'cd' * 32
CAMERA = Intrinsics(20, 12, 16.0, 16.0, 10.0, 6.0)


def patch(number: int, batch: int = 0) -> Patch:
    random = np.random.default_rng(number)
    image = np.full((12, 20, 3), random.integers(30, 220), np.uint8)
    depth = np.where(random.random((12, 20)) < 0.7, 2.0 + number, 0).astype(np.float32)
    return Patch.of(CameraPose.from_planar(number, 1, 1.5, 0.3), CAMERA, image, depth, number,
                    batch)


PATCHES = [patch(number) for number in range(4)]


def written(path: Path, records: Sequence[Record]) -> list[Record]:
    writer = JournalWriter(path, MEMORY, 1 << 20)
    try:
        assert writer.append(records) == records
        return writer.records
    finally:
        writer.close()


def stamps(path: Path, memory: str = MEMORY) -> list[int]:
    return [one.stamp_ns for one in read_journal(path, memory)]


def test_what_is_appended_is_read_again(tmp_path: Path) -> None:
    path = tmp_path / 'a.journal'
    assert read_journal(path, MEMORY) == []
    assert written(path, PATCHES[:2]) == []
    assert [one.stamp_ns for one in written(path, PATCHES[2:])] == [0, 1]
    found = read_journal(path, MEMORY)
    assert [one.stamp_ns for one in found] == [0, 1, 2, 3]
    last = found[3]
    assert isinstance(last, Patch)
    image, depth, _ = last.pictures
    assert np.abs(image.astype(int) - PATCHES[3].pictures[0]).max() < 3
    np.testing.assert_allclose(depth[depth > 0], 5.0, rtol=0.02)
    assert last.camera == CAMERA
    np.testing.assert_array_equal(last.pose.T_world_cam, PATCHES[3].pose.T_world_cam)


@settings(max_examples=40, deadline=None)
@given(share=st.floats(0, 1))
def test_cut_anywhere_it_holds_the_whole_records(tmp_path_factory: pytest.TempPathFactory,
                                                 share: float) -> None:
    path = tmp_path_factory.mktemp('cut') / 'a.journal'
    ends = [HEADER_BYTES]
    for one in PATCHES:
        written(path, [one])
        ends.append(path.stat().st_size)
    content = path.read_bytes()
    path.write_bytes(content[:max(int(share * len(content)), 1)])
    whole = sum(end <= path.stat().st_size for end in ends[1:])
    assert stamps(path) == list(range(whole))
    # What is learnt next stands behind the last whole record.
    written(path, [patch(9)])
    assert stamps(path) == [*range(whole), 9]


@pytest.mark.parametrize('at', [HEADER_BYTES + 2, HEADER_BYTES + 40, -5])
def test_a_flipped_bit_ends_it(tmp_path: Path, at: int) -> None:
    path = tmp_path / 'a.journal'
    written(path, PATCHES)
    content = bytearray(path.read_bytes())
    content[at] ^= 16
    path.write_bytes(content)
    assert stamps(path) == ([] if at > 0 else [0, 1, 2])


def test_a_record_that_was_put_elsewhere_ends_it(tmp_path: Path) -> None:
    path = tmp_path / 'a.journal'
    ends = [HEADER_BYTES]
    for one in PATCHES:
        written(path, [one])
        ends.append(path.stat().st_size)
    content = path.read_bytes()
    path.write_bytes(content[:ends[1]] + content[ends[2]:])
    assert stamps(path) == [0]


def hostile(tmp_path: Path, body: bytes) -> Path:
    """Write a journal with right checksums around any content."""
    header, body = MAGIC + bytes.fromhex(MEMORY), PATCH + body
    path = tmp_path / 'h.journal'
    path.write_bytes(header + struct.pack(
        '<2I', len(body), zlib.crc32(body, zlib.crc32(header))) + body)
    return path


def test_right_checksums_do_not_make_nonsense_right(tmp_path: Path) -> None:
    good = PATCHES[0].to_bytes()
    assert len(read_journal(hostile(tmp_path, good), MEMORY)) == 1
    pose = 12  # Behind stamp and batch.
    broken = {
        'short': good[:50], 'long': good + b'x',
        'pose': good[:pose] + struct.pack('<d', np.nan) + good[pose + 8:],
        'size': good[:pose + 96] + struct.pack('<H', 4000) + good[pose + 98:],
        'focal length': good[:pose + 100] + struct.pack('<d', -1) + good[pose + 108:],
        'image': good.replace(PATCHES[0].texture, b'\xff\xd8' + bytes(
            len(PATCHES[0].texture) - 2)),
        'depth': good.replace(PATCHES[0].depths[40:60], bytes(20))}
    for name, body in broken.items():
        assert read_journal(hostile(tmp_path, body), MEMORY) == [], name


def test_another_memorys_is_left_aside(tmp_path: Path, caplog: pytest.LogCaptureFixture) -> None:
    path = tmp_path / 'a.journal'
    written(path, PATCHES)
    assert stamps(path, OTHER) == [] and 'another memory' in caplog.text
    with pytest.raises(ModelError, match='another memory.*neo memory forget'):
        JournalWriter(path, OTHER, 1 << 20)
    assert len(stamps(path)) == 4
    path.write_bytes(b'something else')
    assert stamps(path) == []
    path.unlink()
    path.mkdir()
    assert stamps(path) == []


def test_it_is_bounded(tmp_path: Path, caplog: pytest.LogCaptureFixture) -> None:
    path = tmp_path / 'a.journal'
    size = len(PATCHES[0].to_bytes()) + 9
    writer = JournalWriter(path, MEMORY, HEADER_BYTES + int(2.5 * size))
    assert writer.append(PATCHES) == PATCHES[:2] and not writer.full
    assert writer.append(PATCHES) == []
    assert writer.make_room(PATCHES[:2]) == PATCHES[:2] and writer.full
    assert 'the journal is full' in caplog.text
    writer.close()
    assert stamps(path) == [0, 1]
    assert most_bytes(14 << 20) == int(0.2 * (14 << 20)) and most_bytes(1 << 40) == 64 << 20


def turn(*parts: int, stamp_ns: int = 50) -> Turn:
    return Turn(np.array(parts, np.uint32), stamp_ns, 9)


def test_turns_are_read_again(tmp_path: Path) -> None:
    path = tmp_path / 'a.journal'
    written(path, [*PATCHES[:2], turn(0, PARTS), PATCHES[2], turn(PARTS, 2 * PARTS + 1)])
    found = read_journal(path, MEMORY)
    assert [type(one) for one in found] == [Patch, Patch, Turn, Patch, Turn]
    hidden = Changes(found).hidden
    # The second patch is shown again.
    assert np.flatnonzero(hidden >= 0).tolist() == [0, 2 * PARTS + 1]
    assert hidden[0] == 2 and hidden[2 * PARTS + 1] == 4


def test_a_full_journal_still_takes_turns_but_not_for_ever(tmp_path: Path) -> None:
    path = tmp_path / 'a.journal'
    writer = JournalWriter(path, MEMORY, HEADER_BYTES + 10)
    assert writer.append(PATCHES[:1]) == []
    writer.close()
    written(path, PATCHES[:1])
    writer = JournalWriter(path, MEMORY, path.stat().st_size)
    turns = [turn(0, stamp_ns=number) for number in range(5000)]
    taken = writer.append(turns)
    assert 1000 < len(taken) < 5000
    assert writer.append(PATCHES[1:2]) == [] == writer.append(turns)
    writer.close()
    assert len(read_journal(path, MEMORY)) == 1 + len(taken)


def test_what_is_hidden_stays_in_a_compact_journal(tmp_path: Path) -> None:
    path = tmp_path / 'a.journal'
    # The second one sees what the first saw; of the third a part is hidden.
    first, again = patch(0, 0), patch(0, 1)
    written(path, [first, again, PATCHES[1], turn(2 * PARTS)])
    kept, before = compact_journal(path, MEMORY, 1 << 20)
    assert before == 4 and len(kept) == 3
    changes = Changes(read_journal(path, MEMORY))
    assert np.flatnonzero(changes.hidden >= 0).tolist() == [PARTS]
    assert changes.patches[1].stamp_ns == 1
    # What is hidden replaces nothing, and is not replaced.
    path.unlink()
    written(path, [first, again, turn(PARTS)])
    assert len(compact_journal(path, MEMORY, 1 << 20)[0]) == 3
    path.unlink()
    written(path, [first, again, turn(0)])
    assert len(compact_journal(path, MEMORY, 1 << 20)[0]) == 3
    # What one turn has hidden is shown again together: of that once is enough.
    path.unlink()
    written(path, [first, again, PATCHES[1], turn(0, PARTS)])
    kept, _ = compact_journal(path, MEMORY, 1 << 20)
    assert [one.batch for one in kept] == [1, 0, 9]
    assert np.flatnonzero(Changes(kept).hidden >= 0).tolist() == [0]


def full_of_the_same(path: Path) -> JournalWriter:
    """Return the writer of a journal whose second patch saw what the first did, and the third."""
    size = len(PATCHES[0].to_bytes()) + 9
    writer = JournalWriter(path, MEMORY, HEADER_BYTES + int(3.5 * size))
    assert writer.append([patch(0), patch(0, 1), patch(0, 2), PATCHES[1]]) and writer.append(
        PATCHES[1:]) == []
    return writer


def test_a_full_journal_makes_room_and_goes_on(tmp_path: Path) -> None:
    path = tmp_path / 'a.journal'
    writer = full_of_the_same(path)
    kept = writer.make_room(read_journal(path, MEMORY))
    assert [one.batch for one in kept] == [2] and not writer.full
    assert len(read_journal(path, MEMORY)) == 1
    # It is another file by now: of that, too, nobody else may be the writer.
    for refused in (lambda: JournalWriter(path, MEMORY, 1 << 20), lambda: delete_learnt(path)):
        with pytest.raises(ModelError, match='another process'):
            refused()
    added: list[Record] = [PATCHES[1], turn(0, PARTS)]
    assert writer.append(added) == added
    writer.close()
    found = read_journal(path, MEMORY)
    assert [one.stamp_ns for one in found] == [0, 1, 50]
    assert np.flatnonzero(Changes(found).hidden >= 0).tolist() == [0, PARTS]
    assert list(tmp_path.iterdir()) == [path]


def test_a_disk_without_room_leaves_a_full_journal_as_it_was(
        tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    path = tmp_path / 'a.journal'
    writer = full_of_the_same(path)
    content = path.read_bytes()

    def full(path: Path) -> None:
        raise OSError(28, 'no space left')

    monkeypatch.setattr(journal, 'see_to_disk', full)
    with pytest.raises(ModelError, match='no space left'):
        writer.make_room(read_journal(path, MEMORY))
    assert path.read_bytes() == content and list(tmp_path.iterdir()) == [path]
    with pytest.raises(ModelError, match='another process'):
        JournalWriter(path, MEMORY, 1 << 20)
    writer.close()
    JournalWriter(path, MEMORY, 1 << 20).close()


def test_what_makes_room_meanwhile_is_not_deleted(
        tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    path = tmp_path / 'a.journal'
    writer, lock = full_of_the_same(path), journal.fcntl.flock

    def late(file: int, how: int) -> None:
        monkeypatch.setattr(journal.fcntl, 'flock', lock)
        writer.make_room(read_journal(path, MEMORY))
        lock(file, how)

    monkeypatch.setattr(journal.fcntl, 'flock', late)
    with pytest.raises(ModelError, match='another process'):
        delete_learnt(path)
    writer.close()
    assert len(read_journal(path, MEMORY)) == 1


def test_one_process_learns_at_a_time(tmp_path: Path) -> None:
    path = tmp_path / 'a.journal'
    writer = JournalWriter(path, MEMORY, 1 << 20)
    with pytest.raises(ModelError, match='another process'):
        JournalWriter(path, MEMORY, 1 << 20)
    writer.close()
    writer.close()
    JournalWriter(path, MEMORY, 1 << 20).close()


def test_written_anew_it_is_whole(tmp_path: Path) -> None:
    path = tmp_path / 'a.journal'
    written(path, PATCHES)
    write_journal(path, MEMORY, PATCHES[1:3])
    assert stamps(path) == [1, 2]
    written(path, [patch(7)])
    assert stamps(path) == [1, 2, 7]


def test_a_journal_takes_no_more_pictures_than_are_read_again(
        tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    path = tmp_path / 'a.journal'
    monkeypatch.setattr(journal, 'MOST_PIXELS', int(2.5 * CAMERA.width * CAMERA.height))
    assert len(written_as_far_as_it_goes(path, PATCHES[:1])) == 1
    assert len(written_as_far_as_it_goes(path, PATCHES[1:])) == 1
    assert stamps(path) == [0, 1]


def written_as_far_as_it_goes(path: Path, patches: list[Patch]) -> list[Record]:
    writer = JournalWriter(path, MEMORY, 1 << 20)
    try:
        return writer.append(patches)
    finally:
        writer.close()


def test_what_another_process_learns_is_neither_deleted_nor_compacted(tmp_path: Path) -> None:
    path = tmp_path / 'a.journal'
    writer = JournalWriter(path, MEMORY, 1 << 20)
    writer.append(PATCHES[:2])
    with pytest.raises(ModelError, match='another process'):
        delete_learnt(path)
    with pytest.raises(ModelError, match='another process'):
        compact_journal(path, MEMORY, 1 << 20)
    writer.append(PATCHES[2:])
    writer.close()
    assert stamps(path) == [0, 1, 2, 3]
    kept, before = compact_journal(path, MEMORY, 1 << 20)
    assert before == 4 and stamps(path) == [one.stamp_ns for one in kept]


def test_a_journal_that_was_replaced_meanwhile_is_opened_anew(
        tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    path = tmp_path / 'a.journal'
    written(path, PATCHES)
    lock, pending = journal.fcntl.flock, [
        lambda: write_journal(path, MEMORY, PATCHES[:1]), path.unlink]

    def late(file: int, how: int) -> None:
        # Between open and lock another process compacts, or forgets.
        if pending and how & journal.fcntl.LOCK_NB:
            pending.pop(0)()
        lock(file, how)

    monkeypatch.setattr(journal.fcntl, 'flock', late)
    written(path, [patch(8)])
    assert not pending and stamps(path) == [8]


def test_whatever_the_file_holds_it_is_deleted(tmp_path: Path) -> None:
    path = tmp_path / 'a.journal'
    partial = tmp_path / 'a.journal.partial'
    delete_learnt(path)
    path.write_bytes(b'something else')
    partial.write_bytes(b'left by a kill')
    delete_learnt(path)
    assert list(tmp_path.iterdir()) == []
    path.symlink_to(tmp_path / 'nowhere')
    delete_learnt(path)
    assert not path.is_symlink()
    path.mkdir()
    with pytest.raises(ModelError, match='cannot delete'):
        delete_learnt(path)
