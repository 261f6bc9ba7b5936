"""The network goes away and comes back, in a namespace of its own where that is allowed."""
import os
from pathlib import Path
import shutil
import subprocess
import sys
import time

from camera_messages import noise_image
from live_node import Camera, SOURCE
import pytest
from ros_graph import ENVIRONMENT, ros_graph
from tiny_model import write_tiny_model

NAMESPACE = ('unshare', '--net', '--user', '--map-root-user')


def loopback(state):
    subprocess.run(['ip', 'link', 'set', 'lo', state], check=True)


def lose_the_network(model):
    """Widen, without a network for a while, and widen again; inside the namespace."""
    loopback('up')
    with ros_graph() as graph:
        camera = Camera(graph)
        process = camera.start_node(model)
        camera.wait_for_node()
        image = noise_image(SOURCE, 0)
        camera.widen(image, 1)
        loopback('down')
        graph.spin_for(3)
        loopback('up')

        def answers():
            camera.publish(image, 2)
            graph.spin_for(0.2)
            return camera.wide['image'][-1].header.frame_id == 'camera_2'
        graph.spin_until(answers, timeout=30)
        restarted = time.monotonic()
        process.kill()
        process.wait()
        camera.start_node(model)

        def answers_again():
            camera.publish(image, 3)
            graph.spin_for(0.2)
            return camera.wide['image'][-1].header.frame_id == 'camera_3'
        graph.spin_until(answers_again, timeout=30)
        print(f'back {time.monotonic() - restarted:.1f} s after a restart')


def test_node_works_again_when_the_network_is_back(tmp_path):
    if not all(map(shutil.which, ('unshare', 'ip'))) or subprocess.run(
            [*NAMESPACE, 'ip', 'link', 'set', 'lo', 'up'], capture_output=True).returncode:
        pytest.skip('needs a network namespace: unshare and ip, and the right to use them')
    model = write_tiny_model(tmp_path / 'tiny.onnx')
    helpers = str(Path(__file__).parents[1] / 'helpers')
    paths = os.pathsep.join([helpers, ENVIRONMENT['PYTHONPATH']])
    result = subprocess.run(
        [*NAMESPACE, sys.executable, __file__, model], text=True, capture_output=True,
        timeout=100, env=os.environ | ENVIRONMENT | {'PYTHONPATH': paths})
    assert result.returncode == 0, result.stdout + result.stderr


if __name__ == '__main__':
    lose_the_network(sys.argv[1])
