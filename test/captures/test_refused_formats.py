"""Captures that cannot be used, as a whole or in part: refused, or counted, by name."""
from collections.abc import Callable
import json
import math
from pathlib import Path

from capture_files import (
    demo_photos, write_colmap_text, write_image, write_matrix, write_scannet, write_seven_scenes,
    write_trajectory, write_transforms_capture)
from neo_ros.captures.capture import Capture
from neo_ros.captures.colmap import read_colmap
from neo_ros.captures.formats import CaptureFormat, detect_format
from neo_ros.captures.nerfstudio import read_transforms_capture
from neo_ros.captures.photos import read_photos
from neo_ros.captures.scannet import read_scannet
from neo_ros.captures.seven_scenes import read_seven_scenes
from neo_ros.captures.trajectory import read_trajectory
from neo_ros.errors import SceneError
import numpy as np
import pytest


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


@pytest.mark.parametrize('files, named', [
    (['DCIM/100CANON/1.jpg', 'DCIM/100CANON/2.JPG', 'DCIM/.thumbnails/1.jpg'],
     ['DCIM/100CANON (photos)']),
    (['walk.mp4', '._walk.mp4', 'notes.txt'], ['walk.mp4 (video)']),
    (['tuesday.r3d'], ['tuesday.r3d (record3d)']),
    (['card/a/walk.MOV', 'card/b/1.png'], ['card/a/walk.MOV (video)', 'card/b (photos)']),
], ids=['photos', 'video', 'record3d', 'below'])
def test_photos_and_videos_that_lie_elsewhere_are_named(
        tmp_path: Path, files: list[str], named: list[str]) -> None:
    for name in files:
        (tmp_path / name).parent.mkdir(parents=True, exist_ok=True)
        (tmp_path / name).write_bytes(b'')
    with pytest.raises(SceneError) as refused:
        detect_format(tmp_path)
    assert str(refused.value).endswith('expected one of these as SOURCE: ' + ', '.join(
        f'{tmp_path}/{name}' for name in named))


def test_hidden_files_make_no_bag_of_a_folder(tmp_path: Path) -> None:
    write_image(tmp_path / '1.png', demo_photos().images[0])
    for name in ('._drive.mcap', '._1.png'):
        (tmp_path / name).write_bytes(bytes(4096))
    assert detect_format(tmp_path) == CaptureFormat.PHOTOS
    capture = read_photos(tmp_path)
    assert [frame.name for frame in capture.frames] == ['images/1.png'] and not capture.notes


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
