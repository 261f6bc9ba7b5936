"""Bags with images of every kind are imported, replayed and described alike."""
from collections import Counter
from pathlib import Path
import sqlite3
from types import SimpleNamespace
from typing import Any

from camera_bags import as_sqlite, CameraBag, COMPRESSED, IMAGE
from camera_messages import header_without_a_clock
import cv2
from encoded_images import ALL, encoded_message, flat_quarters, seen_as, YUV
from message_fuzzer import QuickExtrapolator
from neo_ros.bags.bag_info import read_bag_info
from neo_ros.bags.replay import replay
from neo_ros.captures.bag import BagOptions, read_bag_capture
from neo_ros.geometry import CameraPose
from neo_ros.messages import FrameProcessor, read_image
import numpy as np
import pytest
from rosbags.typesys import get_types_from_msg
from tiny_model import tiny_card, TINY_EXPANSION
from video_messages import video_packets

SOURCE = TINY_EXPANSION.source
STEP, COUNT = 100_000_000, 8
TOPIC = '/cam/image_raw'
FLAT = flat_quarters(SOURCE.height, SOURCE.width)
# Brightness tells the frames of a video apart.
FRAMES = np.stack([FLAT // 2 + 10 * index for index in range(COUNT)]).astype(np.uint8)
VIDEO, PACKET = 'foxglove_msgs/msg/CompressedVideo', 'ffmpeg_image_transport_msgs/msg/FFMPEGPacket'
VIDEO_FIELDS = 'builtin_interfaces/Time timestamp\nstring frame_id\nuint8[] data\nstring format\n'
PACKET_FIELDS = ('std_msgs/Header header\nint32 width\nint32 height\nstring encoding\nuint64 pts\n'
                 'uint8 flags\nbool is_bigendian\nuint8[] data\n')


class Remembering(QuickExtrapolator):
    """Keeps the images that it is given."""

    card = tiny_card()

    def __init__(self) -> None:
        self.images: list[np.ndarray] = []

    def expand(self, image: np.ndarray, prior=None, motion=None, pace=1.0, stamp_ns=None) -> Any:
        self.images.append(image.copy())
        return super().expand(image)


def write_drive(path: Path, topic: str, send: Any) -> Path:
    with CameraBag(path) as bag:
        for name, fields in ((VIDEO, VIDEO_FIELDS), (PACKET, PACKET_FIELDS)):
            bag.typestore.register(get_types_from_msg(fields, name))
        for index in range(COUNT):
            stamp_ns = (index + 1) * STEP
            bag.tf('/tf', stamp_ns, 'map', 'optical', CameraPose.from_planar(
                0.2 * index, 0.1, 1.0, 0.2 * index).T_world_cam)
            bag.info('/cam/camera_info', stamp_ns, SOURCE)
            send(bag, topic, index, stamp_ns, bag.header(stamp_ns, 'optical'))
    return path


def imported(bag: Path, topic: str | None = None) -> tuple[list[np.ndarray], tuple[str, ...]]:
    capture = read_bag_capture(bag, BagOptions(image_topic=topic))
    images = [image for _, image in capture.images(range(len(capture))) if image is not None]
    return images, capture.notes


def assert_alike(found: np.ndarray, expected: np.ndarray, most: float) -> None:
    assert found.shape == expected.shape
    assert np.abs(found[:4, :4].astype(int) - expected[:4, :4]).max() <= most
    assert np.abs(found[-4:, -4:].astype(int) - expected[-4:, -4:]).max() <= most


@pytest.mark.parametrize('encoding', [name for name in ALL if name != '16UC1'])
def test_every_encoding_goes_through_every_entry(tmp_path: Path, encoding: str) -> None:
    def send(bag: CameraBag, topic: str, index: int, stamp_ns: int, header: Any) -> None:
        fields = vars(encoded_message(FLAT, encoding, padding=4, big_endian=True))
        bag.send(topic, IMAGE, stamp_ns, **(fields | {'header': header}))

    path = write_drive(tmp_path / 'bag', TOPIC, send)
    expected, most = seen_as(FLAT, encoding), 3 if encoding in YUV else 0
    images, _ = imported(path)
    assert len(images) == COUNT
    extrapolator, node = Remembering(), Remembering()
    result = replay(path, extrapolator, tmp_path / 'out')  # type: ignore[arg-type]
    assert result.frames == COUNT and not result.rejected
    FrameProcessor(node).process(encoded_message(FLAT, encoding, 4, True), None)
    for found in (images[0], extrapolator.images[-1], node.images[0]):
        assert_alike(found, expected, most)
    image = next(topic for topic in read_bag_info(path).topics if topic.name == TOPIC)
    assert image.roles == ['image'] and encoding in image.content


# Ending for OpenCV, bits of a sample, and how far off pixels may be. Drivers leave old bytes of
# their buffer behind a JPEG.
PICTURES = {'jpeg': ('.jpg', 8, 8), 'jpeg with a tail': ('.jpg', 8, 8), 'png': ('.png', 8, 0),
            'png of 16 bits': ('.png', 16, 0), 'webp': ('.webp', 8, 0),
            'tiff': ('.tiff', 8, 0), 'tiff of 16 bits': ('.tiff', 16, 0)}


@pytest.mark.parametrize('kind, picture', PICTURES.items())
def test_every_compressed_picture_goes_through_every_entry(
        tmp_path: Path, kind: str, picture: tuple[str, int, int]) -> None:
    suffix, bits, most = picture
    pixels = FLAT[..., ::-1] if bits == 8 else FLAT[..., ::-1].astype(np.uint16) * 257
    data = cv2.imencode(suffix, pixels, [cv2.IMWRITE_WEBP_QUALITY, 101])[1].reshape(-1)
    if kind == 'jpeg with a tail':
        data = np.concatenate([data, data[len(data) // 2:], np.zeros(99, np.uint8)])

    def send(bag: CameraBag, topic: str, index: int, stamp_ns: int, header: Any) -> None:
        bag.send(topic, COMPRESSED, stamp_ns, header=header, format=suffix[1:], data=data)

    path = write_drive(tmp_path / 'bag', f'{TOPIC}/compressed', send)
    images, _ = imported(path)
    assert len(images) == COUNT
    extrapolator, node = Remembering(), Remembering()
    result = replay(path, extrapolator, tmp_path / 'out')  # type: ignore[arg-type]
    assert result.frames == COUNT and not result.rejected
    message = SimpleNamespace(header=header_without_a_clock(), format=suffix[1:], data=data)
    FrameProcessor(node).process(message, None)
    for found in (images[0], extrapolator.images[-1], node.images[0]):
        assert_alike(found, FLAT, most)
    assert 'image' in {role for topic in read_bag_info(path).topics for role in topic.roles}


def as_video(kind: str, packets: list[bytes]) -> Any:
    def send(bag: CameraBag, topic: str, index: int, stamp_ns: int, header: Any) -> None:
        data = np.frombuffer(packets[index], np.uint8)
        fields: dict[str, Any] = {'header': header, 'format': 'h264'}
        if kind == VIDEO:
            fields = {'timestamp': header.stamp, 'frame_id': header.frame_id, 'format': 'h264'}
        elif kind == PACKET:
            fields = {'header': header, 'width': SOURCE.width, 'height': SOURCE.height, 'pts': 0,
                      'encoding': 'libx264', 'flags': 0, 'is_bigendian': False}
        bag.send(topic, kind, stamp_ns, data=data, **fields)
    return send


@pytest.mark.parametrize('kind', [COMPRESSED, VIDEO, PACKET])
@pytest.mark.parametrize('cut', [0, 2])
def test_video_is_decoded_from_its_first_key_frame_on(
        tmp_path: Path, kind: str, cut: int) -> None:
    pytest.importorskip('av')
    frames = np.concatenate([FRAMES, FRAMES[:cut]])
    packets = video_packets(frames)[cut:]
    path = write_drive(tmp_path / 'bag', f'{TOPIC}/video', as_video(kind, packets))
    lost = (5 - cut) % 5
    images, notes = imported(path)
    extrapolator = Remembering()
    result = replay(path, extrapolator, tmp_path / 'out')  # type: ignore[arg-type]
    assert len(images) == result.frames == COUNT - lost
    assert result.rejected == (Counter(key_frame=lost) if lost else Counter())
    assert any(f'{lost} video frames before the first key frame' in note
               for note in notes) == bool(lost)
    for found in (images, extrapolator.images):
        for image, expected in zip(found, frames[cut + lost:]):
            assert np.abs(image.astype(int) - expected).mean() < 12
    info = next(topic for topic in read_bag_info(path).topics if topic.name.endswith('video'))
    assert info.roles == ['image']


@pytest.mark.parametrize('kind', [VIDEO, PACKET])
def test_video_is_read_from_bags_that_define_nothing(tmp_path: Path, kind: str) -> None:
    pytest.importorskip('av')
    bag = write_drive(tmp_path / 'bag', f'{TOPIC}/video', as_video(kind, video_packets(FRAMES)))
    database, = as_sqlite(bag, tmp_path / 'humble').glob('*.db3')
    recorder = sqlite3.connect(database)
    recorder.execute('DROP TABLE message_definitions')
    recorder.close()
    for number, path in enumerate((database.parent, tmp_path / '0')):  # And from a copy of it.
        images, _ = imported(path)
        assert len(images) == COUNT
        replay(path, Remembering(), tmp_path / f'{number}')  # type: ignore[arg-type]


def test_what_cannot_be_decoded_is_no_camera(tmp_path: Path) -> None:
    def send(bag: CameraBag, topic: str, index: int, stamp_ns: int, header: Any) -> None:
        bag.send(topic, COMPRESSED, stamp_ns, header=header, format='jpeg',
                 data=np.frombuffer(b'no picture at all', np.uint8))

    info = read_bag_info(write_drive(tmp_path / 'bag', f'{TOPIC}/compressed', send))
    assert not any('image' in topic.roles for topic in info.topics)
    assert info.next == '' and any('cannot be read' in note for note in info.notes)


def test_depth_is_grey_where_its_topic_is_named(tmp_path: Path) -> None:
    def send(bag: CameraBag, topic: str, index: int, stamp_ns: int, header: Any) -> None:
        fields = vars(encoded_message(FLAT, '16UC1'))
        bag.send(topic, IMAGE, stamp_ns, **(fields | {'header': header}))

    images, notes = imported(write_drive(tmp_path / 'bag', TOPIC, send), TOPIC)
    np.testing.assert_array_equal(images[0], read_image(encoded_message(FLAT, 'mono16')))
    # A model of them would widen nothing: all else takes them for depth.
    warning, = [note for note in notes if f'{TOPIC} has the encoding 16UC1' in note]
    assert 'publish them as mono16' in warning
