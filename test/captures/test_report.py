"""The report on a capture says what is wrong with it, and nothing where nothing is."""
from dataclasses import replace
import math
from pathlib import Path

from capture_files import write_image
import cv2
from neo_ros.captures.report import _places, describe, write_capture_report
from neo_ros.captures.report_map import draw_map
from neo_ros.captures.report_measures import measure_capture, RAYS
from neo_ros.geometry import CameraPose, Intrinsics
from neo_ros.pictures.sharpness import blur_threshold
from neo_ros.reports.plan_view import PlanView
from neo_ros.reports.report import Table
from neo_ros.scenes.posed_images import PosedImages
from neo_ros.scenes.scene import Scene
from neo_ros.scenes.walkable import WalkableMap
import numpy as np
import pytest

CAMERA = Intrinsics.from_hfov(32, 24, math.pi / 2)


def texture(seed: int) -> np.ndarray:
    return np.random.default_rng(seed).integers(40, 216, (24, 32, 3), np.uint8)


def make_scene(folder: Path, poses: list[CameraPose], images: list[np.ndarray] | None = None,
               walkable: WalkableMap | None = None) -> Scene:
    images = images or [texture(index) for index in range(len(poses))]
    paths = tuple(write_image(folder / f'{index:03d}.png', image)
                  for index, image in enumerate(images))
    train = PosedImages(CAMERA, paths, tuple(poses), (0,) * len(poses))
    return Scene('room', train, None, None, walkable)


def turning(count: int, full: float = 2 * math.pi, step: float = 0.02) -> list[CameraPose]:
    return [CameraPose.from_planar(step * i, 0.5, 1.5, full * i / count) for i in range(count)]


def looking_around(count: int) -> list[CameraPose]:
    """Turn once at each of three tilts."""
    poses = []
    for tilt in (-0.7, 0.0, 0.7):
        c, s = math.cos(tilt), math.sin(tilt)
        T_tilt = np.array([[1, 0, 0, 0], [0, c, -s, 0], [0, s, c, 0], [0, 0, 0, 1.0]])
        poses += [CameraPose(pose.T_world_cam @ T_tilt) for pose in turning(count)]
    return poses


def test_a_good_capture_gets_no_advice(tmp_path: Path) -> None:
    facts, advice = describe(measure_capture(make_scene(tmp_path, looking_around(20))))
    assert advice == []
    assert dict(facts)['Photos'] == '60'


def test_a_camera_that_stood_still_is_thinned_out(tmp_path: Path) -> None:
    poses = [pose for pose in turning(60, step=0.1) for _ in range(4)]
    for scene, told in ((poses, True), (poses[::4], False)):
        advice = ' '.join(describe(measure_capture(make_scene(tmp_path / str(told), scene)))[1])
        assert ('180 photos are hardly apart' in advice) == told
        assert ('--keyframe-distance 0.1 --keyframe-angle 10' in advice) == told


def test_one_direction_leaves_the_sides_unseen(tmp_path: Path) -> None:
    measures = measure_capture(make_scene(tmp_path, turning(60, full=0.0, step=0.0)))
    # All photos are one: of the wide view, only what it shows itself was seen.
    np.testing.assert_array_equal(
        measures.wide_seen, np.broadcast_to(~measures.beyond_photo, measures.wide_seen.shape))
    assert measures.beyond_photo.mean() == pytest.approx(0.75)
    advice = ' '.join(describe(measures)[1])
    for side in ('on the left', 'on the right', 'above', 'below'):
        assert f'What the wide view adds {side} was seen to 0%' in advice


def test_turning_to_one_side_shows_that_side(tmp_path: Path) -> None:
    # A quarter turn to the left in small steps: most photos have seen what is left of them.
    measures = measure_capture(make_scene(tmp_path, turning(60, math.pi, step=0.0)))
    height, width = measures.beyond_photo.shape
    middle = measures.wide_seen[:, height // 2 - 1:height // 2 + 1]
    left, right = middle[:30, :, :width // 4].mean(), middle[-30:, :, :width // 4].mean()
    assert left == 1.0 and right < 1.0


def test_photos_far_apart_have_no_neighbour(tmp_path: Path) -> None:
    poses = [CameraPose.from_planar(4.0 * i, 0, 1.5, 0.0) for i in range(50)]
    measures = measure_capture(make_scene(tmp_path, poses))
    assert (measures.overlap == 0).all()
    assert '50 photos have no neighbour' in ' '.join(describe(measures)[1])


def test_overlap_of_a_turn_is_what_stays_in_view(tmp_path: Path) -> None:
    quarter = [CameraPose.from_planar(0, 0, 1.5, 0.0),
               CameraPose.from_planar(0, 0, 1.5, math.pi / 4)]
    measures = measure_capture(make_scene(tmp_path, quarter))
    # A 90 degree camera that turns by 45: half the columns stay, less some corners.
    assert measures.overlap == pytest.approx([0.5, 0.5], abs=0.1)


def test_blurred_and_dark_photos_are_found(tmp_path: Path) -> None:
    images = [texture(index) for index in range(60)]
    for index in (7, 20, 21, 40, 50):
        images[index] = cv2.GaussianBlur(images[index], (0, 0), 2)
    for index in range(30, 60):
        images[index] = (images[index] * 0.4).astype(np.uint8)
    measures = measure_capture(make_scene(tmp_path, looking_around(20), images))
    assert {7, 20, 21} <= set(measures.blurred.tolist()) <= {7, 20, 21, 40, 50}
    assert measures.exposure_drift > 0.5
    assert 'brightness drifts' in ' '.join(describe(measures)[1])


@pytest.mark.parametrize('values, below', [
    ([100.0] * 20, 0), ([100.0] * 19 + [5.0], 1), (list(np.geomspace(50, 200, 20)), 0),
    ([0.0] * 5, 0)], ids=['alike', 'one blurred', 'a wide range', 'nothing at all'])
def test_the_limit_of_blur_comes_from_the_photos_themselves(values: list[float],
                                                            below: int) -> None:
    sharpness = np.array(values)
    assert (sharpness < blur_threshold(sharpness)).sum() == below


def test_walkable_floor_without_photos_is_pointed_out(tmp_path: Path) -> None:
    floor = WalkableMap(0.1, (0.0, 0.0), np.ones((10, 60), bool), 1.5)
    scene = make_scene(tmp_path, looking_around(20), walkable=floor)
    measures = measure_capture(scene)
    # Photos between x = 0 and 0.4, at y = 0.5: a third of the 6 m is near them at most.
    assert measures.walkable_near == pytest.approx(1.36 / 6, abs=0.03)
    assert 'more than 1 m from any photo' in ' '.join(describe(measures)[1])


def test_the_map_shows_cameras_on_the_floor(tmp_path: Path) -> None:
    floor = WalkableMap(0.1, (0.0, 0.0), np.ones((10, 60), bool), 1.5)
    scene = make_scene(tmp_path, [CameraPose.from_planar(1.0, 0.5, 1.5, 0.0)], walkable=floor)
    with_one = draw_map(measure_capture(scene), floor)
    changed = (with_one != draw_map(measure_capture(replace(
        scene, train=replace(scene.train, poses=(
            CameraPose.from_planar(5.0, 0.5, 1.5, 0.0),)))), floor)).any(axis=2)
    columns = np.nonzero(changed.any(axis=0))[0]
    # Two places only: the dot moved along x by two thirds of the floor.
    assert columns.min() < with_one.shape[1] * 0.3 and columns.max() > with_one.shape[1] * 0.7
    assert changed.mean() < 0.01


@pytest.mark.parametrize('place', [(0.0, 1.0), (1.8, 0.0)], ids=['by position', 'by heading'])
def test_the_map_takes_the_colour_of_the_nearest_photo_that_was_looked_at(
        tmp_path: Path, place: tuple[float, float]) -> None:
    # In the order of the list, the last photo comes after the third one.
    poses = [CameraPose.from_planar(0, 0, 1.5, 0), CameraPose.from_planar(9, 9, 1.5, 0),
             CameraPose.from_planar(2, 0, 1.5, math.pi), CameraPose.from_planar(*place, 1.5, 0)]
    measures = replace(measure_capture(make_scene(tmp_path, poses)), viewed=np.array([0, 2]),
                       wide_seen=np.stack([np.ones(RAYS, bool), np.zeros(RAYS, bool)]))
    positions = measures.photos.T_world_cam[:, :2, 3]
    column, row = PlanView(positions.min(0), positions.max(0)).place(np.array(place))
    red, green, _ = draw_map(measures, None)[row, column]
    assert green > red


def test_only_unseen_directions_are_named(tmp_path: Path) -> None:
    # A quarter of the wide view, straight ahead, was not seen: one sector of eight.
    measures = measure_capture(make_scene(tmp_path, [CameraPose.from_planar(0, 0, 1.5, 0)]))
    table, = _places(replace(measures, wide_seen=np.abs(measures.wide_headings) > 22))
    assert isinstance(table, Table)
    assert table.rows[0][3] == '0 deg'


@pytest.mark.parametrize('arbitrary, m, metres', [
    (True, 'units', 'units'), (False, 'm', 'metres')], ids=['units', 'metres'])
def test_lengths_have_the_unit_of_the_scene(tmp_path: Path, arbitrary: bool, m: str,
                                            metres: str) -> None:
    scene = make_scene(tmp_path, turning(12, full=0.3))
    lines = write_capture_report(tmp_path, replace(
        scene, train=replace(scene.train, arbitrary_scale=arbitrary)))
    assert f'Extent: 0.2 x 0.0 x 0.0 {m}' in lines
    page = (tmp_path / 'capture.html').read_text()
    for text in (f'0.2 x 0.0 x 0.0 {m}', f'Numbers are {metres}.', f'Place, {metres}<',
                 f'2.5 {m} away', f'Squares of 1 x 1 {m}.'):
        assert text in page
    assert ('metres' in page) != arbitrary


def test_photos_of_an_odd_size_get_a_page(tmp_path: Path) -> None:
    images = [np.random.default_rng(index).integers(40, 216, (47, 61, 3), np.uint8)
              for index in range(12)]
    scene = make_scene(tmp_path, turning(12), images)
    odd = replace(scene, train=replace(
        scene.train, intrinsics=Intrinsics.from_hfov(61, 47, math.pi / 2)))
    write_capture_report(tmp_path, odd)
    assert (tmp_path / 'capture.html').exists()
    wide = measure_capture(odd).expansion
    assert (wide.target.width, wide.target.height) == (122, 94)
    assert (wide.left, wide.right, wide.top, wide.bottom) == (30, 31, 23, 24)


@pytest.mark.slow
def test_the_page_stands_alone_and_says_what_the_terminal_says(tmp_path: Path) -> None:
    scene = make_scene(tmp_path, turning(12, full=0.3))
    lines = write_capture_report(tmp_path, scene, ['4 frames <lost> their pose'])
    page = (tmp_path / 'capture.html').read_text()
    assert any('12 photos are few' in line for line in lines)
    assert '12 photos are few' in page
    assert '4 frames &lt;lost&gt; their pose' in page
    assert page.count('<img ') >= 9 and page.count('<img class="plot"') == 3
    assert 'src="http' not in page and 'href=' not in page
    assert 'Places to go back to' in page


@pytest.mark.filterwarnings('error')
def test_photos_of_one_colour_get_a_page(tmp_path: Path) -> None:
    blank = [np.full((24, 32, 3), 128, np.uint8)] * 12
    write_capture_report(tmp_path, make_scene(tmp_path, turning(12), blank))
    assert (tmp_path / 'capture.html').read_text().count('<img class="plot"') == 3
