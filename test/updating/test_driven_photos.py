"""Photos out of a bag: of which light they are."""
from pathlib import Path

from box_room import box_walk, EXPANSION, view, write_box_model
from camera_bags import CameraBag
from neo_ros.bags import write_demo_bag
from neo_ros.bags.camera_choice import CameraChoice
from neo_ros.bags.demo_bag import RobotFrame, write_robot_bag
from neo_ros.errors import BagError
from neo_ros.geometry import CameraPose
from neo_ros.messages.camera_info import camera_info_fields
from neo_ros.messages.image import image_fields
from neo_ros.runtime import FovExtrapolator
from neo_ros.updating.driven_photos import drive_through
import numpy as np
import pytest

pytestmark = pytest.mark.slow


@pytest.mark.parametrize('slope', [0.0, 0.1], ids=['same light', 'another light'])
def test_photos_are_brought_into_the_light_of_the_training(tmp_path: Path, slope: float) -> None:
    model, walk = write_box_model(tmp_path), box_walk(30)
    frames = list[tuple[int, np.ndarray, CameraPose]]()
    for number, pose in enumerate(walk, 1):
        image, depth = view(pose, EXPANSION.target)
        x = pose.position[0] + ((EXPANSION.target.pixel_rays() * depth[..., None])
                                @ pose.T_world_cam[:3, :3].T)[..., 0]
        lit = 0.7 ** (slope > 0) * np.exp(slope * (x - 2))[..., None] * image
        frames.append((number * 10 ** 8, np.clip(lit, 0, 255).astype(np.uint8), pose))
    write_demo_bag(tmp_path / 'drive', frames, EXPANSION)
    drive = drive_through(tmp_path / 'drive', FovExtrapolator.load(model, threads=1))
    assert drive.seen == 30 and len(drive.images) > 5
    off, before = list[float](), list[float]()
    for image, pose in zip(drive.images, drive.poses):
        truth = EXPANSION.crop(view(pose, EXPANSION.target)[0]).astype(np.float32)
        number = int(np.argmin([np.linalg.norm(pose.T_world_cam - one.T_world_cam)
                                for one in walk]))
        seen = EXPANSION.crop(frames[number][1]).astype(np.float32)
        for errors, shown in ((off, image.astype(np.float32)), (before, seen)):
            ratio = np.median(truth / np.maximum(shown, 1))  # One exposure is as good as another.
            errors.append(np.abs(ratio * shown - truth).mean())
    assert np.mean(off) < (0.5 * np.mean(before) if slope else 1.01 * np.mean(before))


def test_a_camera_that_nobody_described_is_told_and_not_rectified(
        tmp_path: Path, caplog: pytest.LogCaptureFixture) -> None:
    with CameraBag(tmp_path / 'drive') as bag:
        for number, pose in enumerate(box_walk(4), 1):
            bag.image('/eye/image_raw', number * 10 ** 8, view(pose, EXPANSION.source)[0])
    extrapolator = FovExtrapolator.load(write_box_model(tmp_path))
    assert drive_through(tmp_path / 'drive', extrapolator).seen == 4
    told, = [words for words in caplog.messages if 'no camera_info' in words]
    assert told.startswith(f'{tmp_path / "drive"}: ')
    with pytest.raises(BagError, match='--rectify: expected a camera_info beside /eye/image_raw'):
        drive_through(tmp_path / 'drive', extrapolator, CameraChoice(rectify=True))


def test_a_bag_of_a_lens_that_bends_says_what_to_do(tmp_path: Path) -> None:
    """Else nothing of it would be seen, and the scene would count as up to date."""
    info = {**camera_info_fields(EXPANSION.source), 'd': np.array([-0.2, 0, 0, 0, 0])}
    write_robot_bag(tmp_path / 'drive', [
        RobotFrame(number * 10 ** 8, image_fields(EXPANSION.crop(view(pose, EXPANSION.target)[0])),
                   info, np.eye(4), pose.T_world_cam) for number, pose in enumerate(
                       box_walk(4), 1)])
    with pytest.raises(BagError, match='4 messages of the camera cannot be used.*rectify'):
        drive_through(tmp_path / 'drive', FovExtrapolator.load(write_box_model(tmp_path)))
