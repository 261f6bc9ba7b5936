"""What an ordinary robot's camera records in the demo flat."""
import math

import cv2
from neo_ros.flat.demo_flat import build_demo_flat, walking_paths
from neo_ros.flat.robot_camera import (
    AutoExposure, Drift, Drive, exposed, LENS, pinhole_around, poses_along, through_lens)
from neo_ros.geometry import CameraPose, Intrinsics
from neo_ros.geometry.camera_pose import rotation_vector
from neo_ros.geometry.lens import Lens
import numpy as np


def test_a_drive_starts_stands_in_the_middle_and_stops():
    drive, times = Drive(speed=0.5, stands=1.0, speeds_up=1.0), np.arange(0, 20, 0.1)
    way = drive.distances(times, 20.0)
    speed = np.diff(way) / 0.1
    for still in (times < 0.9, abs(times - 10) < 0.9, times > 19.1):
        assert speed[still[:-1]].max() < 1e-9
    assert np.isclose(speed.max(), 0.5) and speed.min() >= 0
    # Two legs of 8 seconds, of which one is lost on getting to speed and stopping.
    assert np.isclose(drive.length(20.0), 0.5 * 2 * 7, atol=0.02)


def test_poses_lie_along_the_walk():
    walk = walking_paths(build_demo_flat(), 1, 12, 3)[0]
    poses = poses_along(walk, np.array([0.0, 0.04, 0.08, 99.0]))
    assert np.allclose(poses[0].T_world_cam, walk[0].T_world_cam)
    assert np.allclose(poses[1].position, (walk[0].position + walk[1].position) / 2)
    assert np.allclose(poses[2].T_world_cam, walk[1].T_world_cam)
    assert np.allclose(poses[3].T_world_cam, walk[-1].T_world_cam, atol=1e-6)


def test_odometry_drifts_with_the_way_and_not_on_the_spot():
    step = np.eye(4)
    step[0, 3] = 0.5
    found = Drift(way=0.02, turn=0.0, bends=0.01).odometry(
        [np.linalg.matrix_power(step, n) for n in range(5)])
    assert np.isclose(np.linalg.norm(np.diff([T[:3, 3] for T in found], axis=0), axis=1), 0.51
                      ).all()
    assert np.isclose(rotation_vector(found[-1][:3, :3])[2], 0.02)
    still = Drift().odometry([step] * 3)
    assert np.allclose(still, np.eye(4))


def test_exposure_follows_the_light():
    exposure, dark, bright = AutoExposure(), np.full((4, 4, 3), 40, np.uint8), np.full(
        (4, 4, 3), 200, np.uint8)
    first = exposure.gain(dark, 0.0)
    assert abs(int(exposed(dark, first).mean()) - 118) <= 1  # sRGB of 0.18
    second = exposure.gain(bright, 0.4)
    assert exposed(bright, second).mean() > 200  # Not yet.
    later = [exposure.gain(bright, 0.4 + seconds) for seconds in (1.0, 2.0, 4.0)]
    assert abs(int(exposed(bright, later[-1]).mean()) - 118) <= 1


def test_the_lens_bends_what_straightening_makes_straight():
    small = LENS.intrinsics.scaled(0.25)
    lens = Lens(small, LENS.distortion)
    pinhole = pinhole_around(lens)
    assert pinhole.width > small.width and math.isclose(pinhole.fx, small.fx)
    flat = build_demo_flat()
    pose = walking_paths(flat, 1, 2, 3)[0][0]
    bent = through_lens(flat.render(pinhole, pose)[0], pinhole, lens)
    straight = flat.render(small, CameraPose(pose.T_world_cam))[0]
    assert bent.shape == straight.shape and bent.min(-1).max(0).min() > 0  # No black border.
    again = cv2.remap(bent, *lens.straighten_maps(small), cv2.INTER_CUBIC)
    inside = np.s_[12:-12, 12:-12]
    error = abs(again[inside].astype(int) - straight[inside]).mean()
    assert error < 3 < abs(bent[inside].astype(int) - straight[inside]).mean()


def test_the_pinhole_of_a_lens_without_distortion_is_the_camera_and_a_margin():
    camera = Intrinsics.from_hfov(40, 30, math.radians(60))
    assert pinhole_around(Lens(camera)).width in range(40, 46)
