"""What goes from a source to the viewers: pictures, and what is known of their sender."""
from dataclasses import dataclass
import json
import struct

import cv2
from neo_ros.messages import encode_jpeg
import numpy as np

# The tint is smooth: a small picture of it does.
CONFIDENCE_SIDE = 256
# Of a picture for a thin link, which is half as large: a fifth of the bytes of the full one.
SMALL_QUALITY = 50


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
    A picture encoded once, for any number of viewers; also half as large where that is wanted.

    A message is two little-endian uint32, the lengths of the next two parts; a JSON object; the
    JPEG of the picture; the JPEG of the confidence, if it is asked for and known. The object
    holds `seq`, `captured` (the server's clock in ms), `timed`, `seen`, `recorded` and `small`.
    Raises ImageRejected for what is too large for a JPEG.
    """

    def __init__(self, seq: int, picture: SourcePicture, quality: int,
                 with_confidence: bool, with_small: bool = False) -> None:
        self.seq = seq
        self._picture = picture
        image = picture.image
        full = image if isinstance(image, bytes) else bytes(encode_jpeg(image, quality))
        self._messages = self._encode(full, CONFIDENCE_SIDE, quality, with_confidence, False)
        self._small = self._messages
        half = _half(image) if with_small else None
        if half is not None:
            quality = min(quality, SMALL_QUALITY)
            self._small = self._encode(bytes(encode_jpeg(half, quality)), CONFIDENCE_SIDE // 2,
                                       quality, with_confidence, True)

    def message(self, confidence: bool, small: bool = False) -> bytes:
        """Return the message for a viewer; the full picture where no small one was made."""
        return (self._small if small else self._messages)[confidence]

    def _encode(self, image: bytes, side: int, quality: int, with_confidence: bool, small: bool
                ) -> tuple[bytes, bytes]:
        """Return the messages without and with the confidence."""
        picture = self._picture
        meta = json.dumps({
            'seq': self.seq, 'captured': 1e3 * picture.captured, 'timed': picture.timed,
            'seen': picture.seen, 'recorded': picture.recorded, 'small': small}).encode()
        plain = b''.join((struct.pack('<II', len(meta), len(image)), meta, image))
        if not with_confidence or picture.confidence is None:
            return plain, plain
        return plain, plain + bytes(encode_jpeg(_shrink(picture.confidence, side), quality))


def _half(image: np.ndarray | bytes) -> np.ndarray | None:
    """Return RGB uint8 of half the size; None for a file that OpenCV cannot read."""
    if isinstance(image, bytes):
        read = cv2.imdecode(np.frombuffer(image, np.uint8), cv2.IMREAD_REDUCED_COLOR_2)
        return cv2.cvtColor(read, cv2.COLOR_BGR2RGB) if read is not None else None
    height, width = image.shape[:2]
    return cv2.resize(image, (max(width // 2, 1), max(height // 2, 1)),
                      interpolation=cv2.INTER_AREA)


def _shrink(confidence: np.ndarray, side: int) -> np.ndarray:
    scale = side / max(confidence.shape)
    if scale >= 1:
        return confidence
    height, width = (max(round(length * scale), 1) for length in confidence.shape)
    return cv2.resize(confidence, (width, height), interpolation=cv2.INTER_AREA)
