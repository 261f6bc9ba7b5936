"""One frame in, the content of the wide messages out, or a refusal."""
import math

from camera_messages import camera_info_message, image_message, noise_image
from neo_ros.errors import ImageRejected
from neo_ros.geometry import Intrinsics
from neo_ros.messages import camera_info_fields
from neo_ros.messages.frame_processor import FrameProcessor
from neo_ros.runtime import FovExtrapolator
import numpy as np
import pytest
from tiny_model import TINY_EXPANSION, write_tiny_model

SOURCE = TINY_EXPANSION.source


@pytest.fixture(scope='module')
def extrapolator(tmp_path_factory):
    return FovExtrapolator.load(write_tiny_model(tmp_path_factory.mktemp('model') / 'tiny.onnx'))


def test_outputs_are_those_of_the_extrapolator(extrapolator):
    image = noise_image(SOURCE, 1)
    frame = FrameProcessor(extrapolator).process(
        image_message(image), camera_info_message(SOURCE))
    expected = extrapolator.expand(image)
    np.testing.assert_array_equal(frame.image, expected.wide_image)
    np.testing.assert_array_equal(frame.confidence, expected.confidence)
    np.testing.assert_array_equal(frame.extrapolated_mask == 255, extrapolator.extrapolated_mask)
    assert set(np.unique(frame.extrapolated_mask)) == {0, 255}
    assert set(frame.stages_ms) == {'decode', 'infer'}


def test_known_and_unknown_camera_give_the_same_wide_camera(extrapolator):
    message = image_message(noise_image(SOURCE, 1))
    expected = camera_info_fields(TINY_EXPANSION.target)
    for camera in (None, camera_info_message(SOURCE)):
        found = FrameProcessor(extrapolator).process(message, camera).camera_info
        assert found.keys() == expected.keys()
        for name, value in expected.items():
            np.testing.assert_array_equal(found[name], value)


def test_network_rests_when_nobody_wants_its_outputs():
    class Resting:
        expansion = TINY_EXPANSION

        def expand(self, image):
            raise AssertionError('the network ran')

    processor = FrameProcessor(Resting())
    frame = processor.process(image_message(noise_image(SOURCE, 1)), None, infer=False)
    assert frame.image is None and frame.confidence is None
    assert frame.extrapolated_mask.any()
    with pytest.raises(ImageRejected, match='data'):
        processor.process(image_message(noise_image(SOURCE, 1), data=b'abc'), None, infer=False)


HFOV_60 = Intrinsics.from_hfov(SOURCE.width, SOURCE.height, math.radians(60))


@pytest.mark.parametrize('image, camera, reason, words', [
    (image_message(noise_image(SOURCE.scaled(2), 1)), None, 'size', 'takes 32x24.*is 64x48'),
    (image_message(noise_image(SOURCE, 1), encoding='16UC1'), None, 'encoding', '16UC1'),
    (image_message(noise_image(SOURCE, 1)), camera_info_message(HFOV_60), 'camera',
     '90.00 deg.*60.00 deg'),
    (image_message(noise_image(SOURCE, 1)), camera_info_message(SOURCE, k=np.zeros(9)),
     'camera_info', 'uncalibrated'),
], ids=['size', 'encoding', 'field of view', 'uncalibrated'])
def test_other_cameras_are_refused_with_both_figures(extrapolator, image, camera, reason, words):
    with pytest.raises(ImageRejected, match=words) as refusal:
        FrameProcessor(extrapolator).process(image, camera)
    assert refusal.value.reason == reason
