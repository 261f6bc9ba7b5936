"""Throw broken priors and odometry at a guided node of which every output is subscribed."""
from array import array
from collections import Counter
from typing import Any

from box_room import apart, box_walk, EXPANSION, view
from geometry_msgs.msg import PoseWithCovarianceStamped
from message_fuzzer import FLOATS, NUMBERS, STRINGS
from nav_msgs.msg import Odometry
from neo_ros.messages import image_fields
from neo_ros.messages.hints import read_pose
from neo_ros.node.interface import NODE_NAME, ODOMETRY, OUTPUTS, PRIOR, RELOCALIZE
import numpy as np
from sensor_msgs.msg import Image
from std_srvs.srv import Trigger

CAMERA = 'camera_optical'
FRAMES = (CAMERA, CAMERA, CAMERA, 'map', 'odom', '', *STRINGS)
WALK = box_walk(20)


class PoseFuzzer:
    """Makes priors and odometry of which hardly any is true, the same for the same seed."""

    def __init__(self, seed: int) -> None:
        self.random = np.random.default_rng(seed)

    def any_of(self, values: Any) -> Any:
        """Choose one."""
        return values[self.random.integers(len(values))]

    def prior(self) -> PoseWithCovarianceStamped:
        """Return a prior."""
        message = PoseWithCovarianceStamped()
        message.header.frame_id = self.any_of(('map', 'map', *FRAMES))
        self._fill(message.pose.pose)
        message.pose.covariance[self.random.integers(36)] = self.any_of(FLOATS)
        return message

    def odometry(self, second: int, nanosecond: int) -> Odometry:
        """Return odometry, mostly of about that time."""
        message = Odometry(child_frame_id=self.any_of(FRAMES))
        stamp = message.header.stamp
        stamp.sec, stamp.nanosec = second, nanosecond
        if not self.random.integers(4):
            stamp.sec = min(int(self.any_of(NUMBERS)), 2**31 - 1)
        self._fill(message.pose.pose)
        return message

    def _fill(self, pose: Any) -> None:
        for name, value in zip('xyz', self.random.uniform(0, 4, 3).tolist()):
            setattr(pose.position, name, value)
        for name, value in zip('xyzw', self.random.normal(size=4).tolist()):
            setattr(pose.orientation, name, value)
        for _ in range(self.random.integers(0, 3)):
            part = self.any_of((pose.position, pose.orientation))
            setattr(part, self.any_of('xyz'), self.any_of(FLOATS))


def fuzz_poses(graph: Any, node: Any, count: int, seed: int) -> Counter[str]:
    """
    Send a walk's images to a node with the box room's memory; return how often each output came.

    After every image the node has widened it, found where it was taken, and sent all that it knows
    of it; nothing that is not true of the image.
    """
    fuzzer = PoseFuzzer(seed)
    images = graph.node.create_publisher(Image, '/image', 10)
    priors = graph.node.create_publisher(PRIOR.kind, f'/{NODE_NAME}/prior', 10)
    odometry = graph.node.create_publisher(ODOMETRY.kind, '/odom', 10)
    came = {name: graph.collect(output.kind, f'/{output.name}')
            for name, output in OUTPUTS.items() if name != 'base_pose'}
    graph.executor.add_node(node)
    publishers = (images, priors, odometry)
    graph.spin_until(lambda: all(one.get_subscription_count() for one in publishers)
                     and sum(node._scene.outputs.wanted()) == len(came))
    ways: Counter[str] = Counter()
    for index in range(count):
        second, nanosecond = divmod(index * 40_000_000, 10**9)
        if not fuzzer.random.integers(4):
            priors.publish(fuzzer.prior())
        for _ in range(fuzzer.random.integers(3)):
            odometry.publish(fuzzer.odometry(second, nanosecond))
        if index % 100 == 99:
            graph.call(Trigger, RELOCALIZE.name.replace('~', f'/{NODE_NAME}'), Trigger.Request())
        turn = index % (2 * len(WALK) - 2)
        pose = WALK[min(turn, 2 * len(WALK) - 2 - turn)]
        fields = image_fields(view(pose, EXPANSION.source)[0])
        image = Image(**(fields | {'data': array('B', bytes(fields['data']))}))
        image.header.frame_id = CAMERA
        image.header.stamp.sec, image.header.stamp.nanosec = second, nanosecond
        graph.spin_for(0.005)  # What was sent before comes before.
        for kept in came.values():
            kept.clear()
        images.publish(image)
        graph.spin_until(lambda: came['status'] and came['image'])
        lines = {line.key: line.value for line in came['status'][0].status[0].values}
        assert node._statistics.snapshot().last_rejection == ''
        ways['guided' if lines['guided'] == 'true' else 'the network alone'] += 1
        if lines['guided'] == 'true':
            graph.spin_until(lambda: came['pose'] and came['points'] and came['panorama'])
            _check(came, image, pose)
        ways.update(f'wide/{name}' for name, kept in came.items() if kept)
    graph.executor.remove_node(node)
    return ways


def _check(came: dict[str, list], image: Image, pose: Any) -> None:
    """Check that what came is of the image, whole, and true."""
    for name, kept in came.items():
        assert all(message.header.stamp == image.header.stamp for message in kept), name
    found = came['pose'][0].pose
    metres, degrees = apart(read_pose(found.pose), pose)
    assert metres < 0.05 and degrees < 1.0, (metres, degrees)
    assert np.linalg.eigvalsh(found.covariance.reshape(6, 6)).min() > 0
    depth = np.frombuffer(came['depth'][0].data, np.float32)
    assert np.isnan(depth).mean() < 0.5 and np.nanmin(depth) > 0 and np.nanmax(depth) < 10
    points = came['points'][0]
    assert len(points.data) == points.row_step * points.height
