"""What happened in a changed place."""
from dataclasses import replace

from box_room import HIGH, SOURCE
from changing_room import remembered
from neo_ros.baking.keyframes import Photos
from neo_ros.benchmark.small_room import AFTER, BEFORE, drive, look, Place
from neo_ros.field.voxel_field import VoxelField
from neo_ros.updating.changed_space import ChangedPlace, find_changed_space
from neo_ros.updating.compared_photos import compare, ComparedPhotos
from neo_ros.updating.what_happened import Event, what_happened
import numpy as np
import pytest


@pytest.fixture(scope='module')
def moved() -> tuple[ComparedPhotos, list[ChangedPlace]]:
    """Return what a drive shows after a post was moved."""
    poses = drive(40)
    posts = [BEFORE, AFTER] * 20
    images = np.stack([look(pose, SOURCE, post)[0] for pose, post in zip(poses, posts)])
    T = np.stack([pose.T_world_cam for pose in poses])
    order = [*range(0, 40, 2), *range(1, 40, 2)]
    found = compare(Photos(images[order], SOURCE, T[order], np.ones(images.shape[:3], bool)), 20,
                    remembered(BEFORE))
    return found, find_changed_space(field_of(), found).places


def field_of(*posts: Place) -> VoxelField:
    """Return the room with posts in it."""
    field = VoxelField.empty(60_000, HIGH / 2, HIGH / 2 + 0.2, 0.2, 0).with_air()
    points = field.world_points()
    x, y, z = np.moveaxis(points, -1, 0)
    matter = ((points < 0) | (points > HIGH)).any(-1)
    for post in posts:
        matter |= (abs(x - post[0]) < 0.2) & (abs(y - post[1]) < 0.2) & (z > 0.5) & (z < 2)
    field.grid[field.row_of[matter.ravel()], 0] = 20
    field.update_occupancy()
    return field


def of_place(places: list[ChangedPlace], events: list[list[Event]], post: Place) -> list[Event]:
    """Return what happened where a post stood, or stands."""
    found, = (happened for place, happened in zip(places, events)
              if (place.low[:2] < post).all() and (place.high[:2] > post).all())
    return found


def test_what_left_and_what_came_is_told(moved: tuple[ComparedPhotos, list[ChangedPlace]]) -> None:
    found, places = moved
    events = what_happened(field_of(BEFORE), field_of(AFTER), places, found)
    assert of_place(places, events, BEFORE)[0] == Event.LEFT
    assert of_place(places, events, AFTER)[0] == Event.CAME


def test_what_stands_where_it_stood_looks_otherwise(
        moved: tuple[ComparedPhotos, list[ChangedPlace]]) -> None:
    found, places = moved
    events = what_happened(field_of(BEFORE, AFTER), field_of(BEFORE, AFTER), places, found)
    assert of_place(places, events, BEFORE) == [Event.REPAINTED]


def test_a_place_that_few_photos_show_has_no_story(
        moved: tuple[ComparedPhotos, list[ChangedPlace]]) -> None:
    found, places = moved
    few = found.contradicts.copy()
    few[found.old + 2:] = False
    assert not any(what_happened(field_of(BEFORE), field_of(AFTER), places,
                                 replace(found, contradicts=few)))
