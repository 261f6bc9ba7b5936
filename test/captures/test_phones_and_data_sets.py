"""TUM RGB-D, EuRoC, Record3D and Polycam give the photos and poses that were written."""
from collections.abc import Callable
from dataclasses import astuple, replace
import json
import math
from pathlib import Path

from capture_files import CAMERA, demo_photos, Photos, write_image, write_matrix
from depth_files import write_polycam_depth
from neo_ros.captures.euroc import read_euroc
from neo_ros.captures.formats import CaptureFormat, detect_format, FOLDER_READERS
from neo_ros.captures.importing import import_capture, ImportOptions
from neo_ros.captures.polycam import read_polycam
from neo_ros.captures.record3d import read_record3d
from neo_ros.captures.scene_writing import write_capture
from neo_ros.captures.tum import read_tum
from neo_ros.errors import SceneError
from neo_ros.flat.demo_flat import build_demo_flat
from neo_ros.geometry import CameraPose, Intrinsics
from neo_ros.geometry.camera_pose import rotation_from_vector
from neo_ros.machine.progress import no_stage_progress
from neo_ros.pictures.depth import read_depth
from neo_ros.scenes.scene import read_scene
import numpy as np
from phone_files import (
    write_camera_info, write_euroc, write_polycam, write_r3d, write_record3d, write_tum, Y_UP)
import pytest

FORMATS: dict[str, tuple[Callable[..., Path], CaptureFormat]] = {
    'tum': (write_tum, CaptureFormat.TUM),
    'euroc': (write_euroc, CaptureFormat.EUROC),
    'record3d': (write_record3d, CaptureFormat.RECORD3D),
    'r3d': (write_r3d, CaptureFormat.RECORD3D),
    'polycam': (write_polycam, CaptureFormat.POLYCAM),
}


@pytest.mark.parametrize('write, format_', FORMATS.values(), ids=FORMATS.keys())
def test_every_format_gives_the_same_scene(tmp_path: Path, write: Callable[..., Path],
                                           format_: CaptureFormat) -> None:
    photos = demo_photos()
    source = write(tmp_path / 'source', photos)
    assert detect_format(source) == format_
    options = ({'camera_info': write_camera_info(tmp_path / 'camera.yaml')}
               if format_ == CaptureFormat.TUM else {})
    write_capture(FOLDER_READERS[format_](source, **options), tmp_path / 'scene')
    found = read_scene(tmp_path / 'scene').train
    assert astuple(found.intrinsics) == pytest.approx(astuple(CAMERA), abs=1e-9)
    np.testing.assert_allclose(
        found.T_world_cam, [pose.T_world_cam for pose in photos.poses], atol=1e-6)
    np.testing.assert_array_equal(found.read_images(), photos.images)
    assert found.z_up == (format_ != CaptureFormat.TUM)


def test_tum_poses_between_images_are_interpolated(tmp_path: Path) -> None:
    photos = demo_photos()
    source = write_tum(tmp_path / 's', photos, late_ns=50_000_000)
    capture = read_tum(source, write_camera_info(tmp_path / 'camera.yaml'))
    # The first image is 50 ms before the first pose.
    assert len(capture) == 4
    assert any('1 of 5 images have no pose within 20 ms' in note for note in capture.notes)
    for index, frame in enumerate(capture.frames):
        assert frame.pose is not None
        expected = photos.poses[index].interpolated(photos.poses[index + 1], 0.5)
        np.testing.assert_allclose(frame.pose.T_world_cam, expected.T_world_cam, atol=1e-9)


def test_sparse_tum_poses_are_taken_from_the_nearest_within_20_ms(tmp_path: Path) -> None:
    source = write_tum(tmp_path / 's', demo_photos(), late_ns=15_000_000)
    lines = (source / 'groundtruth.txt').read_text().splitlines()
    # 0.1 s apart as written: leave two that are too far apart to say what is between.
    far = lines[1].split()
    far[0] = str(float(far[0]) + 5)
    (source / 'groundtruth.txt').write_text('\n'.join(
        [lines[2], 'nan nan nan nan nan nan nan nan'.replace('nan', '1.0', 1), ' '.join(far)]))
    capture = read_tum(source, write_camera_info(tmp_path / 'camera.yaml'))
    frame, = capture.frames
    assert frame.pose is not None
    np.testing.assert_allclose(frame.pose.T_world_cam, demo_photos().poses[1].T_world_cam,
                               atol=1e-9)
    assert '1 poses in groundtruth.txt are not finite' in capture.notes[0]
    assert '4 of 5 images have no pose' in capture.notes[1]


def test_freiburg_cameras_are_known_by_the_folder(tmp_path: Path) -> None:
    source = write_tum(tmp_path / 'rgbd_dataset_freiburg2_xyz', demo_photos())
    with pytest.raises(SceneError, match='640x480 images of Freiburg 2, got 64x48.*--camera-info'):
        read_tum(source)
    for photo in (source / 'rgb').iterdir():
        write_image(photo, np.zeros((480, 640, 3), np.uint8))
    lens = read_tum(source).frames[0].lens
    assert lens is not None and lens.distortion == (0.2312, -0.7849, -0.0033, -0.0001, 0.9172)
    assert astuple(lens.intrinsics) == (640, 480, 520.9, 521.0, 325.6, 250.2)


@pytest.mark.parametrize('change, message', [
    (lambda s: s.rename(s.with_name('desk')), r'TUM RGB-D: .*--camera-info FILE'),
    (lambda s: (s / 'groundtruth.txt').write_text('1 2 3'), 'truth.txt:1: expected STAMP x'),
    (lambda s: (s / 'groundtruth.txt').write_text('1 0 0 0 0 0 0 1'), '5 of 5 images have no'),
    (lambda s: (s / 'rgb.txt').write_text('yesterday rgb/a.png'), "expected a stamp, got 'yest"),
    (lambda s: (s / 'rgb.txt').write_text('1 rgb/a.png'), 'none of its 1 images exists'),
], ids=['unknown camera', 'short line', 'other clock', 'no stamp', 'no image'])
def test_what_is_wrong_with_a_tum_folder_is_named(
        tmp_path: Path, change: Callable[[Path], object], message: str) -> None:
    source = write_tum(tmp_path / 'freiburg3', demo_photos())
    for photo in (source / 'rgb').iterdir():
        write_image(photo, np.zeros((480, 640, 3), np.uint8))
    changed = change(source)
    with pytest.raises(SceneError, match=message):
        read_tum(changed if isinstance(changed, Path) else source)


def test_euroc_cameras_hang_on_a_body(tmp_path: Path) -> None:
    T_body_cam = CameraPose.from_planar(0.1, -0.2, 0.3, 0.7).T_world_cam
    photos = demo_photos()
    source = write_euroc(tmp_path / 's', photos, T_body_cam)
    (source / 'mav0/cam1').mkdir()
    first = next((source / 'mav0/cam0/data').iterdir())
    first.unlink()
    capture = read_euroc(source)
    assert f'1 of 5 listed images are missing and left out: {first.name}' in capture.notes
    assert 'cam1: not read, only cam0 is' in capture.notes
    expected = {f'images/{1_700_000_000_000_000_000 + i * 100_000_000}.png': pose
                for i, pose in enumerate(photos.poses)}
    for frame in capture.frames:
        assert frame.pose is not None
        np.testing.assert_allclose(frame.pose.T_world_cam, expected[frame.name].T_world_cam,
                                   atol=1e-9)


def test_what_is_wrong_with_a_euroc_folder_is_named(tmp_path: Path) -> None:
    source = write_euroc(tmp_path / 's', demo_photos())
    sensor = source / 'mav0/cam0/sensor.yaml'
    text = sensor.read_text()
    sensor.write_text(text.replace('radial-tangential', 'omni'))
    with pytest.raises(SceneError, match='got pinhole and omni; .*--camera-info FILE'):
        read_euroc(source)
    assert len(read_euroc(source, write_camera_info(tmp_path / 'camera.yaml'))) == 5
    sensor.write_text(text.replace('T_BS', 'T_SB'))
    with pytest.raises(SceneError, match='sensor.yaml: T_BS'):
        read_euroc(source)
    sensor.write_text(text)
    truth = source / 'mav0/state_groundtruth_estimate0'
    truth.rename(truth.with_name('leica0'))
    with pytest.raises(SceneError, match='expected poses in one of .*--format photos'):
        read_euroc(source)


def test_record3d_has_cameras_and_poses_frame_by_frame(tmp_path: Path) -> None:
    source = write_record3d(tmp_path / 's', demo_photos())
    metadata = json.loads((source / 'metadata.json').read_text())
    metadata['perFrameIntrinsicCoeffs'] = [[50 + i, 50 + i, 32, 24] for i in range(5)]
    metadata['poses'][1][0] = float('nan')
    (source / 'metadata.json').write_text(json.dumps(metadata))
    (source / 'rgb/2.png').unlink()
    write_image(source / 'rgb/7.png', demo_photos().images[0])
    capture = read_record3d(source)
    assert [frame.lens.intrinsics.fx for frame in capture.frames if frame.lens] == [50, 53, 54]
    assert '1 images have no pose and are left out: 7.png' in capture.notes
    assert '1 images have no finite pose and are left out: 1.png' in capture.notes
    assert '1 poses have no image and are left out' in capture.notes
    for key, value in (('K', [1, 2]), ('poses', [[1, 2]]), ('w', 'wide')):
        (source / 'metadata.json').write_text(json.dumps({**metadata, key: value}))
        with pytest.raises(SceneError, match=f'metadata.json: .*{"K" if key == "w" else key}'):
            read_record3d(source)


def test_a_metadata_file_of_something_else_is_no_record3d(tmp_path: Path) -> None:
    write_image(tmp_path / 'rgb/0.png', demo_photos().images[0])
    (tmp_path / 'metadata.json').write_text('{"camera": "X100"}')
    assert detect_format(tmp_path) == CaptureFormat.PHOTOS
    (tmp_path / 'walk.r3d').write_bytes(b'no zip')
    with pytest.raises(SceneError, match='expected a zip with the member metadata'):
        read_record3d(tmp_path / 'walk.r3d')


def test_hidden_files_are_no_polycam_frames(tmp_path: Path) -> None:
    source = write_polycam(tmp_path / 's', demo_photos())
    for name in ('images/._0.jpg', 'cameras/._0.json'):
        (source / 'keyframes' / name).write_bytes(b'\0\5\x16\7' + bytes(4092))
    capture = read_polycam(source)
    assert len(capture) == len(demo_photos().poses) and not capture.notes


def test_polycam_images_and_cameras_without_the_other_are_counted(tmp_path: Path) -> None:
    source = write_polycam(tmp_path / 's', demo_photos(), 'corrected_')
    (source / 'keyframes/corrected_cameras/100.json').unlink()
    (source / 'keyframes/corrected_images/101.png').unlink()
    capture = read_polycam(source)
    assert len(capture) == 3
    assert '1 images have no file in corrected_cameras/ and are left out: 100.png' in capture.notes
    assert '1 cameras have no image in corrected_images/ and are left out: 101.json' in (
        capture.notes)
    (source / 'keyframes/corrected_cameras/102.json').write_text('{"fx": 3}')
    with pytest.raises(SceneError, match="102.json: expected the key 't_00'"):
        read_polycam(source)


@pytest.mark.parametrize('kind', ['corrected_', ''])
def test_the_size_of_a_polycam_camera_may_stand_elsewhere(tmp_path: Path, kind: str) -> None:
    source = write_polycam(tmp_path / 's', demo_photos(), kind)
    keyframes = source / 'keyframes'
    for file in [*(keyframes / f'{kind}cameras').iterdir()]:
        camera = json.loads(file.read_text())
        del camera['width'], camera['height']
        file.write_text(json.dumps(camera))
    lenses = {frame.lens and frame.lens.intrinsics for frame in read_polycam(source).frames}
    assert lenses == {CAMERA}  # The size is that of the photos.
    (keyframes / f'{kind}images/100.png').write_bytes(b'no image')
    assert '1 images cannot be read and are left out: 100.png' in read_polycam(source).notes
    if kind:
        (keyframes / 'cameras').mkdir()
        (keyframes / 'cameras/100.json').write_text('{"width": 640, "height": 480}')
        lens = read_polycam(source).frames[0].lens
        assert lens is not None and astuple(lens.intrinsics)[:2] == (640, 480)


def test_black_rims_of_polycams_corrected_images_are_left_out(tmp_path: Path) -> None:
    photos = demo_photos()
    source = write_polycam_depth(tmp_path / 's', photos, 'corrected_')
    folder = source / 'keyframes/corrected_images'
    for name, image in zip(sorted(path.name for path in folder.iterdir()), photos.images):
        black = np.zeros_like(image)
        black[12:-12, 12:-12] = image[12:-12, 12:-12]
        write_image(folder / name, black)
    notes = write_capture(read_polycam(source), tmp_path / 'scene')
    assert '15 pixels along the border of corrected_images/ are left out: they may be black' in (
        notes)
    found = read_scene(tmp_path / 'scene').train
    camera = Intrinsics(64, 48, 58.5 * 64 / 34, 58.5 * 48 / 18, 32, 24)
    assert astuple(found.intrinsics) == pytest.approx(astuple(camera))
    flat = build_demo_flat()
    assert len(found.depth_paths) == 5
    for image, path, pose in zip(found.read_images(), found.depth_paths, photos.poses):
        truth, depth = flat.render(camera, pose)
        assert np.abs(image.astype(int) - truth).mean() < 12
        assert path is not None
        measured = read_depth(path, 64, 48) / 1000
        known = measured > 0
        assert known.mean() > 0.8
        assert np.median(np.abs(measured - depth)[known]) < 0.05


def held_by_hand(turns: float, quarter_turns: int, down: float = 0.1, count: int = 24) -> Photos:
    """Look around by so many turns, a little up and down, with the phone turned in the hand."""
    poses = []
    for index in range(count):
        T = CameraPose.from_planar(1, 1, 1.5, index / count * turns * 2 * math.pi).T_world_cam
        T = T.copy()
        for turn in ([-down - 0.2 * math.sin(index), 0, 0],
                     [0, 0, quarter_turns * math.pi / 2 + 0.05 * math.cos(3 * index)]):
            T[:3, :3] = T[:3, :3] @ rotation_from_vector(np.array(turn))
        poses.append(CameraPose(T))
    return Photos(np.zeros((count, CAMERA.height, CAMERA.width, 3), np.uint8), tuple(poses))


@pytest.mark.parametrize('level', [False, True], ids=['', 'level'])
@pytest.mark.parametrize('quarter_turns', range(4))
@pytest.mark.parametrize('turns, down', [(2, 0.1), (2, 0.8), (0.15, 0.1)], ids=[
    'two turns', 'looking down', 'one wall'])
def test_up_of_a_phone_is_up_however_it_was_held(
        tmp_path: Path, turns: float, down: float, quarter_turns: int, level: bool) -> None:
    photos = held_by_hand(turns, quarter_turns, down)
    notes = import_capture(
        write_polycam(tmp_path / 's', photos), tmp_path / 'scene', CaptureFormat.POLYCAM,
        ImportOptions(level=level), no_stage_progress)
    found = read_scene(tmp_path / 'scene').train
    assert found.z_up
    expected = np.array([pose.T_world_cam for pose in photos.poses])
    if not level:
        np.testing.assert_allclose(found.T_world_cam, expected, atol=1e-6)
    # To level it turns the world a little, but never over.
    assert (found.T_world_cam[:, 2, :3] * expected[:, 2, :3]).sum(-1).min() > 0.8
    assert not any('--level' in note for note in notes)
    words = ('', 'lie on their side', 'are upside down', 'lie on their side')[quarter_turns]
    assert any(f'the photos {words}, as the phone was held; y is taken for up' in note
               for note in notes) == (quarter_turns > 0)


@pytest.mark.parametrize('turns', [2, 0.5])
@pytest.mark.parametrize('first', range(4))
def test_a_world_of_a_phone_that_someone_turned_is_left_as_it_is(
        tmp_path: Path, turns: float, first: int) -> None:
    photos = held_by_hand(turns, 0)
    c, s = math.cos(first * math.pi / 2), math.sin(first * math.pi / 2)
    z_up = np.array([[c, -s, 0, 0], [s, c, 0, 0], [0, 0, 1, 0], [0, 0, 0, 1]])
    capture = read_polycam(write_polycam(tmp_path / 's', replace(photos, poses=tuple(
        CameraPose(np.linalg.inv(Y_UP) @ z_up @ pose.T_world_cam) for pose in photos.poses))))
    assert not capture.z_up
    np.testing.assert_allclose(
        [frame.pose.T_world_cam for frame in capture.frames if frame.pose is not None],
        [z_up @ pose.T_world_cam for pose in photos.poses], atol=1e-6)


NEAR: dict[str, tuple[str, str, str]] = {
    'Metashape': ('cameras.xml', '<?xml version="1.0"?>\n<document version="2.0.0">\n<chunk>',
                  'Metashape cameras .cameras.xml.: export it to COLMAP, or .* metashape'),
    'RealityCapture': ('scan.csv', '#name,x,y,alt,heading,pitch,roll\n', 'realitycapture'),
    'XMP': ('0.xmp', '<x:xmpmeta><rdf:Description xcr:Version="3">', 'RealityCapture cameras'),
    'Polycam mesh': ('mesh_info.json', '{}', 'Polycam .mesh_info.json.: expected keyframes/'),
    'TUM list': ('rgb.txt', '1 a.png', 'TUM RGB-D'),
    'JSON': ('cameras.json', '[{"id": 0, "rotation": [], "position": []}]', 'poses .cameras.json'),
    'poses': ('poses.txt', '1 0 0 0', 'poses .poses.txt'),
    'LLFF': ('poses_bounds.npy', '', 'LLFF'),
    'Stray Scanner': ('odometry.csv', 'timestamp, frame', 'Stray Scanner'),
}


@pytest.mark.parametrize('file, content, message', NEAR.values(), ids=NEAR.keys())
def test_files_that_look_like_poses_are_named_before_others_are_computed(
        tmp_path: Path, file: str, content: str, message: str) -> None:
    for index, image in enumerate(demo_photos().images):
        write_image(tmp_path / f'{index}.png', image)
    assert detect_format(tmp_path) == CaptureFormat.PHOTOS
    (tmp_path / file).write_text(content)
    with pytest.raises(SceneError, match=f'{message}.*--format photos'):
        detect_format(tmp_path)


def test_xml_csv_and_json_of_something_else_are_no_poses(tmp_path: Path) -> None:
    write_image(tmp_path / '0.png', demo_photos().images[0])
    write_matrix(tmp_path / 'notes.txt', np.eye(3))
    (tmp_path / 'pom.xml').write_text('<project/>')
    (tmp_path / 'list.csv').write_text('file,price')
    (tmp_path / 'package.json').write_text('{"name": "x"}')
    assert detect_format(tmp_path) == CaptureFormat.PHOTOS
