"""Where a scene has changed: images vote on the cells of its field."""
from box_room import HIGH, SOURCE
from changing_room import AFTER, BEFORE, drive, look
from neo_ros.field.voxel_field import VoxelField
from neo_ros.memory.contradiction import contradicted, contradiction
from neo_ros.updating.changed_space import ChangedSpace, find_changed_space
from neo_ros.updating.driven_photos import Drive, DrivenPhoto
import numpy as np
import pytest

Place = tuple[float, float]


def driven(before: Place, after: Place, walker: bool = False) -> Drive:
    """Drive through the room with the post moved; a walker is elsewhere in each image."""
    photos = []
    for number, pose in enumerate(drive()):
        place = (3.4 + 0.3 * np.sin(9 * number), 2 + 1.3 * np.sin(5 * number)) if walker else after
        now, (then, depth, _) = look(pose, SOURCE, place)[0], look(pose, SOURCE, before)
        off = contradicted(contradiction(now.astype(np.float32), then.astype(np.float32),
                                         depth > 0))
        photos.append(DrivenPhoto(now, pose, depth.astype(np.float32), off))
    return Drive(photos, len(photos), SOURCE)


def empty_field() -> VoxelField:
    return VoxelField.empty(60_000, HIGH / 2, HIGH / 2 + 0.2, 0.2, 0)


def at(space: ChangedSpace, place: Place) -> bool:
    points = np.array([[*place, z] for z in np.linspace(1.0, 1.8, 9)])
    return bool(space.holds(empty_field(), points).mean() > 0.5)


def test_what_left_and_what_came_is_found() -> None:
    space = find_changed_space(empty_field(), driven(BEFORE, AFTER))
    assert at(space, BEFORE) and at(space, AFTER)
    assert not at(space, (1.0, 2.0)) and not at(space, (4.6, 2.0))
    assert space.cells.mean() < 0.2
    assert all(place.images >= 3 for place in space.places)


def test_nothing_is_found_where_nothing_changed() -> None:
    space = find_changed_space(empty_field(), driven(BEFORE, BEFORE))
    assert not space.places and not space.cells.any()


def test_who_walks_about_is_no_change() -> None:
    away = (99.0, 99.0)
    moving = find_changed_space(empty_field(), driven(away, away, walker=True))
    standing = find_changed_space(empty_field(), driven(away, AFTER))
    assert moving.cells.sum() < 0.1 * standing.cells.sum()


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
