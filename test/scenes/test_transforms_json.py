from collections.abc import Callable
import json
import logging
import math
from pathlib import Path
from typing import Any

from neo_ros.errors import SceneError
from neo_ros.geometry import Intrinsics, ViewExpansion
from neo_ros.scenes.transforms_json import read_input_crop, read_transforms, write_transforms
import numpy as np
import pytest
from scene_files import CAMERA, write_capture

NAME = 'transforms_train.json'


@pytest.fixture
def file(tmp_path: Path) -> Path:
    write_capture(tmp_path, 3)
    return tmp_path / NAME


def change(file: Path, **changes: Any) -> dict[str, Any]:
    """Replace keys of the file; None takes one away."""
    document = {**json.loads(file.read_text()), **changes}
    file.write_text(json.dumps({k: v for k, v in document.items() if v is not None}))
    return document


def test_written_captures_read_back(tmp_path: Path) -> None:
    written = write_capture(tmp_path, 5)
    found = read_transforms(tmp_path / NAME)
    assert found.intrinsics == written.intrinsics
    assert found.image_paths == written.image_paths and found.path_ids == written.path_ids
    np.testing.assert_allclose(found.T_world_cam, written.T_world_cam)
    assert sorted(p.name for p in tmp_path.iterdir()) == ['images', NAME]
    write_transforms(tmp_path / 'again.json', found)
    assert (tmp_path / 'again.json').read_bytes() == (tmp_path / NAME).read_bytes()


def test_files_hold_opengl_axes(file: Path) -> None:
    frame = json.loads(file.read_text())['frames'][0]  # looks along +x, at (1, 0, 1.5)
    expected = np.array([[0.0, 0, -1, 1], [-1, 0, 0, 0], [0, 1, 0, 1.5], [0, 0, 0, 1]])
    np.testing.assert_allclose(frame['transform_matrix'], expected, atol=1e-12)


def test_what_a_foreign_file_leaves_out_is_filled_in(file: Path) -> None:
    document = change(file, fl_y=None, cx=None, cy=None, camera_model='OPENCV', k1=0.0, p2=0)
    for frame in document['frames']:
        del frame['path_id']
        frame |= {'fl_x': 10.0, 'k1': 0.0, 'camera_model': 'OPENCV'}  # Said again, no other.
    change(file, fl_y=None, cx=None, cy=None, frames=document['frames'])
    found = read_transforms(file)
    assert found.intrinsics == Intrinsics(16, 12, 10, 10, 8, 6)
    assert found.path_ids == (0, 0, 0)


def test_missing_images_are_named_and_skipped(
        file: Path, caplog: pytest.LogCaptureFixture) -> None:
    (file.parent / 'images' / '1.png').unlink()
    with caplog.at_level(logging.WARNING):
        found = read_transforms(file)
    assert [path.name for path in found.image_paths] == ['0.png', '2.png']
    assert found.path_ids == (0, 1) and found.poses[1].yaw == pytest.approx(-2 * math.pi / 3)
    assert '1 listed images are missing and skipped: images/1.png' in caplog.text


@pytest.mark.parametrize('key', ['depth_file_path', 'mask_path'])
def test_what_is_listed_beside_an_image_has_to_be_there(file: Path, key: str) -> None:
    frames = json.loads(file.read_text())['frames']
    frames[1][key] = 'beside/1.png'
    change(file, frames=frames)
    with pytest.raises(SceneError, match=rf'frames\[1\]: {key}: there is no file beside/1.png'):
        read_transforms(file)


def test_a_capture_without_any_image_is_refused(file: Path) -> None:
    for path in (file.parent / 'images').iterdir():
        path.unlink()
    with pytest.raises(SceneError, match='none of the 3 listed images exists'):
        read_transforms(file)


def with_frame(key: str, value: Any) -> Callable[[Path], None]:
    def spoil(file: Path) -> None:
        frames = json.loads(file.read_text())['frames']
        frames[1][key] = value
        if value is None:
            del frames[1][key]
        change(file, frames=frames)
    return spoil


MIRRORED = np.diag([1.0, 1, -1, 1]).tolist()
NAN_POSE = [[math.nan, 0, 0, 0], [0, 1, 0, 0], [0, 0, 1, 0], [0, 0, 0, 1]]


@pytest.mark.parametrize('spoil, message', [
    (lambda file: file.unlink(), 'no such file'),
    (lambda file: file.write_text('{"frames": ['), 'expected a JSON file'),
    (lambda file: file.write_bytes(b'\xff\xfe\x00'), 'expected a JSON file'),
    (lambda file: file.write_text('[]'), 'expected a JSON object, got list'),
    (lambda file: change(file, w=None), "expected the key 'w'"),
    (lambda file: change(file, fl_x=None), "expected the key 'fl_x'"),
    (lambda file: change(file, fl_x=math.nan), 'intrinsics: fx: expected a finite number'),
    (lambda file: change(file, fl_y=0), 'intrinsics: fy: expected a focal length > 0'),
    (lambda file: change(file, h='tall'), 'intrinsics: .*tall'),
    (lambda file: change(file, k1=0.1, p1=-0.01), r"undistorted pinhole camera, got {'k1': 0.1"),
    (lambda file: change(file, camera_model='OPENCV_FISHEYE'),
     r"got {'camera_model': 'OPENCV_FISHEYE'}; make a scene of it with: neo import \S+ SCENE"),
    (lambda file: change(file, is_fisheye=True), "got {'is_fisheye': True}; make a scene"),
    (lambda file: change(file, fl_x=None, camera_angle_x=1.0), "'fl_x' .*make a scene of it"),
    (with_frame('fl_x', 9.0),
     r"frames\[1\]: expected the one camera .*{'fl_x': 9.0} .*neo import"),
    (with_frame('k1', 0.1), r"frames\[1\]: expected the one camera of the file, got {'k1': 0.1}"),
    (lambda file: change(file, frames=[]), 'frames: expected a list with at least one frame'),
    (lambda file: change(file, frames={'0': 1}), 'frames: expected a list'),
    (lambda file: change(file, frames=['x']), r'frames\[0\]: string indices'),
    (with_frame('transform_matrix', NAN_POSE), r'frames\[1\]: .*expected finite numbers'),
    (with_frame('transform_matrix', MIRRORED), r'frames\[1\]: .*one axis is mirrored'),
    (with_frame('transform_matrix', [[1, 0], [0, 1]]), r'frames\[1\]: .*expected a 4x4 matrix'),
    (with_frame('transform_matrix', 'x'), r'frames\[1\]: could not convert'),
    (with_frame('transform_matrix', None), r"frames\[1\]: expected the key 'transform_matrix'"),
    (with_frame('file_path', None), r"frames\[1\]: expected the key 'file_path'"),
    (with_frame('path_id', 'first'), r'frames\[1\]: invalid literal'),
], ids=['missing', 'cut off', 'binary', 'a list', 'no width', 'no focal length', 'NaN focal',
        'zero focal', 'text for a number', 'distorted', 'fisheye model', 'fisheye flag',
        'an angle', 'a second camera', 'a second lens', 'no frames', 'frames no list',
        'frame no object', 'NaN pose', 'mirrored pose', '2x2 pose', 'text pose', 'no pose',
        'no file', 'text path id'])
def test_bad_files_are_refused_with_the_reason(
        file: Path, spoil: Callable[[Path], Any], message: str) -> None:
    spoil(file)
    with pytest.raises(SceneError, match=message) as caught:
        read_transforms(file)
    assert NAME in str(caught.value)


def test_the_input_crop_is_the_source_of_wide_truth(tmp_path: Path) -> None:
    expansion = ViewExpansion(CAMERA.cropped(4, 2, 8, 6), 4, 4, 2, 4)
    write_capture(tmp_path, 1, expansion=expansion)
    assert read_input_crop(tmp_path / NAME) == expansion
    write_capture(tmp_path, 1)
    assert read_input_crop(tmp_path / NAME) is None


@pytest.mark.parametrize('crop', [
    {'x': 0, 'y': 0, 'w': 8}, {'x': 9, 'y': 0, 'w': 8, 'h': 6}, {'x': 'a', 'y': 0, 'w': 8, 'h': 6},
    [0, 0, 8, 6], {'x': 0, 'y': 0, 'w': 16, 'h': 12},
], ids=['no height', 'outside', 'text', 'a list', 'nothing left to make up'])
def test_bad_input_crops_are_refused(file: Path, crop: Any) -> None:
    change(file, input_crop=crop)
    with pytest.raises(SceneError, match='input_crop: expected x, y, w, h in pixels'):
        read_input_crop(file)


def test_unwritable_folders_are_named(file: Path) -> None:
    capture = read_transforms(file)
    (file.parent / 'transforms.json.partial').mkdir()
    with pytest.raises(SceneError, match='transforms.json: cannot write: Is a directory'):
        write_transforms(file.parent / 'transforms.json', capture)
