"""Depth maps as files: millimetres, unknown pixels, and what is no depth map."""
from pathlib import Path

import cv2
from neo_ros.errors import SceneError
from neo_ros.pictures.depth import read_depth, to_millimetres, write_depth
import numpy as np
import pytest


def test_metres_become_millimetres_and_what_no_map_holds_is_unknown() -> None:
    depth = np.array([[1.2344, 0.0004, 65.535, 65.7], [np.nan, np.inf, -1, 0]], np.float32)
    expected = [[1234, 0, 65535, 0], [0, 0, 0, 0]]
    np.testing.assert_array_equal(to_millimetres(depth), expected)


def test_a_map_comes_back_as_it_was_written(tmp_path: Path) -> None:
    depth = np.random.default_rng(0).integers(0, 65536, (6, 8), np.uint16)
    write_depth(tmp_path / 'depth/1.png', depth)
    np.testing.assert_array_equal(read_depth(tmp_path / 'depth/1.png', 8, 6), depth)
    # Another size takes pixels that are there: no depth between two surfaces.
    small = read_depth(tmp_path / 'depth/1.png', 4, 3)
    assert small.shape == (3, 4) and np.isin(small, depth).all()


@pytest.mark.parametrize('width, height', [(160, 120), (213, 160)], ids=str)
def test_a_slanted_surface_stays_where_it_is(tmp_path: Path, width: int, height: int) -> None:
    rows, columns = np.mgrid[:480, :640]
    for name, place, times in (('x', columns, width / 640), ('y', rows, height / 480)):
        path = tmp_path / f'{name}.png'
        write_depth(path, (1000 + 20 * place).astype(np.uint16))
        found = (read_depth(path, width, height) - 1000.0) / 20 + 0.5
        middles = (np.mgrid[:height, :width][int(name == 'x')] + 0.5) / times
        # A middle between two pixels, of which either one is the nearest, is off by half of one.
        assert abs((found - middles).mean()) < 0.51


@pytest.mark.parametrize('image', [
    np.zeros((4, 4, 3), np.uint8), np.zeros((4, 4), np.uint8), None], ids=['colour', '8 bit', ''])
def test_what_is_no_depth_map_is_refused(image: np.ndarray | None, tmp_path: Path) -> None:
    path = tmp_path / 'depth.png'
    path.write_bytes(b'no picture' if image is None else cv2.imencode('.png', image)[1].tobytes())
    with pytest.raises(SceneError, match='depth.png: expected a depth map'):
        read_depth(path, 4, 4)
    with pytest.raises(SceneError, match='none.png: expected a depth map'):
        read_depth(tmp_path / 'none.png', 4, 4)
