"""Broken journals, thousands of them: refused, or read up to what is broken, and no further."""
from collections.abc import Callable, Iterator
from pathlib import Path
import struct
import tracemalloc
import zlib

from neo_ros.errors import ModelError
from neo_ros.geometry import Band, CameraPose, Intrinsics
from neo_ros.memory.changes import Changes, without_replaced
from neo_ros.memory.journal import (
    HEADER_BYTES, JournalWriter, MAGIC, PATCH, read_journal, TURN)
from neo_ros.memory.patch import PARTS, Patch
from neo_ros.memory.states import Things
from neo_ros.memory.turn import Record, Turn
import numpy as np
import pytest

MEMORY = 'ab' * 32
CAMERA = Intrinsics(16, 12, 14.0, 14.0, 8.0, 6.0)
HEADER = MAGIC + bytes.fromhex(MEMORY)
COUNT = 700  # of each kind
LARGE = 8 << 20


def small_patch(number: int) -> Patch:
    random = np.random.default_rng(number)
    image = np.full((12, 16, 3), 30 * number + 40, np.uint8)
    depth = np.where(random.random((12, 16)) < 0.8, 2.0 + number, 0).astype(np.float32)
    return Patch.of(CameraPose.from_planar(number, 1, 1.5, 0.3), CAMERA, image, depth, number,
                    number, (255 - image, depth + 1), np.full((12, 16), number, np.uint8))


BODIES = [small_patch(number).to_bytes() for number in range(3)]
TURNED = Turn(np.array([1, PARTS + 1, 2 * PARTS + 2], np.uint32), 5, 5).to_bytes()


def framed(bodies: list[bytes], kinds: bytes = PATCH) -> bytes:
    """Return a journal with right lengths and checksums around any bodies of these kinds."""
    content, check = HEADER, zlib.crc32(HEADER)
    for number, body in enumerate(bodies):
        body = kinds[number % len(kinds):][:1] + body
        check = zlib.crc32(body, check)
        content += struct.pack('<2I', len(body), check) + body
    return content


WHOLE = framed(BODIES)
SIZES = np.array([0, 1, 7, 255, 1 << 16, (1 << 31) - 1, 1 << 31, (1 << 32) - 1])


def broken(content: bytes, random: np.random.Generator) -> bytes:
    """Flip bits, cut, insert, repeat, or put a length where there may be one."""
    changed = bytearray(content)
    for _ in range(random.integers(1, 4)):
        at = int(random.integers(len(changed) + 1))
        match random.integers(5):
            case 0 if at < len(changed):
                changed[at] ^= 1 << int(random.integers(8))
            case 1:
                del changed[at:at + int(random.integers(1, 400))]
            case 2:
                changed[at:at] = random.bytes(int(random.integers(1, 40)))
            case 3:
                changed[at:at] = changed[at // 2:at]
            case _:
                changed[at:at + 4] = struct.pack('<I', random.choice(SIZES))
    return bytes(changed)


def of_the_file(random: np.random.Generator) -> bytes:
    """Break anything, the header and the frames of records, too."""
    return broken(WHOLE, random)


def of_a_record(random: np.random.Generator) -> bytes:
    """Break what a record holds; whoever did it can compute checksums."""
    bodies = list(BODIES)
    place = int(random.integers(3))
    # Most of a body are its pictures; half of the time its numbers change.
    head = 160 if random.integers(2) else len(bodies[place])
    bodies[place] = broken(bodies[place][:head], random) + bodies[place][head:]
    return framed(bodies)


def of_a_turn(random: np.random.Generator) -> bytes:
    """Break what is turned, and when."""
    turns = [TURNED if random.integers(2) else broken(TURNED, random) for _ in range(2)]
    return framed([*BODIES, *turns], 3 * PATCH + 2 * TURN)


def of_numbers(random: np.random.Generator) -> bytes:
    """Put numbers into a record that are legal, but senseless."""
    body = bytearray(BODIES[0])
    at = int(random.choice([12, 36, 60, 84, 112, 120, 128, 136]))
    number = random.choice([-1, 1]) * 10.0 ** random.uniform(-30, 30)
    body[at:at + 8] = struct.pack('<d', number)
    return framed([bytes(body), BODIES[1]])


def read_whole(path: Path) -> list[Record]:
    path.write_bytes(WHOLE)
    return read_journal(path, MEMORY)


@pytest.mark.slow
@pytest.mark.parametrize('make', [of_the_file, of_a_record, of_a_turn, of_numbers])
def test_no_broken_journal_raises_hangs_or_fills_the_memory(
        tmp_path: Path, make: Callable[[np.random.Generator], bytes]) -> None:
    path, random = tmp_path / 'a.journal', np.random.default_rng(0)
    read = 0
    shown(read_whole(path))  # Compiled loops are loaded before anything is measured.
    tracemalloc.start()
    try:
        for number in range(COUNT):
            content = make(random)
            path.write_bytes(content)
            found = read_journal(path, MEMORY)
            read += len(found)
            assert len(found) <= 6
            if number % 10 == 0:
                shown(found)
                taken_by_a_writer(path, content, found)
        assert tracemalloc.get_traced_memory()[1] < LARGE
    finally:
        tracemalloc.stop()
    # Some were read as far as they were whole.
    assert read > COUNT // 10


def shown(records: list[Record]) -> None:
    """Put what was read into a keyframe: the compiled loops trust it."""
    texture = np.full((64, 128, 3), 90, np.uint8)
    coded = np.full((32, 64), 300, np.uint16)
    changes = Changes(records)
    changed, depth = changes.put_into(np.zeros(3), Band(1.0, -1.0), 1, texture, coded)
    assert changed.shape == texture.shape and depth.shape == coded.shape
    if changes.patches:
        assert len(Things(changes.patches).of) == len(changes.hidden)
    assert changes.shown_at(np.full((12, 16), 2, np.float32), CAMERA, CameraPose(
        np.eye(4))).shape == (12, 16)
    again = without_replaced(records)
    assert not changes.patches or Changes(again).hidden.shape <= changes.hidden.shape


def taken_by_a_writer(path: Path, content: bytes, found: list[Record]) -> None:
    """Write behind what was read; where the file is refused, it is left as it is."""
    try:
        writer = JournalWriter(path, MEMORY, 1 << 20)
    except ModelError as error:
        assert not content.startswith(HEADER) and path.read_bytes() == content, error
        return
    try:
        assert len(writer.records) == len(found)
        writer.append([small_patch(7)])
    finally:
        writer.close()
    assert [one.stamp_ns for one in read_journal(path, MEMORY)] == [
        *(one.stamp_ns for one in found), 7]


def huge(path: Path) -> Iterator[None]:
    """Write files that are large, or say so, one after the other."""
    for start in (WHOLE, HEADER, b''):
        path.write_bytes(start)
        with path.open('r+b') as file:
            file.truncate(900 << 20)  # Takes no room on the disk.
        yield
    path.write_bytes(WHOLE + struct.pack('<2I', (1 << 32) - 1, 0))
    yield


def test_a_huge_journal_is_not_read_whole(tmp_path: Path) -> None:
    path = tmp_path / 'a.journal'
    tracemalloc.start()
    try:
        for _ in huge(path):
            tracemalloc.reset_peak()
            assert len(read_journal(path, MEMORY)) in (0, 3)
            assert tracemalloc.get_traced_memory()[1] < 80 << 20
    finally:
        tracemalloc.stop()


@pytest.mark.parametrize('at, number', [
    (112, 1e-9), (120, 1e9), (128, 1e30), (136, -1e12)], ids=['fx', 'fy', 'cx', 'cy'])
def test_a_camera_that_no_camera_has_ends_it(tmp_path: Path, at: int, number: float) -> None:
    path, body = tmp_path / 'a.journal', bytearray(BODIES[1])
    body[at:at + 8] = struct.pack('<d', number)
    path.write_bytes(framed([BODIES[0], bytes(body), BODIES[2]]))
    assert len(read_journal(path, MEMORY)) == 1


def test_a_batch_that_none_can_follow_ends_it(tmp_path: Path) -> None:
    path = tmp_path / 'a.journal'
    body = BODIES[1][:8] + struct.pack('<I', (1 << 32) - 1) + BODIES[1][12:]
    path.write_bytes(framed([BODIES[0], body]))
    assert len(read_journal(path, MEMORY)) == 1


@pytest.mark.parametrize('size', [0, 1, len(MAGIC), HEADER_BYTES - 1])
def test_one_that_was_only_begun_is_empty(tmp_path: Path, size: int,
                                          caplog: pytest.LogCaptureFixture) -> None:
    path = tmp_path / 'a.journal'
    path.write_bytes(HEADER[:size])
    assert read_journal(path, MEMORY) == [] and not caplog.text
    writer = JournalWriter(path, MEMORY, 1 << 20)
    writer.append([small_patch(1)])
    writer.close()
    assert len(read_journal(path, MEMORY)) == 1


@pytest.mark.parametrize('kinds, body', [
    (PATCH + TURN, TURNED), (PATCH + TURN, TURNED[:12]), (PATCH + TURN, TURNED[:11]),
    (PATCH + TURN, TURNED[:-1]), (PATCH + TURN, TURNED[:12] + TURNED[12:16] * 2),
    (PATCH + TURN, TURNED[:8] + b'\xff\xff\xff\xff' + TURNED[12:16]),
    (PATCH + b'X', TURNED[:16])],
    ids=['not there', 'none', 'short', 'cut', 'twice', 'batch', 'another kind'])
def test_a_turn_of_what_is_not_there_ends_it(tmp_path: Path, kinds: bytes, body: bytes) -> None:
    path = tmp_path / 'a.journal'
    path.write_bytes(framed([BODIES[0], TURNED[:16]], PATCH + TURN))
    assert len(read_journal(path, MEMORY)) == 2
    path.write_bytes(framed([BODIES[0], body], kinds))
    assert len(read_journal(path, MEMORY)) == 1


def test_a_turn_before_all_patches_ends_it(tmp_path: Path) -> None:
    path = tmp_path / 'a.journal'
    path.write_bytes(framed([TURNED, BODIES[0]], TURN + PATCH))
    assert read_journal(path, MEMORY) == []


@pytest.mark.parametrize('more', [b'12345', b'1'])
def test_what_was_before_has_to_fit(tmp_path: Path, more: bytes) -> None:
    path = tmp_path / 'a.journal'
    size = len(small_patch(0).before) + len(more)
    body = BODIES[0][:144 + 8] + struct.pack('<I', size) + BODIES[0][144 + 12:] + more
    path.write_bytes(framed([body]))
    assert read_journal(path, MEMORY) == []


def test_a_journal_of_another_version_is_left_aside(tmp_path: Path,
                                                    caplog: pytest.LogCaptureFixture) -> None:
    path = tmp_path / 'a.journal'
    path.write_bytes(WHOLE.replace(b'journal 2', b'journal 1'))
    assert read_journal(path, MEMORY) == []
    assert 'another version' in caplog.text and 'neo memory forget' in caplog.text
