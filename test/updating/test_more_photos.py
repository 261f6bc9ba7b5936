"""Photos of an updated scene: what was found out of date may count again."""
from dataclasses import replace
from pathlib import Path

from neo_ros.baking.keyframes import Photos
from neo_ros.benchmark.small_room import write_room
from neo_ros.pictures.usable import write_usable
from neo_ros.scenes.posed_images import PosedImages
from neo_ros.scenes.scene import read_scene, Scene
from neo_ros.updating.more_photos import read_stale, write_more_photos
import numpy as np

LEFT, RIGHT = (slice(None), slice(20)), (slice(None), slice(44, None))


def counting(scene: Scene, *left_out: tuple[slice, slice]) -> np.ndarray:
    camera = scene.train.intrinsics
    usable = np.ones((camera.height, camera.width), bool)
    for part in left_out:
        usable[part] = False
    return usable


def out_of_date(photos: PosedImages, index: int) -> np.ndarray:
    stale, camera = read_stale(photos, index), photos.intrinsics
    return np.zeros((camera.height, camera.width), bool) if stale is None else stale


def written(scene: Scene, folder: Path, index: int, usable: np.ndarray) -> Scene:
    """Write and read the scene with one photo that a change is seen in."""
    train = scene.train
    write_more_photos(folder, scene, [index], Photos(
        train.read_image(index)[None], train.intrinsics, train.T_world_cam[[index]], usable[None]))
    return read_scene(folder)


def test_what_is_out_of_date_is_kept_apart_from_the_masks_of_the_capture(tmp_path: Path) -> None:
    write_room(tmp_path / 'room')
    scene = read_scene(tmp_path / 'room')
    count, camera = len(scene.train), scene.train.intrinsics
    masks: list[Path | None] = [None] * count
    masks[3] = robot = tmp_path / 'robot.png'
    write_usable(robot, counting(scene, LEFT))
    scene = replace(scene, train=replace(scene.train, mask_paths=tuple(masks)))
    first = written(scene, tmp_path / '1', 3, counting(scene, LEFT, RIGHT)).train
    np.testing.assert_array_equal(first.read_usable(3), counting(scene, LEFT, RIGHT))
    np.testing.assert_array_equal(out_of_date(first, 3), ~counting(scene, RIGHT))
    # Another change elsewhere: what was out of date is so.
    second = written(read_scene(tmp_path / '1'), tmp_path / '2', 5, counting(scene, LEFT)).train
    for index in range(count):
        stale = {3: counting(scene, RIGHT), 5: counting(scene, LEFT)}.get(index)
        np.testing.assert_array_equal(out_of_date(second, index), (
            np.zeros((camera.height, camera.width), bool) if stale is None else ~stale))
    # It shows what is there again, but for the robot itself, whatever is asked of it.
    third = written(read_scene(tmp_path / '2'), tmp_path / '3', 3, counting(scene)).train
    np.testing.assert_array_equal(third.read_usable(3), counting(scene, LEFT))
    assert not out_of_date(third, 3).any() and out_of_date(third, 5).any()
