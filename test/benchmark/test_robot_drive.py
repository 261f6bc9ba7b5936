"""A bag of an ordinary robot goes in as one, and its poses are those that it was made of."""
import math

from neo_ros.bags import BagReader
from neo_ros.bags.demo_bag import IMAGE_TOPIC, TRUTH_TOPIC
from neo_ros.benchmark.robot_drive import make_drive
from neo_ros.captures.formats import CaptureFormat
from neo_ros.captures.importing import import_capture, ImportOptions
from neo_ros.flat.demo_flat import build_demo_flat
from neo_ros.flat.robot_camera import LENS
from neo_ros.geometry import Intrinsics
from neo_ros.geometry.lens import Lens
from neo_ros.machine.progress import no_stage_progress
from neo_ros.messages import read_image
from neo_ros.scenes.scene import read_scene
import numpy as np
import pytest

CAMERA = LENS.intrinsics.scaled(0.1)
WIDE = Intrinsics.from_hfov(72, 36, math.radians(90))


@pytest.fixture(scope='module')
def bag(tmp_path_factory):
    path = tmp_path_factory.mktemp('robot') / 'bag'
    assert make_drive(path, 9.0, 2.0, 5, WIDE, Lens(CAMERA, LENS.distortion), workers=1) == 18
    return path


@pytest.mark.slow
def test_images_come_as_a_usb_camera_sends_them(bag):
    with BagReader(bag) as reader:
        images = [message.read() for message in reader.messages([IMAGE_TOPIC])]
        truth = [read_image(message.read()) for message in reader.messages([TRUTH_TOPIC])]
    assert {image.encoding for image in images} == {'yuv422_yuy2'}
    assert {image.shape for image in truth} == {(36, 72, 3)}
    seen = [read_image(image) for image in images]
    assert {image.shape for image in seen} == {(48, 64, 3)}
    assert np.array_equal(seen[0], seen[1])  # It stands, and only then drives off.
    assert abs(seen[0].astype(int) - seen[8]).mean() > 10


def test_it_is_imported_with_a_straight_camera_and_poses_of_a_localisation(bag, tmp_path):
    import_capture(bag, tmp_path / 'scene', CaptureFormat.BAG, ImportOptions(),
                   no_stage_progress)
    photos = read_scene(tmp_path / 'scene').train
    assert photos.intrinsics.width <= 64 and not photos.arbitrary_scale
    first, second = build_demo_flat(), photos.poses[0]
    # Corrected once a second, the odometry is centimetres off in between.
    rendered = first.render(photos.intrinsics, second)[0]
    shown = photos.read_image(0)
    same = np.corrcoef(rendered.ravel(), shown.ravel())[0, 1]
    other = np.corrcoef(first.render(photos.intrinsics, photos.poses[-1])[0].ravel(),
                        shown.ravel())[0, 1]
    assert same > 0.95 > 0.8 > other
