"""One frame in, the content of the wide messages out, or a refusal."""
import math
from types import SimpleNamespace

from camera_messages import camera_info_message, image_message, noise_image
from neo_ros.errors import ImageRejected
from neo_ros.geometry import Intrinsics
from neo_ros.messages import camera_info_fields, jpeg_fields
from neo_ros.messages.camera_info import describe_camera
from neo_ros.messages.frame_processor import FrameProcessor
from neo_ros.runtime import FovExtrapolator, WideView
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
    assert set(frame.stages_ms) == {'decode', 'infer', 'check'}


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
        scene_check = None

        def reset(self):
            pass

        def expand(self, image, prior=None, motion=None, pace=1.0, stamp_ns=None):
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


class Watched:
    """A network that is always half sure, with a scene check that always says the same."""

    expansion = TINY_EXPANSION

    def __init__(self, score):
        self._score = score

    @property
    def scene_check(self):
        return self

    def score(self, image, confidence):
        return self._score

    def reset(self):
        pass

    def expand(self, image, prior=None, motion=None, pace=1.0, stamp_ns=None):
        target = TINY_EXPANSION.target
        confidence = np.full((target.height, target.width), 128, np.uint8)
        confidence[TINY_EXPANSION.observed] = 255
        return WideView(np.zeros((target.height, target.width, 3), np.uint8), confidence)


@pytest.mark.parametrize('score, ring', [(0.0, 128), (0.25, 96), (1.0, 0)])
def test_confidence_sinks_with_the_score_where_the_camera_did_not_see(score, ring):
    frame = FrameProcessor(Watched(score)).process(image_message(noise_image(SOURCE, 1)), None)
    assert frame.out_of_scene == score
    assert frame.confidence is not None
    assert (frame.confidence[TINY_EXPANSION.observed] == 255).all()
    assert (frame.confidence[TINY_EXPANSION.extrapolated_mask] == ring).all()


def test_a_bomb_is_refused_by_the_size_of_its_header_before_it_is_decoded(extrapolator,
                                                                          monkeypatch):
    data = jpeg_fields(np.zeros((3000, 4000, 3), np.uint8), 50)['data'].tobytes()
    monkeypatch.setattr('cv2.imdecode', lambda *_: pytest.fail('it was decoded'))
    with pytest.raises(ImageRejected, match='takes 32x24, the image is 4000x3000'):
        FrameProcessor(extrapolator).process(SimpleNamespace(format='jpeg', data=data), None)


def test_image_and_camera_info_of_different_sizes_are_refused(extrapolator):
    wider = Intrinsics.from_hfov(64, 48, math.radians(100))
    with pytest.raises(ImageRejected, match='image is 32x24, the camera_info says 64x48') as found:
        FrameProcessor(extrapolator).process(
            image_message(noise_image(SOURCE, 1)), camera_info_message(wider))
    assert found.value.reason == 'size'
    with pytest.raises(ImageRejected, match='image is 64x48, the camera_info says 32x24'):
        FrameProcessor(extrapolator).process(
            image_message(noise_image(wider, 1)), camera_info_message(SOURCE))


def test_a_new_camera_info_and_rectify_take_effect_at_the_next_frame(extrapolator):
    processor = FrameProcessor(extrapolator)
    image = image_message(noise_image(SOURCE, 1))
    own = processor.process(image, camera_info_message(SOURCE))
    assert own.camera_note == 'as the model takes it'
    wider = Intrinsics.from_hfov(64, 48, math.radians(100))
    wide_image = image_message(noise_image(wider, 1))
    bent = camera_info_message(wider, d=[-0.01, 0, 0, 0, 0])
    assert 'resampled' in processor.process(wide_image, camera_info_message(wider)).camera_note
    with pytest.raises(ImageRejected, match='rectify'):
        processor.process(wide_image, bent)
    processor.rectify = True
    assert 'rectified' in processor.process(wide_image, bent).camera_note
    assert processor.process(image, None).camera_note == (
        f'no camera_info: the camera is assumed to be {describe_camera(TINY_EXPANSION.source)}')
