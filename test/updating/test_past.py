"""What an update knows of those before it."""
from dataclasses import replace
from pathlib import Path
from typing import cast

from box_room import HIGH
from neo_ros.benchmark.kills import ROOM
from neo_ros.benchmark.small_room import write_room
from neo_ros.errors import SceneError
from neo_ros.field.voxel_field import VoxelField
from neo_ros.pictures.usable import write_usable
from neo_ros.runtime.model_card import ModelCard, Update
from neo_ros.scenes.scene import read_scene
from neo_ros.updating.past import Past
from neo_ros.updating.update_run import UpdateRun
import numpy as np
import pytest


def field() -> VoxelField:
    return VoxelField.empty(20_000, HIGH / 2, HIGH / 2 + 0.2, 0.2, 0)


def cells(*places: tuple[int, int, int]) -> np.ndarray:
    found = np.zeros(field().shape, bool)
    for place in places:
        found[place] = True
    return found


def more(past: Past, changed: np.ndarray, update: int, founders: list[int]) -> Past:
    nothing = np.zeros(field().shape, np.int32)
    return past.with_more(field(), field(), changed, nothing, update, np.array(founders))


def test_the_last_update_of_a_cell_counts(tmp_path: Path) -> None:
    assert not Past.read(tmp_path).dates(field()).any()
    first = more(Past.read(tmp_path), cells((3, 4, 5), (6, 6, 6)), 1, [40, 41])
    more(first, cells((6, 6, 6), (2, 2, 2)), 2, [90]).write(tmp_path)
    past = Past.read(tmp_path)
    dates = past.dates(field())
    assert [dates[place] for place in ((3, 4, 5), (6, 6, 6), (2, 2, 2), (0, 0, 0))] == [1, 2, 2, 0]
    assert (dates > 0).sum() == 3 and past.founders.tolist() == [40, 41, 90]


def test_a_damaged_file_says_what_to_do(tmp_path: Path) -> None:
    (tmp_path / 'changes.npz').write_bytes(b'PK but no more')
    with pytest.raises(SceneError, match='changes.npz.*update the run that it was made of again'):
        Past.read(tmp_path)


class Card:
    """Of a model card what is asked here."""

    def __init__(self, updates: int) -> None:
        self.updates = (Update(memory='ab' * 32, bag='a', photos=1, at='now'),) * updates


@pytest.mark.parametrize('path_ids, updates, expected', [
    ((0, 0, 0, 1, 1, 2), 2, [0, 0, 0, 1, 1, 2]),
    ((4, 0, 3, 5, 6, 6), 2, [0, 0, 0, 1, 2, 2]),
    # The photos of an updated scene, which was trained on anew.
    ((0, 0, 0, 1, 1, 2), 0, [0] * 6)])
def test_photos_are_of_the_training_or_of_an_update(
        tmp_path: Path, path_ids: tuple[int, ...], updates: int, expected: list[int]) -> None:
    write_room(tmp_path / 'room')
    scene = read_scene(tmp_path / 'room')
    train = replace(scene.train.subset(range(6)), path_ids=path_ids)
    more(Past.read(tmp_path), cells((6, 6, 6)), 1, [4]).write(tmp_path)
    camera = train.intrinsics
    usable, gone = np.ones((2, camera.height, camera.width), bool)
    usable[:, :20], gone[:, 20:] = False, False
    write_usable(tmp_path / 'room' / 'masks' / 'now.png', usable)
    write_usable(tmp_path / 'room' / 'out_of_date' / f'{train.image_paths[2].stem}.png', gone)
    train = replace(train, mask_paths=(
        None, None, tmp_path / 'room' / 'masks' / 'now.png', None, None, None))
    run = UpdateRun(tmp_path, replace(scene, train=train), ROOM, tmp_path,
                    cast(ModelCard, Card(updates)), tmp_path)
    found = run.earlier_changes(field(), run.small_camera, 3)
    assert found.updates.tolist() == expected
    assert found.founders.tolist() == [
        number == 0 or index == 4 for index, number in enumerate(expected)]
    # Also of a scene that was trained anew: its photos are as old as they were.
    assert found.stale.shape == (9, camera.height, camera.width)
    assert found.stale[2, :, :20].all() and not found.stale[2, :, 24:].any()
    assert found.stale.any((1, 2)).tolist() == [index == 2 for index in range(9)]
    now, stale = run.masks(2)
    assert (now | stale).all() and not (now & stale).any()
    # Half as fine, a pixel that is in part out of date was usable once, too.
    usable[:, 20], gone[:, 20] = False, True
    write_usable(tmp_path / 'room' / 'masks' / 'now.png', usable)
    write_usable(tmp_path / 'room' / 'out_of_date' / f'{train.image_paths[2].stem}.png', gone)
    now, stale = replace(run, experiment=replace(ROOM, scale=0.5)).masks(2)
    assert now.shape[1] == camera.width // 2 and stale[:, 10].all() and (now | stale).all()
