"""Where a scene has changed: photos vote on the cells of its field."""
from dataclasses import replace

from box_room import HIGH, SOURCE
from changing_room import remembered
from neo_ros.baking.keyframes import Photos
from neo_ros.benchmark.small_room import AFTER, BEFORE, drive, HEIGHT, look, Place
from neo_ros.errors import BagError
from neo_ros.field.grid_points import cells_apart
from neo_ros.field.rendering import render_rays, world_rays
from neo_ros.field.voxel_field import VoxelField
from neo_ros.geometry import CameraPose
from neo_ros.updating.changed_space import ChangedSpace, find_changed_space
from neo_ros.updating.compared_photos import compare, ComparedPhotos, EarlierChanges
from neo_ros.updating.kernels import rays_meet_cells
from neo_ros.updating.refit import still_right
import numpy as np
import pytest

AWAY = (99.0, 99.0)


def photos_of(poses: list[CameraPose], posts: list[Place]) -> tuple[np.ndarray, np.ndarray]:
    return (np.stack([look(pose, SOURCE, post)[0] for pose, post in zip(poses, posts)]),
            np.stack([pose.T_world_cam for pose in poses]))


def compared(before: Place, memory: Place, now: Place, walker: bool = False,
             poses: list[CameraPose] | None = None) -> ComparedPhotos:
    """Compare a drive with a memory, and with photos of before; a walker is never in one place."""
    old, new = drive(40)[1::2], drive(40)[::2] if poses is None else poses
    places = [(3.4 + 0.3 * np.sin(9 * number), 2 + 1.3 * np.sin(5 * number)) if walker else now
              for number in range(len(new))]
    images, T = (np.concatenate(one) for one in zip(
        photos_of(old, [before] * len(old)), photos_of(new, places)))
    return compare(Photos(images, SOURCE, T, np.ones(images.shape[:3], bool)), len(old),
                   remembered(memory))


def empty_field() -> VoxelField:
    return VoxelField.empty(60_000, HIGH / 2, HIGH / 2 + 0.2, 0.2, 0)


def at(space: ChangedSpace, place: Place) -> bool:
    points = np.array([[*place, z] for z in np.linspace(1.0, 1.8, 9)])
    return bool(space.holds(empty_field(), points).mean() > 0.5)


def there(place: Place) -> np.ndarray:
    return np.stack([look(pose, SOURCE, place)[2] for pose in drive(40)[::2]])


def test_what_left_and_what_came_is_found() -> None:
    found = compared(BEFORE, BEFORE, AFTER)
    changed, truth = found.contradicts[found.old:], there(BEFORE) | there(AFTER)
    assert changed[truth].mean() > 0.65 and changed[~truth].mean() < 0.01
    space = find_changed_space(empty_field(), found)
    assert at(space, BEFORE) and at(space, AFTER)
    assert not at(space, (1.0, 2.0)) and not at(space, (4.6, 2.0))
    assert all(place.photos >= 3 for place in space.places)


def test_nothing_is_found_where_nothing_changed() -> None:
    # Keyframes that do not see all sides of the post make a memory that photos contradict.
    found = compared(BEFORE, BEFORE, BEFORE)
    assert found.contradicts[found.old:].mean() > 0.01
    space = find_changed_space(empty_field(), found)
    assert not space.places and not space.cells.any()


def test_where_the_memory_was_wrong_before_nothing_has_changed() -> None:
    # Photos of before show the post where it is now: only the memory has it elsewhere.
    found = compared(AFTER, BEFORE, AFTER)
    assert found.agrees[found.old:].mean() < 0.95
    assert not find_changed_space(empty_field(), found).places


def of_a_drive(found: ComparedPhotos) -> EarlierChanges:
    """Return that photos of before are those of the drive of an update, after all changes."""
    field = empty_field()
    return EarlierChanges(
        field, np.zeros(field.shape, np.int32), np.ones(found.old, np.int32),
        np.zeros(found.old, bool), np.zeros(found.depth.shape, bool))


def test_where_an_update_was_wrong_the_next_drive_may_say_so() -> None:
    found = compared(AFTER, BEFORE, AFTER)
    space = find_changed_space(empty_field(), compare(
        found.photos, found.old, remembered(BEFORE), earlier=of_a_drive(found)))
    assert at(space, BEFORE) and at(space, AFTER)


@pytest.mark.parametrize('told', [True, False])
def test_what_came_may_leave_again(told: bool) -> None:
    """The training saw through where it stood for a while: that says nothing of the memory now."""
    poses, field = drive(60), empty_field()
    trained, first, now = poses[::3], poses[1::3], poses[2::3]
    posts = [BEFORE] * len(trained) + [AFTER] * len(first) + [BEFORE] * len(now)
    images, T = photos_of([*trained, *first, *now], posts)
    old, shape = len(trained) + len(first), images.shape[:3]
    x, y, z = np.moveaxis(field.world_points(), -1, 0)
    dates = np.zeros(field.shape, np.int32)
    for post in (BEFORE, AFTER):
        dates[(abs(x - post[0]) < 0.4) & (abs(y - post[1]) < 0.4)] = 1
    updates = np.repeat(np.arange(2, dtype=np.int32), [len(trained), len(first)])
    found = compare(Photos(images, SOURCE, T, np.ones(shape, bool)), old, remembered(AFTER),
                    earlier=EarlierChanges(
                        field, dates if told else np.zeros_like(dates), updates, updates == 0,
                        np.zeros(shape, bool)))
    space = find_changed_space(field, found)
    assert at(space, AFTER) == at(space, BEFORE) == told


def test_what_is_out_of_date_has_no_say() -> None:
    found = compared(AFTER, BEFORE, AFTER)
    stale = np.zeros(found.depth.shape, bool)
    stale[:found.old] = found.contradicts[:found.old]
    again = compare(found.photos, found.old, remembered(BEFORE), earlier=replace(
        of_a_drive(found), stale=stale, founders=np.ones(found.old, bool)))
    assert not again.contradicts[:found.old].any() and not again.agrees[stale].any()
    assert (again.depth[stale] > 0).all()
    # They are no witnesses of what was there either.
    assert again.contradicts[found.old:].sum() < found.contradicts[found.old:].sum()


def test_from_one_place_nothing_is_found() -> None:
    seen = drive(40)[20]
    x, y, z = seen.position
    found = compared(BEFORE, BEFORE, AFTER, poses=[
        CameraPose.from_planar(x, y + 0.005 * step, z, seen.yaw) for step in range(8)])
    assert found.contradicts[found.old:].mean() > 0.05
    assert not find_changed_space(empty_field(), found).places


def test_who_walks_about_is_no_change() -> None:
    moving = find_changed_space(empty_field(), compared(AWAY, AWAY, AWAY, walker=True))
    standing = find_changed_space(empty_field(), compared(AWAY, AWAY, AFTER))
    assert moving.cells.sum() < 0.3 * standing.cells.sum()


def test_an_image_that_contradicts_as_a_whole_has_no_say() -> None:
    wrong = drive(40)[0]
    elsewhere = CameraPose.from_planar(1.0, 1.0, wrong.position[2], wrong.yaw + 2)
    found = compared(BEFORE, BEFORE, BEFORE, poses=[wrong])
    photos = found.photos
    photos.T_world_cam[-1] = elsewhere.T_world_cam
    found = compare(photos, found.old, remembered(BEFORE))
    usable = found.photos.usable
    assert usable is not None and usable[0].all() and not usable[-1].any()
    assert not found.contradicts[-1].any()


@pytest.mark.parametrize('reach, met', [(0.0, True), (1.0, False), (3.0, True)])
def test_rays_meet_cells_up_to_their_reach(reach: float, met: bool) -> None:
    field = empty_field()
    cells = np.zeros(field.shape, bool)
    index = ((field.grid_position(np.array([3.5, 2.0, 1.3])) + 1) / 2 * (
        np.array(field.shape) - 1)).astype(int)
    cells[tuple(index)] = True
    space = ChangedSpace(cells, [])
    middle = field.world_points(index + 0.5)
    origin = middle - [2.0, 0, 0]
    rays = np.array([[1.0, 0, 0], [-1.0, 0, 0], [0, 1.0, 0]], np.float32)
    found = space.met_by(field, origin, rays, np.full(3, reach, np.float32))
    assert found.tolist() == [met, False, False]


def test_far_steps_pass_no_cell_over() -> None:
    field, random = empty_field(), np.random.default_rng(0)
    for share in (1e-3, 1e-2):
        cells = random.random(field.shape) < share
        apart = cells_apart(cells)
        assert apart.max() > 4
        for origin in field.centre + field.half_extent * random.uniform(-1.1, 1.1, (5, 3)):
            rays = random.normal(size=(500, 3)).astype(np.float32)
            rays /= np.linalg.norm(rays, axis=1, keepdims=True)
            reach = random.uniform(0, 9, 500).astype(np.float32)
            found, half_a_voxel = (rays_meet_cells(field, one, origin, rays, reach)
                                   for one in (apart, np.minimum(apart, 1)))
            np.testing.assert_array_equal(found, half_a_voxel)
            assert 0 < found.sum() < 500


def test_photos_of_before_say_nothing_of_what_is_behind_what_came() -> None:
    before, found = empty_field(), compared(AWAY, AWAY, AWAY)
    after = before.with_air()
    x, y, z = np.moveaxis(after.world_points(), -1, 0)
    post = (abs(x - AFTER[0]) < 0.2) & (abs(y - AFTER[1]) < 0.2) & (z > 0.5) & (z < 2)
    after.grid[after.row_of[post.ravel()], :2] = 20, 3  # And of another colour.
    everywhere = ChangedSpace(np.ones(before.shape, bool), [])
    # Photos that show all that is there now, but were taken before.
    images = np.stack([np.rint(255 * render_rays(after, *world_rays(SOURCE, CameraPose(T))).image)
                       for T in found.photos.T_world_cam]).astype(np.uint8)
    found = replace(found, photos=replace(found.photos, images=images),
                    gains=np.ones_like(found.gains))
    asked = np.ones(images.shape[:3], bool)
    right, all_right = (still_right(one, after, everywhere, found, asked)
                        for one in (before, after))
    stands = np.stack([look(pose, SOURCE, AFTER)[2] for pose in drive(40)[1::2]])
    assert right.shape == all_right.shape == stands.shape  # Of photos of before alone.
    hidden = all_right & ~right
    assert hidden[stands].mean() > 0.7 and hidden[~stands].mean() < 0.2
    # What is out of date may be what stands there again, and its photos are nearer to that.
    stale = np.ones(found.stale.shape, bool)
    again = still_right(before, after, everywhere, replace(found, stale=stale), asked)
    assert again[stands].mean() > 0.6
    gone = still_right(before, before, everywhere, replace(found, stale=stale), asked)
    assert gone[stands].mean() < 0.3


def test_a_picture_that_was_changed_is_no_thing_before_its_wall() -> None:
    """All photos look at it from one side: a thing anywhere on the way would look alike, too."""
    old, new = drive(40)[1::2], [
        CameraPose.from_planar(1.0 + 0.15 * step, 1.6 + 0.1 * (step % 3), HEIGHT, 0.1 * (step % 2))
        for step in range(12)]
    images, T = photos_of(old + new, [AWAY] * (len(old) + len(new)))
    images = images.copy()
    for image, pose in zip(images[len(old):], new):
        rays = SOURCE.pixel_rays() @ pose.T_world_cam[:3, :3].T
        points = pose.position + look(pose, SOURCE, AWAY)[1][..., None] * rays
        y, z = points[..., 1], points[..., 2]
        on_wall = (points[..., 0] > HIGH[0] - 0.05) & (abs(y - 2) < 0.6) & (abs(z - 1.4) < 0.4)
        image[on_wall] = (130 + 110 * np.sin(6 * y) * np.sin(6 * z))[on_wall, None]
    found = compare(Photos(images, SOURCE, T, np.ones(images.shape[:3], bool)), len(old),
                    remembered(AWAY))
    space = find_changed_space(empty_field(), found)
    assert space.places
    assert all(place.low[0] > HIGH[0] - 0.5 for place in space.places)
    # In another light it may be the light.
    assert not find_changed_space(empty_field(), found, other_light=True).places


def test_in_another_light_what_moved_is_found_and_what_looks_otherwise_has_no_say() -> None:
    found = compared(BEFORE, BEFORE, AFTER)
    space = find_changed_space(empty_field(), found, other_light=True)
    assert at(space, BEFORE) and at(space, AFTER)


def test_a_light_in_which_much_looks_otherwise_tells_no_changes() -> None:
    found = compared(AWAY, AWAY, AWAY)
    far_wall = np.stack([
        origin[0] + depth * rays[..., 0] > HIGH[0] - 0.1 for depth, (origin, rays) in zip(
            found.depth, (world_rays(SOURCE, CameraPose(T)) for T in found.photos.T_world_cam))])
    far_wall[:found.old] = False
    by_lamps = replace(found, contradicts=found.contradicts | far_wall)
    assert find_changed_space(empty_field(), by_lamps).places
    with pytest.raises(BagError, match='^taken in another light.* give bags in the light of'):
        find_changed_space(empty_field(), by_lamps, other_light=True)
