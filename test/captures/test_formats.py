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
    write_image, write_matrix, write_scannet, write_seven_scenes, write_trajectory,
    write_transforms_capture, write_turned_jpeg)
import cv2
from neo_ros.captures.bag import read_bag_capture
from neo_ros.captures.capture import Capture
from neo_ros.captures.colmap import read_colmap
from neo_ros.captures.formats import CaptureFormat, detect_format, FOLDER_READERS
from neo_ros.captures.levelling import level_world
from neo_ros.captures.nerfstudio import read_transforms_capture
from neo_ros.captures.photos import read_photos
from neo_ros.captures.scannet import read_scannet
from neo_ros.captures.scene_copying import import_transforms
from neo_ros.captures.scene_writing import write_capture, write_images
from neo_ros.captures.seven_scenes import read_seven_scenes
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


def test_blank_lines_do_not_shift_the_pairs_of_lines_of_colmap(tmp_path: Path) -> None:
    source = write_colmap_text(tmp_path / 's', demo_photos())
    path = source / 'sparse/0/images.txt'
    lines = path.read_text().splitlines()
    first = next(number for number, line in enumerate(lines) if not line.startswith('#'))
    path.write_text('\n'.join([*lines[:first], '', *lines[first:first + 2], '',
                               *lines[first + 2:]]) + '\n')
    capture = read_colmap(source)
    assert [frame.name for frame in capture.frames] == [f'images/{i}.png' for i in range(5)]


def test_the_largest_of_several_colmap_models_is_read(tmp_path: Path) -> None:
    source = write_colmap_text(tmp_path / 's', demo_photos())
    (source / 'sparse/7').mkdir()  # no model
    assert not read_colmap(source).notes
    shutil.copytree(source / 'sparse/0', source / 'sparse/1')
    small = source / 'sparse/0/images.txt'
    small.write_text('\n'.join(small.read_text().splitlines()[:5]))
    capture = read_colmap(source)
    assert len(capture) == 5
    assert capture.notes == (f'{source / "sparse"} holds 2 models: 1 is read, with 5 images; '
                             'others by --model: 0 (2)',)
    assert len(read_colmap(source, model=0)) == len(read_colmap(source / 'sparse/0')) == 2
    with pytest.raises(SceneError, match='--model: expected one of 0, 1 in .*, got 4'):
        read_colmap(source, model=4)


def test_images_of_a_colmap_model_may_be_elsewhere(tmp_path: Path) -> None:
    source = write_colmap_text(tmp_path / 's', demo_photos())
    (source / 'images').rename(tmp_path / 'elsewhere')
    with pytest.raises(SceneError, match='none of its 5 images .*--images DIR'):
        read_colmap(source)
    assert len(read_colmap(source, images=tmp_path / 'elsewhere')) == 5


def test_no_image_is_lost_where_images_txt_has_no_lines_of_points(tmp_path: Path) -> None:
    source = write_colmap_text(tmp_path / 's', demo_photos())
    path = source / 'sparse/0/images.txt'
    path.write_text('\n'.join(line for line in path.read_text().splitlines() if '.png' in line))
    assert [frame.name for frame in read_colmap(source).frames] == [
        f'images/{index}.png' for index in range(5)]


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
    with pytest.raises(SceneError, match=r"pip install 'neo_ros\[heic\]'"):
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


def test_images_of_colmap_stay_inside_the_scene(tmp_path: Path) -> None:
    source = write_colmap_text(tmp_path / 'a/b', demo_photos())
    shutil.copy(source / 'images/0.png', tmp_path / 'a/other.png')
    listing = source / 'sparse/0/images.txt'
    listing.write_text(listing.read_text().replace('0.png', '../../other.png', 1))
    write_capture(read_colmap(source), tmp_path / 'scene')
    images = sorted(path.relative_to(tmp_path / 'scene').as_posix()
                    for path in (tmp_path / 'scene').rglob('*.png'))
    assert images == [f'images/{index}.png' for index in range(1, 5)] + [
        'images/beside/beside/other.png']


def test_any_digits_may_be_in_a_name() -> None:
    assert sorted(['4²10.png', '4²9.png'], key=natural_key) == ['4²9.png', '4²10.png']


@pytest.mark.parametrize('write, reader, where, names, notes', [
    (write_scannet, read_scannet, 'pose/{}.txt', ['0.png', '3.png', '4.png'],
     ['1 frames whose pose was lost', '1 images have no file in pose/']),
    (write_seven_scenes, read_seven_scenes, 'seq-01/frame-{:06d}.pose.txt',
     [f'frame-00000{i}.color.png' for i in (0, 3, 4)], ['2 frames have no pose']),
], ids=['scannet', '7scenes'])
def test_lost_poses_are_counted_and_left_out(
        tmp_path: Path, write: Callable[..., Path], reader: Callable[[Path], Capture],
        where: str, names: list[str], notes: list[str]) -> None:
    source = write(tmp_path / 's', demo_photos())
    write_matrix(source / where.format(1), np.full((4, 4), -np.inf))
    (source / where.format(2)).unlink()
    capture = reader(source)
    assert [Path(frame.name).name for frame in capture.frames] == names
    assert all(found.startswith(note) for found, note in zip(capture.notes, notes, strict=True))


def test_a_capture_that_lost_all_poses_is_refused(tmp_path: Path) -> None:
    source = write_scannet(tmp_path / 's', demo_photos())
    for index in range(5):
        write_matrix(source / f'pose/{index}.txt', np.full((4, 4), -np.inf))
    with pytest.raises(SceneError, match='none of the 5 images has a pose: 5 lost'):
        read_scannet(source)


def test_listed_images_that_are_missing_are_named(tmp_path: Path) -> None:
    source = write_transforms_capture(tmp_path / 'a', demo_photos())
    (source / 'images/3.png').unlink()
    capture = read_transforms_capture(source)
    assert len(capture) == 4 and 'images/3.png' in capture.notes[0]
    source = write_colmap_text(tmp_path / 'b', demo_photos())
    (source / 'images/2.png').unlink()
    capture = read_colmap(source)
    assert len(capture) == 4 and '2.png' in capture.notes[0]


@pytest.mark.parametrize('change, message', [
    (lambda T: T * [[1], [1], [1.1], [1]], r'frames\[1\].*rotation'),
    (lambda T: T @ np.diag([-1, 1, 1, 1]), r'frames\[1\].*mirrored'),
    (lambda T: T[:2], r'frames\[1\].*4x4'),
], ids=['scaled', 'left-handed', 'cut'])
def test_poses_that_are_none_are_refused_by_frame(
        tmp_path: Path, change: Callable[[np.ndarray], np.ndarray], message: str) -> None:
    source = write_transforms_capture(tmp_path / 's', demo_photos())
    document = json.loads((source / 'transforms.json').read_text())
    matrix = change(np.array(document['frames'][1]['transform_matrix']))
    document['frames'][1]['transform_matrix'] = matrix.tolist()
    (source / 'transforms.json').write_text(json.dumps(document))
    with pytest.raises(SceneError, match=message):
        read_transforms_capture(source)


def test_poses_that_are_not_finite_are_named_and_left_out(tmp_path: Path) -> None:
    source = write_transforms_capture(tmp_path / 's', demo_photos())
    document = json.loads((source / 'transforms.json').read_text())
    document['frames'][1]['transform_matrix'][0][3] = float('nan')
    (source / 'transforms.json').write_text(json.dumps(document))
    capture = read_transforms_capture(source)
    assert len(capture) == 4 and '1.png' in capture.notes[0]


@pytest.mark.parametrize('text, message', [
    ('', 'expected a JSON object'),
    ('{"frames": []}', 'at least one frame'),
    ('{"frames": [{"file_path": 3}]}', r'frames\[0\]'),
    ('{"frames": [{"file_path": "none.png"}]}', 'none of the 1 listed images exists'),
], ids=['empty', 'no frames', 'no path', 'no image'])
def test_damaged_transforms_are_refused(tmp_path: Path, text: str, message: str) -> None:
    (tmp_path / 'transforms.json').write_text(text)
    with pytest.raises(SceneError, match=message):
        read_transforms_capture(tmp_path)


@pytest.mark.parametrize('camera, message', [
    ({'camera_model': 'EQUIRECTANGULAR'}, 'camera_model: expected one of'),
    ({'k4': 0.1}, 'k4: expected 0'),
    ({'fl_x': 'wide'}, r'frames\[0\]: camera'),
    ({'k1': float('nan')}, r'frames\[0\]: camera: distortion: expected finite'),
    ({'w': float('inf')}, r'frames\[0\]: camera: cannot convert'),
    ({'fl_x': None, 'camera_angle_x': 0}, r'frames\[0\]: camera: .*division'),
], ids=['model', 'k4', 'word', 'nan', 'infinite', 'no angle'])
def test_cameras_that_cannot_be_used_are_refused(
        tmp_path: Path, camera: dict[str, object], message: str) -> None:
    source = write_transforms_capture(tmp_path / 's', demo_photos(), **camera)
    with pytest.raises(SceneError, match=message):
        read_transforms_capture(source)


def test_a_colmap_camera_that_is_none_is_refused_by_its_line(tmp_path: Path) -> None:
    source = write_colmap_text(tmp_path / 's', demo_photos(), 'SIMPLE_RADIAL',
                               (60, 32, 24, math.nan))
    with pytest.raises(SceneError, match='cameras.txt:2: distortion: expected finite'):
        read_colmap(source)


def test_poses_of_colmap_that_are_not_finite_are_left_out(tmp_path: Path) -> None:
    source = write_colmap_text(tmp_path / 's', demo_photos())
    path = source / 'sparse/0/images.txt'
    lines = path.read_text().split('\n')
    row = next(i for i, line in enumerate(lines) if line.startswith('2 '))
    lines[row] = ' '.join(['2', 'nan', *lines[row].split()[2:]])
    path.write_text('\n'.join(lines))
    capture = read_colmap(source)
    assert [frame.name for frame in capture.frames] == [f'images/{i}.png' for i in (0, 2, 3, 4)]
    assert capture.notes == ('1 images have no finite pose and are left out: 1.png',)


@pytest.mark.parametrize('folder, source', [('sparse/0', '.'), ('sparse', '0')])
def test_a_colmap_model_may_be_named_from_within(
        tmp_path: Path, monkeypatch: pytest.MonkeyPatch, folder: str, source: str) -> None:
    monkeypatch.chdir(write_colmap_text(tmp_path / 's', demo_photos()) / folder)
    assert len(read_colmap(Path(source))) == 5


def test_colmap_models_that_cannot_be_made_straight_are_refused(tmp_path: Path) -> None:
    source = write_colmap_text(tmp_path / 's', demo_photos(), 'FOV', (58.5, 58.5, 32, 24, 0.9))
    with pytest.raises(SceneError, match='FOV is not supported.*image_undistorter'):
        read_colmap(source)


@pytest.mark.parametrize('model, params, distortion', [
    ('SIMPLE_PINHOLE', (60, 32, 24), ()),
    ('SIMPLE_RADIAL', (60, 32, 24, 0.1), (0.1, 0, 0, 0)),
    ('RADIAL', (60, 32, 24, 0.1, 0.2), (0.1, 0.2, 0, 0)),
    ('OPENCV', (60, 60, 32, 24, 0.1, 0.2, 0.3, 0.4), (0.1, 0.2, 0.3, 0.4)),
    ('OPENCV_FISHEYE', (60, 60, 32, 24, 0.1, 0.2, 0.3, 0.4), (0.1, 0.2, 0.3, 0.4)),
], ids=lambda value: value if isinstance(value, str) else '')
def test_colmap_parameters_come_in_the_order_of_opencv(
        tmp_path: Path, model: str, params: tuple[float, ...],
        distortion: tuple[float, ...]) -> None:
    lens = read_colmap(
        write_colmap_text(tmp_path / 's', demo_photos(), model, params)).frames[0].lens
    assert lens is not None and lens.distortion == distortion
    assert lens.fisheye == ('FISHEYE' in model)
    assert (lens.intrinsics.fx, lens.intrinsics.fy) == (60, 60)
    assert (lens.intrinsics.cx, lens.intrinsics.cy) == (32, 24)


@pytest.mark.parametrize('length', [4, 20, 100], ids=lambda n: f'{n} bytes')
def test_cut_off_colmap_files_are_refused(tmp_path: Path, length: int) -> None:
    source = write_colmap_binary(tmp_path / 's', demo_photos())
    images = source / 'sparse/images.bin'
    images.write_bytes(images.read_bytes()[:length])
    with pytest.raises(SceneError, match='images.bin: damaged or cut off'):
        read_colmap(source)


def test_pycolmap_writes_what_is_read(tmp_path: Path) -> None:
    pycolmap = pytest.importorskip('pycolmap', reason='needs pycolmap (the train extra)')
    source = write_colmap_text(tmp_path / 's', demo_photos())
    (source / 'sparse/0/points3D.txt').write_text('')
    images = source / 'sparse/0/images.txt'
    images.write_text(images.read_text().replace('1.5 2.5 -1 3.5 4.5 12', '1.5 2.5 -1'))
    reconstruction = pycolmap.Reconstruction(source / 'sparse/0')
    (source / 'colmap/sparse/0').mkdir(parents=True)
    reconstruction.write_binary(source / 'colmap/sparse/0')
    ours = read_colmap(source)
    (source / 'sparse/0').rename(source / 'text')
    binary = read_colmap(source)
    assert len(binary) == 5
    for a, b in zip(ours.frames, binary.frames):
        assert a.pose is not None and b.pose is not None and a.lens == b.lens
        np.testing.assert_allclose(a.pose.T_world_cam, b.pose.T_world_cam, atol=1e-12)


def test_scannet_intrinsics_that_are_none_are_refused_by_file(tmp_path: Path) -> None:
    source = write_scannet(tmp_path / 's', demo_photos())
    matrix = np.diag([math.nan, 58.5, 1, 1])
    matrix[:2, 2] = 32, 24
    write_matrix(source / 'intrinsic/intrinsic_color.txt', matrix)
    with pytest.raises(SceneError, match='intrinsic_color.txt: fx: expected a finite'):
        read_scannet(source)


def test_scannet_intrinsics_of_another_size_are_refused(tmp_path: Path) -> None:
    source = write_scannet(tmp_path / 's', demo_photos())
    write_matrix(source / 'intrinsic/intrinsic_color.txt', np.diag([1170.0, 1170, 1, 1])
                 + np.array([[0, 0, 648, 0], [0, 0, 484, 0], [0] * 4, [0] * 4]))
    with pytest.raises(SceneError, match='expected the camera of the 64x48 images'):
        read_scannet(source)


def test_a_trajectory_of_another_length_is_refused(tmp_path: Path) -> None:
    source = write_trajectory(tmp_path / 's', demo_photos())
    (source / 'rgb/frame4.png').unlink()
    with pytest.raises(SceneError, match='got 5 lines and 4 images'):
        read_trajectory(source)


@pytest.mark.parametrize('files, message', [
    ([], 'the folder is empty'),
    (['notes.txt'], 'no capture found; looked for'),
], ids=['empty', 'nothing known'])
def test_folders_without_a_capture_are_refused(tmp_path: Path, files: list[str],
                                               message: str) -> None:
    for name in files:
        (tmp_path / name).write_text('')
    with pytest.raises(SceneError, match=message):
        detect_format(tmp_path)


def test_a_capture_in_a_folder_below_is_named(tmp_path: Path) -> None:
    write_colmap_text(tmp_path / 'outputs/room/sfm', demo_photos(2))
    write_transforms_capture(tmp_path / 'walk', demo_photos(2))
    with pytest.raises(SceneError, match=r'expected one of these as SOURCE: .*/walk '
                                         r'\(transforms\), .*/outputs/room/sfm \(colmap\)$'):
        detect_format(tmp_path)


def test_a_bag_of_ros_1_is_told_how_to_convert_it(tmp_path: Path) -> None:
    (tmp_path / 'old.bag').write_bytes(b'#ROSBAG V2.0\n')
    with pytest.raises(SceneError, match='ROS 1; convert it: rosbags-convert --src .*--dst old'):
        detect_format(tmp_path / 'old.bag')


def test_photos_of_several_sizes_are_refused_by_name(tmp_path: Path) -> None:
    image = demo_photos().images[0]
    write_image(tmp_path / 'a.png', image)
    write_image(tmp_path / 'b.png', image[:40])
    with pytest.raises(SceneError, match=r'64x48: a.png; 64x40: b.png.*never resized'):
        read_photos(tmp_path)


def test_a_folder_without_a_readable_photo_is_refused(tmp_path: Path) -> None:
    for name in ('a.png', 'b.jpg'):
        (tmp_path / name).write_bytes(b'no image')
    with pytest.raises(SceneError, match='none of the 2 images can be read'):
        read_photos(tmp_path)


def test_photos_that_cannot_be_read_are_named_and_left_out(tmp_path: Path) -> None:
    write_image(tmp_path / 'a.png', demo_photos().images[0])
    (tmp_path / 'b.png').write_bytes(b'no image')
    capture = read_photos(tmp_path)
    assert len(capture) == 1 and 'b.png' in capture.notes[0]


def test_a_subset_keeps_images_with_their_frames(tmp_path: Path) -> None:
    photos = demo_photos()
    capture = read_bag_capture(write_bag(tmp_path / 'bag', photos)).subset([3, 1])
    found = dict(capture.images([0, 1]))
    for place, original in enumerate((3, 1)):
        np.testing.assert_array_equal(found[place], photos.images[original])
        assert capture.frames[place].pose is not None
    assert capture.frames[0].stamp_ns == START_NS + 3 * STEP_NS
