"""What goes from a source to the viewers: pictures, and what is known of their sender."""
from dataclasses import dataclass
import json
import struct

import cv2
from neo_ros.messages import encode_jpeg
import numpy as np

# The tint is smooth: a small picture of it does.
CONFIDENCE_SIDE = 256


@dataclass(frozen=True)
class SourcePicture:
    """
    One wide picture as its source has it.

    image: uint8 RGB (H, W, 3), or the bytes of a JPEG or PNG file, which are passed on as they
    are. confidence: uint8 (H, W), 255 = sure, or None. seen: the camera's own frame as (left,
    top, width, height) in shares of the picture, or None while it is not known. captured: when
    the camera took it, time.monotonic() in seconds; timed: whether that is known, else it is
    when the picture arrived here. recorded: the log time in a bag, UNIX time in
    seconds; None for a live picture.
    """

    image: np.ndarray | bytes
    captured: float
    timed: bool
    confidence: np.ndarray | None = None
    seen: tuple[float, float, float, float] | None = None
    recorded: float | None = None


@dataclass(frozen=True)
class SourceState:
    """
    What is known of the sender.

    name: topic or bag. waiting: what it waits for, in words; empty when pictures come. level: of
    the node's diagnosis, 0 = OK, 1 = warning, 2 = error; message: its words. out_of_scene: the
    node says that the camera is not in the trained scene. recognised: whether the scene memory
    knew the place of the newest image; None for a model without one, and while it is not known.
    node_ms: the node's median latency. span: first and last log time of a bag, UNIX time in
    seconds; None for a live stream.
    """

    name: str
    waiting: str = ''
    level: int = 0
    message: str = ''
    out_of_scene: bool = False
    recognised: bool | None = None
    node_ms: float | None = None
    span: tuple[float, float] | None = None


class EncodedPicture:
    """
    A picture encoded once, for any number of viewers.

    A message is two little-endian uint32, the lengths of the next two parts; a JSON object; the
    JPEG of the picture; the JPEG of the confidence, if it is asked for and known. The object
    holds `seq`, `captured` (the server's clock in ms), `timed`, `seen` and `recorded`. Raises
    ImageRejected for what is too large for a JPEG.
    """

    def __init__(self, seq: int, picture: SourcePicture, quality: int,
                 with_confidence: bool) -> None:
        self.seq = seq
        self._meta = json.dumps({
            'seq': seq, 'captured': 1e3 * picture.captured, 'timed': picture.timed,
            'seen': picture.seen, 'recorded': picture.recorded}).encode()
        image = picture.image
        self._image = image if isinstance(image, bytes) else bytes(encode_jpeg(image, quality))
        self._confidence = b''
        if with_confidence and picture.confidence is not None:
            self._confidence = bytes(encode_jpeg(_shrink(picture.confidence), quality))
        self._plain = self._join(b'')
        self._full = self._join(self._confidence) if self._confidence else self._plain

    def message(self, confidence: bool) -> bytes:
        """Return the message for a viewer."""
        return self._full if confidence else self._plain

    def _join(self, confidence: bytes) -> bytes:
        lengths = struct.pack('<II', len(self._meta), len(self._image))
        return b''.join((lengths, self._meta, self._image, confidence))


def _shrink(confidence: np.ndarray) -> np.ndarray:
    scale = CONFIDENCE_SIDE / max(confidence.shape)
    if scale >= 1:
        return confidence
    height, width = (max(round(side * scale), 1) for side in confidence.shape)
    return cv2.resize(confidence, (width, height), interpolation=cv2.INTER_AREA)
