"""What comes back is seen in part, and turned back as a whole."""
from pathlib import Path

from box_room import HIGH, SOURCE
from neo_ros.baking.keyframes import Photos
from neo_ros.benchmark.small_room import AFTER, drive
from neo_ros.field.rendering import render_rays, world_rays
from neo_ros.field.voxel_field import VoxelField
from neo_ros.geometry import CameraPose
from neo_ros.updating.compared_photos import ComparedPhotos
from neo_ros.updating.past import MOST_LOOKS, Past
from neo_ros.updating.turned_back import turn_back, TurnedBack
import numpy as np
import pytest

# Of the post nobody sees what is lower, metres.
SEEN_FROM = 0.8


def room(colour: float | None) -> VoxelField:
    """Return a grey room with a post of a colour, None: without."""
    field = VoxelField.empty(60_000, HIGH / 2, HIGH / 2 + 0.2, 0.2, 0)
    points = field.world_points()
    matter, post = ((points < 0) | (points > HIGH)).any(-1), np.zeros(field.shape, bool)
    if colour is not None:
        x, y, z = np.moveaxis(points, -1, 0)
        post = (abs(x - AFTER[0]) < 0.25) & (abs(y - AFTER[1]) < 0.25) & (z > 0.1) & (z < 2)
    field.grid[(matter | post).ravel(), 0] = 20
    field.grid[post.ravel(), 1] = colour
    field = field.keeping((matter | post).ravel())
    field.update_occupancy()
    return field


def taken_in(truth: VoxelField, memory: VoxelField) -> ComparedPhotos:
    """Return photos of a drive through what is there, of which the lowest part is masked."""
    poses = drive(12)
    shown, known = ([render_rays(field, *world_rays(SOURCE, pose)) for pose in poses]
                    for field in (truth, memory))
    images, before = (np.stack([np.rint(255 * one.image) for one in views])
                      for views in (shown, known))
    depth = np.stack([one.depth for one in known])
    usable = np.stack([(pose.position + one.depth[..., None] * world_rays(SOURCE, pose)[1])[..., 2]
                       > SEEN_FROM for pose, one in zip(poses, shown)])
    off = (np.abs(images - before).max(-1) > 15) & usable
    return ComparedPhotos(
        Photos(images.astype(np.uint8), SOURCE, np.stack([pose.T_world_cam for pose in poses]),
               usable), np.ones((12, 3), np.float32), depth, off, usable & ~off,
        np.zeros_like(off), 0, np.ones(0, bool))


def past_of(*fields: VoxelField) -> Past:
    """Return what updates changed that found one field after the other."""
    everywhere, nowhere = np.ones(fields[0].shape, bool), np.zeros(fields[0].shape, np.int32)
    everywhere[-1], everywhere[:, -1], everywhere[:, :, -1] = False, False, False
    past = Past.read(Path('no run'))
    for update, (before, after) in enumerate(zip(fields, fields[1:]), 1):
        past = past.with_more(before, after, everywhere, nowhere, update, np.empty(0, np.int32))
    return past


def turned(truth: VoxelField, *fields: VoxelField) -> TurnedBack:
    return turn_back(fields[-1], taken_in(truth, fields[-1]), past_of(*fields))


def dense(field: VoxelField) -> np.ndarray:
    return field.with_air().grid


def test_what_came_back_is_there_as_a_whole() -> None:
    there, gone = room(3.0), room(None)
    found = turned(there, there, gone)
    assert (dense(found.field) == dense(there)).all()
    place, = found.space.places
    assert place.low[2] < 0.2 < SEEN_FROM < place.high[2] and place.photos >= 3
    assert set(np.unique(found.undone)) == {0, 1} and (found.undone > 0).sum() < 1500
    # Nothing is left to be found, and what is there agrees.
    assert taken_in(there, gone).contradicts.sum() > 500
    assert found.compared.contradicts.sum() < 50 and found.compared.agrees.mean() > 0.4


def test_what_left_again_is_gone() -> None:
    there, gone = room(3.0), room(None)
    assert (dense(turned(gone, gone, there).field) == dense(gone)).all()


@pytest.mark.parametrize('truth', [None, -3.0])
def test_what_is_as_the_memory_has_it_or_something_else_turns_nothing_back(
        truth: float | None) -> None:
    there, gone = room(3.0), room(None)
    found = turned(room(truth), there, gone)
    assert not found.undone.any() and not found.space.places and found.field is gone


def test_of_several_looks_the_right_one_is_chosen() -> None:
    red, other, gone = room(3.0), room(-3.0), room(None)
    for first, second in ((red, other), (other, red)):
        found = turned(red, first, second, gone)
        assert (dense(found.field) == dense(red)).all()
        assert found.undone.max() == (1 if first is red else 2)


def test_what_was_turned_back_counts_as_before_and_may_turn_again() -> None:
    there, gone = room(3.0), room(None)
    past, found = past_of(there, gone), turned(there, there, gone)
    nothing, nobody = np.zeros(there.shape, bool), np.empty(0, np.int32)
    after = past.with_more(gone, found.field, nothing, found.undone, 2, nobody)
    changed = found.undone > 0
    assert past.dates(gone)[changed].all() and not after.dates(gone)[changed].any()
    # What it was turned back to is no look of before any more, what was there until then is one.
    assert after.looks.updates == [2] and len(after.looks.until) == len(past.looks.until)
    again = turn_back(found.field, taken_in(gone, found.field), after)
    assert (dense(again.field) == dense(gone)).all()


def test_looks_are_kept_in_the_run_and_the_oldest_go(tmp_path: Path) -> None:
    there, gone = room(3.0), room(None)
    past = past_of(*[there, gone] * (MOST_LOOKS // 2), there, gone)
    assert past.looks.updates == [*range(2, MOST_LOOKS + 2)]
    past.write(tmp_path)
    read = Past.read(tmp_path)
    points, values = read.looks.of(2, gone)
    assert points.sum() == len(values) > 100
    assert (values == dense(gone)[points.ravel()]).all()
    assert read.looks.values.dtype == read.looks.points.dtype == np.float32


def test_a_run_of_an_earlier_version_has_no_looks(tmp_path: Path) -> None:
    past = past_of(room(3.0), room(None))
    np.savez(tmp_path / 'changes.npz', points=past.points, updates=past.updates,
             founders=past.founders, allow_pickle=False)
    read = Past.read(tmp_path)
    assert not read.looks.updates and len(read.points) == len(past.points)
    now = room(None)
    assert turn_back(now, taken_in(room(3.0), now), read).field is now


def test_photos_that_look_away_say_nothing() -> None:
    there, gone = room(3.0), room(None)
    found = taken_in(there, gone)
    away = [CameraPose.from_planar(pose.position[0], pose.position[1], pose.position[2],
                                   pose.yaw + np.pi).T_world_cam
            for pose in map(CameraPose, found.photos.T_world_cam)]
    found.photos.T_world_cam[:] = np.stack(away)
    assert not turn_back(gone, found, past_of(there, gone)).undone.any()
