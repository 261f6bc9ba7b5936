"""A model with a scene memory beside it: guided where the scene is known, and safe elsewhere."""
import hashlib
from pathlib import Path

from box_room import box_walk, EXPANSION, view, write_box_model
from neo_ros.errors import ModelError
from neo_ros.machine.regular_file import open_model_file
from neo_ros.runtime import FovExtrapolator
from neo_ros.runtime.fov_extrapolator import memory_path
from neo_ros.runtime.model_card import MemoryFile
import numpy as np
import pytest

RING = EXPANSION.extrapolated_mask


@pytest.fixture(scope='module')
def model(tmp_path_factory) -> Path:
    return write_box_model(tmp_path_factory.mktemp('guided'))


def walk(count: int) -> list[np.ndarray]:
    """Return wide views along a walk through the box room."""
    return [view(pose, EXPANSION.target)[0] for pose in box_walk(count)]


def test_the_ring_shows_the_scene(model: Path) -> None:
    guided, alone = FovExtrapolator.load(model), FovExtrapolator.load(model, guided=False)
    for wide in walk(3):
        narrow = EXPANSION.crop(wide)
        ours, floor = guided.expand(narrow), alone.expand(narrow)
        assert ours.guided and not floor.guided
        np.testing.assert_array_equal(EXPANSION.crop(ours.wide_image), narrow)
        error, worse = (np.abs(result.wide_image.astype(int) - wide)[RING].mean()
                        for result in (ours, floor))
        assert error < 6 < worse
        assert ours.confidence[RING].mean() > 128 and (ours.confidence[~RING] == 255).all()


def test_images_of_elsewhere_get_what_the_network_makes_of_them(model: Path) -> None:
    guided, alone = FovExtrapolator.load(model), FovExtrapolator.load(model, guided=False)
    noise = np.random.default_rng(0).integers(0, 256, (64, 64, 3), np.uint8)
    ours, floor = guided.expand(noise), alone.expand(noise)
    assert not ours.guided
    np.testing.assert_array_equal(ours.wide_image, floor.wide_image)
    np.testing.assert_array_equal(ours.confidence, floor.confidence)


def test_a_reset_repeats_every_bit(model: Path) -> None:
    extrapolator = FovExtrapolator.load(model, threads=2)
    frames = [EXPANSION.crop(wide) for wide in walk(3)]
    runs = []
    for _ in range(2):
        extrapolator.reset()
        runs.append([extrapolator.expand(frame) for frame in frames])
    for one, other in zip(*runs):
        np.testing.assert_array_equal(one.wide_image, other.wide_image)
        np.testing.assert_array_equal(one.confidence, other.confidence)


def test_a_missing_or_exchanged_memory_is_refused(model: Path, tmp_path: Path) -> None:
    copy = tmp_path / 'box.onnx'
    copy.write_bytes(model.read_bytes())
    with pytest.raises(ModelError, match='box.memory.*keep it beside the model'):
        FovExtrapolator.load(copy)
    (tmp_path / 'box.memory').write_bytes(b'another')
    with pytest.raises(ModelError, match='sha256'):
        FovExtrapolator.load(copy)
    assert not FovExtrapolator.load(copy, guided=False).expand(
        np.zeros((64, 64, 3), np.uint8)).guided


def test_a_link_to_a_model_finds_its_memory(model: Path, tmp_path: Path) -> None:
    link = tmp_path / 'link.onnx'
    link.symlink_to(model)
    narrow = EXPANSION.crop(walk(1)[0])
    assert FovExtrapolator.load(link).expand(narrow).guided
    # Its checksum tells it from another one of that name beside the link.
    (tmp_path / 'box.memory').write_bytes(b'another')
    assert FovExtrapolator.load(link).expand(narrow).guided


def test_a_model_and_a_memory_that_were_renamed_find_each_other(model: Path, tmp_path: Path
                                                                ) -> None:
    kitchen, content = tmp_path / 'kitchen.onnx', model.with_name('box.memory').read_bytes()
    kitchen.write_bytes(model.read_bytes())
    (tmp_path / 'a.memory').mkdir()  # No file at all.
    (tmp_path / 'box.memory').write_bytes(b'of another model')
    for name in ('kitchen.memory', 'other.memory'):
        (tmp_path / name).write_bytes(content)
        extrapolator = FovExtrapolator.load(kitchen)
        assert extrapolator.card.memory is not None
        assert memory_path(kitchen, extrapolator.card.memory) == tmp_path / name
        assert extrapolator.expand(EXPANSION.crop(walk(1)[0])).guided
        (tmp_path / name).unlink()
    (tmp_path / 'kitchen.memory').write_bytes(content[:-1] + b'x')
    with pytest.raises(ModelError, match='box.memory.*sha256'):
        FovExtrapolator.load(kitchen)


def test_a_renamed_memory_may_be_larger_than_any_model(tmp_path: Path, monkeypatch) -> None:
    monkeypatch.setattr(open_model_file, '__defaults__', (100,))  # Bytes of a model.
    large, content = tmp_path / 'renamed.memory', bytes(200)
    large.write_bytes(content)
    card = MemoryFile(file='room.memory', sha256=hashlib.sha256(content).hexdigest())
    assert memory_path(tmp_path / 'room.onnx', card) == large


@pytest.mark.parametrize('name', ['../x.memory', '/etc/passwd', 'a/b', '', '.', '..'],
                         ids=['above', 'absolute', 'below', 'empty', 'folder', 'folder above'])
def test_a_card_names_only_files_beside_the_model(name: str) -> None:
    with pytest.raises(ModelError, match='file'):
        MemoryFile(file=name, sha256='0' * 64)
