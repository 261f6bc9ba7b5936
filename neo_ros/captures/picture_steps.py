"""Frames for structure from motion: the sharpest of every step that the picture moves."""
import cv2
from neo_ros.captures.capture import Capture
from neo_ros.errors import SceneError
from neo_ros.machine.progress import no_progress, Progress
from neo_ros.pictures.sharpness import sharpness
import numpy as np

# A step ends where corners have moved by so much of the picture's width, or most are lost:
# neighbours then share about nine tenths of what they show.
STEP = 0.08
_TRACK_WIDTH, _CORNERS, _LOST = 320, 300, 0.5


class PictureSteps:
    """Chooses frames while they are read, one after the other."""

    def __init__(self) -> None:
        self._ended: list[int] = []
        self._start: _Corners | None = None
        self._best = (-1, -1.0)

    def add(self, index: int, image: np.ndarray) -> None:
        """Take the next frame, RGB uint8 (H, W, 3)."""
        grey = _small(image)
        if self._start is None or self._start.moved(grey) > STEP:
            self._ended = self.chosen
            self._start, self._best = _Corners(grey), (-1, -1.0)
        score = sharpness(image)
        if score > self._best[1]:
            self._best = (index, score)

    @property
    def chosen(self) -> list[int]:
        """The indices of the sharpest frames, one of each step, the last one included."""
        return self._ended + ([self._best[0]] if self._start is not None else [])


def chosen_note(chosen: int, count: int) -> str:
    """Say how many frames were chosen."""
    return f'{chosen} frames chosen of {count}, the sharpest of every step of the picture'


def select_by_picture(capture: Capture, progress: Progress = no_progress) -> Capture:
    """
    Keep the sharpest frame of every step that the picture moves; no poses are needed.

    Frames that cannot be read are never kept. Raises SceneError where no frame can be read.
    """
    steps = PictureSteps()
    for done, (index, image) in enumerate(capture.images(range(len(capture))), start=1):
        if image is not None:
            steps.add(index, image)
        progress(done, len(capture))
    chosen = sorted(steps.chosen)  # A bag gives images as they were recorded, not by their stamps.
    if not chosen:
        raise SceneError(f'none of the {len(capture)} images can be read')
    return capture.subset(chosen, chosen_note(len(chosen), len(capture)))


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
        # Images of a bag may change their size: what writes them says so.
        if not len(self._now) or grey.shape != self._last.shape:
            return np.inf
        now, status, _ = cv2.calcOpticalFlowPyrLK(
            self._last, grey, self._now, np.empty_like(self._now))
        kept = status.ravel() == 1
        self._start, self._now, self._last = self._start[kept], now[kept], grey
        if kept.sum() < _LOST * self._count:
            return np.inf
        shift = np.linalg.norm(self._now - self._start, axis=-1)
        return float(np.median(shift)) / grey.shape[1]


def _small(image: np.ndarray) -> np.ndarray:
    grey = cv2.cvtColor(image, cv2.COLOR_RGB2GRAY)
    if grey.shape[1] <= _TRACK_WIDTH:
        return grey
    size = (_TRACK_WIDTH, max(1, round(grey.shape[0] * _TRACK_WIDTH / grey.shape[1])))
    return cv2.resize(grey, size, interpolation=cv2.INTER_AREA)
