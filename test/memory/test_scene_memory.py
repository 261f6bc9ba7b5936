"""The file of a scene memory: what goes in comes out, and nothing else is read."""
import gc
import hashlib
import io
import os
from pathlib import Path
import tracemalloc
from typing import Any
import weakref

from box_room import BAND, box_memory, keyframe
import cv2
from neo_ros.errors import ModelError
from neo_ros.memory import decoded, memory_checks, memory_file, scene_memory
from neo_ros.memory.keyframe import CLOSEST, Keyframe
from neo_ros.memory.landmarks import Landmarks
from neo_ros.memory.memory_file import MOST_BYTES
from neo_ros.memory.scene_memory import Glances, SceneMemory
import numpy as np
import pytest


@pytest.fixture(scope='module')
def memory() -> SceneMemory:
    memory = box_memory()
    random = np.random.default_rng(0)
    memory.landmarks = Landmarks(random.random((5, 3), np.float32),
                                 random.integers(0, 256, (5, 128), np.uint8))
    return memory


def test_a_memory_comes_back(memory: SceneMemory, tmp_path: Path) -> None:
    path = tmp_path / 'box.memory'
    again = SceneMemory.read(path, memory.write(path))
    assert again.band == memory.band
    assert np.array_equal(again.positions, memory.positions)
    assert np.array_equal(again.glances.pictures, memory.glances.pictures)
    assert memory.landmarks is not None and again.landmarks is not None
    assert np.array_equal(again.landmarks.points, memory.landmarks.points)
    assert np.array_equal(again.landmarks.descriptors, memory.landmarks.descriptors)
    for index in range(len(memory.positions)):
        one, other = memory.keyframe(index), again.keyframe(index)
        assert np.array_equal(one.texture, other.texture)
        assert np.array_equal(one.depth, other.depth)


def test_a_memory_without_landmarks_comes_back(tmp_path: Path) -> None:
    path = tmp_path / 'box.memory'
    assert SceneMemory.read(path, box_memory().write(path)).landmarks is None


def test_keyframes_stay_in_the_file(memory: SceneMemory, tmp_path: Path) -> None:
    noise = np.random.default_rng(0).integers(0, 256, (320, 640, 3), np.uint8)
    large = SceneMemory.from_keyframes(
        [Keyframe(np.full(3, float(index)), np.ones((16, 32), np.float32), noise)
         for index in range(24)], BAND, memory.glances)
    path = tmp_path / 'large.memory'
    sha256 = large.write(path)
    tracemalloc.start()
    try:
        again = SceneMemory.read(path, sha256)
        now, peak = tracemalloc.get_traced_memory()
    finally:
        tracemalloc.stop()
    assert path.stat().st_size > 3_000_000 and now < 200_000 and peak < 700_000
    assert np.array_equal(again.keyframe(11).texture, large.keyframe(11).texture)
    path.unlink()  # Whoever has it open still reads it.
    assert np.array_equal(again.keyframe(5).texture, large.keyframe(5).texture)


def test_keyframes_that_are_kept_leave_no_holes_in_the_heap() -> None:
    large = SceneMemory.from_keyframes(
        [Keyframe(np.zeros(3), np.ones((160, 320), np.float32), np.zeros((320, 640, 3), np.uint8))
         for _ in range(4)], BAND, box_memory().glances)
    tracemalloc.start()
    try:
        kept = [large.keyframe(index) for index in range(4)]
        # Of malloc's heap, where NumPy's and OpenCV's arrays lie.
        assert tracemalloc.get_traced_memory()[0] < kept[0].depth.nbytes
    finally:
        tracemalloc.stop()
    assert all(np.allclose(keyframe.depth, 1, rtol=0.01) for keyframe in kept)


def test_a_file_that_changes_while_it_is_in_use_is_refused(
        memory: SceneMemory, tmp_path: Path) -> None:
    path = tmp_path / 'box.memory'
    again = SceneMemory.read(path, memory.write(path))
    again.keyframe(0)
    path.write_bytes(path.read_bytes() + b'x')
    with pytest.raises(ModelError, match='was changed while it was in use'):
        again.keyframe(1)


def test_few_keyframes_stay_decoded_and_none_outlives_the_memory(
        monkeypatch: pytest.MonkeyPatch) -> None:
    monkeypatch.setattr(decoded, 'CACHED_BYTES', 1)
    memory = box_memory()
    first, second, third = (memory.keyframe(index) for index in range(3))
    assert memory.keyframe(0) is first
    memory.keyframe(3)  # In the place of 1, which was used before the others.
    assert memory.keyframe(0) is first and memory.keyframe(2) is third
    assert memory.keyframe(1) is not second
    del second, third
    released: list[weakref.ref[Any]] = [weakref.ref(memory), weakref.ref(first)]
    gc.disable()
    try:
        del memory, first
        assert [reference() for reference in released] == [None, None]
    finally:
        gc.enable()


def test_as_many_keyframes_stay_decoded_as_fit(monkeypatch: pytest.MonkeyPatch) -> None:
    memory = box_memory()
    frames = [memory.keyframe(index) for index in range(5)]
    assert all(memory.keyframe(index) is frames[index] for index in range(5))
    monkeypatch.setattr(decoded, 'CACHED_BYTES',
                        4 * (frames[0].depth.nbytes + frames[0].texture.nbytes))
    memory = box_memory()
    frames = [memory.keyframe(index) for index in range(5)]
    assert memory.keyframe(1) is frames[1] and memory.keyframe(0) is not frames[0]


def test_small_views_get_averaged_textures(memory: SceneMemory) -> None:
    whole, half = memory.keyframe(1), memory.keyframe(1, focal=10.0)
    assert half.texture.shape == (len(whole.texture) // 2, whole.texture.shape[1] // 2, 3)
    assert np.array_equal(half.depth, whole.depth)
    means = cv2.resize(whole.texture, half.texture.shape[1::-1], interpolation=cv2.INTER_AREA)
    assert np.abs(half.texture.astype(int) - means).mean() < 1
    # Its texture has 80 pixels a radian: half of them are too few for a view of 20.
    assert memory.keyframe(1, focal=20.0) is memory.keyframe(1) is whole
    assert memory.keyframe(1, focal=10.0) is half


def test_a_texture_keeps_its_colours(memory: SceneMemory) -> None:
    texture = box_memory().keyframe(0).texture
    truth = keyframe(memory.positions[0]).texture
    assert np.abs(texture.astype(int) - truth).mean() < 3


def test_depth_keeps_its_precision_and_its_gaps() -> None:
    depth = np.geomspace(0.1, 30, 64, dtype=np.float32).reshape(8, 8)
    depth[0, 0] = 0
    texture = np.full((16, 16, 3), 90, np.uint8)
    memory = SceneMemory.from_keyframes(
        [Keyframe(np.zeros(3), depth, texture)], BAND,
        Glances(np.zeros((1, 4, 4), np.uint8), np.eye(4)[None]))
    back = memory.keyframe(0).depth
    assert back[0, 0] == 0
    nearness = 1 / np.maximum(depth.ravel()[1:], CLOSEST)
    assert np.abs(1 / back.ravel()[1:] - nearness).max() < 1e-3


@pytest.mark.parametrize(('change', 'message'), [
    (lambda content: None, 'keep it beside the model'),
    (lambda content: content[:-100], 'sha256'),
    (lambda content: content[:1000] + b'x' + content[1001:], 'sha256'),
], ids=['missing', 'truncated', 'changed'])
def test_another_file_is_refused(memory: SceneMemory, tmp_path: Path, change, message) -> None:
    path = tmp_path / 'box.memory'
    sha256 = memory.write(path)
    content = change(path.read_bytes())
    path.unlink()
    if content is not None:
        path.write_bytes(content)
    with pytest.raises(ModelError, match=message):
        SceneMemory.read(path, sha256)


def test_what_is_no_file_of_sensible_size_is_refused_unread(tmp_path: Path) -> None:
    paths = {name: tmp_path / name for name in ('pipe', 'link', 'folder', 'huge', 'empty')}
    os.mkfifo(paths['pipe'])
    paths['link'].symlink_to('/dev/zero')
    paths['folder'].mkdir()
    with paths['huge'].open('wb') as file:
        file.truncate(MOST_BYTES + 1)  # Sparse: takes no space.
    paths['empty'].touch()
    words = {'huge': 'scene memory of at most 16384 MB', 'empty': 'the file is empty'}
    for name, path in paths.items():
        with pytest.raises(ModelError, match=words.get(name, 'cannot read the scene memory')):
            SceneMemory.read(path, '0' * 64)


def test_a_newer_schema_and_other_archives_are_refused(tmp_path: Path) -> None:
    for field, message in (('schema', 'schema 1, got 99'), ('x', 'schema')):
        content = io.BytesIO()
        np.savez(content, **{field: np.array(99)})  # type: ignore[arg-type]
        path = tmp_path / 'other.memory'
        path.write_bytes(content.getvalue())
        with pytest.raises(ModelError, match=message):
            SceneMemory.read(path, hashlib.sha256(content.getvalue()).hexdigest())


@pytest.mark.parametrize(('field', 'change', 'message'), [
    ('schema', lambda value: np.array([1, 1]), r'schema: expected int64 \(\), got int64 \(2,\)'),
    ('schema', lambda value: np.array('one'), 'schema: expected int64'),
    ('band', lambda value: value[:3], r'band: expected float64 \(4,\), got float64 \(3,\)'),
    ('band', lambda value: value[[1, 0, 2, 3]], 'band: expected a part of the sphere'),
    ('band', lambda value: value * np.nan, 'band: expected finite'),
    ('positions', lambda value: value * np.inf, 'positions: expected finite'),
    ('positions', lambda value: value - 2e6, r'within 1e\+06 m of the origin, got one at 2e\+06'),
    ('positions', lambda value: value[:, :2], r'positions: expected float64 \(any, 3\)'),
    ('positions', lambda value: value[1:], 'texture_sizes: expected'),
    ('texture_sizes', lambda value: value + 1, 'texture_sizes: expected sizes that add up'),
    ('depth_sizes', lambda value: -value, 'depth_sizes: expected sizes that add up'),
    ('depth_sizes', lambda value: value * 1.0, 'depth_sizes: expected int64'),
    ('glances', lambda value: value[:0], 'glances: expected'),
    ('glances', lambda value: value[1:], 'glance_poses: expected'),
    ('glance_poses', lambda value: 2 * value, 'glance_poses: expected a rotation'),
    ('landmarks', lambda value: value.astype(float), 'landmarks: expected float32'),
    ('landmarks', lambda value: value * np.float32(np.nan), 'landmarks: expected finite'),
    ('landmarks', lambda value: value[:0], 'landmarks: expected'),
    ('landmark_descriptors', lambda value: value[1:], 'landmark_descriptors: expected'),
    ('landmark_descriptors', lambda value: value[:, 1:], 'landmark_descriptors: expected'),
])
def test_fields_that_no_training_writes_are_refused(memory: SceneMemory, tmp_path: Path, field,
                                                    change, message) -> None:
    path = tmp_path / 'box.memory'
    memory.write(path)
    with np.load(path) as data:
        fields = dict(data)
    fields[field] = change(fields[field])
    content = io.BytesIO()
    np.savez(content, **fields)
    path.write_bytes(content.getvalue())
    with pytest.raises(ModelError, match=message):
        SceneMemory.read(path, hashlib.sha256(content.getvalue()).hexdigest())


@pytest.mark.parametrize('save', [np.save, np.savez_compressed], ids=['one array', 'packed'])
def test_other_files_of_numpy_are_refused(tmp_path: Path, save) -> None:
    content = io.BytesIO()
    save(content, np.zeros(1000))
    path = tmp_path / 'box.memory'
    path.write_bytes(content.getvalue())
    with pytest.raises(ModelError, match='expected a scene memory: (File is not|its arrays)'):
        SceneMemory.read(path, hashlib.sha256(content.getvalue()).hexdigest())


def test_keyframes_of_different_sizes_are_refused(memory: SceneMemory, tmp_path: Path) -> None:
    one = keyframe(memory.positions[0])
    less = Keyframe(one.position, one.depth[:-1].copy(), one.texture[:-2].copy())
    mixed = SceneMemory.from_keyframes([one, less], BAND, memory.glances)
    mixed.keyframe(0)
    with pytest.raises(ModelError, match='keyframe 1: expected texture and depth of the shapes'):
        mixed.keyframe(1)
    path = tmp_path / 'mixed.memory'
    with pytest.raises(ModelError, match='depths: expected keyframes of one size'):
        SceneMemory.read(path, mixed.write(path))


@pytest.mark.parametrize(('limit', 'message'), [
    ('MOST_MESH', 'depths: expected grey 16-bit PNG of at most 9'),
    ('MOST_TEXTURE', 'textures: size: expected 1x1 to 9 pixels'),
    ('MOST_GLANCES', 'glances: expected at most 9 pixels'),
    ('MOST_LANDMARKS', 'landmarks: expected at most 4, got 5'),
    ('MOST_ARRAY', 'expected at most 0 MB')])
def test_what_would_fill_a_robots_memory_is_refused_undecoded(
        memory: SceneMemory, tmp_path: Path, monkeypatch: pytest.MonkeyPatch, limit: str,
        message: str) -> None:
    path = tmp_path / 'box.memory'
    sha256 = memory.write(path)
    monkeypatch.setattr(memory_file if limit == 'MOST_ARRAY' else memory_checks, limit,
                        4 if limit == 'MOST_LANDMARKS' else 9)
    with pytest.raises(ModelError, match=message):
        SceneMemory.read(path, sha256)


@pytest.mark.parametrize(('texture', 'depth', 'message'), [
    ('.jpg', '.tiff', 'depths: expected grey 16-bit PNG'),
    ('.bmp', '.png', 'textures: data: expected a JPEG or PNG')])
def test_pictures_of_other_kinds_are_refused_undecoded(
        memory: SceneMemory, tmp_path: Path, texture: str, depth: str, message: str) -> None:
    coded = (cv2.imencode(texture, np.zeros((16, 16, 3), np.uint8))[1].tobytes(),
             cv2.imencode(depth, np.zeros((8, 8), np.uint16))[1].tobytes())
    other = SceneMemory(np.zeros((1, 3)), BAND, coded[:1], coded[1:], memory.glances)
    path = tmp_path / 'box.memory'
    with pytest.raises(ModelError, match=message):
        SceneMemory.read(path, other.write(path))


@pytest.mark.parametrize('shape', [(16, 24, 3), (15, 16, 3), (4, 4, 3)],
                         ids=['wider only', 'no multiple', 'coarser'])
def test_a_texture_is_some_times_finer_than_its_depth(shape: tuple[int, int, int]) -> None:
    frame = Keyframe(np.zeros(3), np.ones((8, 8), np.float32), np.zeros(shape, np.uint8))
    memory = SceneMemory.from_keyframes([frame], BAND, Glances(
        np.zeros((1, 4, 4), np.uint8), np.eye(4)[None]))
    with pytest.raises(ModelError, match='keyframe 0 is damaged'):
        memory.keyframe(0)


def test_a_damaged_keyframe_is_named() -> None:
    memory = SceneMemory(np.zeros((1, 3)), BAND, [b'no picture'], [b'none'],
                         Glances(np.zeros((1, 4, 4), np.uint8), np.eye(4)[None]))
    with pytest.raises(ModelError, match='keyframe 0'):
        memory.keyframe(0)


def test_an_unwritable_folder_is_named(memory: SceneMemory, tmp_path: Path) -> None:
    with pytest.raises(ModelError, match='cannot write'):
        memory.write(tmp_path / 'missing' / 'box.memory')


def test_what_could_not_be_read_is_not_written(
        memory: SceneMemory, tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    monkeypatch.setattr(scene_memory, 'MOST_BYTES', 1000)
    with pytest.raises(ModelError, match='set memory.distance to more'):
        memory.write(tmp_path / 'box.memory')
    assert not list(tmp_path.iterdir())


@pytest.mark.parametrize(('limit', 'most', 'message'), [
    ('MOST_GLANCES', 1000, 'at most 1000 pixels, got .*; set memory.distance to more'),
    ('MOST_LANDMARKS', 4, 'landmarks: .* 4, got 5; train a model for each part of the scene')])
def test_more_than_a_robot_keeps_is_not_written(
        memory: SceneMemory, tmp_path: Path, monkeypatch: pytest.MonkeyPatch, limit: str,
        most: int, message: str) -> None:
    monkeypatch.setattr(memory_checks, limit, most)
    with pytest.raises(ModelError, match=message):
        memory.write(tmp_path / 'box.memory')
    assert not list(tmp_path.iterdir())


def test_a_memory_that_is_large_for_a_room_is_written_with_a_warning(
        memory: SceneMemory, tmp_path: Path, monkeypatch: pytest.MonkeyPatch,
        caplog: pytest.LogCaptureFixture) -> None:
    memory.write(tmp_path / 'box.memory')
    assert not caplog.messages
    monkeypatch.setattr(scene_memory, 'LARGE_BYTES', 1000)
    memory.write(tmp_path / 'box.memory')
    assert 'a larger memory.distance makes it smaller' in caplog.text
