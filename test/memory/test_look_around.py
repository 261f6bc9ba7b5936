"""Looks in any direction, against exact views of the box room and of the demo flat."""
import math

from box_room import BAND, box_memory, EXPANSION, keyframe, planar, SOURCE, view
from neo_ros.flat.demo_flat import build_demo_flat, walking_paths
from neo_ros.flat.visits import CHAIRS, changed_flat
from neo_ros.geometry import CameraPose
from neo_ros.machine.files import share_dir
from neo_ros.memory.look_around import Direction, LookAround, outline, RECENT, SeenImage
from neo_ros.memory.panorama import REMEMBERED, SEEN, UNKNOWN
from neo_ros.memory.scene_memory import Glances, SceneMemory
from neo_ros.runtime.fov_extrapolator import memory_path
from neo_ros.runtime.model_card import read_model_card
import numpy as np
import pytest

HERE = planar(1.9, 1.7, 30)


def direction(yaw_deg: float, pitch_deg: float = 0, hfov_deg: float = 90) -> Direction:
    return Direction(math.radians(yaw_deg), math.radians(pitch_deg), math.radians(hfov_deg),
                     160, 120)


def seen_from(pose: CameraPose) -> SeenImage:
    return SeenImage(view(pose, SOURCE)[0], pose)


@pytest.fixture(scope='module')
def around() -> LookAround:
    return LookAround(box_memory(), EXPANSION)


@pytest.mark.parametrize('yaw, pitch', [(30, 0), (120, 10), (-100, -30), (200, 45)])
def test_a_look_shows_what_is_there(around: LookAround, yaw: float, pitch: float) -> None:
    look = direction(yaw, pitch)
    truth, _ = view(look.pose(HERE.position), look.view)
    drawn = around.draw(HERE.position, look, seen_from(HERE))
    known = drawn.kinds != UNKNOWN
    assert known.mean() > (0.6 if pitch == 45 else 0.95)
    assert np.abs(drawn.image.astype(int) - truth)[known].mean() < 4
    assert (drawn.image[~known] == 0).all()


def test_directions_are_those_of_the_scene() -> None:
    # From the middle of the room, to a wall whose place is known.
    for yaw, axis, sign in ((0, 0, 1), (90, 1, 1), (180, 0, -1), (-90, 1, -1)):
        assert direction(yaw).pose(HERE.position).forward[axis] == pytest.approx(sign)
    up = direction(70, 30).pose(HERE.position)
    assert up.forward[2] == pytest.approx(math.sin(math.radians(30)))
    assert up.yaw == pytest.approx(math.radians(70))
    assert up.T_world_cam[2, 0] == pytest.approx(0), 'level'


def test_the_live_image_is_in_its_place_and_nowhere_else(around: LookAround) -> None:
    # A camera that sees plain blue: what is blue is its image.
    now = SeenImage(np.full((64, 64, 3), (0, 0, 255), np.uint8), HERE)
    look = direction(30 + 60)
    drawn = around.draw(HERE.position, look, now)
    rays = look.view.pixel_rays() @ look.pose(HERE.position).T_world_cam[:3, :3].T
    local = rays @ HERE.T_world_cam[:3, :3]
    inside = (local[..., 2] > 0) & (np.abs(local[..., :2]) < 0.98 * local[..., 2:]).all(-1)
    outside = (local[..., 2] <= 0) | (np.abs(local[..., :2]) > 1.02 * local[..., 2:]).any(-1)
    assert inside.any() and outside.any()
    assert (drawn.kinds[inside] == SEEN).all() and (drawn.kinds[outside] != SEEN).all()
    assert (drawn.image[inside] == (0, 0, 255)).all()
    behind = around.draw(HERE.position, direction(210), now)
    assert (behind.kinds != SEEN).all() and behind.frame == []


def test_the_outline_is_the_frame_of_the_image(around: LookAround) -> None:
    straight = direction(30, 0, 120)
    lines = outline(HERE, SOURCE, straight.pose(HERE.position), straight.view, 5)
    assert len(lines) == 1
    width = 1 / math.tan(math.radians(60))  # of the 90 degrees of the image in 120.
    assert lines[0][:, 0].min() == pytest.approx(0.5 - width / 2)
    assert lines[0][:, 0].max() == pytest.approx(0.5 + width / 2)
    turned = direction(30 + 90, 0, 90)
    for line in outline(HERE, SOURCE, turned.pose(HERE.position), turned.view, 5):
        assert len(line) > 1 and np.isfinite(line).all()


@pytest.mark.slow
def test_what_was_just_seen_is_marked_and_corrects_the_memory(around: LookAround) -> None:
    before = planar(1.9, 1.7, 110)
    # Under another exposure, with something that was not there: it is shown in that of now.
    image = np.clip(view(before, SOURCE)[0] * [0.6, 0.8, 0.8], 0, 255).astype(np.uint8)
    image[26:38, 26:38] = 0
    now, look = seen_from(HERE), direction(110, 0, 60)
    plain = around.draw(HERE.position, look, now)
    drawn = around.draw(HERE.position, look, now, [SeenImage(image, before)])
    assert (plain.kinds == REMEMBERED).mean() > 0.8
    assert (drawn.kinds == RECENT).mean() > 0.8
    assert drawn.image[50:70, 70:90].mean() < 20 < 60 < plain.image[50:70, 70:90].mean()
    border = np.s_[5:30]
    assert np.abs(drawn.image[border].astype(int) - plain.image[border]).mean() < 4
    behind = around.draw(HERE.position, direction(-70, 0, 60), now, [SeenImage(image, before)])
    assert (behind.kinds != RECENT).all()


def test_a_distance_is_told_with_its_uncertainty(around: LookAround) -> None:
    look = direction(80)
    _, depth = view(look.pose(HERE.position), look.view)
    length = depth * np.linalg.norm(look.view.pixel_rays(), axis=-1)
    for column, row in ((20, 30), (80, 60), (140, 90)):
        told = around.distance(HERE.position, look, (column + 0.5) / 160, (row + 0.5) / 120)
        assert told is not None and not told.contradicted
        assert told.metres == pytest.approx(length[row, column], rel=0.02)
        assert 0.03 * told.metres < told.plus_minus < 0.1 * told.metres
    alone = LookAround(SceneMemory.from_keyframes(
        [keyframe(HERE.position)], BAND, Glances(np.zeros((1, 4, 4), np.uint8), np.eye(4)[None])),
        EXPANSION)
    assert alone.distance(HERE.position, direction(0, 85), 0.5, 0.5) is None, 'out of the band'


def test_a_distance_says_when_something_else_stands_there(around: LookAround) -> None:
    person = seen_from(HERE).image.copy()
    person[20:44, 20:44] = 0
    for image, contradicted in ((person, True), (seen_from(HERE).image, False)):
        told = around.distance(HERE.position, direction(30), 0.5, 0.5, SeenImage(image, HERE))
        assert told is not None and told.contradicted is contradicted


def demo_around() -> LookAround:
    model = share_dir() / 'models/demo_flat.onnx'
    card = read_model_card(model)
    assert card.memory is not None
    return LookAround(SceneMemory.read(memory_path(model, card.memory), card.memory.sha256),
                      card.expansion)


@pytest.mark.slow
def test_two_of_three_distances_in_the_flat_are_as_near_as_told() -> None:
    around, flat, rng = demo_around(), build_demo_flat(), np.random.default_rng(0)
    inside, shares, unknown = [], [], 0
    for pose in walking_paths(flat, 1, 60, 9)[0][::6]:
        look = direction(float(rng.uniform(-180, 180)), float(rng.uniform(-20, 15)))
        _, depth = flat.render(look.view, look.pose(pose.position))
        length = depth * np.linalg.norm(look.view.pixel_rays(), axis=-1)
        for row, column in zip(rng.integers(0, 120, 40), rng.integers(0, 160, 40)):
            told = around.distance(pose.position, look, (column + 0.5) / 160, (row + 0.5) / 120)
            if told is None:
                unknown += 1
                continue
            inside.append(abs(told.metres - length[row, column]) < told.plus_minus)
            shares.append(told.plus_minus / told.metres)
    assert np.mean(inside) > 0.62
    assert np.median(shares) < 0.06, 'not by telling that nothing is known'
    assert unknown < 0.1 * (unknown + len(inside))


@pytest.mark.slow
def test_a_chair_that_was_just_seen_moved_is_shown_moved() -> None:
    around, flat = demo_around(), build_demo_flat()
    moved = changed_flat(flat, CHAIRS)
    position = np.array([3.2, 2.4, 1.5])
    look = Direction(math.radians(-45), math.radians(-15), math.radians(70), 160, 120)
    camera = around.expansion.source
    poses = [CameraPose.from_planar(3.2, 2.4, 1.5, math.radians(yaw)) for yaw in (45, -45)]
    now, before = (SeenImage(moved.render(camera, pose)[0], pose) for pose in poses)
    truth = moved.render(look.view, look.pose(position))[0].astype(int)
    errors = [np.abs(around.draw(position, look, now, seen).image - truth).mean()
              for seen in ([], [before])]
    assert errors[1] < 0.7 * errors[0]
