"""Many viewers, one encode; what a source and the node say, and what of it is shown."""
from contextlib import AsyncExitStack
import json
from types import SimpleNamespace

import cv2
from hand_clock import HandClock
from hypothesis import given, strategies as st
from neo_ros.errors import ImageRejected
from neo_ros.messages import encode_jpeg
from neo_ros.viewer.hub import Wanted
from neo_ros.viewer.pictures import EncodedPicture, SourcePicture, SourceState
from neo_ros.viewer.wide_topics import (
    GUIDED, GUIDED_SHARE, IN_SCENE, LATENCY, MAX_COMPRESSED_BYTES, NodeDiagnosis, read_picture,
    seen_share, WideTopics)
import numpy as np
import pytest
from viewer_server import IMAGE, picture, receive_picture, run, running, split, until, watching


def test_a_picture_that_cannot_be_a_jpeg_is_refused():
    with pytest.raises(ImageRejected, match='at most 65500 pixels a side, got 1x65501'):
        EncodedPicture(1, picture(np.zeros((65501, 1, 3), np.uint8)), 80, False)


def test_twenty_viewers_share_one_encode(monkeypatch):
    encoded = []
    encode = EncodedPicture.__init__

    def count(picture, *arguments):
        encoded.append(arguments[0])
        encode(picture, *arguments)

    monkeypatch.setattr(EncodedPicture, '__init__', count)

    async def test():
        async with running() as (client, hub):
            async with AsyncExitStack() as stack:
                sockets = [await stack.enter_async_context(watching(client))
                           for _ in range(20)]
                for seq in range(1, 31):
                    hub.publish(picture())
                    # No viewer misses any, nor gets one twice or out of order.
                    for socket in sockets:
                        assert (await receive_picture(socket))[0]['seq'] == seq
            assert len(encoded) == hub.encoded == 30
    run(test)


def test_nothing_is_encoded_while_nobody_watches():
    async def test():
        async with running() as (client, hub):
            hub.publish(picture())
            assert hub.encoded == 0 and not hub.wanted.image
            async with watching(client) as socket:
                assert hub.wanted == Wanted(True)
                await socket.send_json({'paused': True})
                await until(lambda: not hub.wanted.image)
                hub.publish(picture())
                assert hub.encoded == 0
                await socket.send_json({'paused': False, 'confidence': True})
                await until(lambda: hub.wanted == Wanted(True, True))
            await until(lambda: hub.wanted == Wanted())
    run(test)


def test_status_and_clock():
    async def test():
        async with running() as (client, hub):
            async with watching(client) as socket:
                hub.report(SourceState('/wide/image', 'waiting', 2, 'lens covered', True,
                                       node_ms=12.5))
                status = await socket.receive_json()
                assert status == {
                    'type': 'status', 'name': '/wide/image', 'waiting': 'waiting', 'level': 2,
                    'message': 'lens covered', 'out_of_scene': True, 'node_ms': 12.5,
                    'recognised': None, 'span': None, 'playback': None, 'viewers': 1, 'rate': 0.0}
                assert isinstance(hub.clock, HandClock)
                hub.clock.turn(0.25)
                await socket.send_json({'ping': 17.5})
                pong = await socket.receive_json()
                assert pong == {'type': 'pong', 'ping': 17.5, 'now': 1e3 * hub.clock.now()}
    run(test)


@given(st.integers(1, 40), st.integers(1, 30), st.data())
def test_seen_share_is_the_window_of_the_mask(width, height, data):
    left, top = data.draw(st.integers(0, width - 1)), data.draw(st.integers(0, height - 1))
    right = data.draw(st.integers(left + 1, width))
    bottom = data.draw(st.integers(top + 1, height))
    mask = np.full((height, width), 255, np.uint8)
    assert seen_share(mask) is None
    mask[top:bottom, left:right] = 0
    seen = seen_share(mask)
    assert seen is not None
    share = np.multiply(seen, [width, height, width, height])
    assert np.allclose(share, [left, top, right - left, bottom - top])


@pytest.mark.parametrize('topic', [
    '/robot/camera/wide/image', '/robot/camera/wide/image/compressed'])
def test_topics_beside_the_image(topic):
    topics = WideTopics(topic)
    assert (topics.confidence, topics.mask, topics.camera) == (
        '/robot/camera/wide/confidence', '/robot/camera/wide/mask', '/robot/camera')


@pytest.mark.parametrize('data, reason', [
    (b'GIF89a', 'encoding'), (b'', 'empty'), (b'<svg onload=x>', 'encoding'),
    (bytes(encode_jpeg(IMAGE, 80)) + bytes(MAX_COMPRESSED_BYTES), 'size')],
    ids=['gif', 'nothing', 'svg', 'huge'])
def test_compressed_pictures_that_are_not_passed_on(data, reason):
    with pytest.raises(ImageRejected) as rejected:
        read_picture(SimpleNamespace(data=data, format='jpeg'))
    assert rejected.value.reason == reason


def status(name, level, message, values=()):
    """Return a DiagnosticStatus as rosbags (int level) or rclpy (bytes) give it."""
    return SimpleNamespace(name=name, level=level, message=message, values=[
        SimpleNamespace(key=key, value=value) for key, value in dict(values).items()])


def test_compressed_pictures_are_passed_on_as_they_are():
    jpeg = bytes(encode_jpeg(IMAGE, 80))
    assert read_picture(SimpleNamespace(data=np.frombuffer(jpeg, np.uint8), format='jpeg')) == jpeg


def test_diagnosis_of_the_node_beside_the_topic():
    ours = status('/cam/fov_extrapolator: widening', b'\x01', 'not in the scene',
                  {IN_SCENE: 'false', LATENCY: '12.5/20/30'})
    other = status('/rear/fov_extrapolator: widening', 0, 'widening')
    of_ours = {'level': 1, 'message': 'not in the scene', 'node_ms': 12.5, 'out_of_scene': True,
               'recognised': None}
    of_other = {'level': 0, 'message': 'widening', 'node_ms': None, 'out_of_scene': False,
                'recognised': None}
    # Every node sends an array of its own.
    diagnosis = NodeDiagnosis('/cam')
    assert diagnosis.read([status('/lidar', 2, 'off')]) == {}
    assert diagnosis.read([other]) == of_other  # The only one there is: perhaps it has this name.
    assert diagnosis.read([ours]) == of_ours
    assert diagnosis.read([other]) == {}
    assert NodeDiagnosis('/cam').read([other, ours]) == of_ours
    strangers = NodeDiagnosis('/front')
    strangers.read([ours])
    assert strangers.read([other]) == {}


def guided_by(share):
    return [status('/cam/fov_extrapolator: widening', 0, 'widening', {GUIDED_SHARE: share})]


def of_frame(guided):
    return [status('/cam/fov_extrapolator: frame', 0, '', {GUIDED: guided})]


def test_a_place_counts_as_recognised_by_the_newest_image():
    diagnosis = NodeDiagnosis('/cam')
    # A model without a memory guides no image, and the node does not know a share.
    assert diagnosis.read_frame(of_frame('false')) == {}
    assert diagnosis.read(guided_by('unknown'))['recognised'] is None
    assert diagnosis.read_frame([]) == {}
    for share, recognised in (('0%', False), ('49%', False), ('50%', True), ('100%', True)):
        assert diagnosis.read(guided_by(share))['recognised'] is recognised
    for guided in ('false', 'true', 'false'):
        assert diagnosis.read_frame(of_frame(guided)) == {'recognised': guided == 'true'}
        assert 'recognised' not in diagnosis.read(guided_by('75%')), 'the frame knows better'
    # The node loads a model without a memory.
    assert diagnosis.read(guided_by('unknown'))['recognised'] is None
    assert diagnosis.read_frame(of_frame('false')) == {}


@pytest.mark.parametrize('passed_on', [True, False])
def test_a_thin_link_gets_half_the_size_and_far_fewer_bytes(passed_on):
    image = cv2.resize(IMAGE[:12, :16], (512, 384), interpolation=cv2.INTER_CUBIC)
    given = bytes(encode_jpeg(image, 80)) if passed_on else image
    encoded = EncodedPicture(3, SourcePicture(given, 1.5, True, np.zeros((384, 512), np.uint8)),
                             80, with_confidence=True, with_small=True)
    full, small = (encoded.message(True, small) for small in (False, True))
    meta, body, confidence = split(small)
    assert meta['small'] and meta['seq'] == 3 and not split(full)[0]['small']
    shown = cv2.imdecode(np.frombuffer(body, np.uint8), cv2.IMREAD_COLOR)
    expected = cv2.resize(image, (256, 192), interpolation=cv2.INTER_AREA)[..., ::-1]
    assert shown is not None and np.abs(shown - expected.astype(float)).mean() < 6
    assert confidence.startswith(b'\xff\xd8\xff') and len(small) < 0.4 * len(full)
    without = EncodedPicture(3, SourcePicture(given, 1.5, True), 80, with_confidence=True)
    assert without.message(False, small=True) == without.message(False)


def test_what_cannot_be_made_small_is_passed_on_full():
    encoded = EncodedPicture(3, SourcePicture(b'JPEG', 1.5, True), 80, False, with_small=True)
    assert encoded.message(False, small=True) == encoded.message(False)


def test_message_layout():
    encoded = EncodedPicture(7, SourcePicture(b'JPEG', 1.5, False, np.zeros((600, 300), np.uint8)),
                             80, with_confidence=True)
    plain, full = encoded.message(False), encoded.message(True)
    length = int.from_bytes(plain[:4], 'little')
    assert int.from_bytes(plain[4:8], 'little') == 4 and plain[8:12] == bytes(4)
    assert plain[12 + length:] == b'JPEG'
    assert json.loads(plain[12:12 + length]) == {
        'seq': 7, 'captured': 1500.0, 'timed': False, 'seen': None, 'recorded': None,
        'small': False}
    assert full[:8] == plain[:8] and full[12:].startswith(plain[12:])
    assert full[len(plain):].startswith(b'\xff\xd8\xff')
    assert int.from_bytes(full[8:12], 'little') == len(full) - len(plain)
    without = EncodedPicture(7, SourcePicture(b'JPEG', 1.5, False), 80, with_confidence=True)
    assert without.message(True) == without.message(False)
