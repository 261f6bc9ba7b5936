"""Depth images of a bag come to the colour images of their time, whatever camera took them."""
from pathlib import Path
from typing import Any

from camera_bags import CameraBag
from capture_files import CAMERA, demo_photos, START_NS, STEP_NS
from depth_files import true_depth
from neo_ros.bags.bag_info import read_bag_info
from neo_ros.captures.bag import BagOptions, read_bag_capture
from neo_ros.captures.scene_writing import write_capture
from neo_ros.flat.demo_flat import build_demo_flat
from neo_ros.geometry import CameraPose, Intrinsics
from neo_ros.geometry.camera_pose import rotation_from_vector
from neo_ros.scenes.scene import read_scene
import numpy as np
import pytest

IMAGE, DEPTH = '/cam/color/image_raw', '/cam/stereo/image'
# Wider and coarser than the colour camera's, and 5 cm beside it, turned by 2 degrees.
DEPTH_CAMERA = Intrinsics(60, 48, 40.0, 40.0, 30.0, 24.0)
T_COLOUR_DEPTH = np.eye(4)
T_COLOUR_DEPTH[:3, :3] = rotation_from_vector(np.array([0, 0.035, 0]))
T_COLOUR_DEPTH[:3, 3] = [-0.05, 0.01, 0]


class DepthBag(CameraBag):
    """The photos of `capture_files` with their poses on /tf."""

    def __init__(self, path: Path) -> None:
        super().__init__(path)
        for index, (image, pose) in enumerate(zip(demo_photos().images, demo_photos().poses)):
            stamp = START_NS + index * STEP_NS
            self.tf('/tf', stamp, 'map', 'optical', pose.T_world_cam)
            self.info('/cam/color/camera_info', stamp, CAMERA)
            self.image(IMAGE, stamp, image)

    def depth(self, index: int, depth: np.ndarray, encoding: str = '16UC1', topic: str = DEPTH,
              frame: str = 'optical', late_ns: int = 8_000_000) -> None:
        numbers = np.rint(depth * 1000).astype('<u2') if encoding == '16UC1' else (
            np.where(depth > 0, depth, np.nan).astype('<f4'))
        stamp = START_NS + index * STEP_NS + late_ns
        self.send(topic, 'sensor_msgs/msg/Image', stamp, header=self.header(stamp, frame),
                  height=len(depth), width=depth.shape[1], encoding=encoding, is_bigendian=0,
                  step=numbers.strides[0], data=numbers.view(np.uint8).reshape(-1))


def imported(bag: Path, scene: Path, **options: Any) -> tuple[np.ndarray | None, str]:
    notes = write_capture(read_bag_capture(bag, BagOptions(**options)), scene)
    return read_scene(scene).train.read_depths(), '\n'.join(notes)


@pytest.mark.parametrize('encoding', ['16UC1', '32FC1'])
def test_depth_in_the_frame_of_the_images_is_registered(tmp_path: Path, encoding: str) -> None:
    with DepthBag(tmp_path / 'bag') as bag:
        for index in (4, 0, 1, 2):  # Of the fourth image there is none.
            bag.depth(index, true_depth()[index], encoding)
    found, notes = imported(tmp_path / 'bag', tmp_path / 'scene')
    assert found is not None
    expected = 1000 * true_depth()
    expected[3] = 0
    np.testing.assert_allclose(found, expected, atol=1)
    assert f'depth from {DEPTH}, in the frame of the images: 4 of 5 images have one' in notes
    assert 'depth: 4 of 5 photos have a depth map' in notes


def write_stereo(path: Path, info: bool = True, mount: bool = True) -> Path:
    flat = build_demo_flat()
    with DepthBag(path) as bag:
        if mount:
            bag.tf('/tf_static', START_NS, 'optical', 'stereo', T_COLOUR_DEPTH)
        for index, pose in enumerate(demo_photos().poses):
            eye = CameraPose(pose.T_world_cam @ T_COLOUR_DEPTH)
            bag.depth(index, np.minimum(flat.render(DEPTH_CAMERA, eye)[1], 60), '32FC1',
                      frame='stereo')
            if info:
                bag.info('/cam/stereo/camera_info', START_NS + index * STEP_NS, DEPTH_CAMERA)
    return path


def test_depth_of_another_camera_is_brought_to_the_images(tmp_path: Path) -> None:
    found, notes = imported(write_stereo(tmp_path / 'bag'), tmp_path / 'scene')
    assert found is not None
    assert 'registered from the frame stereo by its camera_info and transforms' in notes
    known = (found > 0) & (true_depth() > 0)
    assert known.mean() > 0.75
    off = np.abs(found / 1000 - true_depth())[known] / true_depth()[known]
    assert np.median(off) < 0.02 and (off < 0.1).mean() > 0.93


@pytest.mark.parametrize('lack, words', [
    ({'info': False}, f'{DEPTH}: no camera_info beside it'),
    ({'mount': False}, "no transforms that stay from its frame, 'stereo', to that of the images"),
], ids=['camera_info', 'transforms'])
def test_depth_that_cannot_be_registered_is_named(tmp_path: Path, lack: dict[str, bool],
                                                  words: str) -> None:
    bag = write_stereo(tmp_path / 'bag', **lack)
    found, notes = imported(bag, tmp_path / 'scene')
    assert found is None and f'depth is not read: {DEPTH}: ' in notes and words in notes
    info = read_bag_info(bag)
    assert any('depth is not read' in note for note in info.notes)
    assert not [topic for topic in info.topics if 'depth' in topic.roles]


def test_what_a_model_made_is_no_measured_depth(tmp_path: Path) -> None:
    with DepthBag(tmp_path / 'bag') as bag:
        for index, depth in enumerate(true_depth()):
            stamp = START_NS + index * STEP_NS
            bag.depth(index, depth, '32FC1', topic='/cam/color/wide/depth')
            bag.image('/cam/color/wide/image', stamp, np.zeros((60, 80, 3), np.uint8))
            bag.image('/cam/color/wide/mask', stamp, np.zeros((60, 80), np.uint8))
    found, notes = imported(tmp_path / 'bag', tmp_path / 'scene')
    assert found is None and 'depth' not in notes
    assert not [topic for topic in read_bag_info(tmp_path / 'bag').topics
                if 'depth' in topic.roles]


def test_depth_of_another_time_is_not_taken(tmp_path: Path) -> None:
    with DepthBag(tmp_path / 'bag') as bag:
        for index, depth in enumerate(true_depth()):
            bag.depth(index, depth, late_ns=3_600_000_000_000)
    found, notes = imported(tmp_path / 'bag', tmp_path / 'scene')
    assert found is None
    assert '0 of 5 images have one within 20 ms; are both on one clock?' in notes


def test_damaged_depth_is_left_out(tmp_path: Path) -> None:
    with DepthBag(tmp_path / 'bag') as bag:
        for index in (0, 1):
            bag.depth(index, true_depth()[index])
        stamp = START_NS + 2 * STEP_NS
        bag.send(DEPTH, 'sensor_msgs/msg/Image', stamp, header=bag.header(stamp, 'optical'),
                 height=48, width=64, encoding='16UC1', is_bigendian=0, step=128,
                 data=np.zeros(7, np.uint8))
    found, notes = imported(tmp_path / 'bag', tmp_path / 'scene')
    assert found is not None and [depth.any() for depth in found] == [
        True, True, False, False, False]
    assert '1 depth maps cannot be read and are left out: images/000002.png' in notes
