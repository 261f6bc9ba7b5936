from neo_ros.errors import SceneError
from neo_ros.flat import building as building_module
from neo_ros.flat.building import build_building
from neo_ros.flat.building_plan import BuildingPlan, place_pieces
from neo_ros.flat.building_rooms import picture_slot, Room
from neo_ros.flat.building_routes import (
    corridor_drive, door_walks, doorway, mapping_poses)
from neo_ros.flat.light import LightQuality
from neo_ros.flat.raycast import camera_directions, cast_rays
from neo_ros.flat.scene_writing import write_building_scene
from neo_ros.flat.walks import obstacle_distance
from neo_ros.geometry import CameraPose, Intrinsics
from neo_ros.scenes.scene import read_scene
from neo_ros.scenes.walkable import read_walkable
import numpy as np
import pytest

CAMERA = Intrinsics.from_hfov(24, 24, np.pi / 2)
PLAN = BuildingPlan(floors=2, rooms=6, seed=2, twins=1)


@pytest.fixture(scope='module')
def building():
    quick = LightQuality(texel=1.0, shadow_rays=2, bounce_rays=2, bounces=1)
    with pytest.MonkeyPatch.context() as patch:
        patch.setattr(building_module, 'ROOM_LIGHT', quick)
        return build_building(PLAN)


def _inside(room, yaw_deg=70.0):
    x, y, z = room.to_world(np.array([1.25, 0.7, 1.5])).tolist()
    return CameraPose.from_planar(x, y, z, np.radians(yaw_deg + 180 * room.turned))


@pytest.mark.slow
def test_twins_look_the_same_and_other_rooms_do_not(building):
    rooms = building.rooms(0)
    same = [number for number, room in enumerate(rooms) if room.piece == rooms[0].piece]
    assert len(same) == 2
    first, second = (building.render(CAMERA, _inside(rooms[number]))[0] for number in same)
    other = next(number for number in range(6) if number not in same)
    assert np.array_equal(first, second)
    assert not np.array_equal(first, building.render(CAMERA, _inside(rooms[other]))[0])


def test_depth_is_that_of_rays_against_all_solids(building):
    pose = _inside(building.rooms(1)[3], -80.0)  # out of the door, into the corridor
    directions = camera_directions(CAMERA, pose, 1).reshape(3, -1)
    nearest = np.full(directions.shape[1], np.inf, np.float32)
    for placed in building.placed:
        solids = building.insides[placed.piece].solids
        turn = placed.turn.astype(np.float32)[:, None]
        origin = np.repeat(placed.to_own(pose.position)[:, None], directions.shape[1], axis=1)
        hits = cast_rays(solids, np.arange(len(solids)), origin.astype(np.float32),
                         directions * turn)
        nearest = np.where(hits.solid >= 0, np.minimum(nearest, hits.distance), nearest)
    depth = building.depth(CAMERA, pose)
    assert np.isfinite(nearest).mean() > 0.99
    np.testing.assert_allclose(depth.ravel()[np.isfinite(nearest)],
                               nearest[np.isfinite(nearest)], rtol=1e-4, atol=1e-4)
    np.testing.assert_allclose(building.render(CAMERA, pose)[1], depth, rtol=1e-3)


@pytest.mark.slow
def test_the_whole_building_is_closed_but_for_windows(building):
    walkable = building.walkable(0)
    for x, y in walkable.sample(np.random.default_rng(0), 6).tolist():
        up = np.array([[1.0, 0, 0], [0, 0, -1], [0, 1, 0]])
        T = np.eye(4)
        T[:3, :3], T[:3, 3] = up @ np.array([[1.0, 0, 0], [0, 0, 1], [0, -1, 0]]), (x, y, 1.5)
        assert building.depth(CAMERA, CameraPose(T)).max() < 30


def test_free_floor_joins_rooms_and_corridor_and_keeps_clear(building):
    walkable = building.walkable(1)
    assert walkable.camera_height == 4.5
    reached = [walkable.contains(np.array([doorway(room)[:2]]))[0] for room in building.rooms(1)]
    assert all(reached)
    points = walkable.sample(np.random.default_rng(0), 500)
    for placed in building.placed:
        if placed.floor == 1:
            solids = building.insides[placed.piece].solids
            own = (points - placed.origin[:2]) * placed.turn[:2]
            assert obstacle_distance(solids, own).min() >= 0.25


def test_a_mapping_robot_stops_within_half_a_metre_of_everything(building):
    poses = mapping_poses(building, 0)
    stops = np.array([pose.position[:2] for pose in poses])
    centres = building.walkable(0).centres()
    away = np.linalg.norm(centres[::7, None] - stops[None, ::4], axis=2).min(1)
    assert away.max() <= 0.5 + 0.05
    assert building.walkable(0).contains(stops).all()
    yaws = np.sort([pose.yaw for pose in poses[:4]])
    np.testing.assert_allclose(np.diff(yaws), np.pi / 2)


def test_test_walks_cross_doors(building):
    walks = door_walks(building, 0, 25, seed=3)
    doors = [doorway(room) for room in building.rooms(0)]
    assert len(walks) >= 3
    for walk in walks:
        places = np.array([pose.position[:2] for pose in walk])
        assert building.walkable(0).contains(places).all()
        assert any((np.abs(places[:, 0] - door.x).min() < 0.3
                    and places[:, 1].min() < door.y - 0.2 and places[:, 1].max() > door.y + 0.2)
                   for door in doors)


def test_a_plan_follows_its_seed():
    assert place_pieces(PLAN) == place_pieces(PLAN)
    other = BuildingPlan(floors=2, rooms=6, seed=3, twins=1)
    assert place_pieces(other) != place_pieces(PLAN)


def _rooms(plan):
    return [one.piece for one in place_pieces(plan) if isinstance(one.piece, Room)]


def test_rooms_share_as_much_as_was_asked_for():
    rooms = _rooms(BuildingPlan(rooms=12, alike=0.8))
    owners = np.array([room.owners for room in rooms])
    assert len({room.kind for room in rooms}) == 1
    assert (owners == 0).mean() == pytest.approx(0.8, abs=0.08)


def test_twins_with_a_picture_of_their_own_differ_in_nothing_else():
    rooms = _rooms(BuildingPlan(rooms=12, twins=3, own_picture=True))
    pairs = [(one, other) for index, one in enumerate(rooms) for other in rooms[:index]
             if len(set(one.owners) & set(other.owners))]
    assert len(pairs) == 3
    for one, other in pairs:
        differing = [slot for slot, (a, b) in enumerate(zip(one.owners, other.owners)) if a != b]
        assert differing == [picture_slot(one.kind)] and one.window == other.window


def test_equal_floors_are_equal():
    placed = place_pieces(BuildingPlan(floors=2, rooms=4, equal_floors=True))
    floors = [[one.piece for one in placed if one.floor == floor] for floor in (0, 1)]
    assert floors[0] == floors[1]


@pytest.mark.parametrize('settings, said', [
    ({'rooms': 0}, 'rooms: expected 1 to 250, got 0'),
    ({'floors': 99}, 'floors: expected 1 to 20, got 99'),
    ({'rooms': 4, 'twins': 3}, 'twins: expected 0 to 2, got 3'),
    ({'alike': 1.5}, 'alike: expected a share from 0 to 1, got 1.5')], ids=str)
def test_a_plan_that_cannot_be_built_is_refused(settings, said):
    with pytest.raises(SceneError, match=said):
        BuildingPlan(**settings)


def test_the_plan_grows_with_its_rooms():
    assert BuildingPlan(rooms=12).area == pytest.approx(240, rel=0.1)
    assert BuildingPlan(floors=2, rooms=125).area == pytest.approx(5000, rel=0.1)


@pytest.mark.slow
def test_a_building_becomes_a_scene_with_a_map_for_each_floor(tmp_path, monkeypatch):
    monkeypatch.setattr(building_module, 'ROOM_LIGHT',
                        LightQuality(texel=1.0, shadow_rays=2, bounce_rays=2, bounces=1))
    plan = BuildingPlan(floors=2, rooms=2, seed=5)
    stages = set()
    write_building_scene(tmp_path, plan, image_size=16, n_train=6, frames_per_path=3, depth=True,
                         progress=lambda stage, *_: stages.add(stage), workers=1)
    scene = read_scene(tmp_path)
    assert len(scene.train) == 6 and scene.train.read_images().shape == (6, 16, 16, 3)
    assert scene.test is not None and len(scene.test) % 3 == 0
    assert scene.expansion is not None and scene.expansion.target.width == 32
    assert sorted({pose.position[2] for pose in scene.train.poses}) == [1.5, 4.5]
    assert scene.walkable is not None and scene.walkable.camera_height == 1.5
    assert read_walkable(tmp_path / 'walkable_1.json').camera_height == 4.5
    assert stages == {'light', 'images'}
    before = (tmp_path / 'train' / '0003.png').read_bytes()
    (tmp_path / 'train' / '0003.png').unlink()
    write_building_scene(tmp_path, plan, image_size=16, n_train=6, frames_per_path=3, depth=True,
                         progress=lambda *_: None, workers=1)
    assert (tmp_path / 'train' / '0003.png').read_bytes() == before
    with pytest.raises(SceneError, match='expected an empty folder or a demo scene of'):
        write_building_scene(tmp_path, BuildingPlan(rooms=2), image_size=16, n_train=6,
                             progress=lambda *_: None, workers=1)


def test_more_photos_than_the_robot_takes_are_refused(tmp_path, monkeypatch):
    monkeypatch.setattr(building_module, 'ROOM_LIGHT',
                        LightQuality(texel=2.0, shadow_rays=2, bounce_rays=1, bounces=1))
    with pytest.raises(SceneError, match='photos: expected at most [0-9]+, which a mapping'):
        write_building_scene(tmp_path, BuildingPlan(rooms=1), n_train=100_000,
                             progress=lambda *_: None, workers=1)


def test_a_drive_goes_down_the_middle_of_a_corridor(building):
    drive = corridor_drive(building, 1, 0.5)
    places = np.stack([pose.position for pose in drive])
    assert (np.diff(places[:, 0]) >= 0.5 - 1e-9).all() and np.ptp(places[:, 0]) > 8
    assert np.ptp(places[:, 1:], axis=0).max() == 0
    assert building.walkable(1).contains(places[:, :2]).all() and places[0, 2] == 4.5
    doors = np.array([doorway(room)[:2] for room in building.rooms(1)])
    assert doors[:, 1].min() < places[0, 1] < doors[:, 1].max()
    assert all((pose.forward == [1, 0, 0]).all() for pose in drive)
