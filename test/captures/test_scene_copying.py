from dataclasses import replace
import json
from pathlib import Path
import shutil

from capture_files import demo_photos, write_transforms_capture
from neo_ros.captures.nerfstudio import read_transforms_capture
from neo_ros.captures.scene_copying import import_transforms
from neo_ros.captures.scene_writing import write_capture as write_posed
from neo_ros.errors import SceneError
from neo_ros.geometry import CameraPose, Intrinsics, ViewExpansion
from neo_ros.pictures.usable import write_usable
from neo_ros.scenes.scene import read_scene
from neo_ros.scenes.transforms_json import read_transforms, write_transforms
from neo_ros.scenes.walkable import WalkableMap, write_walkable
from neo_ros.updating.more_photos import read_stale
import numpy as np
import pytest
from scene_files import CAMERA, picture, write_capture, write_picture

WIDE = ViewExpansion(CAMERA, 4, 4, 2, 2)


@pytest.fixture
def source(tmp_path: Path) -> Path:
    folder = tmp_path / 'capture'
    write_capture(folder, 3, images='photos/day one')
    write_capture(folder, 2, WIDE.target, 'transforms_test.json', 'test', WIDE)
    write_walkable(folder / 'walkable.json', WalkableMap(0.5, (0, 0), np.ones((2, 3)), 1.5))
    return folder


def test_a_capture_becomes_a_scene(tmp_path: Path, source: Path) -> None:
    calls: list[tuple[int, int]] = []
    import_transforms(source, tmp_path / 'scene', lambda *counts: calls.append(counts))
    assert calls == [(done, 5) for done in range(1, 6)]
    scene, original = read_scene(tmp_path / 'scene'), read_scene(source)
    assert scene.name == 'scene' and scene.expansion == WIDE
    assert scene.walkable is not None and scene.walkable.area == 1.5
    assert scene.train.image_paths[0] == tmp_path / 'scene' / 'photos/day one' / '0.png'
    np.testing.assert_array_equal(scene.train.read_images(), original.train.read_images())
    np.testing.assert_allclose(scene.train.T_world_cam, original.train.T_world_cam)
    assert scene.test is not None and scene.test.path_ids == (0, 0)
    shutil.rmtree(source)
    assert scene.test.read_images().shape == (2, 16, 24, 3)


def test_a_broken_off_import_goes_on(tmp_path: Path, source: Path) -> None:
    class Killed(Exception):
        """What ends the first import."""

    def kill(done: int, total: int) -> None:
        if done == 2:
            raise Killed

    scene = tmp_path / 'scene'
    with pytest.raises(Killed):
        import_transforms(source, scene, kill)
    assert not (scene / 'transforms_train.json').exists()
    first = scene / 'photos/day one/0.png'
    (scene / 'photos/day one/1.png').write_bytes(b'cut off')
    before = first.stat().st_mtime_ns
    import_transforms(source, scene)
    assert first.stat().st_mtime_ns == before
    assert len(read_scene(scene).train.read_images()) == 3


def test_pictures_of_another_capture_are_not_taken_for_done(tmp_path: Path) -> None:
    # Bitmaps of one size all have the same length.
    write_capture(tmp_path / 'a', 1, suffix='.bmp')
    write_capture(tmp_path / 'b', 1, suffix='.bmp')
    write_picture(tmp_path / 'b/images/0.bmp', picture(CAMERA, 77))
    import_transforms(tmp_path / 'a', tmp_path / 'scene')
    import_transforms(tmp_path / 'b', tmp_path / 'scene')
    np.testing.assert_array_equal(read_scene(tmp_path / 'scene').train.read_image(0),
                                  picture(CAMERA, 77))


def test_images_that_no_import_wrote_are_left_alone(tmp_path: Path) -> None:
    write_capture(tmp_path / 'source', 2)
    own = tmp_path / 'mine/images/1.png'
    own.parent.mkdir(parents=True)
    own.write_bytes(b'the only one')
    with pytest.raises(SceneError, match='mine: expected no images .* got images/1.png'):
        import_transforms(tmp_path / 'source', tmp_path / 'mine')
    assert own.read_bytes() == b'the only one'


def test_pictures_of_two_captures_never_meet_the_poses_of_the_other(tmp_path: Path) -> None:
    other = write_transforms_capture(tmp_path / 'other', demo_photos(3))
    scene = tmp_path / 'scene'
    write_posed(read_transforms_capture(other), scene)
    write_capture(tmp_path / 'source', 3)

    def stop(done: int, total: int) -> None:
        raise KeyboardInterrupt

    with pytest.raises(KeyboardInterrupt):
        import_transforms(tmp_path / 'source', scene, stop)
    with pytest.raises(SceneError, match='expected transforms_train.json'):
        read_scene(scene)
    write_posed(read_transforms_capture(other), scene)
    np.testing.assert_array_equal(read_scene(scene).train.read_images(), demo_photos(3).images)


def test_cameras_far_from_the_origin_are_refused(tmp_path: Path) -> None:
    photos = write_capture(tmp_path / 'source', 2)
    T = photos.poses[1].T_world_cam.copy()
    T[0, 3] = 11_000
    write_transforms(tmp_path / 'source/transforms_train.json',
                     replace(photos, poses=(photos.poses[0], CameraPose(T))))
    with pytest.raises(SceneError, match=r'1.png: .* within 10 km .* at \(11000, 0, 2\) m'):
        import_transforms(tmp_path / 'source', tmp_path / 'scene')


def test_another_capture_takes_away_what_an_earlier_one_left(
        tmp_path: Path, source: Path, caplog: pytest.LogCaptureFixture) -> None:
    scene = tmp_path / 'scene'
    import_transforms(source, scene)
    import_transforms(source, scene)
    assert (scene / 'walkable.json').exists() and not (scene / 'walkable.old.json').exists()
    write_capture(tmp_path / 'other', 4, images='test')
    import_transforms(tmp_path / 'other', scene)
    found = read_scene(scene)
    assert len(found.train) == 4 and found.test is found.expansion is found.walkable is None
    assert 'transforms_test.json of an earlier import is deleted' in caplog.text
    # Perhaps it was made with care.
    assert (scene / 'walkable.old.json').read_bytes() == (source / 'walkable.json').read_bytes()
    assert 'rename it back, else run neo floor' in caplog.text


def test_what_is_out_of_date_in_the_photos_of_an_update_comes_along(tmp_path: Path) -> None:
    updated, scene = tmp_path / 'updated', tmp_path / 'scene'
    write_capture(updated, 2)
    gone = np.zeros((CAMERA.height, CAMERA.width), bool)
    gone[3:7, 4:9] = True
    write_usable(updated / 'out_of_date' / '1.png', gone)
    import_transforms(updated, scene)
    first, second = (read_stale(read_scene(scene).train, index) for index in range(2))
    assert first is None
    np.testing.assert_array_equal(second, gone)
    # Of another capture with photos of these names nothing is out of date.
    write_capture(tmp_path / 'other', 2)
    import_transforms(tmp_path / 'other', scene)
    assert read_stale(read_scene(scene).train, 1) is None


def test_images_beside_the_folder_keep_apart(tmp_path: Path) -> None:
    source = tmp_path / 'source'
    write_capture(source, 2)
    document = json.loads((source / 'transforms_train.json').read_text())
    for camera, frame in enumerate(document['frames']):
        frame['file_path'] = f'../cam{camera}/frame.png'
        write_picture(tmp_path / f'cam{camera}/frame.png', picture(CAMERA, 10 + camera))
    (source / 'transforms_train.json').write_text(json.dumps(document))
    import_transforms(source, tmp_path / 'scene')
    scene = read_scene(tmp_path / 'scene')
    np.testing.assert_array_equal(scene.train.read_image(0), picture(CAMERA, 10))
    np.testing.assert_array_equal(scene.train.read_image(1), picture(CAMERA, 11))
    assert all(path.is_relative_to(tmp_path / 'scene') for path in scene.train.image_paths)


@pytest.mark.parametrize('names, photos', [
    (['transforms.json'], 4), (['transforms_train.json', 'transforms.json'], 2),
], ids=['all in one', 'a training set of its own'])
def test_the_training_set_is_what_the_capture_says(
        tmp_path: Path, names: list[str], photos: int) -> None:
    source = tmp_path / 'source'
    for name in names:
        write_capture(source, {'transforms.json': 4, 'transforms_train.json': 2}[name], name=name)
    import_transforms(source, tmp_path / 'scene')
    assert len(read_transforms(tmp_path / 'scene' / 'transforms_train.json')) == photos


def test_bad_sources_are_refused(tmp_path: Path, source: Path) -> None:
    for folder, message in ((tmp_path / 'none', 'expected a folder'), (tmp_path, 'transforms')):
        with pytest.raises(SceneError, match=message):
            import_transforms(folder, tmp_path / 'scene')
    with pytest.raises(SceneError, match='expected another folder than the source'):
        import_transforms(source, tmp_path / 'capture' / '..' / 'capture')
    assert not (tmp_path / 'scene').exists()


@pytest.mark.parametrize('spoil, message', [
    (lambda path: path.write_bytes(path.read_bytes()[:40]), '1.png: expected a readable image'),
    (lambda path: write_picture(path, picture(Intrinsics(8, 12, 9, 9, 4, 6), 0)),
     '1.png: expected 16x12 pixels .* got 8x12'),
], ids=['truncated', 'another size'])
def test_bad_images_are_named(tmp_path: Path, source: Path, spoil, message: str) -> None:
    spoil(source / 'photos/day one/1.png')
    with pytest.raises(SceneError, match=message):
        import_transforms(source, tmp_path / 'scene')


def test_a_scene_folder_that_cannot_be_made_is_named(tmp_path: Path, source: Path) -> None:
    (tmp_path / 'file').write_text('')
    with pytest.raises(SceneError, match='cannot write: .*; choose another scene folder'):
        import_transforms(source, tmp_path / 'file' / 'scene')
