"""Images of which the memory knows no pose are placed by those of which it does."""
from neo_ros.geometry import CameraPose
from neo_ros.updating.driven_photos import Drive, LostImage
from neo_ros.updating.placing import place_lost
import numpy as np
import pytest
from two_rooms import drive_through_door, look, SOURCE

pytest.importorskip('pycolmap')
pytestmark = pytest.mark.slow
METRES, COSINE = 0.08, 0.999


def a_drive(known: list[bool], poses: list[CameraPose]) -> Drive:
    """Return a drive of which the memory knows some poses."""
    images = [look(pose, SOURCE, closed=False) for pose in poses]
    numbers = [number for number, one in enumerate(known) if one]
    return Drive([images[number] for number in numbers], [poses[number] for number in numbers],
                 len(poses), numbers, [LostImage(image, number) for number, (image, one)
                                       in enumerate(zip(images, known)) if not one])


def test_images_in_another_room_are_placed_in_metres() -> None:
    poses = drive_through_door()
    drive = a_drive([pose.position[0] < 3.2 for pose in poses], poses)
    placed = place_lost(drive, SOURCE)
    truth = [poses[one.number] for one in placed.images]
    assert len(truth) > 0.9 * len(drive.lost)
    assert max(np.linalg.norm(one.position - other.position)
               for one, other in zip(placed.poses, truth)) < METRES
    assert min(one.forward @ other.forward for one, other in zip(placed.poses, truth)) > COSINE
    # Those at the other end of the first room see too little of the second one.
    assert 10 < len(placed.beside) and len(drive.poses) - 1 in placed.beside
    assert placed.landmarks is not None and (placed.landmarks.points[:, 0] > 3.8).sum() > 200


def test_poses_of_images_that_show_little_of_what_is_known_are_ties() -> None:
    poses = drive_through_door()[7:40]
    drive = a_drive([pose.position[0] < 3.2 for pose in poses], poses)
    half = len(drive.poses) // 2
    led = [*map(LostImage, drive.images[half:], drive.numbers[half:], drive.poses[half:])]
    fewer = Drive(drive.images[:half], drive.poses[:half], drive.seen, drive.numbers[:half],
                  [*drive.lost, *led])
    placed, again = (place_lost(fewer, SOURCE) for _ in range(2))
    assert placed.poses[:len(led)] == [one.pose for one in led]
    assert len(placed.poses) > len(led) + 0.9 * len(drive.lost)
    for one, other in zip(placed.poses, again.poses, strict=True):
        np.testing.assert_array_equal(one.T_world_cam, other.T_world_cam)


def test_what_has_nothing_in_common_is_not_placed() -> None:
    poses = drive_through_door()
    drive = a_drive([True] * 20, poses[:20])
    random = np.random.default_rng(0)
    noise = [LostImage(random.integers(0, 256, (80, 80, 3), np.uint8), 20 + n) for n in range(5)]
    dark = [LostImage(np.zeros((80, 80, 3), np.uint8), 25 + n) for n in range(5)]
    for lost in (noise, dark, []):
        placed = place_lost(Drive(drive.images, drive.poses, 30, drive.numbers, lost), SOURCE)
        assert not placed.images and not placed.beside and placed.landmarks is None


def test_a_room_that_no_known_photo_looks_into_is_not_placed() -> None:
    poses = drive_through_door()
    # The drive through the door is missing: nothing ties the second room to the first.
    drive = a_drive([True] * 10 + [False] * 27, poses[:10] + poses[40:67])
    assert not place_lost(drive, SOURCE).images


def test_a_known_photo_that_matches_no_other_does_no_harm() -> None:
    poses = drive_through_door()
    drive = a_drive([pose.position[0] < 3.2 for pose in poses], poses)
    drive.images[-1] = np.random.default_rng(0).integers(0, 256, (80, 80, 3), np.uint8)
    assert len(place_lost(drive, SOURCE).images) > 0.8 * len(drive.lost)
