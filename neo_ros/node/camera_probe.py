"""
A camera and a consumer for measurements: sends images to the node, times what comes back.

A program of its own, so that the node is measured between processes as on a robot; prints one
JSON object. `neo_ros.speed.node` runs it.
"""
import argparse
from array import array
from collections import Counter
from collections.abc import Callable, Sequence
import itertools
import json
import os
from pathlib import Path
import sys
import time
from typing import Any

from diagnostic_msgs.msg import DiagnosticArray
from geometry_msgs.msg import PoseWithCovarianceStamped
from nav_msgs.msg import Odometry
from neo_ros.messages import image_fields
from neo_ros.messages.scene_outputs import WIDENING
from neo_ros.node.fastdds_profile import use_large_image_profile
from neo_ros.node.interface import (
    Endpoint, MAP, NODE_NAME, ODOMETRY, OUTPUTS, PRIOR, RELOCALIZE)
import numpy as np
import rclpy
from rclpy.executors import SingleThreadedExecutor
from rclpy.node import Node
from rclpy.qos import DurabilityPolicy, QoSProfile
from rclpy.subscription import Subscription
from rclpy.time import Time
from sensor_msgs.msg import Image
from std_msgs.msg import Header
from std_srvs.srv import Trigger

START_TIMEOUT_S = 60.0
WARM_UP_S = 1.0
# After the last image: long enough for one that is slow and for one more diagnosis.
DRAIN_S = 1.5
IDLE_S = 5.0
WATCHED = ('image', 'mask', 'confidence', 'camera_info')
# Images from one prior to the next, and from one search to the next.
PRIOR_EVERY, RELOCALIZE_EVERY = 200, 900


class CameraProbe:
    """
    Publishes on `image` at a fixed rate and subscribes to the wide images.

    With `everything` it subscribes to all that the node offers, sends odometry with each image
    (the camera stands still), now and then a prior, and asks the node to search anew.
    images: uint8 RGB (N, h, w, 3), sent to and fro. `heard` counts messages by topic, `arrivals`
    holds, per wide image, its stamp and when it came, both in nanoseconds; `beats` when each
    diagnosis came, in seconds, and the memory of the process `pid` then, in MB.
    """

    def __init__(self, images: np.ndarray, pid: int, everything: bool = False) -> None:
        self._pid = pid
        self._node = rclpy.create_node('camera_probe')
        self._executor = SingleThreadedExecutor()
        self._executor.add_node(self._node)
        self._message = Image(**image_fields(images[0]))
        self._message.header.frame_id = 'camera_optical_frame'
        self._images = itertools.cycle(
            [array('B', image.tobytes()) for image in (*images, *images[-2:0:-1])])
        self._camera = self._node.create_publisher(Image, 'image', QoSProfile(depth=1))
        self.sent: list[int] = []
        self.arrivals: list[tuple[int, int]] = []
        self.beats: list[tuple[float, float]] = []
        self.stages: dict[str, str] = {}
        self._node.create_subscription(
            DiagnosticArray, '/diagnostics', self._on_diagnostics, QoSProfile(depth=10))
        self.heard: Counter[str] = Counter()
        watched = [output for name, output in OUTPUTS.items() if everything or name in WATCHED]
        self._watching = [self._watch(output, QoSProfile(depth=10)) for output in watched]
        if everything:
            self._watching.append(self._watch(MAP, QoSProfile(
                depth=1, durability=DurabilityPolicy.TRANSIENT_LOCAL)))
        self._stir = _Stir(self._node) if everything else None

    def wait_for_node(self) -> None:
        """Wait until images go in and come out; raises TimeoutError."""
        deadline = time.monotonic() + START_TIMEOUT_S
        while not self.arrivals:
            if time.monotonic() > deadline:
                raise TimeoutError(f'no wide image within {START_TIMEOUT_S:.0f} s')
            if self._camera.get_subscription_count():
                self._send()
            self._spin_until(time.monotonic() + 0.2)

    def run(self, rate: float, seconds: float) -> None:
        """Send images for a while; forgets earlier ones."""
        self.sent, self.arrivals, self.beats = [], [], []
        start = time.monotonic()
        for index in range(round(rate * seconds)):
            self._spin_until(start + index / rate)
            self._send()
        self._spin_until(start + seconds)

    def rest(self, seconds: float = DRAIN_S) -> None:
        """Send nothing, but take what is on its way."""
        self._spin_until(time.monotonic() + seconds)

    def watch_no_more(self, learns: bool) -> None:
        """
        Unsubscribe from the wide images; TimeoutError where the node still hears the camera.

        learns: then it hears it all the same.
        """
        for subscription in self._watching:
            self._node.destroy_subscription(subscription)
        deadline = time.monotonic() + START_TIMEOUT_S
        while not learns and self._camera.get_subscription_count():
            if time.monotonic() > deadline:
                raise TimeoutError('the node subscribes to the camera though nobody watches')
            self._spin_until(time.monotonic() + 0.2)

    def _watch(self, output: Endpoint, qos: QoSProfile) -> Subscription:
        def take(message: Any) -> None:
            self.heard[output.name] += 1
            if output is OUTPUTS['image']:
                self._on_wide(message)

        return self._node.create_subscription(output.kind, output.name, take, qos)

    def _send(self) -> None:
        now = time.time_ns()
        self._message.data = next(self._images)
        self._message.header.stamp = Time(nanoseconds=now).to_msg()
        if self._stir is not None:
            self._stir.send(self._message.header)
        self._camera.publish(self._message)
        self.sent.append(now)

    def _spin_until(self, moment: float) -> None:
        for _ in self._watching:  # What has come is taken, however late it is.
            self._executor.spin_once(timeout_sec=0)
        while (left := moment - time.monotonic()) > 0:
            self._executor.spin_once(timeout_sec=left)

    def _on_wide(self, message: Image) -> None:
        now = time.time_ns()
        self.arrivals.append((Time.from_msg(message.header.stamp).nanoseconds, now))

    def _on_diagnostics(self, message: DiagnosticArray) -> None:
        for status in message.status:
            if status.name.endswith(f'fov_extrapolator: {WIDENING}'):
                self.stages = {entry.key: entry.value for entry in status.values}
                self.beats.append((time.monotonic(), _rss_mb(self._pid)))


class _Stir:
    """Says where the camera is, in every way that the node hears; true only by chance."""

    def __init__(self, node: Node) -> None:
        self._sent = 0
        self._odometry = node.create_publisher(ODOMETRY.kind, ODOMETRY.name, 10)
        self._prior = node.create_publisher(
            PRIOR.kind, PRIOR.name.replace('~', NODE_NAME), 10)
        self._relocalize = node.create_client(
            RELOCALIZE.kind, RELOCALIZE.name.replace('~', NODE_NAME))

    def send(self, header: Any) -> None:
        """Do what is due with an image of this header."""
        self._sent += 1
        message = Odometry(header=Header(stamp=header.stamp, frame_id='odom'),
                           child_frame_id=header.frame_id)
        self._odometry.publish(message)
        if self._sent % PRIOR_EVERY == 0:
            self._prior.publish(PoseWithCovarianceStamped())
        if self._sent % RELOCALIZE_EVERY == 0 and self._relocalize.service_is_ready():
            self._relocalize.call_async(Trigger.Request())


def main(arguments: Sequence[str] | None = None) -> None:
    """Measure once and print the result."""
    parser = argparse.ArgumentParser(description=main.__doc__)
    for name, kind in (('images', Path), ('rate', float), ('seconds', float), ('pid', int)):
        parser.add_argument(f'--{name}', type=kind, required=True)
    parser.add_argument('--everything', action='store_true')
    parser.add_argument('--learns', action='store_true')
    options = parser.parse_args(arguments)
    use_large_image_profile()
    rclpy.init(args=[])
    try:
        probe = CameraProbe(np.load(options.images), options.pid, options.everything)
        print(json.dumps(_measure(probe, options)))
    except TimeoutError as error:
        sys.exit(str(error))
    finally:
        rclpy.try_shutdown()


def _measure(probe: CameraProbe, options: argparse.Namespace) -> dict[str, Any]:
    probe.wait_for_node()
    probe.rest()
    idle_percent = _cpu_percent(options.pid, lambda: probe.rest(IDLE_S))
    probe.run(options.rate, WARM_UP_S)
    probe.rest()
    cpu_percent = _cpu_percent(
        options.pid, lambda: probe.run(options.rate, options.seconds))
    ended = time.monotonic()
    rss_mb, beats = _rss_mb(options.pid), probe.beats.copy()
    probe.rest()
    sent = set(probe.sent)
    arrivals = [pair for pair in probe.arrivals if pair[0] in sent]
    probe.watch_no_more(options.learns)
    unwatched_percent = _cpu_percent(options.pid, lambda: probe.run(options.rate, IDLE_S))
    return {'sent': len(sent), 'arrivals': arrivals,
            'first_sent': min(sent), 'ended': ended,
            'cpu_percent': cpu_percent, 'idle_cpu_percent': idle_percent,
            'unwatched_cpu_percent': unwatched_percent, 'rss_mb': rss_mb, 'beats': beats,
            'diagnostics': probe.stages, 'heard': dict(probe.heard)}


def _cpu_percent(pid: int, work: Callable[[], None]) -> float:
    """Return how busy a process is meanwhile, 100 = one core."""
    cpu, started = _cpu_seconds(pid), time.monotonic()
    work()
    return 100 * (_cpu_seconds(pid) - cpu) / (time.monotonic() - started)


def _cpu_seconds(pid: int) -> float:
    # Behind the name in brackets: state first, user and system time as 12th and 13th (proc(5)).
    fields = Path(f'/proc/{pid}/stat').read_text().rpartition(')')[2].split()
    return (int(fields[11]) + int(fields[12])) / os.sysconf('SC_CLK_TCK')


def _rss_mb(pid: int) -> float:
    lines = Path(f'/proc/{pid}/status').read_text().splitlines()
    return next(int(line.split()[1]) / 1024 for line in lines if line.startswith('VmRSS'))


if __name__ == '__main__':
    main()
