"""A video without poses: the sharpest frame of every step that the picture moves."""
from collections.abc import Iterator, Sequence
from pathlib import Path

import cv2
from neo_ros.captures.camera_file import read_camera_file
from neo_ros.captures.capture import Capture, CapturedFrame, origin_of
from neo_ros.errors import SceneError
from neo_ros.machine.progress import no_progress, Progress
from neo_ros.pictures.sharpness import sharpness
import numpy as np

VIDEO_SUFFIXES = ('.mp4', '.mov', '.avi', '.mkv', '.webm', '.m4v')
# A step ends where corners have moved by so much of the picture's width, or most are lost:
# neighbours then share about nine tenths of what they show.
STEP = 0.08
_TRACK_WIDTH, _CORNERS, _LOST = 320, 300, 0.5


def read_video(source: Path, progress: Progress = no_progress,
               camera_info: Path | None = None) -> Capture:
    """
    Choose frames of a video for structure from motion.

    camera_info: the calibration of its frames, else the camera is estimated.

    Progress is shown of videos that say how many frames they have. Raises SceneError for files
    that are no video.
    """
    lens = None if camera_info is None else read_camera_file(camera_info)
    total = _frame_count(source)
    chosen: list[int] = []
    best, count = (-1, -1.0), 0
    start: _Corners | None = None
    for index, image in _frames(source):
        count = index + 1
        grey = _small(image)
        if start is None or start.moved(grey) > STEP:
            chosen += [best[0]] if start is not None else []
            start, best = _Corners(grey), (-1, -1.0)
        score = sharpness(image)
        if score > best[1]:
            best = (index, score)
        if count < total:
            progress(count, total)
    if start is None:
        raise SceneError(f'{source}: expected a video that OpenCV can read, got no frame')
    chosen.append(best[0])
    if total > 0:
        progress(count, count)  # Many videos say a few more or less than they have.

    def stream(indices: Sequence[int]) -> Iterator[tuple[int, np.ndarray | None]]:
        wanted = {chosen[index]: index for index in indices}
        if wanted:
            for number, image in _frames(source):
                if number in wanted:
                    yield wanted.pop(number), image
                if not wanted:
                    return
            yield from ((index, None) for index in wanted.values())

    note = f'{len(chosen)} frames chosen of {count}, the sharpest of every step of the picture'
    return Capture(tuple(CapturedFrame(f'images/{number:06d}.png', None, lens)
                         for number in chosen), (note,), stream, origin_of(source))


class _Corners:
    """Corners of the first frame of a step, and how far they have moved since."""

    def __init__(self, grey: np.ndarray) -> None:
        self._last = grey
        found = cv2.goodFeaturesToTrack(grey, _CORNERS, 0.01, 5)
        self._start = np.zeros((0, 1, 2), np.float32) if found is None else found
        self._now = self._start
        self._count = len(self._start)

    def moved(self, grey: np.ndarray) -> float:
        """Return the median shift over the width; infinite where too few corners are left."""
        if not len(self._now):
            return np.inf
        now, status, _ = cv2.calcOpticalFlowPyrLK(
            self._last, grey, self._now, np.empty_like(self._now))
        kept = status.ravel() == 1
        self._start, self._now, self._last = self._start[kept], now[kept], grey
        if kept.sum() < _LOST * self._count:
            return np.inf
        shift = np.linalg.norm(self._now - self._start, axis=-1)
        return float(np.median(shift)) / grey.shape[1]


def _frames(source: Path) -> Iterator[tuple[int, np.ndarray]]:
    """Yield (number, RGB uint8 (H, W, 3)) of all frames."""
    video = cv2.VideoCapture(str(source))
    try:
        number = 0
        while True:
            there, image = video.read()
            if not there:
                return
            yield number, cv2.cvtColor(image, cv2.COLOR_BGR2RGB)
            number += 1
    finally:
        video.release()


def _frame_count(source: Path) -> int:
    """Return how many frames the file says it has; 0 or less if it does not."""
    video = cv2.VideoCapture(str(source))
    try:
        return int(video.get(cv2.CAP_PROP_FRAME_COUNT))
    finally:
        video.release()


def _small(image: np.ndarray) -> np.ndarray:
    grey = cv2.cvtColor(image, cv2.COLOR_RGB2GRAY)
    if grey.shape[1] <= _TRACK_WIDTH:
        return grey
    size = (_TRACK_WIDTH, max(1, round(grey.shape[0] * _TRACK_WIDTH / grey.shape[1])))
    return cv2.resize(grey, size, interpolation=cv2.INTER_AREA)
