"""`neo update` with a bag that drives into a room that the scene did not have."""
from dataclasses import replace
import json
from pathlib import Path

from neo_ros.benchmark.kills import ROOM
from neo_ros.experiment import ViewConfig
from neo_ros.field.voxel_field import VoxelField
from neo_ros.geometry import CameraPose
from neo_ros.memory.scene_memory import SceneMemory
from neo_ros.pipeline import train
from neo_ros.runtime import FovExtrapolator, read_model_card
from neo_ros.scenes.scene import read_scene
from neo_ros.updating.update import update, UpdateOptions
import numpy as np
import pytest
from two_rooms import (
    DOORWAY, HEIGHT, look, WIDE, write_door_drive, write_first_room)

pytestmark = [pytest.mark.slow, pytest.mark.torch, pytest.mark.timeout(900)]
EXPERIMENT = replace(ROOM, view=ViewConfig((80, 80), (160, 160)),
                     field=replace(ROOM.field, steps=1200))
QUICK = UpdateOptions(minutes=0.15)
OLD = [(1.2, 1.2, 0.5), (2.0, 2.2, -2.0), (2.4, 1.4, 3.0)]
NEW = [(4.9, 1.3, 0.2), (5.5, 2.2, 2.4), (5.9, 1.6, 1.2)]


@pytest.fixture(scope='module')
def base(tmp_path_factory: pytest.TempPathFactory) -> Path:
    """Return a folder with the run of the first room, and the run that the bag updated."""
    pytest.importorskip('pycolmap')
    folder = tmp_path_factory.mktemp('growing')
    write_first_room(folder / 'room')
    train(folder / 'room', EXPERIMENT, folder / 'run')
    write_door_drive(folder / 'drive')
    found, = update(folder / 'run', [folder / 'drive'], folder / 'new', experiment=EXPERIMENT)
    assert found
    return folder


def memory_of(folder: Path) -> SceneMemory:
    named = read_model_card(folder / 'room.onnx').memory
    assert named is not None
    return SceneMemory.read(folder / named.file, named.sha256)


def seen(model: Path, places: list[tuple[float, float, float]]) -> list[tuple[float, float]]:
    """Return how far off the pose is, metres, and the ring, grey levels, where it is found."""
    extrapolator, found = FovExtrapolator.load(model), []
    ring = extrapolator.extrapolated_mask
    for x, y, yaw in places:
        pose = CameraPose.from_planar(x, y, HEIGHT, yaw)
        truth = look(pose, WIDE.target, closed=False)
        extrapolator.reset()
        view = extrapolator.expand(np.ascontiguousarray(WIDE.crop(truth)))
        if view.guide is not None:
            found.append((float(np.linalg.norm(view.guide.pose.position - pose.position)),
                          float(np.abs(view.wide_image[ring].astype(float) - truth[ring]).mean())))
    return found


def test_the_camera_is_found_in_the_new_room_and_the_room_is_shown(base: Path) -> None:
    assert not seen(base / 'run' / 'room.onnx', NEW)
    before, old, new = (seen(base / name / 'room.onnx', places) for name, places in (
        ('run', OLD), ('new', OLD), ('new', NEW)))
    assert len(before) == len(old) == len(OLD) and len(new) == len(NEW)
    assert max(metres for metres, _ in new) < 0.15
    assert np.mean([off for _, off in old]) < np.mean([off for _, off in before]) + 2
    assert np.mean([off for _, off in new]) < np.mean([off for _, off in before]) + 8


def test_what_was_there_stays(base: Path) -> None:
    old, new = memory_of(base / 'run'), memory_of(base / 'new')
    count = len(old.positions)
    np.testing.assert_array_equal(old.positions, new.positions[:count])
    np.testing.assert_array_equal(old.glances.pictures,
                                  new.glances.pictures[:len(old.glances.pictures)])
    added = new.positions[count:]
    assert len(added) >= 4 and (added[:, 0] > DOORWAY[0, 0] - 0.3).all()
    for before, after in zip(old.each(), new.each()):
        rays = old.band.rays(*before.depth.shape)
        ends = before.position + before.depth[..., None] * rays
        door = (np.abs(ends - DOORWAY.mean(0)) < (DOORWAY[1] - DOORWAY[0]) / 2 + 0.4).all(-1)
        assert (before.depth != after.depth)[~door].mean() < 0.01
    assert old.landmarks is not None and new.landmarks is not None
    there = {one.tobytes() for one in old.landmarks.points}
    kept = {one.tobytes() for one in new.landmarks.points} & there
    assert len(kept) > 0.9 * len(there) and len(new.landmarks.points) > len(kept) + 100
    field, grown = (VoxelField.load(base / name / 'field.npz') for name in ('run', 'new'))
    points = field.world_points().reshape(-1, 3)
    inside = (field.row_of >= 0) & (np.abs(points - field.centre) <= field.half_extent).all(1)
    place = (grown.grid_position(points[inside]) + 1) / 2 * (np.array(grown.shape) - 1)
    rows = grown.row_of.reshape(grown.shape)[tuple(np.rint(place).astype(int).T)]
    same = (grown.grid[rows] == field.grid[field.row_of[inside]]).all(1) & (rows >= 0)
    at_door = np.abs(points[inside] - DOORWAY.mean(0)).max(1) < 1.4
    assert same[~at_door].mean() > 0.99


def test_floor_photos_card_and_report_tell_of_it(base: Path) -> None:
    scene, before = (read_scene(base / name) for name in ('new/room', 'room'))
    assert scene.walkable is not None and before.walkable is not None
    assert scene.walkable.area > before.walkable.area + 1
    assert scene.walkable.contains(before.walkable.centres()).all()
    free = scene.walkable.centres()
    free = free[~before.walkable.contains(free)]
    # The field's surfaces are off by a voxel of a decimetre.
    assert (free[:, 0] > 3.2).all() and (free[:, 0] < 6.9).all() and (free[:, 1] < 3.3).all()
    assert len(scene.train) > len(before.train) + 60
    entry, = read_model_card(base / 'new' / 'room.onnx').updates
    assert entry.bag == 'drive' and entry.photos > 60
    assert 'The new place' in (base / 'new' / 'report.html').read_text()
    assert json.loads((base / 'new' / 'run.json').read_text())['floor'] != json.loads(
        (base / 'run' / 'run.json').read_text())['floor']


def test_a_drive_through_a_room_that_is_known_adds_nothing(base: Path, tmp_path: Path) -> None:
    before = memory_of(base / 'new')
    update(base / 'new', [base / 'drive'], tmp_path / 'again', QUICK, experiment=EXPERIMENT)
    if (tmp_path / 'again').exists():  # What moved by a little; but no place is new.
        assert len(memory_of(tmp_path / 'again').positions) == len(before.positions)
