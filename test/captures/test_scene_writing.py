"""What comes into a scene folder: copies, straight pictures, and nothing that is broken."""
from dataclasses import replace
import json
from pathlib import Path
import shutil

from capture_files import (
    CAMERA, demo_photos, write_bag, write_image, write_transforms_capture, write_turned_jpeg)
import cv2
from neo_ros.captures.bag import read_bag_capture
from neo_ros.captures.capture import Capture, MaskSource
from neo_ros.captures.nerfstudio import read_transforms_capture
from neo_ros.captures.scene_writing import write_capture
from neo_ros.errors import SceneError
from neo_ros.geometry import CameraPose
from neo_ros.pictures.photo import read_photo
from neo_ros.scenes.scene import read_scene
import numpy as np
import pytest


@pytest.fixture
def source(tmp_path: Path) -> Path:
    return write_transforms_capture(tmp_path / 'source', demo_photos())


def test_images_of_a_pinhole_camera_are_copied_byte_by_byte(tmp_path: Path, source: Path) -> None:
    write_capture(read_transforms_capture(source), tmp_path / 'scene')
    for index in range(5):
        name = f'images/{index}.png'
        assert (tmp_path / 'scene' / name).read_bytes() == (source / name).read_bytes()


def test_distorted_images_are_made_straight(tmp_path: Path) -> None:
    source = write_transforms_capture(tmp_path / 's', demo_photos(), k1=-0.1, p1=0.001)
    write_capture(read_transforms_capture(source), tmp_path / 'scene')
    found = read_scene(tmp_path / 'scene').train
    assert found.intrinsics.fx < CAMERA.fx  # barrel distortion: it saw more than a pinhole
    assert (found.read_image(0) != demo_photos().images[0]).any()
    document = json.loads((tmp_path / 'scene/transforms_train.json').read_text())
    assert document['camera_model'] == 'PINHOLE' and 'k1' not in document


@pytest.mark.parametrize('convert, expected', [
    (lambda image: image.astype(np.uint16) * 257, lambda image: image),
    (lambda image: image[..., 1], lambda image: np.repeat(image[..., 1:2], 3, axis=2)),
], ids=['16 bit', 'grayscale'])
def test_other_pixels_become_8_bit_rgb(tmp_path: Path, source: Path, convert: object,
                                       expected: object) -> None:
    assert callable(convert) and callable(expected)
    image = demo_photos().images[2]
    write_image(source / 'images/2.png', convert(image))
    write_capture(read_transforms_capture(source), tmp_path / 'scene')
    found = read_scene(tmp_path / 'scene').train.read_image(2)
    assert np.abs(found.astype(int) - expected(image)).max() <= 1


def test_exif_orientation_does_not_turn_the_pixels(tmp_path: Path) -> None:
    path = write_turned_jpeg(tmp_path / 'a.jpg', demo_photos().images[0], 6)
    turned = cv2.imread(str(path))
    assert turned is not None and turned.shape == (64, 48, 3)  # so the tag is there
    found = read_photo(path)
    assert found is not None and found.shape == (48, 64, 3)


def test_unreadable_images_are_named_and_left_out(tmp_path: Path, source: Path) -> None:
    (source / 'images/3.png').write_bytes(b'no image')
    notes = write_capture(read_transforms_capture(source), tmp_path / 'scene')
    assert notes == (f'1 images cannot be read and are left out: {source}/images/3.png',)
    found = read_scene(tmp_path / 'scene').train
    np.testing.assert_allclose(
        found.T_world_cam, [demo_photos().poses[i].T_world_cam for i in (0, 1, 2, 4)], atol=1e-9)


@pytest.mark.parametrize('kept, readable', [(1.0, True), (0.5, False), (0.01, False)])
def test_a_jpeg_that_was_cut_off_is_no_photo(tmp_path: Path, kept: float, readable: bool) -> None:
    path = write_turned_jpeg(tmp_path / 'a.jpg', demo_photos().images[0], 1)
    whole = path.read_bytes()
    # The small picture in a camera's file has an end of its own; other things may follow it.
    small = b'\xff\xe2' + (2 + len(whole)).to_bytes(2, 'big') + whole
    path.write_bytes(whole[:2] + small + whole[2:2 + int(kept * len(whole))]
                     + (b'more' if readable else b''))
    assert (read_photo(path) is not None) == readable


def test_a_capture_without_a_readable_image_is_refused(tmp_path: Path, source: Path) -> None:
    for index in range(5):
        (source / f'images/{index}.png').write_bytes(b'no image')
    with pytest.raises(SceneError, match='none of the 5 images can be read'):
        write_capture(read_transforms_capture(source), tmp_path / 'scene')


def test_images_of_another_size_than_their_camera_are_refused(tmp_path: Path,
                                                              source: Path) -> None:
    write_image(source / 'images/2.png', demo_photos().images[2][:40])
    with pytest.raises(SceneError, match='2.png: expected 64x48.*got 64x40.*never resized'):
        write_capture(read_transforms_capture(source), tmp_path / 'scene')


def test_an_image_listed_twice_is_refused(tmp_path: Path, source: Path) -> None:
    capture = read_transforms_capture(source)
    twice = replace(capture, frames=(*capture.frames, capture.frames[0]))
    with pytest.raises(SceneError, match='images/0.png: expected every image once'):
        write_capture(twice, tmp_path / 'scene')


def test_images_that_no_import_wrote_are_left_alone(tmp_path: Path, source: Path) -> None:
    own = write_image(tmp_path / 'mine/images/3.png', demo_photos().images[0])
    before = own.read_bytes()
    with pytest.raises(SceneError, match='mine: expected no images .* got images/3.png; choose'):
        write_capture(read_transforms_capture(source), tmp_path / 'mine')
    assert own.read_bytes() == before and len(list((tmp_path / 'mine').rglob('*'))) == 2


def test_no_image_is_written_outside_of_the_scene(tmp_path: Path, source: Path) -> None:
    capture = read_transforms_capture(source)
    for name in ('images/../../0.png', str(tmp_path / '0.png')):
        frames = (replace(capture.frames[0], name=name), *capture.frames[1:])
        with pytest.raises(SceneError, match='expected a name of an image inside the scene'):
            write_capture(replace(capture, frames=frames), tmp_path / 'scene')
    assert not (tmp_path / 'scene').exists()


def test_a_scene_is_not_written_over_its_source(source: Path) -> None:
    before = (source / 'images/0.png').read_bytes()
    with pytest.raises(SceneError, match='another folder than the source'):
        write_capture(read_transforms_capture(source), source)
    assert (source / 'images/0.png').read_bytes() == before


def test_masks_are_never_replaced_by_those_of_the_scene(tmp_path: Path) -> None:
    source = write_transforms_capture(tmp_path / 'hall/photos', demo_photos())
    (tmp_path / 'hall/transforms_train.json').write_text('{}')
    masks = [write_image(tmp_path / f'hall/masks/{index}.png', np.full((48, 64), 255, np.uint8))
             for index in range(5)]
    capture = read_transforms_capture(source)
    capture = replace(capture, frames=tuple(
        replace(frame, mask=MaskSource(mask)) for frame, mask in zip(capture.frames, masks)))
    with pytest.raises(SceneError, match='another folder than the source: .* replace .*masks/0.p'):
        write_capture(capture, tmp_path / 'hall')
    assert all(mask.is_file() for mask in masks)


def interrupted(capture: Capture, scene: Path, after: int) -> None:
    def stop(done: int, total: int) -> None:
        if done == after:
            raise KeyboardInterrupt

    with pytest.raises(KeyboardInterrupt):
        write_capture(capture, scene, stop)


def test_an_interrupted_import_goes_on(tmp_path: Path) -> None:
    capture = read_bag_capture(write_bag(tmp_path / 'bag', demo_photos()))
    scene = tmp_path / 'scene'
    interrupted(capture, scene, 3)
    assert not (scene / 'transforms_train.json').exists()
    first = {path: path.stat().st_mtime_ns for path in (scene / 'images').iterdir()}
    assert len(first) == 3
    steps: list[int] = []
    write_capture(capture, scene, lambda done, total: steps.append(done))
    assert steps == [3, 4, 5]
    assert all(path.stat().st_mtime_ns == time for path, time in first.items())
    np.testing.assert_array_equal(read_scene(scene).train.read_images(), demo_photos().images)


def test_another_capture_does_not_keep_the_images_of_the_first(tmp_path: Path) -> None:
    scene = tmp_path / 'scene'
    photos = demo_photos()
    interrupted(read_bag_capture(write_bag(tmp_path / 'a', photos)), scene, 2)
    turned = replace(photos, images=photos.images[:, ::-1])
    capture = read_bag_capture(write_bag(tmp_path / 'b', turned))
    write_capture(capture, scene)
    np.testing.assert_array_equal(read_scene(scene).train.read_images(), turned.images)


def test_an_interrupted_import_leaves_no_poses_of_another_capture(tmp_path: Path) -> None:
    scene = tmp_path / 'scene'
    photos = demo_photos()
    write_capture(read_bag_capture(write_bag(tmp_path / 'a', photos)), scene)
    shutil.copy(scene / 'transforms_train.json', scene / 'transforms_test.json')
    other = read_bag_capture(write_bag(tmp_path / 'b', photos))
    interrupted(other, scene, 1)
    assert not (scene / 'transforms_test.json').exists()
    with pytest.raises(SceneError, match='expected transforms_train.json'):
        read_scene(scene)
    steps: list[int] = []
    write_capture(other, scene, lambda done, total: steps.append(done))
    assert steps == [1, 2, 3, 4, 5] and len(read_scene(scene).train) == 5


def test_cameras_far_from_the_origin_are_refused(tmp_path: Path, source: Path) -> None:
    capture = read_transforms_capture(source)
    far = np.eye(4)
    far[:3, 3] = 500_000, 5_400_000, 400  # UTM
    frames = tuple(replace(frame, pose=CameraPose(far @ frame.pose.T_world_cam))
                   for frame in capture.frames if frame.pose is not None)
    with pytest.raises(SceneError, match=r'4.png: .* 10 km .* at \(500003, 5400001, 402\) m; '
                       r'subtract .* about \(500000, 5400000, 400\), from all positions'):
        write_capture(replace(capture, frames=frames), tmp_path / 'scene')
    assert not (tmp_path / 'scene').exists()
