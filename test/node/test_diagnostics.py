"""The one line that tells an operator what is wrong."""
from types import SimpleNamespace
from typing import Any, cast

from diagnostic_msgs.msg import DiagnosticStatus
from neo_ros.messages import SceneWatch
from neo_ros.messages.camera_fit import NO_CAMERA_INFO
from neo_ros.node.diagnostics import (
    build_camera_status, build_status, CAMERA_KEYS, Health, judge, KEYS)
from neo_ros.node.frame_statistics import Snapshot, Spread
from neo_ros.node.loaded_model import load_model
from neo_ros.node.parameters import NodeParameters
from neo_ros.node.stamp_watch import StampReport
import pytest
from tiny_model import write_tiny_model

OK, WARN, ERROR = DiagnosticStatus.OK, DiagnosticStatus.WARN, DiagnosticStatus.ERROR


def snapshot(**changes):
    fields: dict[str, Any] = {
        'received': 10, 'published': 10, 'dropped': 0, 'rejected': {}, 'last_rejection': '',
        'recent_received': 10, 'recent_published': 10, 'recent_rejected': 0, 'rate_in': 30.0,
        'rate_out': 29.8, 'out_of_scene': None, 'guided': 0.0, 'camera_note': 'unknown',
        'latency_ms': {'infer': Spread(1.0, 2.0, 3.0)}}
    return Snapshot(**(fields | changes))


def health(counts=None, **changes):
    fields: dict[str, Any] = {'state': 'active', 'fault': '', 'loading': False, 'enabled': True,
                              'topic': '/camera/image', 'publishers': 1, 'conflict': '',
                              'missing': 'waiting for image', 'twin': '', 'transform': '',
                              'warning': '',
                              'camera': 'eye', 'subscribed': True,
                              'unlike_scene': False, 'memory': False}
    return Health(**(fields | changes), counts=counts or snapshot())


REJECTING = snapshot(recent_rejected=3, last_rejection='size: too big')


@pytest.mark.parametrize('found, level, words', [
    (health(), OK, 'widening 29.8 images per second'),
    (health(state='unconfigured', fault='cannot load the model: x'), ERROR, 'cannot load'),
    (health(state='inactive'), OK, 'inactive'),
    (health(enabled=False), OK, 'disabled'),
    (health(snapshot(recent_received=0)), WARN, 'waiting for image'),
    (health(snapshot(recent_received=0), conflict='/x is best effort'), WARN,
     'waiting for image; /x is best effort'),
    (health(snapshot(camera_note=f'{NO_CAMERA_INFO} 4x3')), WARN,
     'widening 29.8 images per second; no camera_info: the camera is assumed to be 4x3, without '
     'distortion'),
    (health(snapshot(camera_note=f'{NO_CAMERA_INFO} 4x3'), subscribed=False), OK,
     'nobody subscribes to wide/*: waiting for image'),
    (health(conflict='/x is best effort'), WARN,
     'widening 29.8 images per second; /x is best effort'),
    (health(snapshot(recent_rejected=3, recent_published=0, last_rejection='size'),
            conflict='/x is best effort'), ERROR, 'rejected: size; /x is best effort'),
    (health(transform='no odom'), WARN, 'widening 29.8 images per second; no odom'),
    (health(transform='no odom', subscribed=False), OK, 'nobody subscribes'),
    (health(warning='journal: is full'), WARN, 'images per second; journal: is full'),
    (health(twin='another node'), WARN, 'widening 29.8 images per second; another node'),
    (health(snapshot(recent_received=0), subscribed=False), OK, 'nobody subscribes'),
    (health(REJECTING), WARN, 'some images are rejected: size: too big'),
    (health(snapshot(recent_rejected=3, recent_published=0, last_rejection='step')), ERROR,
     'every image is rejected: step'),
    (health(snapshot(recent_published=0, published=0)), WARN, 'first image'),
    (health(snapshot(recent_published=0)), WARN, 'none was lately'),
    (health(snapshot(recent_received=0), loading=True), OK, 'active: the model is being loaded'),
    (health(unlike_scene=True), WARN, 'unlike the trained scene'),
    (health(snapshot(guided=0.09), memory=True), OK,
     'widening 29.8 images per second, the network alone: the memory does not know this place'),
    (health(snapshot(guided=0.09), memory=True, unlike_scene=True), WARN, 'unlike the trained'),
], ids=lambda value: value if isinstance(value, str) else '')
def test_verdict(found, level, words):
    assert judge(found)[0] == level
    assert words in judge(found)[1]


def test_without_an_image_the_hardware_is_the_topic():
    assert build_status('/node', health(camera=''), {}).hardware_id == '/camera/image'


def test_status_has_the_numbers():
    counts = snapshot(rejected={'step': 2, 'size': 1}, dropped=4)
    status = build_status('/robot/node', health(counts), {'scene': 'flat', 'path': 'm.onnx'})
    lines = {pair.key: pair.value for pair in status.values}
    assert (status.name, status.hardware_id) == ('/robot/node: widening', 'eye')
    assert lines['rejected'] == '3' and lines['rejected: step'] == '2'
    assert lines['dropped for a newer image'] == '4'
    assert lines['latency infer median/p95/max [ms]'] == '1.00/2.00/3.00'
    assert lines['model path'] == 'm.onnx' and lines['image publishers'] == '1'


@pytest.mark.parametrize('guided, memory, share', [
    (0.9, True, '90%'), (None, True, 'unknown'), (0.0, False, 'unknown')],
    ids=['known', 'nothing widened', 'no memory'])
def test_a_memory_that_knows_the_place_or_has_no_say(guided, memory, share):
    status = build_status('/node', health(snapshot(guided=guided), memory=memory), {})
    assert status.message == 'widening 29.8 images per second'
    lines = {pair.key: pair.value for pair in status.values}
    assert lines['guided by the scene memory'] == share


def test_verdict_on_the_scene_does_not_flicker():
    watch = SceneWatch()
    scores = [None, 0.1, 0.45, 0.6, 0.45, None, 0.4, 0.3, 0.45, 0.51]
    assert [watch.update(score) for score in scores] == [
        False, False, False, True, True, False, True, False, False, True]


def test_every_key_is_explained_in_the_order_of_the_status():
    counts = snapshot(rejected={'REASON': 1}, latency_ms={'STAGE': Spread(1.0, 2.0, 3.0)})
    model = {key.removeprefix('model '): '' for key in KEYS if key.startswith('model ')}
    status = build_status('/node', health(counts), model)
    assert [pair.key for pair in status.values] == list(KEYS)
    status = build_camera_status('/node', 'eye', StampReport(), '')
    assert [pair.key for pair in status.values] == list(CAMERA_KEYS)


def test_status_of_a_camera():
    quiet = build_camera_status('/robot/node', 'eye', StampReport(), 'x')
    assert (quiet.name, quiet.hardware_id) == ('/robot/node: camera', 'eye')
    assert (quiet.level, quiet.message) == (OK, 'no image lately')
    report = StampReport(images=60, infos=0, bytes=921600, age_ms=12.34, same=1, rate=30.0,
                         sent=150, lost=90)
    lossy = build_camera_status('/node', 'eye', report, 'set reliable')
    assert (lossy.level, lossy.message) == (
        WARN, '90 of 150 images got lost before this node (0.9 MB each): set reliable')
    assert {pair.key: pair.value for pair in lossy.values} == {
        'images': '60', 'camera_infos': '0', 'age of the stamps [ms]': '12.3',
        'images of the newest stamp': '1', 'rate by the stamps [Hz]': '30.0',
        'images sent': '150', 'images lost before the node': '90'}


def test_a_real_models_lines_are_explained(tmp_path):
    values = SimpleNamespace(model=str(write_tiny_model(tmp_path / 'tiny.onnx')), threads=1,
                             providers=['cuda', 'cpu'], rectify=False, learn=False)
    lines = load_model(cast(NodeParameters, values)).description
    assert {f'model {key}' for key in lines} <= KEYS.keys()
