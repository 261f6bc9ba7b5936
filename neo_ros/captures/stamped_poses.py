"""Poses with stamps, from text files with one in a line, and which one belongs to an image."""
from bisect import bisect_left
from collections.abc import Iterator, Sequence
from decimal import Decimal, InvalidOperation
from pathlib import Path
from typing import TypeVar

from neo_ros.bags.tf_tree import PoseTrack
from neo_ros.captures.capture import CapturedFrame
from neo_ros.errors import GeometryError, SceneError
from neo_ros.geometry.camera_pose import transform_from_quaternion
from neo_ros.machine.names import listed
import numpy as np

Stamped = TypeVar('Stamped')
# As far apart as TUM's own tools let an image and a pose be.
NEAREST_NS = 20_000_000


def read_rows(path: Path, columns: int, what: str) -> Iterator[tuple[str, list[str]]]:
    """
    Yield (place in the file, words) of each line that is no comment, at least `columns` words.

    Words end at commas or blanks. Raises SceneError that names the line; `what` is expected there.
    """
    try:
        lines = path.read_text('utf-8-sig').splitlines()
    except (OSError, UnicodeDecodeError) as error:
        raise SceneError(f'{path}: cannot read: {error}') from error
    for number, line in enumerate(lines, start=1):
        words = line.replace(',', ' ').split()
        if not words or words[0].startswith('#'):
            continue
        if len(words) < columns:
            raise SceneError(f'{path}:{number}: expected {what}, got {line.strip()!r}')
        yield f'{path}:{number}', words


def nanoseconds(word: str, where: str, unit_ns: int = 1) -> int:
    """Read a stamp, exactly; unit_ns is what the file counts in."""
    try:
        return int(Decimal(word) * unit_ns)
    except (InvalidOperation, ValueError, OverflowError) as error:
        raise SceneError(f'{where}: expected a stamp, got {word!r}') from error


def read_track(path: Path, unit_ns: int, scalar_first: bool) -> tuple[PoseTrack, int]:
    """
    Read lines of stamp, position and quaternion; returns the poses and how many were lost.

    scalar_first: the quaternion is w x y z, not x y z w. Poses that are not finite are lost ones.
    """
    order = 'qw qx qy qz' if scalar_first else 'qx qy qz qw'
    track, lost = PoseTrack(), 0
    for where, words in read_rows(path, 8, f'STAMP x y z {order}'):
        try:
            numbers = np.array([float(word) for word in words[1:8]])
        except ValueError as error:
            raise SceneError(f'{where}: expected STAMP x y z {order}: {error}') from error
        if not np.isfinite(numbers).all():
            lost += 1
            continue
        quaternion = np.roll(numbers[3:], -1) if scalar_first else numbers[3:]
        try:
            transform_from_quaternion(numbers[:3], quaternion)
        except GeometryError as error:
            raise SceneError(f'{where}: {error}') from error
        track.add(nanoseconds(words[0], where, unit_ns), (*numbers[:3], *quaternion))
    if not track:
        raise SceneError(f'{path}: expected poses, got {lost} lines and none is finite')
    return track, lost


def pose_at(track: PoseTrack, stamp_ns: int) -> np.ndarray | None:
    """
    Return the transform (4, 4) at a time: between near neighbours, else the nearest one's.

    None where the track has none within 20 ms.
    """
    T = track.at(stamp_ns)
    if T is not None:
        return T
    nearest = min(track.neighbours(stamp_ns), key=lambda stamp: abs(stamp - stamp_ns))
    return track.at(nearest) if abs(nearest - stamp_ns) <= NEAREST_NS else None


def nearest_within(entries: Sequence[tuple[int, Stamped]], stamp_ns: int) -> Stamped | None:
    """Return what has the nearest stamp, of entries by rising stamp; None if none is in 20 ms."""
    place = bisect_left(entries, stamp_ns, key=lambda entry: entry[0])
    near = min(entries[max(place - 1, 0):place + 1], default=None,
               key=lambda entry: abs(entry[0] - stamp_ns))
    return near[1] if near is not None and abs(near[0] - stamp_ns) <= NEAREST_NS else None


def pairing_notes(total: int, missing: Sequence[str], unpaired: Sequence[str],
                  lost: int, poses: Path) -> tuple[str, ...]:
    """Say which images have no file, and which no pose."""
    notes = []
    if missing:
        notes.append(f'{len(missing)} of {total} listed images are missing and left out: '
                     f'{listed(missing)}')
    if lost:
        notes.append(f'{lost} poses in {poses.name} are not finite and left out')
    if unpaired:
        notes.append(f'{len(unpaired)} of {total} images have no pose within '
                     f'{NEAREST_NS // 1_000_000} ms in {poses.name} and are left out: '
                     f'{listed(unpaired)}')
    return tuple(notes)


def check_paired(frames: Sequence[CapturedFrame], notes: Sequence[str], source: Path) -> None:
    """Raise SceneError with the notes where no image is left."""
    if not frames:
        raise SceneError(f'{source}: no image has a pose: '
                         f'{"; ".join(notes) or "no image is listed"}. Are both on one clock?')
