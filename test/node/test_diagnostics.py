"""The one line that tells an operator what is wrong."""
from pathlib import Path
import re
from typing import Any

from diagnostic_msgs.msg import DiagnosticStatus
import neo_ros
from neo_ros.messages import SceneWatch
from neo_ros.messages.camera_fit import NO_CAMERA_INFO
from neo_ros.node.diagnostics import build_status, Health, judge
from neo_ros.node.frame_statistics import Snapshot, Spread
import pytest

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
                              'missing': 'waiting for image', 'subscribed': True,
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
     'widening 29.8 images per second; no camera_info: the camera is assumed to be 4x3'),
    (health(snapshot(camera_note=f'{NO_CAMERA_INFO} 4x3'), subscribed=False), OK,
     'nobody subscribes to wide/*: images are not widened'),
    (health(conflict='/x is best effort'), WARN,
     'widening 29.8 images per second; /x is best effort'),
    (health(snapshot(recent_rejected=3, recent_published=0, last_rejection='size'),
            conflict='/x is best effort'), ERROR, 'rejected: size; /x is best effort'),
    (health(subscribed=False), OK, 'nobody subscribes'),
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


def test_status_has_the_numbers():
    counts = snapshot(rejected={'step': 2, 'size': 1}, dropped=4)
    status = build_status('/robot/node', health(counts), {'scene': 'flat', 'path': 'm.onnx'})
    lines = {pair.key: pair.value for pair in status.values}
    assert (status.name, status.hardware_id) == ('/robot/node', 'flat')
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


def test_the_reference_names_every_key():
    page = Path(neo_ros.__file__).parent.parent / 'docs/reference/node.md'
    if not page.is_file():
        pytest.skip('not a source checkout')
    table = page.read_text().split('## Diagnostics')[1].split('| reject |')[0]
    cells = re.findall(r'^\| (`.*?`) \|', table, re.M)
    documented = {key for cell in cells for key in re.findall('`(.*?)`', cell)}
    counts = snapshot(rejected={'REASON': 1}, latency_ms={'STAGE': Spread(1.0, 2.0, 3.0)})
    model = {key.removeprefix('model '): '' for key in documented if key.startswith('model ')}
    status = build_status('/node', health(counts), model)
    assert {pair.key for pair in status.values} == documented
