"""The file of a scene memory: what goes in comes out, and nothing else is read."""
import gc
import hashlib
import io
import os
from pathlib import Path
from typing import Any
import weakref

from box_room import BAND, box_memory
from neo_ros.errors import ModelError
from neo_ros.memory import scene_memory
from neo_ros.memory.scene_memory import CLOSEST, Glances, Keyframe, SceneMemory
from neo_ros.model_bytes import MAX_BYTES
import numpy as np
import pytest


@pytest.fixture(scope='module')
def memory() -> SceneMemory:
    return box_memory()


def test_a_memory_comes_back(memory: SceneMemory, tmp_path: Path) -> None:
    path = tmp_path / 'box.memory'
    again = SceneMemory.read(path, memory.write(path))
    assert again.band == memory.band
    assert np.array_equal(again.positions, memory.positions)
    assert np.array_equal(again.glances.pictures, memory.glances.pictures)
    for index in range(len(memory.positions)):
        one, other = memory.keyframe(index), again.keyframe(index)
        assert np.array_equal(one.texture, other.texture)
        assert np.array_equal(one.depth, other.depth)


def test_few_keyframes_stay_decoded_and_none_outlives_the_memory(
        monkeypatch: pytest.MonkeyPatch) -> None:
    monkeypatch.setattr(scene_memory, 'CACHED', 2)
    memory = box_memory()
    first = memory.keyframe(0)
    assert memory.keyframe(1) is not first and memory.keyframe(0) is first
    memory.keyframe(2)  # In the place of 1, which was used before 0.
    assert memory.keyframe(0) is first
    released: list[weakref.ref[Any]] = [weakref.ref(memory), weakref.ref(first)]
    gc.disable()
    try:
        del memory, first
        assert [reference() for reference in released] == [None, None]
    finally:
        gc.enable()


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
        file.truncate(MAX_BYTES + 1)  # Sparse: takes no space.
    paths['empty'].touch()
    words = {'huge': 'scene memory of at most 1024 MB', 'empty': 'the file is empty'}
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


def test_a_damaged_keyframe_is_named() -> None:
    memory = SceneMemory(np.zeros((1, 3)), BAND, [b'no picture'], [b'none'],
                         Glances(np.zeros((1, 4, 4), np.uint8), np.eye(4)[None]))
    with pytest.raises(ModelError, match='keyframe 0'):
        memory.keyframe(0)


def test_an_unwritable_folder_is_named(memory: SceneMemory, tmp_path: Path) -> None:
    with pytest.raises(ModelError, match='cannot write'):
        memory.write(tmp_path / 'missing' / 'box.memory')
