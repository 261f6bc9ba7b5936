from pathlib import Path

from neo_ros.errors import SceneError
from neo_ros.geometry import ViewExpansion
from neo_ros.scenes.digests import floor_digest, floors_digest
from neo_ros.scenes.scene import clear_earlier_import, floor_file, read_scene
from neo_ros.scenes.walkable import WalkableMap, write_walkable
import numpy as np
import pytest
from scene_files import CAMERA, write_capture


@pytest.mark.parametrize('name', ['transforms.json', 'transforms_train.json'])
def test_photos_alone_make_a_scene(tmp_path: Path, name: str) -> None:
    write_capture(tmp_path / 'kitchen', 3, name=name)
    scene = read_scene(tmp_path / 'kitchen')
    assert scene.name == 'kitchen' and len(scene.train) == 3
    assert scene.test is scene.expansion is scene.walkable is None


def test_the_training_file_comes_before_the_file_of_all(tmp_path: Path) -> None:
    write_capture(tmp_path, 4, name='transforms.json')
    write_capture(tmp_path, 2)
    assert len(read_scene(tmp_path).train) == 2


def test_wide_truth_brings_its_expansion(tmp_path: Path) -> None:
    wide = ViewExpansion(CAMERA, 2, 2, 0, 0)
    write_capture(tmp_path, 2)
    write_capture(tmp_path, 3, wide.target, 'transforms_test.json', 'test', wide)
    scene = read_scene(tmp_path)
    assert scene.test is not None and len(scene.test) == 3 and scene.expansion == wide


def test_each_storey_has_its_floor_map(tmp_path: Path) -> None:
    write_capture(tmp_path, 2)
    maps = [WalkableMap(0.05, (0.0, 0.0), np.ones((9, 9 + storey), bool), 1.5 + 3 * storey)
            for storey in range(3)]
    for storey in (0, 2):
        write_walkable(floor_file(tmp_path, storey), maps[storey])
    assert read_scene(tmp_path).upper == ()  # They count on: the second one is missing.
    write_walkable(floor_file(tmp_path, 1), maps[1])
    found = read_scene(tmp_path)
    assert found.walkable is not None
    assert [floor.camera_height for floor in (found.walkable, *found.upper)] == [1.5, 4.5, 7.5]
    digests = {floors_digest(maps[:count]) for count in (1, 2, 3)}
    assert len(digests) == 3 and floor_digest(maps[0]) in digests


@pytest.mark.parametrize('has_floor', [True, False])
def test_another_import_leaves_no_storey_of_before(tmp_path: Path, has_floor: bool) -> None:
    floor = WalkableMap(0.05, (0.0, 0.0), np.ones((9, 9), bool), 1.5)
    for storey in range(3):
        write_walkable(floor_file(tmp_path, storey), floor)
    clear_earlier_import(tmp_path, has_floor)
    names = sorted(path.name for path in tmp_path.iterdir())
    assert names == (['walkable.json'] if has_floor else [
        'walkable.old.json', 'walkable_1.old.json', 'walkable_2.old.json'])


def test_what_is_no_scene_is_told(tmp_path: Path) -> None:
    with pytest.raises(SceneError, match='none: expected a scene folder, there is none'):
        read_scene(tmp_path / 'none')
    with pytest.raises(SceneError, match='make one with: neo import'):
        read_scene(tmp_path)
    write_capture(tmp_path)
    (tmp_path / 'walkable.json').write_text('{}')
    with pytest.raises(SceneError, match="walkable.json: expected the key 'width'"):
        read_scene(tmp_path)


def test_photos_in_both_lists_are_named(tmp_path: Path) -> None:
    write_capture(tmp_path, 3)
    write_capture(tmp_path, 2, name='transforms_test.json')
    with pytest.raises(SceneError, match=r'not trained on, got 2 that transforms_train.json has, '
                                         r'too \(0.png, 1.png\); import the capture again'):
        read_scene(tmp_path)
