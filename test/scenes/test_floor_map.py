from dataclasses import replace
import math
from pathlib import Path
from typing import Any

import cv2
from hypothesis import given, strategies as st
from neo_ros.cli.floor import floor
from neo_ros.errors import NeoError, SceneError
from neo_ros.geometry import CameraPose
from neo_ros.scenes.floor_map import place_floor, read_floor_mask, read_map_server
from neo_ros.scenes.scene import read_scene
from neo_ros.scenes.transforms_json import write_transforms
from neo_ros.scenes.walkable import WalkableMap
import numpy as np
import pytest
from scene_files import write_capture
import typer
from typer.testing import CliRunner
import yaml

APP = typer.Typer()
APP.command()(floor)
MAP = {'image': 'map.pgm', 'resolution': 0.5, 'origin': [-1.0, 2.0, 0.0], 'negate': 0,
       'occupied_thresh': 0.65, 'free_thresh': 0.196}
# Row 0 is at the top, the largest y: free, free, unknown / occupied, free, free.
PIXELS = np.array([[254, 254, 205], [0, 254, 254]], np.uint8)


def write_map(folder: Path, pixels: np.ndarray = PIXELS, name: str = 'map.pgm',
              **changes: Any) -> Path:
    folder.mkdir(parents=True, exist_ok=True)
    assert cv2.imwrite(str(folder / name), pixels)
    document = {key: value for key, value in (MAP | {'image': name} | changes).items()
                if value is not None}
    (folder / 'map.yaml').write_text(yaml.safe_dump(document))
    return folder / 'map.yaml'


def test_a_map_lies_where_its_origin_says(tmp_path: Path) -> None:
    found = read_map_server(write_map(tmp_path), 1.2)
    assert (found.resolution, found.origin, found.camera_height) == (0.5, (-1.0, 2.0), 1.2)
    # Lower row first: y grows with the index.
    np.testing.assert_array_equal(found.cells, [[0, 1, 1], [1, 1, 0]])
    assert found.contains(np.array([[-0.25, 2.1], [-0.75, 2.9]])).all()
    assert not found.contains(np.array([[-0.75, 2.1], [0.3, 2.9], [5.0, 2.5]])).any()


@pytest.mark.parametrize('changes, pixels, free', [
    ({}, [254, 205, 0, 206, 100], [1, 0, 0, 1, 0]),
    ({'negate': 1}, [254, 205, 0, 49, 50], [0, 0, 1, 1, 0]),
    ({'mode': 'scale'}, [254, 205, 0, 206, 100], [1, 0, 0, 1, 0]),
    ({'mode': 'raw'}, [0, 19, 20, 100, 255], [1, 1, 0, 0, 0]),
    ({'free_thresh': 0.25}, [254, 205, 191, 192, 0], [1, 1, 0, 1, 0]),
], ids=['trinary', 'negate', 'scale', 'raw', 'unknown below the threshold'])
def test_thresholds_decide_what_is_free(
        tmp_path: Path, changes: dict[str, Any], pixels: list[int], free: list[int]) -> None:
    path = write_map(tmp_path, np.array([pixels], np.uint8), **changes)
    np.testing.assert_array_equal(read_map_server(path, 1.0).cells, [free])


def test_unknown_floor_that_counts_as_free_is_told(
        tmp_path: Path, caplog: pytest.LogCaptureFixture) -> None:
    read_map_server(write_map(tmp_path), 1.0)
    assert not caplog.records
    read_map_server(write_map(tmp_path, free_thresh=0.25), 1.0)
    assert 'grey 205, which map savers write for unknown floor, counts as free' in caplog.text


def test_transparent_pixels_are_unknown(tmp_path: Path) -> None:
    pixels = np.full((1, 3, 4), 255, np.uint8)
    pixels[0, 1, 3] = 0
    path = write_map(tmp_path, pixels, 'map.png', mode='scale')
    np.testing.assert_array_equal(read_map_server(path, 1.0).cells, [[1, 0, 1]])


@given(yaw=st.floats(-3.2, 3.2), x=st.floats(-5, 5), y=st.floats(-5, 5))
def test_a_turned_map_is_turned_about_its_corner(yaw: float, x: float, y: float) -> None:
    # 4 x 2 m of floor with an obstacle in its first metre of x.
    free = np.ones((20, 40), bool)
    free[:, :10] = False
    found = place_floor(free, 0.1, (x, y, yaw), 1.0)
    R = np.array([[math.cos(yaw), -math.sin(yaw)], [math.sin(yaw), math.cos(yaw)]])
    inside = np.array([[1.2, 0.2], [3.8, 0.2], [3.8, 1.8], [1.2, 1.8], [2.5, 1.0]])
    outside = np.array([[0.8, 1.0], [-0.2, 1.0], [2.0, -0.2], [2.0, 2.2], [4.2, 1.0]])
    assert found.contains(inside @ R.T + (x, y)).all()
    assert not found.contains(outside @ R.T + (x, y)).any()
    assert found.area == pytest.approx(6.0, rel=0.05)


def test_a_robot_keeps_its_radius_off_the_walls() -> None:
    room = WalkableMap(0.05, (0.0, 0.0), np.ones((40, 60), bool), 1.0, clearance=0.0)
    small = room.kept_off(0.4).centres()
    assert small.min() >= 0.4 - 1e-6 and (small <= [2.6 + 1e-6, 1.6 + 1e-6]).all()
    assert room.kept_off(0.4).area == pytest.approx(2.2 * 1.2, rel=0.1)
    # A map that keeps off already is not shrunk twice.
    assert WalkableMap(0.05, (0, 0), room.cells, 1.0, 0.25).kept_off(0.2).area == room.area
    assert WalkableMap(0.05, (0, 0), room.cells, 1.0, 0.3).kept_off(0.4).area == (
        pytest.approx(2.8 * 1.8))
    with pytest.raises(SceneError, match='sampling.robot_radius: .* a robot of 1.2 m, got none'):
        room.kept_off(1.2)


@pytest.mark.parametrize('white', [1, 100, 255, 1000, 65535])
def test_the_header_of_a_binary_pgm_says_what_is_white(tmp_path: Path, white: int) -> None:
    path = write_map(tmp_path)
    pixels = np.array([white, 0], '>u2' if white > 255 else np.uint8).tobytes()
    (tmp_path / 'map.pgm').write_bytes(f'P5\n# 255 grey\n2 1\n{white}\n'.encode() + pixels)
    np.testing.assert_array_equal(read_map_server(path, 1.0).cells, [[1, 0]])


@pytest.mark.parametrize('size', [0, 5, 14])
def test_an_image_that_is_cut_off_is_not_looked_for_elsewhere(tmp_path: Path, size: int) -> None:
    path = write_map(tmp_path)
    image = tmp_path / 'map.pgm'
    image.write_bytes(image.read_bytes()[:size])
    with pytest.raises(SceneError, match=r'map.pgm: .* is cut off or of another kind'):
        read_map_server(path, 1.0)


def test_a_mask_is_a_map_of_bright_pixels(tmp_path: Path) -> None:
    assert cv2.imwrite(str(tmp_path / 'mask.png'), np.array([[255, 127], [0, 128]], np.uint8))
    found = read_floor_mask(tmp_path / 'mask.png', 0.1, (1.0, 2.0, 0.0), 0.5)
    np.testing.assert_array_equal(found.cells, [[0, 1], [1, 0]])


@pytest.mark.parametrize('changes, message', [
    ({'free_thresh': None}, "expected the key 'free_thresh'"),
    ({'resolution': 0.0}, 'map.yaml: resolution: expected metres per pixel > 0, got 0.0'),
    ({'origin': [1.0]}, r'map.yaml: origin: expected \[x, y, yaw\], got \[1.0\]'),
    ({'origin': [1.0, 2.0, 3.0, 4.0]}, 'map.yaml: origin: expected .x, y, yaw.'),
    ({'origin': 3}, 'map.yaml: origin: expected .x, y, yaw., got 3'),
    ({'origin': ['a', 0, 0]}, 'map.yaml: origin: expected .x, y, yaw., got'),
    ({'origin': [0.0, 0.0, math.nan]}, 'map.yaml: origin: expected finite x, y and yaw'),
    ({'mode': 'sepia'}, "mode: expected trinary, scale, raw, got 'sepia'"),
    ({'free_thresh': 0.9}, 'free_thresh <= occupied_thresh <= 1, got 0.9 and 0.65'),
    ({'free_thresh': 'x'}, "map.yaml: free_thresh: expected a number, got 'x'"),
    ({'negate': 1}, 'map.yaml: cells: expected a 2-D grid with at least one free cell'),
    ({'negate': 'maybe'}, "map.yaml: negate: expected a number, got 'maybe'"),
    ({'resolution': 'wide'}, "map.yaml: resolution: expected a number, got 'wide'"),
    ({'resolution': [1]}, r'map.yaml: resolution: expected a number, got \[1\]'),
], ids=str)
def test_bad_maps_say_what_is_wrong(
        tmp_path: Path, changes: dict[str, Any], message: str) -> None:
    path = write_map(tmp_path, np.full((2, 2), 254, np.uint8), **changes)
    with pytest.raises(SceneError, match=message):
        read_map_server(path, 1.0)


def test_a_map_without_its_image(tmp_path: Path) -> None:
    path = write_map(tmp_path)
    (tmp_path / 'map.pgm').unlink()
    with pytest.raises(SceneError, match=r'map.pgm: .*No such file .*is the path right'):
        read_map_server(path, 1.0)


def test_a_file_that_is_no_map(tmp_path: Path) -> None:
    (tmp_path / 'map.yaml').write_text('- a\n')
    with pytest.raises(SceneError, match='expected the YAML file of a map'):
        read_map_server(tmp_path / 'map.yaml', 1.0)


def test_the_command_writes_the_floor_and_says_who_stands_on_it(tmp_path: Path) -> None:
    write_capture(tmp_path / 'scene')  # Photos on a circle of 1 m around the origin, at 1.5 m.
    path = write_map(tmp_path / 'map', np.full((40, 40), 254, np.uint8), resolution=0.1,
                     origin=[-2.0, -2.0, 0.0])
    result = CliRunner().invoke(APP, [str(tmp_path / 'scene'), str(path)])
    assert result.exit_code == 0, result.output
    assert '16.0 m2 of free floor; 100% of the photos' in result.output
    walkable = read_scene(tmp_path / 'scene').walkable
    assert walkable is not None and walkable.camera_height == 1.5
    assert (tmp_path / 'scene' / 'capture.html').exists()
    away = write_map(tmp_path / 'map', np.full((4, 4), 254, np.uint8), origin=[50.0, 0.0, 0.0])
    result = CliRunner().invoke(APP, [str(tmp_path / 'scene'), str(away)])
    assert "is the map in the photos' world?" in result.output


@pytest.mark.parametrize('arguments, message', [
    (['mask.png'], '--resolution: expected metres per pixel with an image'),
    (['map.yaml', '--resolution', '0.1'], 'a map says its own'),
], ids=['image', 'map'])
def test_the_resolution_is_said_once(
        tmp_path: Path, arguments: list[str], message: str) -> None:
    write_capture(tmp_path / 'scene')
    write_map(tmp_path)
    name, *rest = arguments
    result = CliRunner().invoke(APP, [str(tmp_path / 'scene'), str(tmp_path / name), *rest])
    assert isinstance(result.exception, NeoError) and message in str(result.exception)


def test_a_world_on_its_side_gets_no_floor(tmp_path: Path) -> None:
    scene, path = tmp_path / 'scene', write_map(tmp_path / 'map')
    photos = write_capture(scene)
    turn = np.eye(4)
    turn[:3, :3] = [[1, 0, 0], [0, 0, 1], [0, -1, 0]]  # z to y
    write_transforms(scene / 'transforms_train.json', replace(photos, poses=tuple(
        CameraPose(turn @ pose.T_world_cam) for pose in photos.poses)))
    result = CliRunner().invoke(APP, [str(scene), str(path)])
    assert isinstance(result.exception, NeoError) and '--level' in str(result.exception)
    assert not (scene / 'walkable.json').exists()
