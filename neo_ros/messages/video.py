"""Video messages to RGB arrays: of a stream, no message can be decoded without those before it."""
from typing import Any

from neo_ros.errors import ImageRejected
from neo_ros.messages.compressed_image import video_format
from neo_ros.pictures.header import MAX_PIXELS
import numpy as np

# What encoders call themselves ('libx264', 'hevc_nvenc'), and the name of what they write.
_CODECS = {'h264': 'h264', 'x264': 'h264', 'avc': 'h264', 'h265': 'hevc', 'x265': 'hevc',
           'hevc': 'hevc', 'av1': 'av1', 'vp9': 'vp9'}


def video_codec(message: Any) -> str | None:
    """
    Return FFmpeg's name of the codec of a video message; None for a single picture.

    Video is a `foxglove_msgs/CompressedVideo`, an `ffmpeg_image_transport_msgs/FFMPEGPacket`, or
    a `sensor_msgs/CompressedImage` whose format is a video's. Raises ImageRejected('encoding')
    for a packet of an unknown codec.
    """
    word = message.encoding if hasattr(message, 'pts') else video_format(
        getattr(message, 'format', ''))
    if word is None:
        return None
    codec = next((codec for name, codec in _CODECS.items() if name in word.lower()), None)
    if codec is None:
        raise ImageRejected('encoding', f'encoding: expected video of one of '
                            f'{", ".join(sorted(set(_CODECS.values())))}, got {word!r:.80}')
    return codec


class VideoDecoder:
    """Decodes the messages of one topic in their order, from a key frame on."""

    def __init__(self, codec: str) -> None:
        """Raise ImageRejected('encoding') where PyAV, the extra `video`, is not installed."""
        try:
            import av
        except ImportError:
            raise ImageRejected(
                'encoding', f"format: {codec} is video, which needs pip install '.[video]' in a "
                            'checkout') from None
        self._av = av
        self.codec = codec
        self._begun = False
        self._context = self._opened()

    def decode(self, data: Any) -> np.ndarray:
        """
        Return RGB uint8 (H, W, 3) of one message's data.

        Raises ImageRejected with the reason 'key_frame' where the stream has not begun, 'empty',
        or 'data' for what cannot be decoded; then the next key frame is waited for.
        """
        if len(data) == 0:
            raise ImageRejected('empty', f'data: expected a frame of {self.codec}, got no bytes')
        try:
            frames = self._context.decode(self._av.Packet(bytes(data)))
            image = frames[-1].to_ndarray(format='rgb24') if frames else None
        except (self._av.error.FFmpegError, ValueError) as error:
            self._context = self._opened()
            raise ImageRejected('data', f'data: {self.codec} that cannot be decoded '
                                f'({error!s:.200})') from None
        if image is None and not self._begun:
            raise ImageRejected(
                'key_frame', f'data: expected a key frame of {self.codec} first; this one builds '
                'on others that are not there')
        if image is None:
            raise ImageRejected('data', f'data: expected a frame of {self.codec} from each message'
                                ', got none; send without B-frames')
        if not self._begun:
            self._begun, self._context.skip_frame = True, 'DEFAULT'
        return image

    def _opened(self) -> Any:
        context = self._av.CodecContext.create(self.codec, 'r')
        # Threads would keep frames back.
        context.thread_count = 1
        context.options = {'flags': 'low_delay', 'max_pixels': str(MAX_PIXELS)}
        context.skip_frame = 'NONKEY'
        self._begun = False
        return context
