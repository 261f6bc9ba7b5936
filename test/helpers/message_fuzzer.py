"""
Throw broken camera messages at the message layer and at a live node.

python test/helpers/message_fuzzer.py --layer 100000 --live 5000 --seed 1    what `make fuzz` runs
"""
import argparse
from array import array
from collections import Counter
import math
import struct
import time
from types import SimpleNamespace
from typing import Any
import zlib

from camera_messages import camera_info_message, header_without_a_clock, image_message, noise_image
import cv2
from encoded_images import ALL, encoded_message
from neo_ros.errors import ImageRejected
from neo_ros.geometry import Intrinsics
from neo_ros.messages import FrameProcessor, jpeg_fields
from neo_ros.messages.image_encodings import ENCODINGS
from neo_ros.runtime import WideView
import numpy as np
from tiny_model import TINY_EXPANSION

SOURCE, TARGET = TINY_EXPANSION.source, TINY_EXPANSION.target
REASONS = {'encoding', 'size', 'step', 'empty', 'data', 'camera_info', 'camera'}
NUMBERS = (0, 1, 2, 23, 24, 31, 32, 33, 96, 97, 255, 4096, 65_535, 2**31 - 1, 2**31, 2**32 - 1)
FLOATS = (0.0, -0.0, 1.0, -16.0, 1e-300, 1e300, math.nan, math.inf, -math.inf, 15.5, 5e-324)
STRINGS = ('', ' ', 'rgb8', 'RGB8', 'mono16', '16UC1', 'yuv422', 'jpeg', 'png', 'x' * 5000, 'ü€',
           'rgb8; jpeg compressed bgr8', '16UC1; compressedDepth png', 'plumb_bob', 'equidistant',
           'rational_polynomial', 'bgr8; png compressed bayer_rggb8', '; ;', 'h264', 'webp',
           'mono16; png compressed ', 'bayer_grbg8; png compressed ',
           'bayer_rggb16; png compressed mono16')


class Fuzzer:
    """Makes messages of which some are good and most are not, the same for the same seed."""

    def __init__(self, seed: int) -> None:
        self.random = np.random.default_rng(seed)
        image = noise_image(SOURCE, 0)
        self.jpeg = jpeg_fields(image, 80)['data'].tobytes()
        self.png = cv2.imencode('.png', image)[1].tobytes()
        wide = image.astype(np.uint16) * 257
        self.others = [cv2.imencode(extension, pixels)[1].tobytes() for extension, pixels in (
            ('.png', wide[..., 0]), ('.png', wide), ('.webp', image), ('.tiff', image),
            ('.tiff', wide[..., 0]))]

    def any_of(self, values: Any) -> Any:
        """Choose one."""
        return values[self.random.integers(len(values))]

    def raw(self) -> SimpleNamespace:
        """Return an Image with up to four wrong fields."""
        message = encoded_message(
            noise_image(SOURCE, int(self.random.integers(4))), self.any_of(ALL),
            2 * int(self.random.integers(3)), bool(self.random.integers(2)))
        message.data = message.data.tobytes()
        for _ in range(self.random.integers(0, 5)):
            field = self.any_of(('height', 'width', 'step', 'encoding', 'is_bigendian', 'data'))
            value: Any = int(self.any_of(NUMBERS))
            if field == 'encoding':
                value = self.any_of((*STRINGS, *ENCODINGS))
            elif field == 'is_bigendian':
                value = int(self.random.integers(256))
            elif field == 'data':
                value = self.random.bytes(int(self.any_of(
                    (0, 1, 767, 2303, 2304, 2305, 3072, 4608, 9216))))
            setattr(message, field, value)
        return message

    def compressed(self) -> SimpleNamespace:
        """Return a CompressedImage, whole, cut, with wrong bytes, or a bomb."""
        data = bytearray(self.any_of((self.jpeg, self.png, *self.others, self.bomb(), b'',
                                      self.random.bytes(200), self.jpeg_bomb())))
        kind = self.random.integers(5)
        if kind == 1:
            del data[int(self.random.integers(len(data) + 1)):]
        elif kind >= 2 and data:
            for _ in range(self.random.integers(1, 9)):
                data[self.random.integers(len(data))] = self.random.integers(256)
        return SimpleNamespace(format=self.any_of(STRINGS), data=bytes(data))

    def bomb(self) -> bytes:
        """Return a PNG of some bytes that claims any size."""
        def chunk(name: bytes, content: bytes) -> bytes:
            return (struct.pack('>I', len(content)) + name + content
                    + struct.pack('>I', zlib.crc32(name + content)))
        size = (int(self.any_of(NUMBERS)), int(self.any_of(NUMBERS)))
        return (b'\x89PNG\r\n\x1a\n' + chunk(b'IHDR', struct.pack(
            '>IIBBBBB', *size, int(self.any_of((1, 8, 16))), int(self.random.integers(7)), 0, 0,
            0)) + chunk(b'IDAT', zlib.compress(bytes(500))) + chunk(b'IEND', b''))

    def jpeg_bomb(self) -> bytes:
        """Return a JPEG that claims any size, or has a scan many times over."""
        start = self.jpeg.index(b'\xff\xda')
        if self.random.integers(2):
            return self.jpeg[:-2] + self.jpeg[start:-2] * int(self.random.integers(200)) + (
                self.jpeg[-2:])
        frame = self.jpeg.index(b'\xff\xc0') + 5
        size = struct.pack('>HH', *(int(self.any_of(NUMBERS)) % 65_536 for _ in range(2)))
        return self.jpeg[:frame] + size + self.jpeg[frame + 4:]

    def camera_info(self) -> SimpleNamespace:
        """Return a CameraInfo of the model's camera or a wider one, with wrong fields or not."""
        camera = self.any_of((SOURCE, SOURCE, Intrinsics(48, 40, 14, 15, 24, 20)))
        message = camera_info_message(camera)
        for _ in range(self.random.integers(0, 4)):
            field = self.any_of(('height', 'width', 'binning_x', 'binning_y', 'd', 'k', 'r', 'p',
                                 'roi', 'distortion_model'))
            if field == 'roi':
                for name in ('x_offset', 'y_offset', 'width', 'height'):
                    setattr(message.roi, name, int(self.any_of(NUMBERS)))
            elif field == 'distortion_model':
                message.distortion_model = self.any_of(STRINGS)
            elif field == 'd':
                count = int(self.any_of((0, 1, 4, 5, 8, 12, 14)))
                message.d = np.array([self.any_of((*FLOATS, 0.1, -0.2, 0.01))
                                      for _ in range(count)], np.float64)
            elif field in ('k', 'r', 'p'):
                values = np.array(getattr(message, field), np.float64)
                values[self.random.integers(len(values))] = self.any_of(FLOATS)
                setattr(message, field, values)
            else:
                setattr(message, field, int(self.any_of(NUMBERS)))
        return message


class QuickExtrapolator:
    """Stands in for a network that has nothing to do with messages."""

    expansion = TINY_EXPANSION
    scene_check = None

    def reset(self) -> None:
        """Have nothing to forget."""

    def expand(self, image: np.ndarray, prior=None, motion=None, pace=1.0,
               stamp_ns=None) -> WideView:
        """Check what comes in; return black."""
        assert image.shape == (SOURCE.height, SOURCE.width, 3) and image.dtype == np.uint8
        assert 0.25 <= pace <= 4
        shape = (TARGET.height, TARGET.width)
        return WideView(np.zeros((*shape, 3), np.uint8), np.zeros(shape, np.uint8))


def fuzz_layer(count: int, seed: int) -> Counter[str]:
    """Send messages through the frame processor; return how many went which way."""
    fuzzer, processor = Fuzzer(seed), FrameProcessor(QuickExtrapolator())
    good = image_message(noise_image(SOURCE, 0))
    ways: Counter[str] = Counter()
    # Apart from the fuzzer's own, which stays as it was without stamps.
    stamps = np.random.default_rng(seed)
    for index in range(count):
        message = fuzzer.compressed() if fuzzer.random.integers(2) else fuzzer.raw()
        message.header = header_without_a_clock()
        message.header.stamp.sec = int(stamps.choice((-2**31, -1, 0, 1, 2**31 - 1)))
        message.header.stamp.nanosec = int(stamps.choice((0, 1, 10**8, 2 * 10**8, 2**32 - 1)))
        info = fuzzer.camera_info() if fuzzer.random.integers(3) else None
        processor.rectify = bool(fuzzer.random.integers(2))
        try:
            frame = processor.process(message, info)
            assert frame.image is not None
            assert frame.image.shape == (TARGET.height, TARGET.width, 3)
            assert all(np.isfinite(frame.camera_info[name]).all() for name in 'dkrp')
            ways['widened'] += 1
        except ImageRejected as rejection:
            assert rejection.reason in REASONS, rejection.reason
            assert len(str(rejection)) < 1000
            ways[rejection.reason] += 1
        if index % 100 == 0:
            assert processor.process(good, None).image is not None
    return ways


def fuzz_node(graph: Any, node: Any, count: int, seed: int) -> Counter[str]:
    """
    Publish messages to a node of this process; return how many went which way.

    After each message the node has either widened it or counted it under its reason, and every
    tenth one is good and is widened.
    """
    from sensor_msgs.msg import CameraInfo, CompressedImage, Image, RegionOfInterest
    fuzzer = Fuzzer(seed)
    compressed = node.get_parameter('image_transport').value == 'compressed'
    kind, topic = (CompressedImage, '/image/compressed') if compressed else (Image, '/image')
    images = graph.node.create_publisher(kind, topic, 10)
    infos = graph.node.create_publisher(CameraInfo, '/camera_info', 10)
    widened = graph.collect(Image, '/wide/image')
    graph.executor.add_node(node)
    graph.spin_until(lambda: images.get_subscription_count() and infos.get_subscription_count()
                     and node._scene.outputs.wanted().image)
    before = node._statistics.snapshot()
    accepted: list[int] = []
    for index in range(count):
        is_good = index % 10 == 9
        info = camera_info_message(SOURCE) if is_good else fuzzer.camera_info()
        info.roi = RegionOfInterest(**vars(info.roi))
        sent = CameraInfo(**vars(info))
        infos.publish(sent)
        # Reliable, but best effort on the node's side: wait for it.
        graph.spin_until(lambda: same_info(node._inputs._pairing.newest, sent))
        if is_good:
            message = SimpleNamespace(format='jpeg', data=fuzzer.jpeg) if compressed else (
                image_message(noise_image(SOURCE, 0)))
        else:
            message = fuzzer.compressed() if compressed else fuzzer.raw()
        fields = {name: value for name, value in vars(message).items() if name != 'header'}
        fields['data'] = array('B', bytes(fields['data']))
        image = kind(**fields)
        # Stamps go backwards.
        image.header.stamp.sec = count - index
        images.publish(image)
        after = graph.spin_until(lambda: (now := node._statistics.snapshot()).published + sum(
            now.rejected.values()) == before.published + sum(before.rejected.values()) + index + 1
            and now)
        if after.published > before.published + len(accepted):
            accepted.append(count - index)
        else:
            assert not is_good, after.last_rejection
    graph.spin_until(lambda: len(widened) == len(accepted))
    assert [message.header.stamp.sec for message in widened] == accepted
    assert set(after.rejected) <= REASONS
    graph.executor.remove_node(node)
    return Counter(after.rejected) + Counter(widened=len(accepted))


def same_info(one: Any, other: Any) -> bool:
    """Compare messages that may hold NaN."""
    return repr(one) == repr(other)


def main() -> None:
    """Fuzz both and say what came of it."""
    from neo_ros.node.extrapolator_node import ExtrapolatorNode
    from pathlib import Path
    from rclpy.parameter import Parameter
    from ros_graph import ros_graph
    import tempfile
    from tiny_model import write_tiny_model
    parser = argparse.ArgumentParser(description=__doc__)
    for name, default in (('layer', 100_000), ('live', 5_000), ('seed', 0)):
        parser.add_argument(f'--{name}', type=int, default=default)
    options = parser.parse_args()
    started = time.monotonic()
    print('message layer:', dict(fuzz_layer(options.layer, options.seed).most_common()),
          f'{time.monotonic() - started:.0f} s')
    for transport in ('raw', 'compressed') if options.live else ():
        started = time.monotonic()
        with ros_graph() as graph, tempfile.TemporaryDirectory() as folder:
            model = write_tiny_model(Path(folder, 'tiny.onnx'))
            node = ExtrapolatorNode(context=graph.context, parameter_overrides=[
                Parameter('model', value=str(model)),
                Parameter('image_transport', value=transport),
                Parameter('reliable', value=True), Parameter('rectify', value=True)])
            node.autostart()
            ways = fuzz_node(graph, node, options.live // 2, options.seed)
            print(f'live node, {transport}:', dict(ways.most_common()),
                  f'{time.monotonic() - started:.0f} s')
            node.stop()
            node.destroy_node()
    if options.live:
        _fuzz_guided(options.live // 2, options.seed)


def _fuzz_guided(count: int, seed: int) -> None:
    from box_room import write_box_model
    from neo_ros.node.extrapolator_node import ExtrapolatorNode
    from pathlib import Path
    from pose_fuzzer import fuzz_poses
    from rclpy.parameter import Parameter
    from ros_graph import ros_graph
    import tempfile
    started = time.monotonic()
    with ros_graph() as graph, tempfile.TemporaryDirectory() as folder:
        node = ExtrapolatorNode(context=graph.context, parameter_overrides=[
            Parameter('model', value=str(write_box_model(Path(folder)))),
            Parameter('reliable', value=True), Parameter('panorama_width', value=64),
            Parameter('panorama_fps', value=30.0)])
        node.autostart()
        ways = fuzz_poses(graph, node, count, seed)
        print('live node, priors and odometry:', dict(ways.most_common()),
              f'{time.monotonic() - started:.0f} s')
        node.stop()
        node.destroy_node()


if __name__ == '__main__':
    main()
