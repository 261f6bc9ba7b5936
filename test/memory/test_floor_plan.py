"""The scene from above, against the box room and the demo flat, whose geometry is known."""
import time
import tracemalloc
from unittest.mock import Mock

from box_room import BAND, box_memory, HIGH, keyframe
import cv2
from neo_ros.benchmark.small_room import cast
from neo_ros.errors import ModelError
from neo_ros.flat.demo_flat import build_demo_flat
from neo_ros.flat.raycast import cast_rays
from neo_ros.geometry import Band
from neo_ros.machine.files import share_dir
from neo_ros.memory import scene_memory
from neo_ros.memory.floor_plan import (
    draw_floor_plan, encode_plan, FloorPlan, PlanThresholds)
from neo_ros.memory.keyframe import Keyframe
from neo_ros.memory.scene_memory import Glances, SceneMemory
from neo_ros.runtime.fov_extrapolator import memory_path
from neo_ros.runtime.model_card import read_model_card
import numpy as np
import pytest

TOP = 1.7  # metres; just below where the plan of the flat is cut
MODEL = share_dir() / 'models/demo_flat.onnx'


@pytest.fixture(scope='module')
def demo_memory() -> SceneMemory:
    card = read_model_card(MODEL)
    assert card.memory is not None
    return SceneMemory.read(memory_path(MODEL, card.memory), card.memory.sha256)


@pytest.fixture(scope='module')
def demo_plan(demo_memory: SceneMemory) -> FloorPlan:
    return draw_floor_plan(demo_memory)


def height_at(plan: FloorPlan, x: float, y: float, around: float = 0.05) -> np.ndarray:
    """Return the heights within `around` metres, NaN where nothing is known."""
    column, row = plan.pixel(x, y)
    reach = max(round(around / plan.resolution), 1)
    return plan.height[max(int(row) - reach, 0):int(row) + reach + 1,
                       max(int(column) - reach, 0):int(column) + reach + 1]


@pytest.mark.slow
def test_the_box_room_is_a_floor_within_walls() -> None:
    plan = draw_floor_plan(box_memory())
    low, high = plan.pixel(0, 0), plan.pixel(HIGH[0], HIGH[1])
    assert np.allclose(low, (0, len(plan.image)), atol=2)
    assert np.allclose(high, (plan.image.shape[1], 0), atol=2)
    assert np.nanmax(np.abs(height_at(plan, 2.5, 2.0, 0.5))) < 0.1, 'the floor'
    for x, y in ((0.0, 2.0), (5.0, 2.0), (2.5, 0.0), (2.5, 4.0)):
        assert np.nanmax(height_at(plan, x, y, 0.06)) > 1.5, 'the wall, below the ceiling'
    # The colour of the floor is that of the cast, in x, y and not mirrored.
    for x, y in ((1.0, 1.0), (4.0, 1.0), (1.5, 3.2)):
        column, row = (int(value) for value in plan.pixel(x, y))
        red = 130 + 60 * np.sin(2.3 * x + 1.1 * y + 2) + 40 * np.sin(5.1 * y)
        assert plan.image[row, column, 0] == pytest.approx(red, abs=12)
        assert plan.image[row, column, 3] == 255


def test_what_no_keyframe_shows_is_transparent() -> None:
    frame = keyframe(np.array([2.5, 2.0, 1.4]))
    half = frame.depth.copy()
    half[:, :half.shape[1] // 2] = 0  # The columns run clockwise from -x: +y.
    memory = SceneMemory.from_keyframes(
        [Keyframe(frame.position, half, frame.texture)], BAND,
        Glances(np.zeros((1, 4, 4), np.uint8), np.eye(4)[None]))
    plan = draw_floor_plan(memory)
    assert plan.origin[1] == pytest.approx(0, abs=0.11)
    assert plan.pixel(0, 2.0)[1] == pytest.approx(0, abs=2), 'it ends where the half does'


def without_floor(case: str) -> SceneMemory:
    """Remember the box room as a camera does that never saw its floor."""
    position = np.array([2.5, 2.0, 1.4])
    frame, band = keyframe(position), BAND
    depth = frame.depth.copy()
    if case == 'no lower rows':
        depth[len(depth) // 2:] = 0
    elif case == 'nothing':
        depth[:] = 0
    elif case == 'two points':
        depth[:] = 0
        depth[[0, -4], [0, 4]] = 1.5
    else:  # A camera that looks up.
        band = Band(1.4, 1.2)
        _, far = cast(position, band.rays(*depth.shape))
        depth = far.astype(np.float32)
    return SceneMemory.from_keyframes(
        [Keyframe(position, depth, frame.texture)], band,
        Glances(np.zeros((1, 4, 4), np.uint8), np.eye(4)[None]))


@pytest.mark.parametrize('case', ['no lower rows', 'nothing', 'two points', 'ceiling'])
def test_without_a_floor_there_is_no_plan(case: str) -> None:
    with pytest.raises(ModelError, match='the memory shows no floor'):
        draw_floor_plan(without_floor(case))


def test_keyframes_are_decoded_small_and_one_at_a_time(monkeypatch: pytest.MonkeyPatch) -> None:
    frame, count = keyframe(np.array([2.5, 2.0, 1.4])), 150
    memory = SceneMemory.from_keyframes(
        [frame] * count, BAND, Glances(np.zeros((1, 4, 4), np.uint8), np.eye(4)[None]))
    decode = Mock(side_effect=scene_memory.decode_image)
    monkeypatch.setattr(scene_memory, 'decode_image', decode)
    coarse = PlanThresholds(most_cells=40)
    draw_floor_plan(memory, thresholds=coarse)
    # The texture is twice as fine as the depth.
    textures = {call.args[1] for call in decode.call_args_list} - {cv2.IMREAD_UNCHANGED}
    assert textures == {cv2.IMREAD_REDUCED_COLOR_2}
    tracemalloc.start()
    try:
        draw_floor_plan(memory, thresholds=coarse)
        _, peak = tracemalloc.get_traced_memory()
    finally:
        tracemalloc.stop()
    assert peak < count * 5 * frame.depth.size, 'their depths and colours have 7 bytes each'


def test_a_scene_of_any_scale_has_the_same_plan() -> None:
    memory = box_memory()
    times = 3.0
    scaled = SceneMemory.from_keyframes([
        Keyframe(frame.position * times, frame.depth * times, frame.texture) for frame in (
            memory.keyframe(index) for index in range(len(memory.positions)))],
        BAND, memory.glances)
    plan = draw_floor_plan(scaled, arbitrary_scale=True)
    assert plan.pixel(5 * times, 4 * times) == pytest.approx((plan.image.shape[1], 0), abs=2)
    assert np.nanmax(height_at(plan, 0, 2 * times, 2)) > 1.5 * times


def test_the_demo_flat_lies_where_it_is(demo_plan: FloorPlan, demo_memory: SceneMemory) -> None:
    under = np.array([np.nanmedian(height_at(demo_plan, x, y))
                      for x, y, _ in demo_memory.positions])
    assert (np.abs(under) < 0.15).mean() > 0.95, 'keyframes stand on free floor'
    for y in (1.0, 1.5, 3.5):
        assert np.nanmax(height_at(demo_plan, 6.07, y, 0.2)) > 1.3, 'between the rooms'
    assert np.nanmedian(height_at(demo_plan, 6.07, 2.55, 0.1)) < 0.2, 'the doorway'


def test_heights_are_those_of_the_flat(demo_plan: FloorPlan) -> None:
    flat = build_demo_flat()
    rows, columns = np.nonzero(demo_plan.image[..., 3])
    some = np.random.default_rng(0).permutation(len(rows))[:4000]
    x = demo_plan.origin[0] + (columns[some] + 0.5) * demo_plan.resolution
    y = demo_plan.origin[1] + (len(demo_plan.image) - rows[some] - 0.5) * demo_plan.resolution
    origins = np.stack([x, y, np.full(len(x), TOP)]).astype(np.float32)
    down = np.tile(np.array([[0], [0], [-1]], np.float32), len(x))
    hits = cast_rays(flat.solids, np.arange(len(flat.solids.kind)), origins, down)
    inside = (x > 0.1) & (x < 9.9) & (y > 0.7) & (y < 4.1)
    off = np.abs(demo_plan.height[rows[some], columns[some]] - (TOP - hits.distance))[inside]
    assert np.median(off) < 0.06
    assert (off < 0.15).mean() > 0.75


def test_it_is_quick_small_and_the_same_every_time(demo_memory: SceneMemory,
                                                   demo_plan: FloorPlan) -> None:
    started = time.process_time()
    again = draw_floor_plan(demo_memory)
    assert time.process_time() - started < 2
    assert np.array_equal(again.image, demo_plan.image)
    coded = encode_plan(demo_plan)
    assert len(coded) < 60_000
    decoded = cv2.imdecode(np.frombuffer(coded, np.uint8), cv2.IMREAD_UNCHANGED)
    assert decoded is not None and decoded.shape == demo_plan.image.shape
    assert np.array_equal(decoded[..., 3] > 0, demo_plan.image[..., 3] > 0)
