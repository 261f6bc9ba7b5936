"""A thing that was seen in one state and then in another is shown as it was seen last."""
from collections.abc import Callable
from dataclasses import replace

from box_board import DRIVE, with_board
from box_room import box_memory, EXPANSION, planar, SOURCE, view
from neo_ros.geometry import CameraPose
from neo_ros.memory.changes import Changes
from neo_ros.memory.contradiction import contradicted, contradiction
from neo_ros.memory.patch import PARTS, Patch
from neo_ros.memory.rendering import MemoryRenderer
from neo_ros.memory.state_kernels import OTHER
from neo_ros.memory.states import (
    _look, _turned, _weigh, find_turn, parts_of, StateThresholds, Things)
from neo_ros.memory.stereo import Shot
from neo_ros.memory.turn import Turn
import numpy as np
import pytest

LIMITS = StateThresholds()
LATER = 10 ** 15
NOWHERE = 99.0  # where the board is when it is away


def learnt(pose: CameraPose, columns: slice = slice(None), board: float = 1.8,
           before: float = NOWHERE, stamp_ns: int = 0) -> Patch:
    """Return what an image shows of a board that came, or of the wall where it left."""
    (image, depth, seen), (image_before, depth_before, was) = (
        with_board(pose, SOURCE, middle) for middle in (board, before))
    changed = np.zeros(depth.shape, bool)
    changed[:, columns] = (seen | was)[:, columns]
    return Patch.of(pose, SOURCE, image, np.where(changed, depth, 0), stamp_ns, 0,
                    (image_before, depth_before))


def shots(seen: float, shown: float, poses: list[CameraPose], columns: slice = slice(None),
          spoil: Callable[[np.ndarray], np.ndarray] = lambda image: image) -> list[Shot]:
    """Return images of the board at one place, where another is shown, compared in columns."""
    found = []
    for pose in poses:
        image = spoil(with_board(pose, SOURCE, seen)[0]).astype(np.float32)
        before, depth, _ = with_board(pose, SOURCE, shown)
        score = contradiction(image, before.astype(np.float32), depth > 0)
        score[:, :columns.start or 0], score[:, columns.stop or SOURCE.width:] = 0, 0
        known = np.zeros(depth.shape, np.float32)
        known[:, columns] = depth[:, columns]
        found.append(Shot(pose, image, before.astype(np.float32), known, contradicted(score),
                          score, LATER))
    return found


PATCHES = [learnt(DRIVE[number]) for number in (4, 10, 16)]
LOOKS = DRIVE[6:10]


def test_a_board_that_left_again_is_hidden_wholly() -> None:
    half = slice(0, 32)
    # Each patch saw a part of it; the images see another.
    patches = [*PATCHES, learnt(DRIVE[10], slice(34, 64))]
    turn = find_turn(shots(NOWHERE, 1.8, LOOKS, half), Changes(patches), SOURCE, 7, 1)
    assert turn is not None and turn.batch == 7 and turn.stamp_ns == LATER
    assert turn.parts.tolist() == [PARTS * number for number in range(4)]


def test_what_another_state_explains_contradicts_no_more() -> None:
    looks = shots(NOWHERE, 1.8, LOOKS)
    before = sum(int(one.contradicted.sum()) for one in looks)
    assert find_turn(looks, Changes(PATCHES), SOURCE, 0, 1) is not None
    assert sum(int(one.contradicted.sum()) for one in looks) < 0.35 * before


def test_it_turns_back_as_it_was_but_not_on_the_same_visit() -> None:
    back = Turn(np.arange(3, dtype=np.uint32) * PARTS, LATER - 1, 1)
    changes, looks = Changes([*PATCHES, back]), shots(1.8, NOWHERE, LOOKS, slice(0, 40))
    assert find_turn(looks, changes, SOURCE, 2, 1) is None
    turn = find_turn(looks, changes, SOURCE, 2, 2)
    assert turn is not None and turn.parts.tolist() == [PARTS * number for number in range(3)]
    again = changes.with_more([turn])
    assert (again.hidden < 0).all()
    looks = shots(NOWHERE, 1.8, LOOKS)
    assert find_turn(looks, again, SOURCE, 3, 2) is None
    assert find_turn(looks, again, SOURCE, 3, 3) is not None


def noise(image: np.ndarray) -> np.ndarray:
    return np.random.default_rng(0).integers(0, 256, image.shape)


@pytest.mark.parametrize('learnt_ns, turns', [(LATER, False), (LATER - 10 ** 13, True)])
def test_what_this_visit_has_just_learnt_does_not_turn(learnt_ns: int, turns: bool) -> None:
    patches = [replace(one, stamp_ns=learnt_ns, batch=4) for one in PATCHES]
    for begun, expected in ((4, turns), (5, True)):
        turn = find_turn(shots(NOWHERE, 1.8, LOOKS), Changes(patches), SOURCE, 9, begun)
        assert (turn is not None) == expected


def test_what_has_just_been_learnt_stays_where_the_state_before_it_goes() -> None:
    patches = [*PATCHES, replace(learnt(DRIVE[10], slice(34, 64)), stamp_ns=LATER, batch=4)]
    turn = find_turn(shots(NOWHERE, 1.8, LOOKS), Changes(patches), SOURCE, 7, 4)
    assert turn is not None and set(turn.parts // PARTS) == {0, 1, 2}


@pytest.mark.parametrize('made', ['as shown', 'something else', 'one image', 'moved on'])
def test_it_does_not_turn(made: str) -> None:
    looks = {'as shown': lambda: shots(1.8, 1.8, LOOKS),
             'something else': lambda: shots(1.8, 1.8, LOOKS, spoil=noise),
             'one image': lambda: shots(NOWHERE, 1.8, LOOKS[:1]),
             # At its old place the board is still seen: it has another beside it.
             'moved on': lambda: [replace(one, contradicted=two.contradicted) for one, two in zip(
                 shots(1.8, 1.8, LOOKS), shots(NOWHERE, 1.8, LOOKS))]}[made]()
    assert find_turn(looks, Changes(PATCHES), SOURCE, 0, 1) is None


def test_only_what_was_learnt_last_goes_where_the_state_before_it_is_seen() -> None:
    # The board came, and was moved by its width on a later visit; now it is back.
    later = [learnt(DRIVE[number], board=2.8, before=1.8, stamp_ns=LATER) for number in (4, 10)]
    changes = Changes([*PATCHES, *later])
    turn = find_turn(shots(1.8, 2.8, LOOKS), changes, SOURCE, 0, 1)
    assert turn is not None and set(turn.parts // PARTS) == {3, 4}


@pytest.mark.parametrize('hidden, expected', [(True, [0, 1]), (False, [0, 1, 2])])
def test_what_is_said_of_a_part_itself_keeps_it_hidden(hidden: bool, expected: list[int]) -> None:
    turn = Turn(np.arange(3, dtype=np.uint32) * PARTS, LATER, 1)
    changes = Changes([*PATCHES, *([turn] if hidden else [])])
    things = np.full(3 * PARTS, -1)
    things[::PARTS] = 0  # All three are taken for one thing; of the third images say it stays.
    votes = np.zeros((3, 3 * PARTS, 3), np.int32)
    votes[:, ::PARTS] = [[200, 0, 0], [0, 0, 0], [5, 30, 0]]
    assert np.flatnonzero(_turned(votes, things, changes, LIMITS)).tolist() == [
        PARTS * number for number in expected]


@pytest.mark.parametrize('goes', [True, False])
def test_nothing_of_a_thing_comes_while_some_of_it_goes(goes: bool) -> None:
    changes = Changes([*PATCHES, Turn(np.array([PARTS], np.uint32), LATER, 1)])
    things = np.full(3 * PARTS, -1)
    things[::PARTS] = 0
    votes = np.zeros((3, 3 * PARTS, 3), np.int32)
    # The second is hidden, and images show it, too.
    votes[:, ::PARTS] = [[200, 0, 0] if goes else [0, 90, 0], [150, 0, 0], [0, 0, 0]]
    turned = _turned(votes, things, changes, LIMITS)
    assert turned[0] == goes and turned[PARTS] == (not goes)


def test_a_part_may_turn_alone() -> None:
    things = np.full(3 * PARTS, -1)
    things[::PARTS] = 0
    votes = np.zeros((3, 3 * PARTS, 3), np.int32)
    votes[:, ::PARTS] = [[200, 10, 0], [0, 900, 0], [2, 0, 0]]
    assert np.flatnonzero(_turned(votes, things, Changes(PATCHES), LIMITS)).tolist() == [0]


def test_many_samples_in_one_pixel_are_one_witness() -> None:
    things, other = Things([learnt(planar(2.6, 1.8, 0))]), np.full(PARTS, -1, np.int8)
    other[0] = 1
    near, far = (_weigh(things, other, _look(shots(NOWHERE, 1.8, [planar(x, 1.8, 0)])[0]),
                        SOURCE, LIMITS)[0][0, OTHER] for x in (2.6, 1.6))
    # A metre farther away the wall behind the board has a third of the pixels.
    assert near >= LIMITS.least and 0.2 * near < far < 0.5 * near


def test_few_samples_turn_if_images_say_so() -> None:
    sliver = learnt(DRIVE[10], slice(30, 33))
    changes = Changes([sliver])
    count = len(sliver.samples.parts)
    assert LIMITS.each * count < LIMITS.least / 2
    turn = find_turn(shots(NOWHERE, 1.8, LOOKS), changes, SOURCE, 7, 1)
    assert turn is not None and turn.parts.tolist() == [0]
    assert find_turn(shots(NOWHERE, 1.8, LOOKS[:1]), changes, SOURCE, 7, 1) is None
    assert find_turn(shots(1.8, 1.8, LOOKS), changes, SOURCE, 7, 1) is None


def test_what_lies_apart_is_of_two_parts() -> None:
    random = np.random.default_rng(0)
    points = np.concatenate([random.uniform(0, 1, (300, 3)), random.uniform(3, 4, (200, 3)),
                             [[9.0, 9, 9]]])
    parts = parts_of(points, 24, LIMITS)
    assert (parts[:300] == 0).all() and (parts[300:500] == 1).all() and parts[500] == PARTS - 1
    many = np.repeat(np.arange(40)[:, None] * [5.0, 0, 0], 30, 0)
    assert set(parts_of(many, 24, LIMITS)) == set(range(PARTS))


def test_parts_at_one_place_are_one_thing() -> None:
    far = learnt(planar(1.2, 2.9, 0), board=3.2)
    things = Things([*PATCHES, far]).of.reshape(-1, PARTS)
    assert things[0, 0] == things[1, 0] == things[2, 0] != things[3, 0] >= 0
    assert (things[:, 1:] == -1).all()


def test_patches_without_a_sample_are_things_that_never_turn() -> None:
    # Samples are of every third pixel.
    sliver = learnt(DRIVE[10], slice(31, 33))
    assert not len(sliver.samples.parts)
    assert (Things([sliver]).of == -1).all()
    assert find_turn(shots(NOWHERE, 1.8, LOOKS), Changes([sliver]), SOURCE, 7, 1) is None
    both = Things([sliver, PATCHES[0]]).of
    assert both[PARTS] == 0 and np.count_nonzero(both >= 0) == 1


@pytest.mark.slow
def test_what_is_hidden_is_not_drawn() -> None:
    memory, pose = box_memory(), planar(1.8, 1.7, 12)

    def drawn() -> np.ndarray:
        return MemoryRenderer(memory).render(pose, EXPANSION.target).image
    before = drawn()
    memory.change(Changes(PATCHES))
    after = drawn()
    turn = Turn(np.arange(3, dtype=np.uint32) * PARTS, 0, 0)
    memory.change(Changes([*PATCHES, turn]))
    hidden = drawn()
    memory.change(Changes([*PATCHES, turn, turn]))
    assert np.array_equal(hidden, before) and np.array_equal(drawn(), after)
    assert np.abs(after - before).max() > 60


@pytest.mark.parametrize('hidden', [False, True])
def test_what_may_be_in_another_state_is_found_in_a_view(hidden: bool) -> None:
    pose = planar(1.8, 1.7, 12)
    turn = Turn(np.arange(3, dtype=np.uint32) * PARTS, 0, 0)
    changes = Changes([*PATCHES, turn] if hidden else PATCHES)
    depth, board = with_board(pose, EXPANSION.target)[1:]
    if hidden:  # The wall behind it is shown.
        depth = view(pose, EXPANSION.target)[1].astype(np.float32)
    found = changes.shown_at(depth, EXPANSION.target, pose)
    assert found.shape == board.shape and found[board].mean() > (0.5 if hidden else 0.75)
    assert found[:, :20].max() == 0
