"""The map of the floor: of heights, and of the demo flat, whose free floor is known."""
from pathlib import Path

from box_board import teach_board, WALL
from box_room import write_box_model
from neo_ros.flat.demo_flat import build_demo_flat
from neo_ros.runtime import read_model_card
from neo_ros.runtime.scene_map import (
    cells_of, FREE, OCCUPIED, read_scene_map, SceneMap, UNKNOWN)
import numpy as np

MODEL = Path(__file__).parents[2] / 'models' / 'demo_flat.onnx'


def test_floor_furniture_and_what_nobody_saw():
    heights = np.array([[0.1, 0.1, 0.85, np.nan], [0.15, 1.9, 0.3, np.nan]], np.float32)
    cells, floor = cells_of(heights)
    assert cells.tolist() == [[FREE, FREE, OCCUPIED, UNKNOWN], [FREE, OCCUPIED, OCCUPIED, UNKNOWN]]
    assert floor == np.float32(0.1) and cells.dtype == np.int8


def test_the_demo_flats_free_floor_is_free_in_its_map():
    drawn = read_scene_map(MODEL, read_model_card(MODEL))
    assert drawn is not None and abs(drawn.floor) < 0.1
    walkable = build_demo_flat().walkable()
    rows, columns = np.nonzero(walkable.cells)
    places = (np.stack([columns, rows], 1) + 0.5) * walkable.resolution + walkable.origin
    at = ((places - drawn.origin) / drawn.resolution).astype(int)
    found = drawn.cells[at[:, 1], at[:, 0]]
    assert np.mean(found == FREE) > 0.95
    # Furniture and walls: a robot with the floor's clearance cannot be everywhere that is free.
    assert 0.2 < np.mean(drawn.cells == FREE) < 0.8 and np.mean(drawn.cells == OCCUPIED) > 0.1


def at_the_board(drawn: SceneMap) -> np.ndarray:
    """Return the cells of the middle of the board."""
    places = (np.array([WALL, 1.8]) - drawn.origin) / drawn.resolution
    column, row = places.astype(int)
    return drawn.cells[row - 3:row + 4, column - 3:column + 4]


def test_what_was_learnt_stands_in_the_map(tmp_path):
    model = write_box_model(tmp_path)
    card = read_model_card(model)
    untaught = read_scene_map(model, card)
    teach_board(model)
    taught = read_scene_map(model, card)
    assert untaught is not None and taught is not None
    assert (at_the_board(untaught) == FREE).all() and (at_the_board(taught) == OCCUPIED).any()
