"""What goes from a source to the viewers: pictures, and what is known of their sender."""
from collections.abc import Mapping
from dataclasses import dataclass, field
import json
import struct
from typing import Any

import cv2
from neo_ros.messages import encode_jpeg
from neo_ros.viewer.tiles import Tiles
import numpy as np

# The tint is smooth: a small picture of it does.
CONFIDENCE_SIDE = 256
# Of a picture for a thin link, which is half as large: a fifth of the bytes of the full one.
SMALL_QUALITY = 50
# What can be shown beside a picture.
TRUTH, CAMERAS = 'truth', 'cameras'


@dataclass(frozen=True)
class SourcePicture:
    """
    One wide picture as its source has it.

    image: uint8 RGB (H, W, 3), or the bytes of a JPEG or PNG file, which are passed on as they
    are. confidence: uint8 (H, W), 255 = sure, or None. seen: the camera's own frame as (left,
    top, width, height) in shares of the picture, or None while it is not known. captured: when
    the camera took it, time.monotonic() in seconds; timed: whether that is known, else it is
    when the picture arrived here. recorded: the log time in a bag, UNIX time in
    seconds; None for a live picture. beside: what is shown beside it, by TRUTH or CAMERAS.
    """

    image: np.ndarray | bytes
    captured: float
    timed: bool
    confidence: np.ndarray | None = None
    seen: tuple[float, float, float, float] | None = None
    recorded: float | None = None
    beside: Mapping[str, np.ndarray | Tiles] = field(default_factory=dict)


@dataclass(frozen=True)
class SourceState:
    """
    What is known of the sender.

    name: topic or bag. waiting: what it waits for, in words; empty when pictures come. level: of
    the node's diagnosis, 0 = OK, 1 = warning, 2 = error; message: its words. out_of_scene: the
    node says that the camera is not in the trained scene. recognised: whether the scene memory
    knew the place of the newest image; None for a model without one, and while it is not known.
    node_ms: the node's median latency. span: first and last log time of a bag, UNIX time in
    seconds; None for a live stream. playback: of a bag, see `Playback.describe`.
    """

    name: str
    waiting: str = ''
    level: int = 0
    message: str = ''
    out_of_scene: bool = False
    recognised: bool | None = None
    node_ms: float | None = None
    span: tuple[float, float] | None = None
    playback: dict[str, Any] | None = None


class EncodedPicture:
    """
    A picture encoded once, for any number of viewers; also half as large where that is wanted.

    A message, see `pack`, is a JSON object, the JPEG of the picture, the JPEG of the confidence,
    and the JPEG of what is beside it; the last two only if they are asked for and known. The
    object holds `seq`, `captured` (the server's clock in ms), `timed`, `seen`, `recorded`,
    `small`, `beside` (what it is) and `tiles` (of several cameras, see `Tiles.describe`).
    Raises ImageRejected for what is too large for a JPEG.
    """

    def __init__(self, seq: int, picture: SourcePicture, quality: int,
                 with_confidence: bool, with_small: bool = False) -> None:
        self.seq = seq
        self._picture = picture
        image = picture.image
        confidence = picture.confidence if with_confidence else None
        full = image if isinstance(image, bytes) else bytes(encode_jpeg(image, quality))
        self._full = self._small = _Parts(full, confidence, CONFIDENCE_SIDE, picture.beside,
                                          quality)
        half = _half(image) if with_small else None
        if half is not None:
            quality = min(quality, SMALL_QUALITY)
            self._small = _Parts(bytes(encode_jpeg(half, quality)), confidence,
                                 CONFIDENCE_SIDE // 2, {
                                     name: _half(_pixels(shown)) for name, shown in
                                     picture.beside.items()}, quality)
        self._messages: dict[tuple[bool, bool, str], bytes] = {}

    def message(self, confidence: bool, small: bool = False, beside: str = '') -> bytes:
        """Return the message for a viewer; the full picture where no small one was made."""
        wanted = confidence, small, beside
        if wanted not in self._messages:
            self._messages[wanted] = self._pack(*wanted)
        return self._messages[wanted]

    def _pack(self, confidence: bool, small: bool, beside: str) -> bytes:
        picture, parts = self._picture, self._small if small else self._full
        about: dict[str, Any] = {
            'seq': self.seq, 'captured': 1e3 * picture.captured, 'timed': picture.timed,
            'seen': picture.seen, 'recorded': picture.recorded,
            'small': parts is not self._full}
        shown = picture.beside.get(beside)
        if shown is not None:
            about['beside'] = beside
            if isinstance(shown, Tiles):
                about['tiles'] = shown.describe()
        return pack(about, parts.image, parts.confidence if confidence else b'',
                    parts.beside.get(beside, b''))


class _Parts:
    """A picture in one size, encoded, with what goes with it."""

    def __init__(self, image: bytes, confidence: np.ndarray | None, side: int,
                 beside: Mapping[str, Any], quality: int) -> None:
        self.image = image
        self.confidence = b'' if confidence is None else bytes(
            encode_jpeg(_shrink(confidence, side), quality))
        self.beside = {name: bytes(encode_jpeg(_pixels(shown), quality))
                       for name, shown in beside.items()}


def pack(about: dict[str, Any], image: bytes, second: bytes = b'', third: bytes = b'') -> bytes:
    """
    Return a message of a JSON object, a coded picture, and two that may be empty.

    Before them stand three little-endian uint32, the lengths of the object and the first two.
    """
    meta = json.dumps(about).encode()
    return b''.join((struct.pack('<III', len(meta), len(image), len(second)), meta, image, second,
                     third))


def _pixels(shown: np.ndarray | Tiles) -> np.ndarray:
    return shown.image if isinstance(shown, Tiles) else shown


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
