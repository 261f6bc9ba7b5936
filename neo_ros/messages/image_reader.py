"""Images of any message that a camera's topic may have."""
from typing import Any

from neo_ros.messages.compressed_image import compressed_size, read_compressed_image
from neo_ros.messages.image import read_image
from neo_ros.messages.video import video_codec, VideoDecoder
import numpy as np


class ImageReader:
    """
    Reads the images of one topic in their order.

    An Image or CompressedImage is read by itself; a video needs every message from its last key
    frame on. depth_as_grey: read 16UC1, too.
    """

    def __init__(self, depth_as_grey: bool = False) -> None:
        self._depth_as_grey = depth_as_grey
        self._video: VideoDecoder | None = None

    def read(self, message: Any) -> np.ndarray:
        """
        Return RGB uint8 (H, W, 3).

        Raises ImageRejected as `read_image`, `read_compressed_image` and `VideoDecoder` do.
        """
        codec = video_codec(message)
        if codec is None:
            read = read_image if hasattr(message, 'step') else read_compressed_image
            return read(message, self._depth_as_grey)
        if self._video is None or self._video.codec != codec:
            self._video = VideoDecoder(codec)
        return self._video.decode(message.data)


def is_video(message: Any) -> bool:
    """Say whether no message of this kind can be read by itself."""
    return video_codec(message) is not None


def image_size(message: Any) -> tuple[int, int] | None:
    """Return (width, height) as the message says them without being decoded; None of a video."""
    if is_video(message):
        return None
    return (message.width, message.height) if hasattr(message, 'step') else (
        compressed_size(message))
