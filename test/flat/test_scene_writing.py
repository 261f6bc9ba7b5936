import os
import shutil
from typing import Any

from neo_ros.benchmark.true_depth import is_demo_flat
from neo_ros.captures.scene_copying import import_transforms
from neo_ros.errors import SceneError
from neo_ros.flat.demo_flat import build_demo_flat
from neo_ros.flat.scene_writing import fingerprint, write_demo_scene
from neo_ros.flat.visits import CHAIRS, changed_flat
from neo_ros.geometry import Intrinsics
from neo_ros.scenes.scene import read_scene
import numpy as np
import pytest
from scene_files import write_capture

SIZES: dict[str, Any] = {'image_size': 16, 'n_train': 5, 'n_paths': 2, 'frames_per_path': 3}


@pytest.fixture(scope='module')
def scene_folder(tmp_path_factory):
    folder = tmp_path_factory.mktemp('scene') / 'flat'
    write_demo_scene(folder, **SIZES, seed=4, workers=1)
    return folder


def _files(folder):
    return {path.relative_to(folder).as_posix(): path.read_bytes()
            for path in sorted(folder.rglob('*')) if path.is_file()}


def test_a_written_scene_reads_as_one(scene_folder):
    scene = read_scene(scene_folder)
    assert scene.test and scene.expansion and scene.walkable
    assert len(scene.train) == 5 and len(scene.test) == 6
    assert scene.test.path_ids == (0, 0, 0, 1, 1, 1)
    assert np.degrees(scene.train.intrinsics.hfov) == pytest.approx(90)
    assert np.degrees(scene.test.intrinsics.hfov) == pytest.approx(126.87, abs=0.01)
    assert scene.expansion.source == scene.train.intrinsics
    assert scene.walkable.contains(scene.train.T_world_cam[:, :2, 3]).all()
    assert scene.train.read_images().shape == (5, 16, 16, 3)
    assert scene.test.read_image(0).std() > 10


def test_a_broken_off_run_goes_on(scene_folder, tmp_path):
    whole = _files(scene_folder)
    folder = tmp_path / 'flat'
    calls = []

    def stop_after_four(done, total):
        calls.append((done, total))
        if done == 4:
            raise KeyboardInterrupt

    with pytest.raises(KeyboardInterrupt):
        write_demo_scene(folder, **SIZES, seed=4, workers=1, progress=stop_after_four)
    assert not (folder / 'transforms_train.json').exists()
    (folder / 'train' / '0001.png').write_bytes(b'kept')  # a finished file is not made again
    stamp = os.stat(folder / 'train' / '0000.png').st_mtime_ns
    calls.clear()
    write_demo_scene(folder, **SIZES, seed=4, workers=1,
                     progress=lambda done, total: calls.append((done, total)))
    assert calls == [(done, 11) for done in range(4, 12)]
    assert os.stat(folder / 'train' / '0000.png').st_mtime_ns == stamp
    assert _files(folder) == {**whole, 'train/0001.png': b'kept'}


@pytest.mark.slow
def test_processes_write_the_same_files(scene_folder, tmp_path):
    write_demo_scene(tmp_path / 'flat', **SIZES, seed=4, workers=2)
    assert _files(tmp_path / 'flat') == _files(scene_folder)


def test_another_scene_is_not_mixed_in(scene_folder):
    with pytest.raises(SceneError, match='choose another folder'):
        write_demo_scene(scene_folder, **SIZES, seed=5, workers=1)


def test_a_capture_is_not_overwritten_by_the_demo(tmp_path):
    write_capture(tmp_path / 'scene')
    before = (tmp_path / 'scene/transforms_train.json').read_bytes()
    with pytest.raises(SceneError, match='it holds another scene'):
        write_demo_scene(tmp_path / 'scene', **SIZES, workers=1)
    assert (tmp_path / 'scene/transforms_train.json').read_bytes() == before


def test_a_capture_in_the_demos_place_is_no_demo(scene_folder, tmp_path):
    shutil.copytree(scene_folder, tmp_path / 'scene')
    write_capture(tmp_path / 'source')
    import_transforms(tmp_path / 'source', tmp_path / 'scene')
    assert is_demo_flat(scene_folder) and not is_demo_flat(tmp_path / 'scene')


def test_the_fingerprint_is_that_of_what_is_seen():
    flat = build_demo_flat()
    pose = np.eye(4)
    same = fingerprint(flat, [pose])
    assert fingerprint(flat, [pose + 1e-9]) == same != fingerprint(flat, [pose + 1e-4])
    assert fingerprint(changed_flat(flat, CHAIRS), [pose]) != same


def test_an_unwritable_folder_is_named(tmp_path):
    (tmp_path / 'file').write_text('')
    with pytest.raises(SceneError, match='cannot write a demo scene here'):
        write_demo_scene(tmp_path / 'file' / 'flat', **SIZES, workers=1)


@pytest.mark.slow
def test_depth_maps_lie_beside_the_photos_where_they_are_asked_for(scene_folder, tmp_path):
    assert read_scene(scene_folder).train.read_depths() is None
    write_demo_scene(tmp_path, **SIZES, seed=4, workers=1, depth=True)
    train = read_scene(tmp_path).train
    depths = train.read_depths()
    assert depths is not None
    assert depths.shape == (5, 16, 16) and depths.dtype == np.uint16
    flat = build_demo_flat()
    for depth, pose in zip(depths, train.poses):
        true = flat.render(train.intrinsics, pose)[1]
        known = depth > 0
        assert known.any() and np.abs(depth / 1000 - true)[known].max() < 0.25
    half = train.subset([3]).read_depths(0.5)
    assert half is not None and half.shape == (1, 8, 8)


def test_another_camera_is_rendered_as_it_sees(tmp_path):
    camera = Intrinsics.from_hfov(32, 24, np.radians(69))
    write_demo_scene(tmp_path, camera=camera, n_train=2, n_paths=1, frames_per_path=2, workers=1)
    scene = read_scene(tmp_path)
    assert scene.train.intrinsics == camera and scene.train.read_image(0).shape == (24, 32, 3)
    assert scene.expansion is not None and scene.test is not None
    assert (scene.expansion.target.width, scene.expansion.target.height) == (64, 48)
    assert scene.expansion.target.fx == pytest.approx(camera.fx)
    with pytest.raises(SceneError, match='expected an empty folder or a demo scene of'):
        write_demo_scene(tmp_path, image_size=32, n_train=2, n_paths=1, frames_per_path=2)
