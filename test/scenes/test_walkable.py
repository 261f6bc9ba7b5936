import json

from hypothesis import given, strategies as st
from neo_ros.errors import SceneError
from neo_ros.scenes.walkable import read_walkable, WalkableMap, write_walkable
import numpy as np
import pytest

CELLS = np.array([[0, 1, 1], [0, 0, 1]], bool)


def _map(**changes) -> WalkableMap:
    fields = {'resolution': 0.5, 'origin': (-1.0, 2.0), 'cells': CELLS, 'camera_height': 1.5}
    return WalkableMap(**{**fields, **changes})


def test_contains_knows_cells_edges_and_outside():
    points = [(-0.75, 2.25), (-0.25, 2.25), (0.49, 2.9), (0.51, 2.9), (-0.25, 2.75), (0.2, 1.9)]
    assert _map().contains(np.array(points)).tolist() == [False, True, True, False, False, False]


def test_centres_and_area():
    np.testing.assert_allclose(_map().centres(), [(-0.25, 2.25), (0.25, 2.25), (0.25, 2.75)])
    assert _map().area == pytest.approx(0.75)


@given(st.integers(0, 2 ** 32 - 1))
def test_samples_are_walkable(seed):
    points = _map().sample(np.random.default_rng(seed), 50)
    assert points.shape == (50, 2)
    assert _map().contains(points).all()


def test_samples_are_uniform():
    points = _map().sample(np.random.default_rng(0), 6000)
    in_upper_cell = (points[:, 1] > 2.5).mean()
    assert in_upper_cell == pytest.approx(1 / 3, abs=0.03)
    np.testing.assert_allclose(points.mean(axis=0), _map().centres().mean(axis=0), atol=0.02)


def test_written_maps_read_back(tmp_path):
    write_walkable(tmp_path / 'walkable.json', _map())
    found = read_walkable(tmp_path / 'walkable.json')
    assert (found.resolution, found.origin, found.camera_height, found.clearance) == (
        0.5, (-1.0, 2.0), 1.5, 0.25)
    assert np.array_equal(found.cells, CELLS)
    assert [path.name for path in tmp_path.iterdir()] == ['walkable.json']


@pytest.mark.parametrize('changes, message', [
    ({'rows': ['011']}, 'rows: expected 2 strings'),
    ({'rows': ['011', '0x1']}, r'rows\[1\]: expected 3 characters'),
    ({'rows': ['011', '01']}, r'rows\[1\]: expected 3 characters'),
    ({'rows': ['000', '000']}, 'at least one free cell'),
    ({'rows': 5}, 'rows: expected 2 strings'),
    ({'resolution': 0}, 'resolution: expected metres > 0'),
    ({'resolution': 'fine'}, "walkable.json: resolution: expected a number, got 'fine'"),
    ({'origin': [1]}, r'walkable.json: origin: expected \[x, y\], got \[1\]'),
    ({'origin': 3}, r'walkable.json: origin: expected \[x, y\], got 3'),
    ({'origin': [float('nan'), 0]}, r'origin\[0\]: expected a finite'),
    ({'width': 'x'}, "walkable.json: width: expected a number, got 'x'"),
    ({'width': 3.7}, r'rows\[0\]: expected 3.7 characters .* as width says'),
    ({'height': 2.7}, 'rows: expected 2.7 strings as height says, got 2'),
    ({'width': float('nan'), 'height': 0, 'rows': []}, 'walkable.json: cells: expected'),
    ({'camera_height': None}, 'walkable.json: camera_height: expected a number, got None'),
    ({'clearance': -5}, 'walkable.json: clearance: expected metres >= 0, got -5'),
    ({'clearance': 'x'}, "walkable.json: clearance: expected a number, got 'x'"),
], ids=lambda value: str(value)[:30])
def test_bad_fields_are_named(tmp_path, changes, message):
    path = tmp_path / 'walkable.json'
    write_walkable(path, _map())
    path.write_text(json.dumps({**json.loads(path.read_text()), **changes}))
    with pytest.raises(SceneError, match=message):
        read_walkable(path)


@pytest.mark.parametrize('key', ['resolution', 'origin', 'width', 'rows', 'camera_height'])
def test_missing_fields_are_named(tmp_path, key):
    path = tmp_path / 'walkable.json'
    write_walkable(path, _map())
    document = json.loads(path.read_text())
    del document[key]
    path.write_text(json.dumps(document))
    with pytest.raises(SceneError, match=f"expected the key '{key}'"):
        read_walkable(path)


@pytest.mark.parametrize('text', ['', '[1, 2]', '{"rows": ['], ids=['empty', 'list', 'cut'])
def test_other_files_are_refused(tmp_path, text):
    path = tmp_path / 'walkable.json'
    path.write_text(text)
    with pytest.raises(SceneError, match='expected a JSON'):
        read_walkable(path)


def test_a_missing_file_is_named(tmp_path):
    with pytest.raises(SceneError, match='nowhere.json: no such file'):
        read_walkable(tmp_path / 'nowhere.json')
