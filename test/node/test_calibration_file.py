"""A camera that publishes no camera_info, and a file that says what it is."""
from dataclasses import replace
import math

from camera_messages import camera_info_message, noise_image
from diagnostic_msgs.msg import DiagnosticStatus
from live_node import Camera, set_parameter
from neo_ros.errors import ConfigError
from neo_ros.geometry import Intrinsics
from neo_ros.messages import CameraFit
from neo_ros.node.parameters import NodeParameters, parameters, read_calibration
from neo_ros.runtime import FovExtrapolator
import numpy as np
import pytest
from tiny_model import TINY_EXPANSION
import yaml

LENS = Intrinsics.from_hfov(96, 80, math.radians(115))
VALUES = NodeParameters(**{name: default for name, default, _ in parameters()})
BENT = {'d': [-0.1, 0.01, 0.0, 0.0, 0.0]}


def write_calibration(path, lens):
    """Write what camera_calibration does."""
    message = camera_info_message(lens, **BENT)
    path.write_text(yaml.safe_dump({
        'image_width': lens.width, 'image_height': lens.height, 'camera_name': 'eye',
        'camera_matrix': {'rows': 3, 'cols': 3, 'data': [float(value) for value in message.k]},
        'distortion_model': 'plumb_bob',
        'distortion_coefficients': {'rows': 1, 'cols': 5, 'data': BENT['d']}}))
    return path


def test_the_calibration_of_a_file_stands_for_the_one_that_nobody_publishes(
        graph, model, tmp_path):
    file = write_calibration(tmp_path / 'eye.yaml', LENS)
    camera = Camera(graph)
    camera.start_node(model, f'camera_info_url:=file://{file}', 'rectify:=true')
    camera.wait_for_node()
    image = noise_image(LENS, 1)
    wide = camera.widen(image, 1)
    fit = CameraFit(camera_info_message(LENS, **BENT), TINY_EXPANSION, rectify=True)
    expected = FovExtrapolator.load(model).expand(fit.apply(image)).wide_image
    np.testing.assert_array_equal(
        np.frombuffer(wide['image'].data, np.uint8).reshape(expected.shape), expected)
    lines = camera.wait_for_diagnosis(DiagnosticStatus.OK, 'widening')
    assert lines['camera'].startswith('rectified and resampled from 96x80')
    assert not graph.node.count_subscribers('/robot/camera_info')


def test_it_may_change_while_the_node_runs_and_what_is_no_calibration_is_refused(
        graph, model, tmp_path):
    camera = Camera(graph)
    camera.start_node(model)
    camera.wait_for_node()
    image = noise_image(LENS, 1)
    camera.publish(image, 1)
    camera.wait_for_diagnosis(DiagnosticStatus.ERROR, '96x80')
    for name, words in (('missing.yaml', 'No such file'), ('wrong.yaml', 'camera_calibration')):
        (tmp_path / 'wrong.yaml').write_text('image_width: 96\n')
        refused = set_parameter(graph, 'camera_info_url', str(tmp_path / name))
        assert not refused.successful
        assert refused.reason.startswith('camera_info_url: ') and words in refused.reason
    file = write_calibration(tmp_path / 'eye.yaml', LENS)
    assert set_parameter(graph, 'camera_info_url', str(file)).successful
    assert set_parameter(graph, 'rectify', True).successful
    camera.wait_for_node()
    camera.widen(image, 2)
    assert set_parameter(graph, 'camera_info_url', '').successful
    graph.spin_until(lambda: graph.node.count_subscribers('/robot/camera_info'))


@pytest.mark.parametrize('name, value, words', [
    ('image_width', -5, 'image_width: expected a number of pixels, got -5'),
    ('image_height', True, 'image_height: expected a number of pixels, got True'),
    ('camera_matrix', [1, 0], 'camera_matrix: expected finite numbers under the key data'),
    ('camera_matrix', None, 'camera_matrix: expected finite numbers under the key data, got None'),
    ('camera_matrix', {'data': [math.nan] * 9}, 'camera_matrix: expected finite numbers'),
    ('camera_matrix', {'data': [1.0] * 8}, 'camera_matrix: expected 9 numbers, got 8'),
    ('camera_matrix', {'data': [0.0] * 9}, r'k: the camera is uncalibrated \(k\[0\] = 0\)'),
    ('distortion_model', 'magic', 'd: expected finite coefficients, .*magic'),
], ids=['width', 'height', 'list', 'null', 'nan', 'eight', 'zero', 'model'])
def test_a_calibration_that_fits_no_camera_is_refused_at_once(tmp_path, name, value, words):
    file = write_calibration(tmp_path / 'eye.yaml', LENS)
    file.write_text(yaml.safe_dump({**yaml.safe_load(file.read_text()), name: value}))
    with pytest.raises(ConfigError, match=f'camera_info_url: .*{words}'):
        read_calibration(replace(VALUES, camera_info_url=str(file)))


def test_small_numbers_without_a_point_are_numbers(tmp_path):
    file = write_calibration(tmp_path / 'eye.yaml', LENS)
    file.write_text(file.read_text().replace('- 0.01\n', '- 5e-05\n'))
    found = read_calibration(replace(VALUES, camera_info_url=str(file)))
    assert found is not None and found.d[1] == 5e-05


def test_a_file_that_cannot_be_used_leaves_the_node_unconfigured(graph, model):
    camera = Camera(graph)
    camera.start_node(model, 'camera_info_url:=/none.yaml')
    camera.wait_for_diagnosis(DiagnosticStatus.ERROR, 'camera_info_url: /none.yaml: cannot read')
