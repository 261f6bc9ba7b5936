"""A video of a replay: the camera's view in its place, and the widened view beside it."""
from fractions import Fraction
from pathlib import Path
from types import TracebackType

import av
from neo_ros.errors import NeoError
from neo_ros.geometry import ViewExpansion
from neo_ros.reports.strips import frame_strip
import numpy as np

# Time in an MP4 is counted in these; frames keep the distance of their stamps.
_TICKS_PER_S = 90_000
_QUALITY = {'crf': '20', 'preset': 'veryfast'}


class SideBySide:
    """
    An MP4 file (H.264) that frames are added to, as a context manager.

    Every frame stays on as long as its stamp says. The file takes its name once it is whole: what
    was there before stays until then, and where nothing comes of it. Raises NeoError where the
    file cannot be written.
    """

    def __init__(self, path: Path, expansion: ViewExpansion) -> None:
        self._expansion = expansion
        self._path = path
        self._partial = path.with_name(f'{path.name}.partial')
        self._first_ns: int | None = None
        self._last_pts = -1
        try:
            path.parent.mkdir(parents=True, exist_ok=True)
            self._file = av.open(str(self._partial), 'w', format='mp4',
                                 options={'movflags': 'faststart'})
        except OSError as error:
            raise NeoError(f'{path}: cannot write the video: {error.strerror}') from error
        self._stream = self._file.add_stream('libx264', rate=30, options=_QUALITY)
        target = expansion.target
        # Colours are stored for two by two pixels.
        self._stream.width = 2 * target.width
        self._stream.height = target.height + target.height % 2
        self._stream.pix_fmt = 'yuv420p'
        self._stream.time_base = Fraction(1, _TICKS_PER_S)

    def __enter__(self) -> 'SideBySide':
        return self

    def __exit__(self, kind: type[BaseException] | None, error: BaseException | None,
                 trace: TracebackType | None) -> None:
        try:
            if self._first_ns is not None:
                self._file.mux(self._stream.encode(None))
            self._file.close()
            if self._first_ns is not None and kind is None:
                self._partial.replace(self._path)
        except OSError as failure:
            if kind is None:
                raise self._failed(failure) from failure
        finally:
            self._partial.unlink(missing_ok=True)

    def add(self, stamp_ns: int, image: np.ndarray, wide_image: np.ndarray) -> None:
        """Add the camera's image (h, w, 3) and the wide one (H, W, 3), RGB uint8."""
        pictures = [picture for _, picture in frame_strip(
            '', self._expansion, image, wide_image).images]
        canvas = np.zeros((self._stream.height, self._stream.width, 3), np.uint8)
        both = np.hstack(pictures)
        canvas[:both.shape[0], :both.shape[1]] = both
        if self._first_ns is None:
            self._first_ns = stamp_ns
        frame = av.VideoFrame.from_ndarray(canvas, 'rgb24')
        # Stamps may go back or repeat; a video cannot.
        self._last_pts = max(self._last_pts + 1, round(
            (stamp_ns - self._first_ns) * _TICKS_PER_S / 1e9))
        frame.pts, frame.time_base = self._last_pts, Fraction(1, _TICKS_PER_S)
        try:
            self._file.mux(self._stream.encode(frame))
        except OSError as failure:
            raise self._failed(failure) from failure

    def _failed(self, failure: OSError) -> NeoError:
        return NeoError(f'{self._path}: cannot write the video: {failure.strerror}')
