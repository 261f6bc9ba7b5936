"""The viewer on a real ROS graph: behind the real node, and at a bare topic."""
from array import array
import asyncio
import json
from pathlib import Path
import time

import aiohttp
from camera_messages import noise_image
import cv2
from diagnostic_msgs.msg import DiagnosticArray, DiagnosticStatus, KeyValue
from neo_ros.messages import image_fields
from neo_ros.viewer.main import read_settings
import numpy as np
import pytest
from rclpy.node import Node
from rclpy.parameter import Parameter
from ros_graph import ros_graph, WAIT_S
from sensor_msgs.msg import CompressedImage, Image
from tiny_model import TINY_EXPANSION, write_tiny_model
from viewer_server import split

SOURCE, TARGET = TINY_EXPANSION.source, TINY_EXPANSION.target
PORT_ARGUMENTS = ('--ros-args', '-r', '__ns:=/robot', '-p', 'port:=0')


@pytest.fixture
def graph():
    with ros_graph() as graph:
        yield graph


class Watcher:
    """A viewer without a browser, run in turns with the graph."""

    def __init__(self, graph, url):
        self.graph, self.url = graph, url.rstrip('/')
        self.pictures, self.status = [], {}
        self.loop = asyncio.new_event_loop()

    def __enter__(self):
        self.session = self.loop.run_until_complete(self._open())
        self.task = self.loop.create_task(self._listen())
        return self

    def __exit__(self, *_):
        self.task.cancel()
        self.loop.run_until_complete(asyncio.gather(self.task, return_exceptions=True))
        self.loop.run_until_complete(self.session.close())
        self.loop.close()

    async def _open(self):
        session = aiohttp.ClientSession()
        self.socket = await session.ws_connect(
            f'{self.url}/stream', origin=self.url, max_msg_size=0)
        await self.socket.send_str(json.dumps({'paused': False}))
        return session

    async def _listen(self):
        async for message in self.socket:
            if message.type is aiohttp.WSMsgType.TEXT:
                content = json.loads(message.data)
                self.status = content if content['type'] == 'status' else self.status
                continue
            meta, *pictures = split(message.data)
            meta['age_ms'] = 1e3 * time.monotonic() - meta['captured']
            self.pictures.append((meta, *pictures))
            await self.socket.send_str(json.dumps({'shown': meta['seq']}))

    def send(self, message):
        self.loop.run_until_complete(self.socket.send_str(json.dumps(message)))

    def until(self, condition, each=lambda: None, timeout=WAIT_S):
        """Call `each` at 20 Hz until the condition holds."""
        deadline = time.monotonic() + timeout
        while not condition():
            assert time.monotonic() < deadline, (self.status, len(self.pictures))
            each()
            self.graph.spin_for(0.02)
            self.loop.run_until_complete(asyncio.sleep(0.03))


def start_viewer(graph, *arguments):
    """Start the executable; return the process and its address."""
    process = graph.start('-m', 'neo_ros.viewer.main', *PORT_ARGUMENTS, *arguments)
    line = process.stdout.readline()
    assert line.startswith('Viewer: http://127.0.0.1:'), line
    return process, line.split()[-1]


def stamped(graph, message):
    message.header.stamp = graph.node.get_clock().now().to_msg()
    return message


def test_behind_the_real_node(graph, tmp_path):
    model = write_tiny_model(tmp_path / 'tiny.onnx')
    graph.start('-m', 'neo_ros.node.main', '--ros-args', '-r', '__ns:=/robot',
                '-p', f'model:={model}')
    camera = graph.node.create_publisher(Image, '/robot/image', 10)
    process, url = start_viewer(graph)
    graph.spin_until(lambda: graph.node.count_publishers('/robot/wide/image'))
    graph.spin_for(0.5)
    # Nobody watches yet: the node has no reason to take images.
    assert graph.node.count_subscribers('/robot/wide/image') == 0
    assert camera.get_subscription_count() == 0

    fields = image_fields(noise_image(SOURCE, 0))
    fields['data'] = array('B', fields['data'].tobytes())

    def send():
        camera.publish(stamped(graph, Image(**fields)))

    with Watcher(graph, url) as watcher:
        watcher.until(lambda: watcher.pictures and watcher.pictures[-1][0]['seen'], send)
        meta, image, confidence = watcher.pictures[-1]
        shares = [TINY_EXPANSION.left / TARGET.width, TINY_EXPANSION.top / TARGET.height,
                  SOURCE.width / TARGET.width, SOURCE.height / TARGET.height]
        assert np.allclose(meta['seen'], shares) and meta['timed'] and confidence == b''
        assert 0 <= meta['age_ms']
        shown = cv2.imdecode(np.frombuffer(image, np.uint8), cv2.IMREAD_COLOR)
        assert shown is not None and shown.shape == (TARGET.height, TARGET.width, 3)
        watcher.send({'confidence': True})
        watcher.until(lambda: watcher.pictures[-1][2], send)
        grey = cv2.imdecode(np.frombuffer(watcher.pictures[-1][2], np.uint8),
                            cv2.IMREAD_UNCHANGED)
        assert grey is not None
        assert grey.shape == (TARGET.height, TARGET.width) and abs(int(grey[0, 0]) - 64) < 6
        watcher.until(lambda: watcher.status['node_ms'] is not None
                      and watcher.status['rate'] > 1, send)
        assert watcher.status['name'] == '/robot/wide/image'
        sequence = [meta['seq'] for meta, _, _ in watcher.pictures]
        assert sequence == sorted(set(sequence))
    graph.spin_until(lambda: graph.node.count_subscribers('/robot/wide/image') == 0)
    process.terminate()
    assert process.wait(WAIT_S) == 0


def test_compressed_pictures_and_warnings_of_the_node(graph):
    _, url = start_viewer(graph, '-r', 'wide/image:=wide/image/compressed')
    data = cv2.imencode('.jpg', np.zeros((48, 64, 3), np.uint8))[1].tobytes()
    diagnosis = DiagnosticArray(status=[DiagnosticStatus(
        level=DiagnosticStatus.WARN, name='/robot/fov_extrapolator: widening',
        message='unlike the scene',
        values=[KeyValue(key='in the trained scene', value='false')])])
    with Watcher(graph, url) as watcher:
        watcher.until(lambda: 'publishers: 0' in watcher.status.get('waiting', ''))
        pictures = graph.node.create_publisher(CompressedImage, '/robot/wide/image/compressed', 1)
        diagnostics = graph.node.create_publisher(DiagnosticArray, '/diagnostics', 1)

        def send():
            pictures.publish(CompressedImage(format='rgb8; jpeg compressed bgr8', data=data))
            diagnostics.publish(diagnosis)

        watcher.until(lambda: watcher.pictures and watcher.status['out_of_scene'], send)
        meta, image, _ = watcher.pictures[-1]
        # Passed on as they came; the stamp 0 is of no clock of this machine.
        assert image == data and meta['timed'] is False and meta['seen'] is None
        assert (watcher.status['level'], watcher.status['message']) == (1, 'unlike the scene')
        assert watcher.status['waiting'] == ''
        watcher.until(lambda: 'cannot show' in watcher.status['waiting'], lambda: (
            pictures.publish(CompressedImage(format='jpeg', data=b'no picture'))))


@pytest.mark.parametrize('parameter, words', [
    ('quality:=500', 'quality: expected 1 to 100, got 500'), ('max_mbit:=20', 'max_mbit'),
    ('model:=package://nowhere/room.onnx', "there is no package 'nowhere'")],
    ids=['range', 'type', 'package'])
def test_settings_that_cannot_be(graph, parameter, words):
    process = graph.start('-m', 'neo_ros.viewer.main', *PORT_ARGUMENTS, '-p', parameter)
    text = process.communicate(timeout=WAIT_S)[0]
    assert words in text and 'Traceback' not in text
    assert process.returncode == 1


def test_the_model_is_named_as_the_nodes(graph, monkeypatch):
    monkeypatch.setenv('HOME', '/home/ada')
    for number, (place, path) in enumerate((
            ('', None), ('~/a.onnx', '/home/ada/a.onnx'),
            ('file:///data/a%20room.onnx', '/data/a room.onnx'))):
        node = Node(f'viewer_{number}', context=graph.context, parameter_overrides=[
            Parameter('model', value=place)])
        found = read_settings(node).model
        node.destroy_node()
        assert found == (None if path is None else Path(path))


def test_no_picture_from_before_a_pause_is_shown_after_it(graph):
    _, url = start_viewer(graph)
    publishers = {name: graph.node.create_publisher(Image, f'/robot/wide/{name}', 1)
                  for name in ('image', 'confidence')}

    def send(shade, *names):
        fields = image_fields(np.full((48, 64, 3), shade, np.uint8))
        fields['data'] = array('B', fields['data'].tobytes())
        message = stamped(graph, Image(**fields))
        for name in names:
            publishers[name].publish(message)

    def heard(count):
        return [publisher.get_subscription_count() for publisher in publishers.values()] == [
            count, count]

    with Watcher(graph, url) as watcher:
        watcher.send({'confidence': True})
        watcher.until(lambda: heard(1))
        graph.spin_for(0.3)
        send(10, 'image')  # It waits for its confidence.
        graph.spin_for(0.5)
        assert not watcher.pictures
        watcher.send({'paused': True})
        watcher.until(lambda: heard(0))
        watcher.send({'paused': False})
        watcher.until(lambda: heard(1))
        watcher.until(lambda: watcher.pictures, lambda: send(200, *publishers))
        shown = cv2.imdecode(np.frombuffer(watcher.pictures[0][1], np.uint8), cv2.IMREAD_COLOR)
        assert shown is not None and shown.min() > 150
