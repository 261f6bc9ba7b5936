"""Transforms of long bags take little memory, and the same ones come out as were recorded."""
import random
import tracemalloc
from types import SimpleNamespace
from typing import Any

from neo_ros.bags import tf_tree
from neo_ros.bags.tf_tree import PoseTrack, TransformTree
from neo_ros.geometry.camera_pose import transform_from_quaternion
import numpy as np
import pytest

STEP = 20_000_000
MOUNT = (0.1, 0.2, 0.3, 0.0, 0.0, 0.1, 0.99)


def transforms(stamp_ns: int, pose: tuple[float, ...]) -> Any:
    seconds, rest = divmod(stamp_ns, 1_000_000_000)
    translation, rotation = (SimpleNamespace(**dict(zip('xyzw', part)))
                             for part in (pose[:3], pose[3:]))
    return SimpleNamespace(transforms=[SimpleNamespace(
        header=SimpleNamespace(frame_id='base', stamp=SimpleNamespace(sec=seconds, nanosec=rest)),
        child_frame_id='joint',
        transform=SimpleNamespace(translation=translation, rotation=rotation))])


def test_a_transform_takes_less_than_100_bytes() -> None:
    count = 20_000
    tree = TransformTree()
    tracemalloc.start()
    before = tracemalloc.get_traced_memory()[0]
    for index in range(count):
        tree.add(transforms(index * STEP, MOUNT), is_static=False)
    taken = tracemalloc.get_traced_memory()[0] - before
    tracemalloc.stop()
    assert taken < 100 * count and len(tree.moving['joint']) == count


def test_transforms_come_out_bit_for_bit_in_any_order_and_the_last_of_a_stamp() -> None:
    chance = random.Random(0)
    track, expected = PoseTrack(), {}
    for index in range(300):
        stamp_ns = chance.randrange(100) * STEP
        pose = tuple(chance.uniform(-2, 2) for _ in range(7))
        track.add(stamp_ns, pose)
        expected[stamp_ns] = transform_from_quaternion(np.array(pose[:3]), np.array(pose[3:]))
        if index % 50 == 0 or index == 299:
            assert len(track) == len(expected)
            for stamp_ns, T in expected.items():
                found = track.at(stamp_ns)
                assert found is not None
                np.testing.assert_array_equal(found, T)
            np.testing.assert_array_equal(track.first, next(iter(expected.values())))


@pytest.mark.parametrize('change, moves', [
    ((0, 0, 0, 0, 0, 0, 0), False), ((0.019, 0, 0, 0, 0, 0, 0), False),
    ((0.021, 0, 0, 0, 0, 0, 0), True), ((0, 0, 0, 0.0094, 0, 0, 0), False),
    ((0, 0, 0, 0.0106, 0, 0, 0), True), ((0, 0, 0, 0, 0, -0.2, -1.98), False),
    ((1e150, 0, 0, 0, 0, 0, 0), True)],
    ids=['as it was', '19 mm', '21 mm', '0.019 rad', '0.021 rad', 'negative', 'huge'])
def test_a_mount_that_is_told_repeatedly_is_compared_once(
        monkeypatch: pytest.MonkeyPatch, change: tuple[float, ...], moves: bool) -> None:
    compared = []
    still = tf_tree._still

    def compare(first: np.ndarray, other: np.ndarray) -> bool:
        compared.append(other)
        return still(first, other)

    monkeypatch.setattr(tf_tree, '_still', compare)
    track = PoseTrack()
    for index in range(100):
        track.add(index * STEP, MOUNT)
    assert not track.moves and not track.moves and not compared
    track.add(50 * STEP, tuple(np.add(MOUNT, change)))
    assert (track.moves, track.moves) == (moves, moves) and len(compared) <= 1


def test_damaged_stamps_hurt_no_others() -> None:
    track = PoseTrack()
    for stamp_ns in (1 << 70, STEP, -1 << 70, 0):
        track.add(stamp_ns, MOUNT)
    assert len(track) == 4 and track.neighbours(STEP // 2) == [0, STEP]
