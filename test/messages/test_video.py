"""Video messages are decoded in their order, from a key frame on, or say why not."""
import sys
from types import SimpleNamespace
from typing import Any

from encoded_images import flat_quarters
from neo_ros.errors import ImageRejected
from neo_ros.messages import FrameProcessor
from neo_ros.messages.image_reader import ImageReader, is_video
from neo_ros.messages.video import video_codec
import numpy as np
import pytest
from video_messages import video_packets

pytest.importorskip('av')
# Brightness tells the frames apart.
IMAGES = np.stack([flat_quarters(48, 64) // 2 + 10 * index for index in range(8)]).astype(np.uint8)


def foxglove(data: bytes, form: str = 'h264') -> Any:
    return SimpleNamespace(header=None, format=form, data=np.frombuffer(data, np.uint8))


def packet(data: bytes, encoding: str = 'libx264') -> Any:
    return SimpleNamespace(header=None, width=64, height=48, encoding=encoding, pts=0, flags=0,
                           is_bigendian=False, data=np.frombuffer(data, np.uint8))


def rejections(reader: ImageReader, messages: list[Any]) -> list[str]:
    """Read all; return the reason of each, '' where it came."""
    reasons = []
    for message in messages:
        try:
            reader.read(message)
            reasons.append('')
        except ImageRejected as rejection:
            reasons.append(rejection.reason)
    return reasons


@pytest.mark.parametrize(('codec', 'make', 'word'), [
    ('libx264', foxglove, 'h264'), ('libx264', packet, 'libx264'),
    ('libx264', packet, 'h264_nvenc'), ('libx264', packet, 'h264;yuv420p;bgr8;bgr8'),
    ('libx265', foxglove, 'h265'), ('libx265', foxglove, 'hevc'), ('libx265', packet, 'libx265')])
def test_each_message_gives_its_own_frame(codec: str, make: Any, word: str) -> None:
    reader = ImageReader()
    for image, data in zip(IMAGES, video_packets(IMAGES, codec)):
        found = reader.read(make(data, word))
        assert found.shape == image.shape and found.dtype == np.uint8
        assert np.abs(found.astype(int) - image).mean() < 5


def test_what_comes_before_the_first_key_frame_is_refused_by_its_reason() -> None:
    messages = [foxglove(data) for data in video_packets(IMAGES)]
    assert rejections(ImageReader(), messages[2:]) == ['key_frame'] * 3 + [''] * 3


def test_after_damage_the_next_key_frame_is_waited_for() -> None:
    messages = [foxglove(data) for data in video_packets(IMAGES)]
    messages[1:3] = [foxglove(b'abc'), foxglove(b'')]
    assert rejections(ImageReader(), messages) == [
        '', 'data', 'empty', 'key_frame', 'key_frame', '', '', '']


def test_a_frame_that_claims_too_much_is_refused(monkeypatch: pytest.MonkeyPatch) -> None:
    monkeypatch.setattr('neo_ros.messages.video.MAX_PIXELS', 1000)
    assert rejections(ImageReader(), [foxglove(video_packets(IMAGES)[0])]) != ['']


def test_without_pyav_the_extra_is_named(monkeypatch: pytest.MonkeyPatch) -> None:
    message = foxglove(video_packets(IMAGES)[0])
    monkeypatch.setitem(sys.modules, 'av', None)
    with pytest.raises(ImageRejected, match=r'\.\[video\]') as refusal:
        ImageReader().read(message)
    assert refusal.value.reason == 'encoding'


def test_an_unknown_codec_is_named() -> None:
    with pytest.raises(ImageRejected, match="h264.*got 'theora'"):
        video_codec(packet(b'abc', 'theora'))


def test_single_pictures_are_no_video() -> None:
    assert not is_video(SimpleNamespace(format='rgb8; jpeg compressed bgr8', data=b''))
    assert not is_video(SimpleNamespace(encoding='rgb8', step=3, data=b''))


def test_live_frames_of_a_video_are_refused_with_the_way_out() -> None:
    from message_fuzzer import QuickExtrapolator
    message = SimpleNamespace(header=None, format='h264', data=video_packets(IMAGES)[0])
    with pytest.raises(ImageRejected, match='h264, which is video.*publish JPEG'):
        FrameProcessor(QuickExtrapolator()).process(message, None)
