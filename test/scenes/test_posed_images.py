from pathlib import Path

from capture_files import write_turned_jpeg
import cv2
from neo_ros.errors import SceneError
from neo_ros.geometry import CameraPose, Intrinsics
from neo_ros.scenes.posed_images import PosedImages, read_rgb_image
import numpy as np
import pytest
from scene_files import CAMERA, picture, write_capture, write_picture


def test_images_come_as_rgb_in_the_order_of_their_poses(tmp_path: Path) -> None:
    capture = write_capture(tmp_path, 3)
    np.testing.assert_array_equal(capture.read_image(1), picture(CAMERA, 1))
    done: list[int] = []
    images = capture.read_images(progress=done.append)
    assert images.shape == (3, 12, 16, 3) and images.dtype == np.uint8 and done == [1, 2, 3]
    np.testing.assert_array_equal(images[2], picture(CAMERA, 2))
    np.testing.assert_array_equal(capture.T_world_cam[2], capture.poses[2].T_world_cam)


def test_a_subset_keeps_its_order(tmp_path: Path) -> None:
    capture = write_capture(tmp_path, 4)
    subset = capture.subset([3, 1])
    assert len(subset) == 2 and subset.path_ids == (1, 0)
    np.testing.assert_array_equal(subset.read_image(0), picture(CAMERA, 3))
    assert subset.poses == (capture.poses[3], capture.poses[1])


def test_half_the_size_is_the_mean_of_blocks(tmp_path: Path) -> None:
    capture = write_capture(tmp_path, 1)
    half = capture.read_image(0, 0.5)
    blocks = picture(CAMERA, 0).reshape(6, 2, 8, 2, 3).mean(axis=(1, 3))
    assert half.shape == (6, 8, 3) and np.abs(half - blocks).max() <= 0.5
    assert capture.read_image(0, 2.0).shape == (24, 32, 3)


def test_grey_and_deep_images_become_rgb_of_eight_bits(tmp_path: Path) -> None:
    grey = np.arange(192, dtype=np.uint16).reshape(12, 16) * 257
    assert cv2.imwrite(str(tmp_path / 'grey.png'), grey)
    image = read_rgb_image(tmp_path / 'grey.png', CAMERA)
    assert image.dtype == np.uint8
    np.testing.assert_array_equal(image, np.repeat((grey // 257)[..., None], 3, axis=-1))


def test_exif_does_not_turn_an_image_away_from_its_pose(tmp_path: Path) -> None:
    image = np.zeros((12, 16, 3), np.uint8)
    image[:6] = 255
    path = write_turned_jpeg(tmp_path / 'phone.jpg', image, 3)  # upside down
    turned = cv2.imread(str(path))
    assert turned is not None and turned[0].mean() < 50, 'OpenCV alone turns it'
    assert read_rgb_image(path, CAMERA)[0].mean() > 200


@pytest.mark.parametrize('content, message', [
    (None, 'expected a readable image file'),
    (b'', 'expected a readable image file'),
    (b'no picture', 'expected a readable image file'),
], ids=['missing', 'empty', 'text'])
def test_what_is_no_image(tmp_path: Path, content: bytes | None, message: str) -> None:
    if content is not None:
        (tmp_path / 'x.png').write_bytes(content)
    with pytest.raises(SceneError, match=message):
        read_rgb_image(tmp_path / 'x.png', CAMERA)


def test_images_of_another_size_are_refused(tmp_path: Path) -> None:
    write_picture(tmp_path / 'x.png', picture(Intrinsics(12, 16, 9, 9, 6, 8), 0))
    with pytest.raises(SceneError, match='x.png: expected 16x12 pixels .* got 12x16'):
        read_rgb_image(tmp_path / 'x.png', CAMERA)


@pytest.mark.parametrize('counts, message', [
    ((2, 1, 2), 'got 2 images, 1 poses, 2 path ids'),
    ((2, 2, 3), 'got 2 images, 2 poses, 3 path ids'),
    ((0, 0, 0), 'expected at least one image'),
], ids=['a pose short', 'a path id too many', 'nothing'])
def test_images_and_poses_go_together(counts: tuple[int, int, int], message: str) -> None:
    pose = CameraPose(np.eye(4))
    with pytest.raises(SceneError, match=message):
        PosedImages(CAMERA, (Path('x.png'),) * counts[0], (pose,) * counts[1], (0,) * counts[2])
