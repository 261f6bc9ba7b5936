"""Every format gives back the same photos and poses, and says clearly what is wrong."""
from collections.abc import Callable
from dataclasses import astuple
import importlib.util
import json
import math
from pathlib import Path
import shutil
import sys

from capture_files import (
    CAMERA, demo_photos, START_NS, STEP_NS, write_bag, write_colmap_binary, write_colmap_text,
    write_image, write_scannet, write_seven_scenes, write_trajectory, write_transforms_capture,
    write_turned_jpeg)
import cv2
from neo_ros.captures.bag import read_bag_capture
from neo_ros.captures.capture import Capture
from neo_ros.captures.formats import CaptureFormat, detect_format, FOLDER_READERS
from neo_ros.captures.levelling import level_world
from neo_ros.captures.nerfstudio import read_transforms_capture
from neo_ros.captures.photos import read_photos
from neo_ros.captures.scene_copying import import_transforms
from neo_ros.captures.scene_writing import write_capture, write_images
from neo_ros.captures.trajectory import read_trajectory
from neo_ros.errors import SceneError
from neo_ros.machine.names import natural_key
from neo_ros.pictures.photo import read_photo
from neo_ros.scenes.scene import read_scene
import numpy as np
from phone_files import write_camera_info
import pytest
import zstandard

FORMATS: dict[str, tuple[Callable[..., Path], CaptureFormat]] = {
    'transforms': (write_transforms_capture, CaptureFormat.TRANSFORMS),
    'colmap text': (write_colmap_text, CaptureFormat.COLMAP),
    'colmap binary': (write_colmap_binary, CaptureFormat.COLMAP),
    'scannet': (write_scannet, CaptureFormat.SCANNET),
    '7scenes': (write_seven_scenes, CaptureFormat.SEVEN_SCENES),
    'trajectory': (write_trajectory, CaptureFormat.TRAJECTORY),
    'bag': (write_bag, CaptureFormat.BAG),
}


def read(source: Path) -> Capture:
    format_ = detect_format(source)
    return (read_bag_capture(source) if format_ == CaptureFormat.BAG
            else FOLDER_READERS[format_](source))


@pytest.mark.parametrize('write, format_', FORMATS.values(), ids=FORMATS.keys())
def test_every_format_gives_the_same_scene(tmp_path: Path, write: Callable[..., Path],
                                           format_: CaptureFormat) -> None:
    photos = demo_photos()
    source = write(tmp_path / 'source', photos)
    assert detect_format(source) == format_
    write_capture(read(source), tmp_path / 'scene')
    found = read_scene(tmp_path / 'scene').train
    assert astuple(found.intrinsics) == pytest.approx(astuple(CAMERA), abs=1e-9)
    np.testing.assert_allclose(
        found.T_world_cam, [pose.T_world_cam for pose in photos.poses], atol=1e-6)
    np.testing.assert_array_equal(found.read_images(), photos.images)
    assert found.path_ids == ((0, 0, 0, 1, 1) if format_ == CaptureFormat.SEVEN_SCENES
                              else (0,) * 5)


@pytest.mark.parametrize('whole_folder', [True, False], ids=['folder', 'file'])
def test_a_bag_that_rosbag2_compressed_as_files_is_a_bag(
        tmp_path: Path, whole_folder: bool) -> None:
    source = write_bag(tmp_path / 'source', demo_photos())
    plain, = source.glob('*.mcap')
    packed = plain.with_name(plain.name + '.zstd')
    packed.write_bytes(zstandard.ZstdCompressor().compress(plain.read_bytes()))
    plain.unlink()
    capture = read(source if whole_folder else packed)
    assert len(capture) == 5 and capture.posed


@pytest.mark.parametrize('name, defined', [
    ('scannet', True), ('bag', True), ('transforms', False), ('7scenes', False),
    ('trajectory', False), ('colmap text', False)])
def test_formats_that_define_up_say_so_in_the_scene(
        tmp_path: Path, name: str, defined: bool) -> None:
    write_capture(read(FORMATS[name][0](tmp_path / 'source', demo_photos())), tmp_path / 'scene')
    assert read_scene(tmp_path / 'scene').train.z_up == defined
    # A scene that is copied says it, too, and so does one that was levelled.
    import_transforms(tmp_path / 'scene', tmp_path / 'copy')
    copy = tmp_path / 'copy' / 'transforms_train.json'
    assert read_scene(tmp_path / 'copy').train.z_up == defined
    assert read_transforms_capture(copy).z_up == defined
    assert level_world(read_transforms_capture(copy)).z_up


def test_a_plain_folder_of_images_is_taken_for_photos(tmp_path: Path) -> None:
    write_image(tmp_path / 'b10.jpg', demo_photos().images[0])
    write_image(tmp_path / 'b9.jpg', demo_photos().images[1])
    assert detect_format(tmp_path) == CaptureFormat.PHOTOS
    capture = read_photos(tmp_path)
    assert [frame.name for frame in capture.frames] == ['images/b9.jpg', 'images/b10.jpg']
    assert not capture.posed


def test_reading_photos_shows_progress_and_decodes_a_jpeg_once(
        tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    for index, image in enumerate(demo_photos(3).images):
        write_turned_jpeg(tmp_path / f'{index}.jpg', image, 8)
    (tmp_path / '3.jpg').write_bytes(b'no image')
    decoded: list[int] = []
    decode = cv2.imdecode

    def counted(data: np.ndarray, flags: int) -> np.ndarray | None:
        decoded.append(len(data))
        return decode(data, flags)

    monkeypatch.setattr(cv2, 'imdecode', counted)
    shown: list[tuple[int, int]] = []
    capture = read_photos(tmp_path, progress=lambda done, total: shown.append((done, total)))
    assert shown == [(done, 4) for done in range(1, 5)]
    assert len(capture) == 3 and len(decoded) == 4
    assert '3 photos are stored turned' in capture.notes[1]


def test_a_picture_beside_the_folder_of_the_photos_does_not_hide_them(tmp_path: Path) -> None:
    write_image(tmp_path / 'preview.jpg', demo_photos().images[0][::2, ::2])
    for index, image in enumerate(demo_photos(3).images):
        write_image(tmp_path / f'images/{index}.png', image)
    write_image(tmp_path / 'rgb/one.png', demo_photos().images[0])
    assert detect_format(tmp_path) == CaptureFormat.PHOTOS
    capture = read_photos(tmp_path)
    assert [frame.file for frame in capture.frames] == [
        tmp_path / f'images/{index}.png' for index in range(3)]
    assert capture.notes == tuple(
        f'1 photos in {folder} are left aside, as {tmp_path}/images has 3: {name}'
        for folder, name in ((tmp_path, 'preview.jpg'), (tmp_path / 'rgb', 'one.png')))
    for index, image in enumerate(demo_photos(3).images[:2]):
        write_image(tmp_path / f'{index}.jpg', image[::2, ::2])
    assert [frame.file and frame.file.name for frame in read_photos(tmp_path).frames] == [
        '0.jpg', '1.jpg', 'preview.jpg']  # As many: those of the folder itself.


@pytest.mark.parametrize('orientation, turn', [(6, -1), (3, 2)], ids=['portrait', 'upside down'])
def test_photos_that_a_camera_stored_turned_are_written_upright(
        tmp_path: Path, orientation: int, turn: int) -> None:
    upright = demo_photos().images[0]
    for name in ('a.jpg', 'b.jpg'):
        write_turned_jpeg(tmp_path / 'in' / name, np.rot90(upright, -turn), orientation)
    capture = read_photos(tmp_path / 'in')
    assert '2 photos are stored turned' in capture.notes[0]
    names, camera = write_images(capture, tmp_path / 'out')
    assert names == ['images/a.jpg.png', 'images/b.jpg.png']
    assert (camera.width, camera.height) == (64, 48)
    found = read_photo(tmp_path / 'out/images/b.jpg.png')
    assert found is not None and np.abs(found.astype(int) - upright).mean() < 8  # JPEG's
    # One of another size beside them is told as it is shown.
    write_image(tmp_path / 'in/c.png', np.zeros((8, 9, 3), np.uint8))
    with pytest.raises(SceneError, match='64x48: a.jpg, b.jpg; 9x8: c.png'):
        read_photos(tmp_path / 'in')


def test_one_turned_photo_among_upright_ones_stays_as_it_is_stored(tmp_path: Path) -> None:
    write_image(tmp_path / 'a.png', demo_photos().images[0])
    write_turned_jpeg(tmp_path / 'b.jpg', demo_photos().images[1], 6)
    capture = read_photos(tmp_path)
    assert '1 of 2 photos are stored turned' in capture.notes[0] and capture.stream is None
    assert [frame.name for frame in capture.frames] == ['images/a.png', 'images/b.jpg']


def test_habitat_poses_look_along_minus_z(tmp_path: Path) -> None:
    photos = demo_photos()
    capture = read_trajectory(write_trajectory(tmp_path / 's', photos, axes='opengl'))
    for frame, pose in zip(capture.frames, photos.poses):
        assert frame.pose is not None
        np.testing.assert_allclose(frame.pose.T_world_cam, pose.T_world_cam, atol=1e-12)


def test_a_camera_of_habitat_is_given_by_its_field_of_view(tmp_path: Path) -> None:
    source = write_trajectory(tmp_path / 's', demo_photos())
    (source / 'camera.json').write_text(json.dumps({'w': 64, 'h': 48, 'hfov': 90}))
    lens = read_trajectory(source).frames[0].lens
    assert lens is not None and lens.intrinsics.fx == pytest.approx(32)
    assert (lens.intrinsics.cx, lens.intrinsics.cy) == (32, 24)


def test_a_centre_that_counts_from_the_first_pixels_middle_is_the_images(tmp_path: Path) -> None:
    source = write_trajectory(tmp_path / 's', demo_photos())
    for centre, expected in (((31.5, 23.5), (32, 24)), ((31.5, 24.5), (31.5, 24.5))):
        (source / 'camera.json').write_text(json.dumps(
            {'w': 64, 'h': 48, 'fx': 58.5, 'cx': centre[0], 'cy': centre[1]}))
        lens = read_trajectory(source).frames[0].lens
        assert lens is not None and (lens.intrinsics.cx, lens.intrinsics.cy) == expected


def test_frames_of_a_transforms_file_come_in_the_order_of_their_names(tmp_path: Path) -> None:
    source = write_transforms_capture(tmp_path / 's', demo_photos(12))
    document = json.loads((source / 'transforms.json').read_text())
    np.random.default_rng(0).shuffle(document['frames'])
    (source / 'transforms.json').write_text(json.dumps(document))
    capture = read_transforms_capture(source)
    assert [frame.name for frame in capture.frames] == [f'images/{i}.png' for i in range(12)]
    for frame, pose in zip(capture.frames, demo_photos(12).poses):
        assert frame.pose is not None
        np.testing.assert_allclose(frame.pose.T_world_cam, pose.T_world_cam, atol=1e-12)


def test_a_trajectory_takes_a_calibration_from_elsewhere(tmp_path: Path) -> None:
    source = write_trajectory(tmp_path / 's', demo_photos())
    (source / 'camera.json').unlink()
    with pytest.raises(SceneError, match='--camera-info FILE'):
        read_trajectory(source)
    lens = read_trajectory(source, write_camera_info(tmp_path / 'c.yaml')).frames[0].lens
    assert lens is not None and astuple(lens.intrinsics) == astuple(CAMERA)


def test_heic_photos_are_read_and_written_as_png(tmp_path: Path) -> None:
    pillow_heif = pytest.importorskip('pillow_heif')
    image = demo_photos().images[0]
    source = tmp_path / 'in'
    write_image(source / 'a.png', image)
    pillow_heif.from_bytes('RGB', (64, 48), image.tobytes()).save(
        source / 'b.HEIC', quality=100, chroma=444)
    (source / 'c.dng').write_bytes(b'raw')
    capture = read_photos(source)
    assert '1 files are of kinds that are not read, and are left out: c.dng' in capture.notes[0]
    names, _ = write_images(capture, tmp_path / 'out')
    assert names == ['images/a.png', 'images/b.HEIC.png']
    found = read_photo(tmp_path / 'out/images/b.HEIC.png')
    assert found is not None and np.abs(found.astype(int) - image).mean() < 2


def test_heic_photos_without_the_extra_are_named_with_it(
        tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    monkeypatch.setitem(sys.modules, 'pillow_heif', None)
    monkeypatch.setattr(importlib.util, 'find_spec', lambda name: None)
    (tmp_path / 'b.heic').write_bytes(b'heic')
    assert detect_format(tmp_path) == CaptureFormat.PHOTOS
    with pytest.raises(SceneError, match=r"pip install '\.\[heic\]' in a checkout"):
        read_photos(tmp_path)
    write_image(tmp_path / 'a.png', demo_photos().images[0])
    note, = read_photos(tmp_path).notes
    assert '1 images cannot be read and are left out: b.heic; HEIC photos need' in note


def test_instant_ngp_states_an_angle_and_leaves_the_ending_out(tmp_path: Path) -> None:
    source = write_transforms_capture(tmp_path / 's', demo_photos())
    document = json.loads((source / 'transforms.json').read_text())
    for frame in document['frames']:
        frame['file_path'] = './' + frame['file_path'].removesuffix('.png')
    (source / 'transforms.json').write_text(json.dumps(
        {'camera_angle_x': 2 * np.arctan(32 / 58.5), 'frames': document['frames']}))
    capture = read_transforms_capture(source)
    assert capture.frames[3].name == 'images/3.png'
    lens = capture.frames[0].lens
    assert lens is not None and lens.intrinsics.fx == pytest.approx(58.5)
    assert (lens.intrinsics.width, lens.intrinsics.height) == (64, 48)


@pytest.mark.parametrize('name', ['images\\2.png', 'images/2', './images/2.png'])
def test_images_are_found_as_other_systems_name_them(tmp_path: Path, name: str) -> None:
    source = write_transforms_capture(tmp_path / 'in', demo_photos())
    path = source / 'transforms.json'
    (source / 'images/2.png').rename(source / 'images/2.PNG')
    document = json.loads(path.read_text())
    document['frames'][2]['file_path'] = name.replace('.png', '.PNG')
    # Windows' editors write a mark in front.
    path.write_text(json.dumps(document), 'utf-8-sig')
    assert [frame.name for frame in read_transforms_capture(source).frames] == [
        'images/0.png', 'images/1.png', 'images/2.PNG', 'images/3.png', 'images/4.png']


def test_missing_images_name_a_file(tmp_path: Path) -> None:
    source = write_transforms_capture(tmp_path, demo_photos())
    shutil.rmtree(source / 'images')
    with pytest.raises(SceneError, match=f'none of the 5 listed .* {source}/images/0.png'):
        read_transforms_capture(source)


def test_angles_stand_in_for_focal_lengths_and_null_for_nothing(tmp_path: Path) -> None:
    angles = {'camera_angle_x': 2 * math.atan(32 / 58.5), 'camera_angle_y': 2 * math.atan(24 / 50)}
    source = write_transforms_capture(tmp_path, demo_photos(), **angles, fl_x=None, fl_y=None,
                                      cx=None)
    lens = read_transforms_capture(source).frames[0].lens
    assert lens is not None
    assert astuple(lens.intrinsics) == pytest.approx((64, 48, 58.5, 50, 32, 24))
    source = write_transforms_capture(tmp_path, demo_photos(), cx='middle')
    with pytest.raises(SceneError, match=r"frames\[0\]: camera: cx: expected a number, got 'mid"):
        read_transforms_capture(source)


def test_any_digits_may_be_in_a_name() -> None:
    assert sorted(['4²10.png', '4²9.png'], key=natural_key) == ['4²9.png', '4²10.png']


def test_a_subset_keeps_images_with_their_frames(tmp_path: Path) -> None:
    photos = demo_photos()
    capture = read_bag_capture(write_bag(tmp_path / 'bag', photos)).subset([3, 1])
    found = dict(capture.images([0, 1]))
    for place, original in enumerate((3, 1)):
        np.testing.assert_array_equal(found[place], photos.images[original])
        assert capture.frames[place].pose is not None
    assert capture.frames[0].stamp_ns == START_NS + 3 * STEP_NS
